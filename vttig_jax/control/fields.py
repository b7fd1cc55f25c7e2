"""Fields of the parts of a simulation: numbers with default, unit, bounds and meaning.

The tables of a scenario file, its defaults and checks, the axes of a sweep and the numbers that
`tune` may change follow from these fields; see `scenario/scenario.py`.
"""

import re
from dataclasses import Field, fields
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import equinox as eqx
import msgspec
import numpy as np
from jaxtyping import Float

from ..base.arrays import Number, float64, known
from ..base.files.toml_io import key

if TYPE_CHECKING:  # users give floats, which the fields convert
    from typing import Any as Quantity
else:
    Quantity = Float[Number, ""]


def number(
    default: float | None,
    meaning: str,
    unit: str = "1",
    kind: type = float,
    signed: bool = False,
    **bounds: Any,
) -> Any:
    """Return the field of a part that holds one number; JAX may trace it.

    `bounds` are `gt`, `ge`, `lt`, `le` and, without a default, `examples`; see `key`. In Python the
    number may also be negative if it is `signed`; the bounds then hold for its absolute value.
    """
    annotated: Any = Annotated[kind, key(meaning, unit, **bounds)]
    return eqx.field(
        converter=lambda value: None if value is None else float64(value),
        default=default,
        metadata={
            "kind": annotated if default is not None else annotated | None,
            "signed": signed,
        },
    )


positive = partial(number, gt=0, le=1e9)
not_negative = partial(number, ge=0, le=1e9)


def number_fields(part: Any) -> list[Field[Any]]:
    """Return the fields of a part, or of its class, that `number` made, in their order.

    The entry `kind` of their metadata is the annotated type for `msgspec.convert`.
    """
    return [field for field in fields(part) if "kind" in field.metadata]


class Part(eqx.Module):
    """Base class of the parts of a simulation, which checks the numbers of a new part.

    **Raises** `ValueError` for a number outside its bounds, and for an array of several numbers.
    Traced values are not checked.
    """

    def __check_init__(self) -> None:
        for field in number_fields(self):
            name, value = field.name, getattr(self, field.name)
            if value is None or not known(value):
                continue
            if np.ndim(value):
                raise ValueError(
                    f"Argument `{name}` must be one number, but its shape is {np.shape(value)};"
                    " use `jax.vmap` for a batch."
                )
            try:
                size = abs(float(value)) if field.metadata["signed"] else float(value)
                msgspec.convert(size, field.metadata["kind"], strict=False)
            except msgspec.ValidationError as error:
                bounds = re.sub(r"Expected `\w+( \| null)?`(, got `float`)?", "must be", str(error))
                raise ValueError(f"Argument `{name}` {bounds}, but is {float(value):g}.") from None


def may_be_positive(value: Any) -> bool:
    """Return whether a number is above zero or traced, so that its effect must be computed."""
    return not known(value) or bool(np.any(value > 0))

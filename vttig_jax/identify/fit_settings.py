"""The settings of a fit, declared once for Python, the command line and `run.toml`.

Needs no jax.

Every field of `FitSettings` states its type, its default and its text. The keywords of
`vttig_jax.fit`, the options of `vttig fit` and the table `[options]` of a run follow from it.
"""

import inspect
import sys
from collections.abc import Callable
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from ..pair.schema import Flank

LONGEST_DELAY_S = 1.0
"""Largest delay of the driven channel in s; chosen, far beyond that of any encoder interface."""

Delay = Annotated[float, Meta(ge=-LONGEST_DELAY_S, le=LONGEST_DELAY_S)]
DelayBound = Annotated[float, Meta(gt=0, le=1e3 * LONGEST_DELAY_S)]
Share = Annotated[float, Meta(ge=0, le=0.1)]
Positive = Annotated[float, Meta(gt=0, le=sys.float_info.max)]


def setting(text: str, metavar: str | None = None, option: str | None = None) -> Meta:
    """Describe a field: its text for `help()` and `--help`, and its option on the command line.

    The option has the name of the field, unless another one is given.
    """
    return Meta(description=text, extra={"option": option, "metavar": metavar})


class FitSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything that a user can choose about a fit beside logs, pair and harmonic orders.

    **Raises** `ValueError` naming the argument that is wrong, or the two that exclude each other.

    **Arguments**
    """

    flank: Annotated[Flank | None, setting("Use one flank only, as the paper does.")] = None
    perfect_encoders: Annotated[
        bool,
        setting("Fit no encoder eccentricity. With one flank the encoders are always perfect."),
    ] = False
    perfect_gears: Annotated[
        bool,
        setting("Fit no gear eccentricity: the first orders are those of the encoders."),
    ] = False
    delay: Annotated[
        Literal["auto", "off"] | Delay,
        setting(
            "Delay of the driven channel: fitted (auto, the default), taken as zero, or given in"
            " seconds (on the command line also as 0.5ms).",
            "auto|off|SECONDS",
        ),
    ] = "auto"
    delay_within_ms: Annotated[
        DelayBound | None,
        setting(
            "Standard deviation of the delay before the log is read, in milliseconds (on the"
            " command line also as 0.0005s). By default it is half a sampling interval, and as much"
            " as the delay that the log shows. Where the log cannot tell a delay from the backlash,"
            " the interval of the backlash follows from it.",
            "MILLISECONDS",
            "--delay-within",
        ),
    ] = None
    ratio_within: Annotated[
        Share,
        setting(
            "Standard deviation of the relative error of the ratio of a drive before the log is"
            " read; 0 for an exact one, 0.003 by default. The ratio of gears is that of their"
            " teeth.",
            "SHARE",
        ),
    ] = 0.003
    orders_within: Annotated[
        Positive,
        setting(
            "Standard deviation of orders before the log is read, in robust deviations of the"
            " transmission error; 3 by default. It is that of first orders of a drive, mesh orders,"
            " lines, and higher orders that stand out.",
            "DEVIATIONS",
        ),
    ] = 3.0
    widths_within: Annotated[
        Positive,
        setting(
            "Scale of the width of what a log need not contain (higher orders, differences between"
            " the flanks, drift, a delay that moves, a gap that depends on the speed), in multiples"
            " of what the noise hides; 1 by default.",
            "FACTOR",
        ),
    ] = 1.0
    same_zero: Annotated[
        bool | None,
        setting(
            "Do the angles of several logs count from the same zero? By default they do where the"
            ' pair file says zero = "reading".',
            option="--same-zero/--own-zero",
        ),
    ] = None
    standstill: Annotated[
        bool | None,
        setting(
            "Is the log a table of readings at standstill, or did the shafts turn? By default the"
            " log says: a table has no ramps, and no clock or unequal times between equal steps.",
            option="--standstill/--running",
        ),
    ] = None
    use_readings: Annotated[
        bool,
        setting("Let the backlash readings join the fit instead of only checking it."),
    ] = False
    lines: Annotated[
        Literal["join", "report"],
        setting(
            "Lines of the residual that are no order join the model as fractional orders of the"
            " driving shaft (join, the default), or are only reported.",
        ),
    ] = "join"

    def __post_init__(self):
        for field in fields():
            value = getattr(self, field.name)
            if getattr(value, "shape", None) == ():  # a scalar of NumPy or JAX
                value = value.item()
                msgspec.structs.force_setattr(self, field.name, value)
            try:
                msgspec.convert(value, field.type)
            except msgspec.ValidationError:
                raise ValueError(
                    f"Argument `{field.name}` must be {_expected(field.type)}, but is {value!r}."
                ) from None
        if self.perfect_encoders and self.perfect_gears:
            raise ValueError(
                "Arguments `perfect_encoders` and `perfect_gears` together leave nothing to fit;"
                " give one."
            )
        if self.delay != "auto" and self.delay_within_ms is not None:
            raise ValueError(
                "Arguments `delay` and `delay_within_ms` exclude each other, because the bound is"
                " for a delay that nothing else tells; give one of them."
            )

    @property
    def kinds(self) -> tuple[str, ...]:
        """Which of `vttig_jax.model.gears.KINDS` are fitted."""
        return ("",) * (not self.perfect_gears) + ("_encoder",) * (not self.perfect_encoders)


BATCH = tuple(
    name for name in FitSettings.__struct_fields__ if name not in ("same_zero", "use_readings")
)
"""Settings of a fit of many logs, each of a rig of its own."""


class Field(NamedTuple):
    """One setting: its name, type with bounds, default, text, option and metavar."""

    name: str
    type: Any
    default: Any
    text: str
    option: str
    metavar: str | None


@cache
def fields() -> tuple[Field, ...]:
    """List the settings in the order of their declaration."""
    found = []
    for field in msgspec.structs.fields(FitSettings):
        shown = field.type.__metadata__[-1]
        option = shown.extra["option"] or f"--{field.name.replace('_', '-')}"
        own = field.name, field.type, field.default, shown.description
        found.append(Field(*own, option, shown.extra["metavar"]))
    return tuple(found)


def from_keywords(settings: FitSettings | None, changes: dict[str, Any]) -> FitSettings:
    """Apply keywords of `vttig_jax.fit` to its settings.

    **Raises** `TypeError` for a keyword that is no setting.
    """
    unknown = sorted(set(changes).difference(FitSettings.__struct_fields__))
    if unknown:
        raise TypeError(
            f"`fit` has no argument `{unknown[0]}`; its settings are"
            f" {', '.join(FitSettings.__struct_fields__)}."
        )
    return replace(settings or FitSettings(), **changes)


Function = TypeVar("Function", bound=Callable[..., Any])


def takes_settings(function: Function) -> Function:
    """Show the fields of `FitSettings` in the signature of a function with `**changes`."""
    signature = inspect.signature(function)
    kept = [p for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD]
    named = [
        inspect.Parameter(field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default)
        for field in fields()
    ]
    function.__signature__ = signature.replace(parameters=kept + named)  # pyright: ignore
    return function


def _expected(kind: Any) -> str:
    """Say in words which values a type allows."""
    words, others = [], []
    for member in members(kind):
        if get_origin(member) is Literal:
            words += [f'"{word}"' for word in get_args(member)]
        elif member is not NoneType:
            others.append(_range(member))
    *first, last = [*words, *others]
    return f"{', '.join(first)} or {last}" if first else last


def members(kind: Any) -> tuple[Any, ...]:
    """Return the members of a union, each with its own bounds only."""
    if get_origin(kind) is Annotated and kind.__metadata__[-1].extra:
        *bounds, _ = kind.__metadata__
        kind = Annotated[kind.__origin__, *bounds] if bounds else kind.__origin__
    return get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)


def _range(kind: Any) -> str:
    if get_origin(kind) is Annotated:
        bounds = kind.__metadata__[0]
        if bounds.gt == 0:
            limit = "" if bounds.le == sys.float_info.max else f" of at most {bounds.le:g}"
            return f"a positive number{limit}"
        return f"a number in {bounds.ge:g} … {bounds.le:g}"
    return "True or False"


FitSettings.__doc__ = inspect.cleandoc(FitSettings.__doc__ or "") + "".join(
    f"\n- `{field.name}`: {field.text}" for field in fields()
)

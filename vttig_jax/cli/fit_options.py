"""Command-line options for the settings of a fit, generated from the fields of `FitSettings`."""

import math
import re
from collections.abc import Callable
from typing import Annotated, Any, Literal, get_args, get_origin

import click

from ..base.errors import UsageError
from ..identify.fit_settings import BATCH, LONGEST_DELAY_S, REMOVED, Field, fields, members
from .options import POSITIVE, with_options

_UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?) ?(s|ms|us|µs)?")


class TimeParam(click.ParamType):
    """Option type for a time: a number with a unit, a plain number of `unit`, or one of `words`.

    With words it is a delay of either sign; without them it must be positive.
    """

    def __init__(self, name: str, unit: str, words: tuple[str, ...] = ()):
        self.name, self.unit, self.words = name, unit, words

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> str | float:
        """Return the word or the time in `unit`, or report a usage error."""
        if value in self.words:
            return value
        match = _NUMBER.fullmatch(str(value).strip())
        seconds = float(match[1]) * _UNITS_S[match[2] or self.unit] if match else math.nan
        if self.words and not abs(seconds) <= LONGEST_DELAY_S:
            self.fail(
                f"{value!r} is neither {', '.join(self.words)} nor a number of seconds, or"
                f" one with its unit, such as 0.5ms, within ±{LONGEST_DELAY_S:g} s.",
                param,
                ctx,
            )
        if not self.words and not 0 < seconds < math.inf:
            self.fail(
                f"{value!r} is no positive time; give milliseconds, or a number with its unit, such"
                " as 0.5ms or 0.0005s.",
                param,
                ctx,
            )
        return float(f"{seconds / _UNITS_S[self.unit]:.15g}")  # 0.0005 s is 0.5 ms


def model_options(function: Callable[..., None]) -> Callable[..., None]:
    """Add to a command one option for every field of `FitSettings`."""
    removed = (
        _removed("--" + name.replace("_", "-"), instead, flag=default is False)
        for name, (default, instead) in REMOVED.items()
    )
    return with_options(function, (*removed, *map(_option, fields())))


def _removed(option: str, instead: str, *, flag: bool) -> Callable[..., Any]:
    """Return a hidden option of an older version, which says what takes its place."""

    def refuse(ctx: click.Context, param: click.Parameter, value: Any) -> None:
        if value:
            raise UsageError(f"{option} is no option any more: {instead}; leave it out.")

    return click.option(
        option, is_flag=flag, multiple=not flag, hidden=True, expose_value=False, callback=refuse
    )


def batch_options(function: Callable[..., None]) -> Callable[..., None]:
    """Add to a command one option for every setting of a fit of many logs."""
    return with_options(function, [_option(one) for one in fields() if one.name in BATCH])


def _option(field: Field) -> Callable[[Callable[..., None]], Callable[..., None]]:
    return click.option(
        field.option,
        field.name,
        default=field.default,
        help=field.text,
        metavar=field.metavar,
        **_kind(field),
    )


def _kind(field: Field) -> dict[str, Any]:
    """Return the keywords of `click.option` that follow from the type of a field."""
    kinds = members(field.type)
    words = tuple(word for kind in kinds if get_origin(kind) is Literal for word in get_args(kind))
    numbers = [kind for kind in kinds if get_origin(kind) is Annotated]
    if words and numbers:
        return {"type": TimeParam("delay", "s", words)}
    if words:
        return {"type": click.Choice(words)}
    if field.name.endswith("_ms"):
        return {"type": TimeParam("milliseconds", "ms")}
    if numbers:
        bounds = get_args(numbers[0])[1]
        limits = bounds.gt is None
        return {"type": click.FloatRange(bounds.ge, bounds.le) if limits else POSITIVE}
    return {"is_flag": True}

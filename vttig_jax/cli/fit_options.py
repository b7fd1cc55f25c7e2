"""Command-line options for the settings of a fit, generated from the fields of `FitSettings`."""

import math
import re
from typing import Annotated, Any, Literal, get_args, get_origin

import click

from ..base.errors import UsageError
from ..identify.fit_settings import (
    BATCH,
    LONGEST_DELAY_S,
    Field,
    FitSettings,
    fields,
    members,
)
from .drive_options import GROUPS
from .options import POSITIVE, Gathered, Parsed

_UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?) ?(s|ms|us|µs)?")


def time_type(name: str, unit: str, words: tuple[str, ...] = ()) -> Parsed:
    """Return the option type for a time: a number with a unit, or one of `unit`, or a word.

    With words it is a delay of either sign; without them it must be positive.
    """

    def parse(text: str) -> str | float:
        if text in words:
            return text
        match = _NUMBER.fullmatch(text.strip())
        seconds = float(match[1]) * _UNITS_S[match[2] or unit] if match else math.nan
        if words and not abs(seconds) <= LONGEST_DELAY_S:
            raise ValueError(
                f"{text!r} is neither {', '.join(words)} nor a number of seconds, or one with its"
                f" unit, such as 0.5ms, within ±{LONGEST_DELAY_S:g} s."
            )
        if not words and not 0 < seconds < math.inf:
            raise ValueError(
                f"{text!r} is no positive time; give milliseconds, or a number with its unit, such"
                " as 0.5ms or 0.0005s."
            )
        return float(f"{seconds / _UNITS_S[unit]:.15g}")  # 0.0005 s is 0.5 ms

    return Parsed(name, parse)


def _option(field: Field) -> click.Parameter:
    """Return the option of a setting; the type of the option follows from that of the field."""
    kinds = members(field.type)
    words = tuple(word for kind in kinds if get_origin(kind) is Literal for word in get_args(kind))
    numbers = [kind for kind in kinds if get_origin(kind) is Annotated]
    settings: dict[str, Any] = {"is_flag": True}
    if words:
        kind = time_type("delay", "s", words) if numbers else click.Choice(words)
        settings = {"type": kind}
    elif field.name.endswith("_ms"):
        settings = {"type": time_type("milliseconds", "ms")}
    elif numbers:
        bounds = get_args(numbers[0])[1]
        limits = bounds.gt is None
        settings = {"type": click.FloatRange(bounds.ge, bounds.le) if limits else POSITIVE}
    return click.Option(
        [field.option, field.name],
        default=field.default,
        help=field.text,
        metavar=field.metavar,
        **settings,
    )


def settings_of(**values: Any) -> FitSettings:
    """Return the settings of a fit from the options of a command: name → value.

    **Raises** `UsageError` for two options that exclude each other.
    """
    try:
        return FitSettings(**values)
    except ValueError as error:
        message = str(error).removeprefix("Arguments ").removeprefix("Argument ")
        for field in fields():
            message = message.replace(f"`{field.name}`", field.option.split("/")[0])
        raise UsageError(message) from None


Settings = Annotated[FitSettings, Gathered([_option(one) for one in fields()], settings_of)]
"""Parameter of a verb that fits: one option for every field of `FitSettings`."""

BatchSettings = Annotated[
    FitSettings,
    Gathered([_option(one) for one in fields() if one.name in BATCH], settings_of),
]
"""Parameter of a verb that fits many logs: one option for each field that applies to them."""

OF_A_FIT = {*(name for names in GROUPS.values() for name in names), *(one.name for one in fields())}
"""Parameters that say how a fit is made, beside its files."""

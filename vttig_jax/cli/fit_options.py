"""Click options of the settings of a fit, made from `FitSettings`."""

import math
from collections.abc import Callable
from typing import Annotated, Any, Literal, get_args, get_origin

import click

from ..identify.settings import LONGEST_DELAY_S, Field, fields, members
from .options import POSITIVE


class DelayParam(click.ParamType):
    """One of some words, or a number of seconds."""

    name = "delay"

    def __init__(self, words: tuple[str, ...]):
        self.words = words

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> str | float:
        """Return the word or the number; anything else is a usage error."""
        if value in self.words:
            return value
        try:
            seconds = float(value)
        except ValueError:
            seconds = math.nan
        if not abs(seconds) <= LONGEST_DELAY_S:
            self.fail(
                f"{value!r} is neither {', '.join(self.words)} nor a number of seconds"
                f" within ±{LONGEST_DELAY_S:g}.",
                param,
                ctx,
            )
        return seconds


def model_options(function: Callable[..., None]) -> Callable[..., None]:
    """Give a verb one option for every field of `FitSettings`."""
    for field in reversed(fields()):
        function = _option(field)(function)
    return function


def _option(field: Field) -> Callable[[Callable[..., None]], Callable[..., None]]:
    return click.option(
        field.option,
        field.name,
        default=field.default if field.default != () else None,
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
        return {"type": DelayParam(words)}
    if words:
        return {"type": click.Choice(words)}
    if numbers:
        kind, bounds = get_args(numbers[0])
        return {"type": POSITIVE if kind is float else click.IntRange(bounds.ge, bounds.le)}
    if get_origin(kinds[0]) is tuple:
        return {"type": click.Choice(get_args(get_args(kinds[0])[0])), "multiple": True}
    return {"is_flag": True}

"""How a log is read: `--column`, `--decimal` and `--sample-rate`, the same for every verb."""

from collections.abc import Callable, Iterable

import click

from ..base.errors import UsageError
from ..logs.columns import ROLES
from .options import POSITIVE


def log_options(function: Callable[..., None]) -> Callable[..., None]:
    """Give a verb the options `columns` (texts ROLE=NAME), `decimal` and `sample_rate`."""
    for option in reversed(
        [
            click.option(
                "--column",
                "columns",
                multiple=True,
                metavar="ROLE=NAME",
                callback=_checked,
                help=f"Name the column of a role ({', '.join(ROLES)}); may be repeated. #1 is the"
                " first column of a text file, #row the number 0, 1, 2, … of the row.",
            ),
            click.option("--decimal", type=click.Choice([".", ","]), help="Decimal mark."),
            click.option(
                "--sample-rate",
                type=POSITIVE,
                metavar="HZ",
                help="Samples per second, in place of a time column.",
            ),
        ]
    ):
        function = option(function)
    return function


def roles_of(columns: Iterable[str]) -> dict[str, str]:
    """Role → name of the column, from texts ROLE=NAME.

    **Raises** `UsageError` for another form, a role there is not and one that is named twice.
    """
    named: dict[str, str] = {}
    for text in columns:
        role, equals, name = text.partition("=")
        if not equals or not name or role not in ROLES:
            raise UsageError(
                f"--column {text!r} must be ROLE=NAME with a role of {', '.join(ROLES)}."
            )
        if role in named:
            raise UsageError(f"--column: `{role}` is named twice; keep one of the two.")
        named[role] = name
    return named


def _checked(
    context: click.Context, parameter: click.Parameter, columns: tuple[str, ...]
) -> tuple[str, ...]:
    roles_of(columns)
    return columns

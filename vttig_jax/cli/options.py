"""Options that all verbs share, and options for reading a log."""

import functools
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from ..base.errors import UsageError
from ..base.files.limits import most_memory
from ..logs.readers.column_names import ROLES
from ..logs.recognition.request import roles_of
from .completion import columns_of_log
from .output import Narrator, Output
from .program_cache import kept_programs


class Finite(click.FloatRange):
    """Number that is neither NaN nor infinite, with the bounds of `click.FloatRange`."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number, or report a usage error."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number

    def _describe_range(self) -> str:
        """Return "" if there are no bounds, for which click would print `x<=None`."""
        return "" if self.min is None and self.max is None else super()._describe_range()


class KeyValue(click.ParamType):
    """Option type KEY=VALUE, or KEY alone where a value is `optional` and then None.

    `parse` returns the value of a text, and raises `ValueError` for a wrong text; it gets the key
    too, for its message.
    """

    def __init__(self, name: str, parse: Callable[[str, str], Any], *, optional: bool = False):
        self.name, self.parse, self.optional = name, parse, optional

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, Any]:
        """Return the key and the value, or report a usage error."""
        if isinstance(value, tuple):
            return value
        key, equals, text = (part.strip() for part in value.partition("="))
        if self.optional and not equals:
            return key, None
        if not (key and equals and text):
            self.fail(f"{value!r} is not of the form {self.name}.", param, ctx)
        try:
            return key, self.parse(key, text)
        except ValueError as error:
            self.fail(str(error), param, ctx)


def once(option: str, pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return the pairs of a repeatable option KEY=VALUE, each key of which may be given once."""
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise UsageError(f"{option} {key} is given twice; give it once.")
        found[key] = value
    return found


POSITIVE = Finite(min=0, min_open=True)
STEP_DEG = Finite(min=0, min_open=True, max=360)
"""Difference of the driving angle between two rows of a table, deg, at most one turn."""


class GroupedCommand(click.Command):
    """Command whose help lists its options under several titles.

    `groups` is title → names of parameters; options in no group follow under "Options".
    """

    groups: Mapping[str, Collection[str]] = {}

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options of each group, and the others at the end."""
        shown = {p.name: record for p in self.get_params(ctx) if (record := p.get_help_record(ctx))}
        for title, names in self.groups.items():
            with formatter.section(title):
                formatter.write_dl([shown.pop(name) for name in names if name in shown])
        if shown:
            with formatter.section("Options"):
                formatter.write_dl(list(shown.values()))


def verb(
    name: str,
    *,
    example: str,
    compiles: bool = True,
    groups: Mapping[str, Collection[str]] | None = None,
) -> Callable[[Callable[..., None]], click.Command]:
    """Make a function a command of `vttig` with the shared options.

    The function receives an `Output` as its first argument, then its own options by name. Its
    docstring is the help text. Each line of `example` is a command line, printed below the options.
    If `compiles` is true, the compiled programs of the command are stored for its next run.
    `groups` is title → names of the parameters that the help lists under this title.
    """

    def decorate(function: Callable[..., None]) -> click.Command:
        lines = "\n".join(f"  {line}" for line in example.strip().splitlines())
        made = click.command(
            name,
            cls=GroupedCommand,
            epilog=f"\b\nExample:\n{lines}",
            context_settings={"help_option_names": ["-h", "--help"]},
        )(_with_shared_options(function, name if compiles else None))
        made.groups = groups or {}
        return made

    return decorate


def given(names: Collection[str]) -> list[str]:
    """Return those of the parameters `names` that the user gave.

    Each is written as on the command line, for example `LOG` or `--pair`.
    """
    context = click.get_current_context()
    return [
        re.sub(r"\W", "", parameter.metavar or "")
        if isinstance(parameter, click.Argument)
        else "/".join([parameter.opts[0], *parameter.secondary_opts])
        for parameter in context.command.params
        if parameter.name in names
        and context.get_parameter_source(parameter.name) is not ParameterSource.DEFAULT
        and context.params[parameter.name] != ()  # click 8.2 reports an empty LOG as given
    ]


def exclude_each_other(*names: str) -> None:
    """Raise `UsageError` if the user gave more than one of the parameters `names`."""
    if len(asked := given(names)) > 1:
        raise UsageError(f"{' and '.join(asked)} exclude each other; give one of them.")


def need(name: str, *needing: str) -> None:
    """Raise `UsageError` if the user gave one of the parameters `needing` without `name`."""
    if (asked := given(needing)) and not given([name]):
        raise UsageError(f"{' and '.join(asked)} without --{name}; give it too, or leave it out.")


def refuse_existing(path: Path, *, overwrite: bool) -> None:
    """Raise `UsageError`, before any work, for a file that would be replaced unasked."""
    if path.exists() and not overwrite:
        raise UsageError("already exists; add --overwrite or choose another name.", where=str(path))


@contextmanager
def arguments_as_options(names: Mapping[str, str] = {}) -> Iterator[None]:
    """Turn an error about the argument of a function into a usage error about its option.

    `names`: options whose name is not that of the argument with dashes.
    """
    try:
        yield
    except ValueError as error:
        if not str(error).startswith("Argument `"):
            raise
        name, _, rest = str(error).removeprefix("Argument `").partition("`")
        raise UsageError(names.get(name, "--" + name.replace("_", "-")) + rest) from error


def _with_shared_options(function: Callable[..., None], kept: str | None) -> Callable[..., None]:
    """Add the options that all commands share.

    `kept` is the name under which compiled programs are stored; with None, none are stored.
    """

    @click.option("--json", "as_json", is_flag=True, help="Print one JSON object to stdout.")
    @click.option(
        "-v",
        "--verbose",
        count=True,
        help="Explain the words of the report below it, and say more on stderr; -vv says all.",
    )
    @click.option("-q", "--quiet", is_flag=True, help="Errors only, no progress bar.")
    @click.option(
        "--log-file",
        type=click.Path(dir_okay=False, path_type=Path),
        help="Append all messages, and the traceback of a defect, to this file.",
    )
    @click.option(
        "--most-memory",
        "most_memory_gib",
        type=Finite(0.0, 1 << 20, min_open=True),  # up to a pebibyte
        metavar="GIB",
        help="Memory that a file may take when it is read, instead of 64 times its size (at least"
        " 0.25 GiB, at most half of the free memory).",
    )
    @functools.wraps(function)
    def wrapper(
        as_json: bool,
        verbose: int,
        quiet: bool,
        log_file: Path | None,
        most_memory_gib: float | None,
        **own: Any,
    ) -> None:
        if verbose and quiet:
            raise click.UsageError("Options -v and -q exclude each other; give one of them.")
        output = Output(json=as_json, quiet=quiet, verbose=verbose > 0)
        with ExitStack() as stack:
            narrator = click.get_current_context().find_object(Narrator)
            if narrator is None:
                narrator = stack.enter_context(Narrator())
            narrator.tune(verbose, quiet, log_file)
            limit = None if most_memory_gib is None else int(most_memory_gib * 2**30)
            stack.enter_context(most_memory(limit))
            if kept is not None:
                stack.enter_context(kept_programs(kept))
            function(output, **own)
            output.finish()

    return wrapper


def _checked(
    context: click.Context, parameter: click.Parameter, columns: tuple[str, ...]
) -> tuple[str, ...]:
    roles_of(columns)
    return columns


_OF_READING = (
    click.option(
        "--column",
        "columns",
        multiple=True,
        metavar="ROLE=NAME",
        callback=_checked,
        shell_complete=columns_of_log,
        help=f"Name the column of a role ({', '.join(ROLES)}); may be repeated. #1 is the"
        " first column of a text file, #row the number 0, 1, 2, … of the row, and 0.5*(a+b)"
        " is computed from two columns.",
    ),
    click.option(
        "--quadrature",
        multiple=True,
        metavar="ROLE=A,B",
        callback=_checked,
        help="Count the angle of a shaft from the levels of two channels, A and B or STEP"
        " and DIR; may be repeated.",
    ),
    click.option("--decimal", type=click.Choice([".", ","]), help="Decimal mark."),
    click.option(
        "--sample-rate",
        type=POSITIVE,
        metavar="HZ",
        help="Samples per second, in place of a time column.",
    ),
    click.option(
        "--from",
        "start",
        metavar="PLACE",
        help="Read the log from here: seconds, or turns of the driving shaft such as 3rev,"
        " since its first sample.",
    ),
    click.option("--to", "stop", metavar="PLACE", help="Read the log up to here."),
    click.option(
        "--cut",
        multiple=True,
        metavar="A:B",
        help="Leave out this part, such as 18:21 or 3rev:4rev; may be repeated.",
    ),
    click.option(
        "--missing",
        type=click.Choice(["skip"]),
        help="Leave out the rows in which a column that is used has no number.",
    ),
    click.option("--lead-mm", type=POSITIVE, help="Travel in one turn of an axis in mm or µm."),
    click.option("--radius-mm", type=POSITIVE, help="Radius of a dial gauge that shows mm or µm."),
)
"""Options of `ReadingOptions`; `--quadrature ROLE=A,B` is `--column ROLE=quadrature(A,B)`, and
`--radius-mm` is the `--lead-mm` of its circumference."""


def log_options(function: Callable[..., None]) -> Callable[..., None]:
    """Add the options for reading a log to a verb, which receives those of `ReadingOptions`."""

    @functools.wraps(function)
    def wrapper(*arguments: Any, quadrature: tuple[str, ...], **options: Any) -> None:
        counted = (one.partition("=") for one in quadrature)
        columns = tuple(f"{role}=quadrature({channels})" for role, _, channels in counted)
        options["columns"] = (*options["columns"], *columns)
        if (radius_mm := options.pop("radius_mm")) is not None:
            if options["lead_mm"] is not None:
                raise UsageError("--radius-mm and --lead-mm are both given; keep one of them.")
            options["lead_mm"] = math.tau * radius_mm
        function(*arguments, **options)

    return with_options(wrapper, _OF_READING)


def gathered(
    function: Callable[..., None],
    options: Sequence[Callable[..., Any]],
    name: str,
    names: Collection[str],
    make: Callable[..., Any],
) -> Callable[..., None]:
    """Add options to a verb, which receives them as one argument `name`.

    The argument is what `make` returns for the parameters `names` of the options.
    """

    @functools.wraps(function)
    def wrapper(*arguments: Any, **given: Any) -> None:
        made = make(**{one: given.pop(one) for one in names})
        function(*arguments, **{name: made}, **given)

    return with_options(wrapper, options)


def with_options(
    function: Callable[..., None], options: Sequence[Callable[..., Any]]
) -> Callable[..., None]:
    """Return a command to which options are added, in the order in which the help lists them."""
    return functools.reduce(lambda made, option: option(made), reversed(options), function)

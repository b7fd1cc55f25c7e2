"""Options that all verbs share, and options for reading a log."""

import inspect
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

import click
from click.core import ParameterSource

from ..base.errors import InputError, UsageError
from ..base.files.limits import most_memory
from ..logs.readers.column_names import ROLES
from ..logs.recognition.request import ReadingOptions, roles_of
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


class Parsed(click.ParamType):
    """Option type whose value `parse` makes of a text; it raises `ValueError` with the sentence."""

    def __init__(self, name: str, parse: Callable[[str], Any]):
        self.name, self.parse = name, parse

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the value, or report a usage error; a default is no text."""
        try:
            return self.parse(value) if isinstance(value, str) else value
        except ValueError as error:
            self.fail(str(error), param, ctx)


def key_value(name: str, parse: Callable[[str, str], Any], *, optional: bool = False) -> Parsed:
    """Return the option type KEY=VALUE, or KEY alone where a value is `optional` and then None.

    `parse` gets the text of the value, and the key for its message.
    """

    def pair(text: str) -> tuple[str, Any]:
        key, equals, value = (part.strip() for part in text.partition("="))
        if optional and not equals:
            return key, None
        if not (key and equals and value):
            raise ValueError(f"{text!r} is not of the form {name}.")
        return key, parse(key, value)

    return Parsed(name, pair)


def once(option: str, pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return the pairs of a repeatable option KEY=VALUE, each key of which may be given once."""
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise UsageError(f"{option} {key} is given twice; give it once.")
        found[key] = value
    return found


POSITIVE = Finite(min=0, min_open=True)
Positive = Annotated[float, POSITIVE]
NotNegative = Annotated[float, Finite(min=0)]
Real = Annotated[float, Finite()]
StepDeg = Annotated[float, Finite(min=0, min_open=True, max=360)]
"""Difference of the driving angle between two rows of a table, deg, at most one turn."""


class Argument(NamedTuple):
    """Mark of a parameter that is an argument of the command line, with its name in the help."""

    metavar: str | None = None
    required: bool = False


class Gathered(NamedTuple):
    """Mark of a parameter that is made of several options.

    **Arguments**
    - `options`: the options. - `make`: function of their values by name.
    """

    options: Sequence[click.Parameter]
    make: Callable[..., Any]


RunPath = Annotated[Path, Argument("RUN")]
"""Parameter of a verb that reads a run folder."""

ConstantBacklash = Annotated[NotNegative | None, "Replaces the fitted one."]

Dask = Annotated[
    str | None, {"metavar": "ADDRESS"}, "Scheduler of dask.distributed to send blocks to."
]


def declared(function: Callable[..., Any]) -> list[click.Parameter]:
    """Return the options and arguments that the signature of a function declares.

    A parameter `step_deg: Annotated[Positive, "Distance of the rows."] = 1.0` is the option
    `--step-deg`. Beside the type stand, in this order, names of the option unless it is that of the
    parameter, a type of click unless that of Python says it, further keywords of click in a dict,
    and the help; or the mark `Argument` or `Gathered`. `bool` is a flag, and a tuple of any length
    is an option that may be repeated. An option is required if it has no default, and its type is
    neither of these and does not allow None.
    """
    found = []
    for name, parameter in inspect.signature(function).parameters.items():
        if get_origin(parameter.annotation) is Annotated:
            kind, *marks = get_args(parameter.annotation)
            if isinstance(marks[0], Gathered):
                found += marks[0].options
            else:
                found.append(_parameter(name, kind, marks, parameter.default))
    return found


def _parameter(name: str, kind: Any, marks: list[Any], default: Any) -> click.Parameter:
    settings: dict[str, Any] = {"required": default is inspect.Parameter.empty}
    if not settings["required"] and default is not None:
        settings["default"] = default
    if get_origin(kind) in (Union, UnionType):
        settings["required"] &= NoneType not in get_args(kind)
        kind = next(one for one in get_args(kind) if one is not NoneType)
    if get_origin(kind) is tuple:
        kind, *more = get_args(kind)
        settings |= {"multiple": True, "required": False} if more == [...] else {"nargs": 2}
    if get_origin(kind) is Annotated:
        kind, *own = get_args(kind)
        marks = [*own, *marks]
    if kind is bool:
        settings |= {"is_flag": True, "required": False}
    elif get_origin(kind) is Literal:
        settings["type"] = click.Choice(get_args(kind))
    else:
        settings["type"] = click.Path(path_type=Path) if kind is Path else kind
    argument, names = None, []
    for mark in marks:
        if isinstance(mark, Argument):
            argument = mark
        elif isinstance(mark, dict):
            settings |= mark
        elif isinstance(mark, click.ParamType):
            settings["type"] = mark
        elif mark.startswith("-"):
            names.append(mark)
        else:
            settings["help"] = mark
    if argument is None:
        return click.Option([name, *(names or ["--" + name.replace("_", "-")])], **settings)
    settings["nargs"] = -1 if settings.pop("multiple", False) else 1
    settings["required"] |= argument.required
    return click.Argument([name], metavar=argument.metavar, **settings)


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
        wrapper = _with_shared_options(function, name if compiles else None)
        lines = "\n".join(f"  {line}" for line in example.strip().splitlines())
        made = click.command(
            name,
            cls=GroupedCommand,
            epilog=f"\b\nExample:\n{lines}",
            context_settings={"help_option_names": ["-h", "--help"]},
            help=function.__doc__,
            params=[*declared(wrapper), *declared(function)],
        )(wrapper)
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


def takes_no(what: str, *names: str) -> None:
    """Raise `UsageError` if the user gave some of the parameters `names`, which `what` ignores."""
    if wrong := given(names):
        raise UsageError(f"{what} takes no {' and no '.join(wrong)}; leave it out.")


MOST_ROWS = 200_000
"""Rows of a table over the driving angle that are written unless more are asked for (chosen)."""


def require_rows(turns: float, step_deg: float, most: int = MOST_ROWS) -> None:
    """Raise `UsageError` for a table over the driving angle that has too many rows."""
    if turns * 360.0 / step_deg > most:
        least = math.ceil(turns * 360 / most * 100) / 100
        raise UsageError(
            f"{turns:g} turns in steps of {step_deg:g}° are more than {most} rows; give --step-deg"
            f" {least:g} or more, or ask for fewer turns."
        )


def refuse_out(
    path: Path, *endings: str, overwrite: bool, option: str = "--out", cure: str = ""
) -> None:
    """Raise `UsageError`, before any work, for a file that could not be written after it.

    `endings` are those of names that the option takes, and `cure` what to do about another one.
    """
    if path.is_dir():
        raise UsageError(f"{option} is a folder; name a file in it.", where=str(path))
    if path.suffix.lower() not in endings:
        *others, last = endings
        known = f"{', '.join(others)} or {last}" if others else last
        cure = cure or f"choose a name that ends with {'one' if others else last}"
        raise UsageError(f"{option} writes {known}; {cure}.", where=str(path))
    refuse_existing(path, overwrite=overwrite)


def refuse_existing(path: Path, *, overwrite: bool) -> None:
    """Raise `UsageError`, before any work, for a file that would be replaced unasked."""
    if path.exists() and not overwrite:
        raise UsageError("already exists; add --overwrite or choose another name.", where=str(path))


def refuse_results(out: Path | None, names: Iterable[str], cure: str) -> None:
    """Raise `UsageError`, before any work, for a result that `out` holds, with what to do."""
    if out is None:
        return
    if out.exists() and not out.is_dir():
        raise InputError("a file is in the way; choose another name.", where=str(out))
    for path in (out / name for name in names):
        if path.exists():
            raise UsageError(f"already exists; {cure}, or choose another folder.", where=str(path))


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
    gathers = {
        name: mark
        for name, parameter in inspect.signature(function).parameters.items()
        for mark in getattr(parameter.annotation, "__metadata__", ())
        if isinstance(mark, Gathered)
    }

    def wrapper(
        *,
        as_json: Annotated[bool, "--json", "Print one JSON object to stdout."],
        verbose: Annotated[
            int,
            "-v",
            "--verbose",
            {"count": True},
            "Explain the words of the report below it, and say more on stderr; -vv says all.",
        ] = 0,
        quiet: Annotated[bool, "-q", "--quiet", "Errors only, no progress bar."],
        log_file: Annotated[
            Path | None,
            click.Path(dir_okay=False, path_type=Path),
            "Append all messages, and the traceback of a defect, to this file.",
        ],
        most_memory_gib: Annotated[
            float | None,
            "--most-memory",
            Finite(0.0, 1 << 20, min_open=True),  # up to a pebibyte
            {"metavar": "GIB"},
            "Memory that a file may take when it is read, instead of 64 times its size (at least"
            " 0.25 GiB, at most half of the free memory).",
        ],
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
            for name, mark in gathers.items():
                own[name] = mark.make(**{one.name: own.pop(one.name) for one in mark.options})
            function(output, **own)
            output.finish()

    return wrapper


def _checked(
    context: click.Context, parameter: click.Parameter, columns: tuple[str, ...]
) -> tuple[str, ...]:
    roles_of(columns)
    return columns


class _OfReading(NamedTuple):
    columns: Annotated[
        tuple[str, ...],
        "--column",
        {"metavar": "ROLE=NAME", "callback": _checked},
        f"Name the column of a role ({', '.join(ROLES)}); may be repeated. #1 is the"
        " first column of a text file, #row the number 0, 1, 2, … of the row, and 0.5*(a+b)"
        " is computed from two columns.",
    ]
    quadrature: Annotated[
        tuple[str, ...],
        {"metavar": "ROLE=A,B", "callback": _checked},
        "Count the angle of a shaft from the levels of two channels, A and B or STEP"
        " and DIR; may be repeated.",
    ]
    decimal: Annotated[Literal[".", ","] | None, "Decimal mark."]
    sample_rate: Annotated[
        Positive | None, {"metavar": "HZ"}, "Samples per second, in place of a time column."
    ]
    start: Annotated[
        str | None,
        "--from",
        {"metavar": "PLACE"},
        "Read the log from here: seconds, or turns of the driving shaft such as 3rev,"
        " since its first sample.",
    ]
    stop: Annotated[str | None, "--to", {"metavar": "PLACE"}, "Read the log up to here."]
    cut: Annotated[
        tuple[str, ...],
        {"metavar": "A:B"},
        "Leave out this part, such as 18:21 or 3rev:4rev; may be repeated.",
    ]
    missing: Annotated[
        Literal["skip"] | None,
        "Leave out the rows in which a column that is used has no number.",
    ]
    lead_mm: Annotated[Positive | None, "Travel in one turn of an axis in mm or µm."]
    radius_mm: Annotated[Positive | None, "Radius of a dial gauge that shows mm or µm."]


def _reading(
    quadrature: tuple[str, ...], radius_mm: float | None, **reading: Any
) -> ReadingOptions:
    counted = (one.partition("=") for one in quadrature)
    reading["columns"] += tuple(f"{role}=quadrature({channels})" for role, _, channels in counted)
    if radius_mm is not None:
        if reading["lead_mm"] is not None:
            raise UsageError("--radius-mm and --lead-mm are both given; keep one of them.")
        reading["lead_mm"] = math.tau * radius_mm
    return ReadingOptions(**reading)


READING = Gathered(declared(_OfReading), _reading)
"""Options for reading a log; `--quadrature ROLE=A,B` is `--column ROLE=quadrature(A,B)`, and
`--radius-mm` is the `--lead-mm` of its circumference."""

"""`vttig simulate`: simulation of one drive with its controller, usually through a reversal."""

import math
import re
import tomllib
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from ...base.errors import ScenarioError, UsageError
from ...base.files.run_folder import RunFolder, write_files
from ...base.logger import LOGGER
from ...runs.map_table import csv_text
from ..options import Argument, key_value, need, once, refuse_out, takes_no, verb
from ..output import Output, print_text

if TYPE_CHECKING:
    from ...control.scenario.spec import ScenarioSpec
    from ...control.simulation.result import Simulation

_MOST_ROWS, _MOST_SHOWN = 20_000_000, 1_000_000
"""Largest number of rows of a trace file, and of a trace that is only for a picture."""

_LONG, _MOST_PERIODS = 2e7, 1e12
"""Number of periods above which the run is announced (minutes), and the largest (a month)."""

_QUOTED = ('"', "'", "[", "{")
"""First characters of a value that must be TOML, and not a text without quotes."""


def _toml_value(key: str, text: str) -> Any:
    """Return the value that a text has in TOML, or the text itself if it is not TOML.

    **Raises** `ValueError` for a text that is not UTF-8, and for one that is not TOML but starts
    with a quote or bracket, or has several lines.
    """
    try:
        text.encode()
    except UnicodeEncodeError:  # bytes of an argument that are no text become surrogates
        raise ValueError(f"the value of {key!r} is not UTF-8: {text}; write it in UTF-8.") from None
    try:
        table = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):  # not TOML, a number too long or a list too deep
        table = {}
    if list(table) == ["value"]:
        return table["value"]
    if text.startswith(_QUOTED) or re.search(r"[\r\n]", text):
        raise ValueError(f"the value of {key!r} is no TOML: {text}; close its quotes and brackets.")
    return text


@verb(
    "simulate",
    example="""
vttig simulate --print-defaults > scenario.toml
vttig simulate scenario.toml --figure reversal.png --trace trace.csv --every 10
vttig simulate scenario.toml --set controller=none --set motion.reversal_deg=1080
vttig simulate run --set constant_backlash_deg=0.01
vttig simulate --paper --out paper
""",
)
def command(
    output: Output,
    *,
    scenario: Annotated[Path | None, Argument("[SCENARIO]")],
    print_defaults: Annotated[bool, "Print a scenario of all keys, and stop."],
    settings: Annotated[
        tuple[tuple[str, Any], ...],
        "--set",
        key_value("key=value", _toml_value),
        "Another value for a key of SCENARIO, such as motion.reversal_deg=720; repeatable.",
    ],
    trace: Annotated[Path | None, "CSV of the run to write."],
    every: Annotated[
        int,
        click.IntRange(min=1),
        "With --trace: keep one period of the controller in this many; all by default.",
    ] = 1,
    figure: Annotated[Path | None, "PNG of the run to write."],
    paper: Annotated[bool, "Simulate the runs of the paper instead of SCENARIO."],
    out: Annotated[Path | None, "With --paper: folder for its files."],
    overwrite: Annotated[bool, "Replace files that exist."],
) -> None:
    """Simulate the drive in SCENARIO (TOML) through its motion, usually one reversal.

    The command prints the mean and the extremes of the transmission error, its jump at the change
    of flanks, the detection of the reversal by the controller, the backlash that remained open, and
    the interference where the gap was closed too far. Paths in SCENARIO are relative to it. With
    rig = { from = "RUN" } instead of [eccentricities] the plant has the map of a fitted run folder,
    and SCENARIO may be a run folder itself. A run with a failure, such as a blocked drive, is also
    a result; its outcome names the failure. --paper simulates the runs of Figs. 16-20 of the paper
    with three controllers each and prints them beside its Table 3; --out DIR keeps the table and a
    picture of every run.
    """
    if paper:
        _simulate_paper(out, overwrite, output)
        return
    if out is not None:
        raise UsageError("--out keeps the files of --paper; give that too, or --trace or --figure.")
    if print_defaults:
        names = ("scenario", "settings", "trace", "every", "figure", "overwrite", "as_json")
        takes_no("--print-defaults", *names)
        from ...control.scenario.spec import default_toml

        print_text(default_toml().rstrip("\n"))
        return
    if scenario is None:
        raise UsageError("SCENARIO is missing; --print-defaults prints one to start from.")
    need("trace", "every")
    for option, path, ending in (("--trace", trace, ".csv"), ("--figure", figure, ".png")):
        if path is not None:
            refuse_out(path, ending, overwrite=overwrite, option=option)
    from ...runs.simulations import file_named, specified

    spec, folder = specified(scenario, sweep=False)
    if scenario.is_dir():
        output.narrate(
            "a run folder has gears only: motion, controller and sampling are the defaults, which"
            " --print-defaults lists and --set motion.reversal_deg=720 and the like replace"
        )
    with file_named(scenario):
        spec, thinned = _with_settings(spec, settings), every if trace else 0
        found, kept = _simulated(spec, folder, thinned, output, draws=figure is not None)
    if trace is not None:
        rows = {name: values[:: every // kept] for name, values in found.columns().items()}
        write_files({trace: csv_text(rows)}, overwrite=overwrite)
    if figure is not None:
        from ...plotting.save import png
        from ...plotting.simulation import plot_simulation

        write_files({figure: png(plot_simulation(found))}, overwrite=overwrite)
    written = [f"written to {path}" for path in (trace, figure) if path is not None]
    output.emit(found.to_json(), "\n".join([str(found), *written]))


def _simulate_paper(out: Path | None, overwrite: bool, output: Output) -> None:
    from ...runs.paper_runs import CONTROLLERS, TABLE, simulate_paper

    takes_no("--paper", "scenario", "print_defaults", "settings", "trace", "every", "figure")
    need("out", "overwrite")
    kept = RunFolder(out, overwrite=overwrite, results=(TABLE,)) if out else nullcontext()
    names: list[str] = []
    with kept as folder, output.progress(5 * len(CONTROLLERS), "simulate") as bar:
        found = simulate_paper(trace_every=0 if folder is None else 1, progress=bar.update)
        if folder is not None:
            for name, data in found.files().items():
                folder.write_bytes(name, data)
                names.append(name)
    shown = str(found) if out is None else f"{found}\n\nwritten to {out}: {', '.join(names)}"
    output.emit(found.to_json(), shown)


def _with_settings(spec: "ScenarioSpec", settings: tuple[tuple[str, Any], ...]) -> "ScenarioSpec":
    """Return the scenario with the values of `--set`.

    **Raises** `UsageError` for a wrong value; its `where` names the option.
    """
    from ...control.scenario.spec import with_values

    values = once("--set", settings)
    if not values:
        return spec
    try:
        return with_values(spec, values)
    except ScenarioError as error:
        where = f"--set {error.where}" if error.where in values else f"with --set: {error.where}"
        raise UsageError(error.message, where=where) from None


def _simulated(
    spec: "ScenarioSpec", folder: Path, every: int, output: Output, *, draws: bool
) -> "tuple[Simulation, int]":
    """Run a scenario; return it, and the stride of its trace in periods of the controller."""
    from ...control.simulation.prepare import motion_of
    from ...runs.simulations import simulate

    duration = float(motion_of(spec.motion, folder).pieces.duration_s)
    periods = duration * spec.sampling.controller_hz
    kept = _stride(periods, every, draws)
    if not periods <= _MOST_PERIODS:
        raise UsageError(
            f"a run of {duration:.3g} s has {periods:.3g} periods, but at most"
            f" {_MOST_PERIODS:.0e} are simulated; choose a higher speed, a shorter motion or a"
            " lower rate of the controller."
        )
    if periods > _LONG:
        LOGGER.warning("to run: %.3g periods; Ctrl-C ends it and writes nothing", periods)
    with output.progress(1, "simulate") as bar:
        found = simulate(spec, folder=folder, trace_every=kept, progress=bar.reach)
    return found, kept


def _stride(periods: float, every: int, draws: bool) -> int:
    """Return the stride of the trace in controller periods; 0 for no trace.

    A CSV file gets one row for every `every` periods; 0 means no CSV file. If `draws` is true, the
    trace also serves a picture.

    **Raises** `UsageError` for a CSV file with too many rows.
    """
    if every and periods / every > _MOST_ROWS:
        raise UsageError(
            f"--trace of {periods:.3g} periods is more than {_MOST_ROWS} rows; thin it out with"
            f" --every {math.ceil(periods / _MOST_ROWS)}."
        )
    # The stride divides `every`, so that one run serves CSV file and picture.
    return math.gcd(every, math.ceil(periods / _MOST_SHOWN)) if draws else every

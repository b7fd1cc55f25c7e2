"""`vttig fit`: from a log to parameters, and to a run folder."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..base.errors import NoAnswerError, UsageError
from .options import POSITIVE, verb
from .output import LOGGER, Output
from .run_file import Run, read_run, require_same_data

if TYPE_CHECKING:
    from ..identify.result import Fit


@verb(
    "fit",
    example="""
vttig fit log.csv --pair pair.toml
vttig fit log.csv --pair pair.toml --out run --require constant_backlash_deg
vttig fit --run run/run.toml
""",
)
@click.argument("log", required=False, type=click.Path(path_type=Path))
@click.option("--pair", type=click.Path(path_type=Path), help="TOML file of the gear pair.")
@click.option(
    "--run", "run_path", type=click.Path(path_type=Path), help="Repeat the run of this run.toml."
)
@click.option("--out", type=click.Path(path_type=Path), help="Run folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace the fit that is in --out.")
@click.option("--no-figures", is_flag=True, help="Leave the pictures out of the run folder.")
@click.option("--column", "columns", multiple=True, help="ROLE=NAME of a column; repeatable.")
@click.option("--decimal", type=click.Choice([".", ","]), help="Decimal mark of the log.")
@click.option("--sample-rate", type=POSITIVE, help="Sampling rate in Hz of a log without time.")
@click.option("--flank", type=click.Choice(["A", "B"]), help="Use one flank only.")
@click.option("--perfect-encoders", is_flag=True, help="Fit no encoder eccentricity.")
@click.option(
    "--drift-order",
    type=click.IntRange(0, 6),
    help="Highest power of time; by default 0, 1 or 2, whichever the log asks for.",
)
@click.option("--require", multiple=True, help="Exit with 4 unless this parameter is determined.")
def command(
    output: Output,
    log: Path | None,
    pair: Path | None,
    run_path: Path | None,
    out: Path | None,
    overwrite: bool,
    no_figures: bool,
    require: tuple[str, ...],
    **options: Any,
) -> None:
    """Identify the eccentricity and phase of both gears and the backlash from LOG.

    LOG is a text file (CSV, TSV) with time and two encoder channels, or with one angle and the
    transmission error. Nothing is written without --out.
    """
    run = _resolve(log, pair, run_path, options)
    result, run = perform(run, output)
    _check_names(result, require)
    if out is not None:
        write_run(result, run, out, overwrite=overwrite, with_figures=not no_figures)
        LOGGER.info("written to %s", out)
    output.emit(result.to_json(), result)
    _check_required(result, require)
    if result.outcome in ("not_converged", "not_determined"):
        raise NoAnswerError(_FAILURES[result.outcome], where=result.source)


_FOLLOWING = ("map.csv", "map.json", "figures/backlash_map.png")
"""What an older fit may have left that a new one makes untrue."""

_FAILURES = {
    "not_converged": "the fit did not converge; its numbers are not to be trusted.",
    "not_determined": "the log determines no parameter; the reasons are listed above.",
}


def perform(run: Run, output: Output) -> tuple["Fit", Run]:
    """Fit the log of a run; returns the fit and the run with the hash of its log."""
    import vttig_jax

    from ..identify.fit import fit
    from ..logs.read import read_log
    from ..pair.gears import pair_from_spec

    vttig_jax.enable_x64()
    o = run.options
    columns = dict(_role_and_name(text) for text in o.get("columns") or ())
    pair = pair_from_spec(run.spec)
    log = read_log(
        run.log,
        pair,
        columns=columns,
        decimal=o.get("decimal"),
        sample_rate_hz=o.get("sample_rate"),
    )
    LOGGER.info("read %d samples from %s", len(log), run.log)
    result = fit(
        log,
        pair,
        flank=o.get("flank"),
        encoder_terms=not o.get("perfect_encoders", False),
        drift_order=o.get("drift_order"),
    )
    return result, Run(run.log, run.spec, run.options, log.sha256)


def write_run(result: "Fit", run: Run, out: Path, *, overwrite: bool, with_figures: bool) -> None:
    """Write `run.toml`, `fit.json`, `summary.npz` and the pictures."""
    from ..base.jsonio import dumps
    from ..base.runfolder import RunFolder
    from ..identify.store import fit_arrays

    with RunFolder(out, overwrite=overwrite, results=("fit.json",)) as folder:
        for name in _FOLLOWING:
            folder.discard(name)
        folder.write_toml("run.toml", run.table(out))
        folder.write_npz("summary.npz", **fit_arrays(result))
        if with_figures:
            for name, data in run_figures(result).items():
                folder.write_bytes(f"figures/{name}", data)
        folder.write_text("fit.json", dumps(result.to_json()) + "\n")


def run_figures(result: "Fit") -> dict[str, bytes]:
    """Pictures of a fit, with the map where the log fixes one: file name → PNG."""
    from ..identify.mapping import backlash_map
    from ..report.save import figures

    grid = backlash_map(result) if result.parameters["constant_backlash_deg"].determined else None
    return figures(result, grid)


def _resolve(
    log: Path | None, pair: Path | None, run_path: Path | None, options: dict[str, Any]
) -> Run:
    from ..pair.spec import load_pair_spec

    if run_path is not None:
        given = [name for name, value in options.items() if value]
        if log is not None or pair is not None or given:
            raise UsageError(
                "--run repeats a run as it was: give no LOG, no --pair and no option of the fit"
                " beside it."
            )
        run = read_run(run_path)
        require_same_data(run)
        return run
    if log is None or pair is None:
        missing = "LOG" if log is None else "--pair"
        raise UsageError(f"{missing} is missing; see `vttig fit --help`.")
    return Run(log, load_pair_spec(pair), options | {"columns": list(options["columns"])})


def _role_and_name(text: str) -> tuple[str, str]:
    role, equals, name = text.partition("=")
    if not equals or not name:
        raise UsageError(f"--column takes ROLE=NAME, but got {text!r}.")
    return role, name


def _check_names(result: "Fit", names: tuple[str, ...]) -> None:
    for name in names:
        if name not in result.parameters:
            known = ", ".join(result.parameters)
            raise UsageError(f"--require {name}: no such parameter; there are {known}.")


def _check_required(result: "Fit", names: tuple[str, ...]) -> None:
    for name in names:
        parameter = result.parameters[name]
        if not parameter.determined:
            raise NoAnswerError(
                f"{name} is required but undetermined: {parameter.reason}.", where=result.source
            )

"""`vttig fit`: from logs to parameters, and to a run folder."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ...base.errors import NoAnswerError, UsageError
from ..fit_options import model_options
from ..options import given, log_options, verb
from ..output import LOGGER, Output
from ..run_file import CHECKPOINT, RunRecord, read_run, require_same_data
from ..run_options import RunOptions

if TYPE_CHECKING:
    from ...base.files.run_folder import RunFolder
    from ...identify.fit_result import Fit
    from ...identify.report.parameters import Parameter


@verb(
    "fit",
    example="""
vttig fit log.csv --pair pair.toml
vttig fit log.csv --pair pair.toml --out run --require constant_backlash_deg
vttig fit monday.csv friday.csv --pair pair.toml --loss bisquare --regressor torque
vttig fit log.mat --pair pair.toml --column "driving=rec.pos_deg(1,:)" --sample-rate 250
vttig fit --run run/run.toml
""",
)
@click.argument("logs", metavar="[LOG]...", nargs=-1, type=click.Path(path_type=Path))
@click.option("--pair", type=click.Path(path_type=Path), help="TOML file of the gear pair.")
@click.option(
    "--run", "run_path", type=click.Path(path_type=Path), help="Repeat the run of this run.toml."
)
@click.option("--out", type=click.Path(path_type=Path), help="Run folder to write.")
@click.option("--overwrite", is_flag=True, help="Replace the fit that is in --out.")
@click.option("--no-figures", is_flag=True, help="Leave the pictures out of the run folder.")
@click.option(
    "--backlash-readings",
    "readings",
    type=click.Path(path_type=Path),
    help="CSV of driving_deg,backlash_deg (gear 1 held, gear 2 rocked) to check the fit against.",
)
@click.option("--require", multiple=True, help="Exit with 4 unless this parameter is determined.")
@log_options
@model_options
def command(
    output: Output,
    logs: tuple[Path, ...],
    pair: Path | None,
    run_path: Path | None,
    out: Path | None,
    overwrite: bool,
    no_figures: bool,
    readings: Path | None,
    require: tuple[str, ...],
    **options: Any,
) -> None:
    """Identify the eccentricity and phase of both gears and the backlash from LOG.

    LOG is a text file (CSV, TSV), a MATLAB file or an HDF5 file with time and two encoder channels,
    or with one angle and the transmission error. Several logs of one rig are fitted together: they
    share eccentricities, orders, backlash and delay. Nothing is written without --out.
    """
    if out is None and (overwrite or no_figures):
        name = "--overwrite" if overwrite else "--no-figures"
        raise UsageError(
            f"{name} says how to write a run folder; give one with --out, or leave it."
        )
    if run_path is None:
        run = resolve(logs, pair, readings, RunOptions(**options))
    else:
        run = _repeated(run_path, options)
    result, run = perform(run)
    _check_names(result, require)
    if out is not None:
        write_run(result, run, out, overwrite=overwrite, with_figures=not no_figures)
        LOGGER.info("written to %s", out)
    output.emit(result.to_json(), result)
    _check_required(result, require)
    if result.outcome in ("not_converged", "not_determined"):
        raise NoAnswerError(_FAILURES[result.outcome], where=result.source)


_FOLLOWING = (
    "map.csv",
    "map.json",
    CHECKPOINT,
    "posterior.json",
    *(f"figures/{name}.png" for name in ("te_fit", "orders", "residual", "backlash_map")),
    *(f"figures/{name}.png" for name in ("corner", "trace", "band", "predictive")),
)
"""What an older fit may have left that a new one makes untrue."""

_FAILURES = {
    "not_converged": "the fit did not converge; its numbers are not to be trusted.",
    "not_determined": "the log determines no parameter; the reasons are listed above.",
}

ON_REQUEST = {
    "torque_arcsec_per_unit": "--regressor torque",
    "acceleration_arcsec_s2_per_rad": "--regressor acceleration",
    "speed_s": "--regressor speed",
    "ratio": "--free-ratio",
}
"""Parameters that are certain to be fitted only with an option."""


def perform(run: RunRecord) -> tuple["Fit", RunRecord]:
    """Fit the logs of a run; returns the fit and the run with the hashes of its logs.

    **Raises** `UsageError` where two logs are the same file or copies of one.
    """
    import vttig_jax

    from ...identify.fitting import fit
    from ...logs.read import read_log
    from ...logs.readers.backlash_readings import read_backlash_readings
    from ...pair.load import pair_from_spec

    vttig_jax.enable_x64()
    pair = pair_from_spec(run.spec)
    logs = []
    first: dict[str, Path] = {}
    for path in run.logs:
        log = read_log(path, pair, **run.options.reading())
        if (other := first.setdefault(log.sha256, path)) is not path:
            seen = "given twice" if other == path else f"the same data as {other}"
            raise UsageError(f"{seen}; give every log once.", where=str(path))
        run.options.check_drift(log)
        logs.append(log)
    readings = None
    if run.readings is not None:
        readings = read_backlash_readings(run.readings, decimal=run.options.decimal)
    result = fit(logs, pair, readings=readings, **run.options.fitting())
    digest = "" if readings is None else readings.sha256
    return result, replace(run, sha256=tuple(first), readings_sha256=digest)


def write_run(
    result: "Fit", run: RunRecord, out: Path, *, overwrite: bool, with_figures: bool
) -> None:
    """Write a run folder: `run.toml`, `fit.json`, `summary.npz` and the pictures."""
    from ...base.files.run_folder import RunFolder

    refuse_while_sampled(out)
    with RunFolder(out, overwrite=overwrite, results=("fit.json",)) as folder:
        if (out / CHECKPOINT).exists():
            LOGGER.warning("the draws in %s were those of the fit it replaces, and go", out)
        write_fit(folder, result, run, out, with_figures=with_figures)


def refuse_while_sampled(out: Path) -> None:
    """Refuse to replace the fit of a folder that a sampler is writing to."""
    lock = out / f".{CHECKPOINT}.lock"
    if not lock.exists():
        return
    from filelock import FileLock, Timeout

    try:
        with FileLock(lock).acquire(timeout=0):
            pass
    except Timeout:
        raise UsageError(
            "a sampler is writing to this folder; wait for it or choose another folder.",
            where=str(out),
        ) from None


def write_fit(
    folder: "RunFolder", result: "Fit", run: RunRecord, out: Path, *, with_figures: bool
) -> None:
    """Write a fit into an open run folder, and take away what it makes untrue."""
    from ...base.files.json_io import dumps
    from ...identify.store import fit_arrays

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
    from ...identify.backlash import backlash_map
    from ...plotting.save import figures

    grid = backlash_map(result) if result.parameters["constant_backlash_deg"].determined else None
    return figures(result, grid)


def resolve(
    logs: tuple[Path, ...], pair: Path | None, readings: Path | None, options: RunOptions
) -> RunRecord:
    """The run that the command line asks for."""
    from ...pair.pair_file import load_pair_spec

    if not logs or pair is None:
        missing = "--pair" if logs else "LOG"
        raise UsageError(f"{missing} is missing; see `vttig fit --help`.")
    options.check(len(logs), readings=readings is not None)
    return RunRecord(logs, load_pair_spec(pair), options, readings=readings)


def _repeated(path: Path, options: dict[str, Any]) -> RunRecord:
    """The run of a `run.toml`, if nothing else is asked for beside it."""
    if asked := given({"logs", "pair", "readings", *options}):
        raise UsageError(
            f"--run repeats a run as it was; leave out {' and '.join(asked)}, or leave out --run."
        )
    run = read_run(path)
    require_same_data(run)
    return run


def _check_names(result: "Fit", names: tuple[str, ...]) -> None:
    for name in names:
        if name in ON_REQUEST and name not in _named(result):
            raise UsageError(f"--require {name}: it was not fitted; add {ON_REQUEST[name]}.")
        if name not in _named(result):
            known = ", ".join(_named(result))
            raise UsageError(f"--require {name}: no such parameter; there are {known}.")


def _check_required(result: "Fit", names: tuple[str, ...]) -> None:
    for name in names:
        parameter = _named(result)[name]
        if not parameter.determined:
            raise NoAnswerError(
                f"{name} is required but undetermined: {parameter.reason}.", where=result.source
            )


def _named(result: "Fit") -> dict[str, "Parameter"]:
    """Parameters and regressors by name."""
    return result.parameters | {one.name: one for one in result.regressors}

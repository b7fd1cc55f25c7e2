"""`vttig fit`: identification of the parameters from logs, and the run folder with the result."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from ... import report as reports
from ...base.errors import NoAnswerError, UsageError, VttigError
from ...base.logger import LOGGER
from ...identify.fit_settings import fields
from ...logs.readers.open_table import with_standard_input
from ...logs.recognition.request import in_words
from ...runs.fit_run import perform, readings_alone, resolve, save_fit
from ...runs.run_file import CHECKPOINT, RunOptions, read_run, require_same_data
from ..drive_options import GROUPS, Drive
from ..fit_options import OF_A_FIT, Settings
from ..options import Argument, given, need, refuse_results, verb
from ..output import Output

if TYPE_CHECKING:
    from ...identify.result import Fit
    from ...model.parameter import Parameter


@verb(
    "fit",
    example="""
vttig fit log.csv --ratio 64:23
vttig fit log.csv --teeth 45/80 --counts 90000,90000 --column driving=enc1 --column driven=enc2
vttig fit log.csv --pair pair.toml --out run --report --require constant_backlash_deg
vttig fit monday.csv friday.csv --pair pair.toml --delay-within 0.2ms
vttig fit log.mat --pair pair.toml --column "driving=rec.pos_deg(1,:)" --sample-rate 250
vttig fit --readings dial_gauge.csv --ratio 45:1
vttig fit --run run/run.toml
xz -dc log.csv.xz | vttig fit - --pair pair.toml --out run
""",
    groups={
        **GROUPS,
        "The result": (
            *("out", "overwrite", "no_figures", "report", "require", "readings", "run_path"),
        ),
        "The model": tuple(field.name for field in fields()),
    },
)
def command(
    output: Output,
    *,
    logs: Annotated[tuple[Path, ...], Argument("[LOG]...")],
    run_path: Annotated[Path | None, "--run", "Repeat the run of this run.toml."],
    out: Annotated[Path | None, "Run folder to write."],
    overwrite: Annotated[bool, "Replace the fit that is in --out."],
    no_figures: Annotated[bool, "Leave the pictures out of the run folder."],
    report: Annotated[bool, "Write report.html of it too; see `vttig report`."],
    readings: Annotated[
        Path | None,
        "--readings",
        "--backlash-readings",
        "CSV of driving_deg,backlash_deg (gear 1 held, gear 2 rocked) to check the fit against, or"
        " without LOG to be fitted alone.",
    ],
    require: Annotated[
        tuple[str, ...],
        "Exit with 4 unless this parameter is determined; a warning tells one that may be zero.",
    ],
    drive: Drive,
    settings: Settings,
) -> None:
    """Identify the eccentricity and phase of both gears and the backlash from LOG.

    LOG is a text file (CSV, TSV), a MATLAB file or an HDF5 file with time and two encoder channels,
    or with one angle and the transmission error. Give the ratio with --ratio or --teeth, or all
    that a drawing says with --pair. Where a log can be read in two ways the command asks. Several
    logs of one rig are fitted together: they share eccentricities, orders, backlash and delay.
    LOG may be - for stdin; it is then kept in --out, so that --run can repeat the fit. Without
    --out no file is written.
    """
    need("out", "overwrite", "no_figures", "report")
    options = RunOptions(drive.reading, settings)
    if report:
        reports.require_bokeh()
    if readings is not None and not logs and run_path is None:
        if out is not None or require:
            raise UsageError("readings alone have no run folder and no parameters; leave that out.")
        found = readings_alone(readings, drive.pair, drive.request, options)
        length = _as_length(found.backlash_deg, found.std_deg, drive.reading.lead_mm)
        output.emit(found.to_json(), "\n\n".join([str(found), *length]))
        return
    if not (drive.explain_columns or overwrite):
        refuse_results(out, (CHECKPOINT, "fit.json"), "add --overwrite to replace it")
    if run_path is None:
        logs = with_standard_input(logs)
        try:
            run = resolve(logs, drive.pair, readings, options, drive.request)
        except VttigError as error:
            if readings is not None and "in one command: " in error.message:
                error.message = f"{error.message.removesuffix('.')} --readings {readings}."
            raise
        if drive.only_explains(output, logs, run.spec, run.guesses):
            return
    else:
        if asked := given({"logs", "readings", *OF_A_FIT}):
            raise UsageError(
                f"--run repeats a run as it was; leave out {' and '.join(asked)}, or leave out"
                " --run."
            )
        run = read_run(run_path)
        require_same_data(run)
    result, run = perform(run)
    told = result.parameters | {one.name: one for one in result.regressors}
    for name in require:
        if name not in told:
            known = ", ".join(told)
            raise UsageError(f"--require {name}: no such parameter; there are {known}.")
    if out is not None:
        save_fit(result, out, overwrite=overwrite, figures=not no_figures, record=run)
        LOGGER.info("written to %s", out)
    written = []
    if report and out is not None:
        written = [f"report: {reports.write_report(out).record['report']}"]
    parts = [in_words(result.pair.ratio)] if drive.request.names_a_drive else []
    parts += [str(result), *([_noise_to_plan(result)] if output.verbose else [])]
    gap, lead_mm = result.checks.gap_over_angles_covered, run.options.reading.lead_mm
    parts += _as_length(gap.value, gap.std, lead_mm or run.spec.log.lead_mm)
    output.emit(result.to_json(), "\n\n".join([*parts, *written]))
    _check_required(result.source, {name: told[name] for name in require})
    if result.outcome == "contradicts" or (result.outcome == "not_determined" and gap.determined):
        # The result is printed before the error, because its numbers show what the error says.
        output.finish()
        said = (
            f"only the gap over the covered angles: {gap.in_words}; the reasons are listed above."
        )
        said = f"the log determines no parameter, {said}"
        if result.outcome == "contradicts":  # the log is not that of a drive
            slugs = ("column-computed", "gap-below-zero")
            said = next(one.text for one in result.findings if one.slug in slugs) + "."
        LOGGER.error("%s: %s", result.source, said)
        raise click.exceptions.Exit(NoAnswerError.exit_code)
    if result.outcome in ("not_converged", "not_determined"):
        raise NoAnswerError(_FAILURES[result.outcome], where=result.source)


def _as_length(value_deg: float | None, std_deg: float | None, lead_mm: float | None) -> list[str]:
    """Return a line with the gap as a length, if the travel in one turn is stated."""
    if value_deg is None or std_deg is None or lead_mm is None:
        return []
    value, std = (1e3 * lead_mm / 360 * one for one in (value_deg, std_deg))
    return [f"mean gap over the angles ({lead_mm:.6g} mm a turn): {value:.4g} ± {std:.2g} µm"]


_FAILURES = {
    "not_converged": "the fit did not converge; its numbers are not to be trusted.",
    "not_determined": "the log determines no parameter; the reasons are listed above.",
}


def _noise_to_plan(result: "Fit") -> str:
    """Return the options of `vttig plan` whose noise has the power of that of a fit.

    The plan adds counting, so that its part is taken off: 2 σ² τ = 2 s² τ − c² Δt.
    """
    from ...base.units import DEG
    from ...posterior.planning.noise import counting_std

    noise, step_s = result.noise, result.core.shafts[0].interval_s
    counting = (counting_std(result.pair) / DEG) ** 2 * step_s / (2 * noise.correlation_s)
    std = math.sqrt(max(noise.std_deg**2 - counting, 0.0))
    return (
        f"to plan a run with this noise: vttig plan --rate-hz {1 / step_s:.5g} --noise-std-deg"
        f" {std:.3g} --noise-correlation-s {noise.correlation_s:.3g}, with the drive and --turns"
    )


def _check_required(source: str, required: "dict[str, Parameter]") -> None:
    from ...identify.result import doubt

    for name, p in required.items():
        if not p.determined:
            reason = f"{name} is required but undetermined: {p.reason}."
            raise NoAnswerError(reason, where=source)
        if not p.significant and name != "ratio":
            LOGGER.warning(
                "%s is determined, as --require asks, but %s (%s): the log does not certainly tell"
                " it from zero",
                name,
                doubt(p.value, p.low95, p.high95, p.reason).strip(" ()"),
                _size(p),
            )


def _size(parameter: "Parameter") -> str:
    """Return value and standard error of a parameter, or its upper limit, as text."""
    if parameter.value is None:
        return parameter.reason or "it has no value"
    if parameter.upper95 is not None:
        return f"at most {parameter.upper95:.3g} {parameter.unit}"
    return f"{parameter.value:.3g} ± {parameter.std:.2g} {parameter.unit}"

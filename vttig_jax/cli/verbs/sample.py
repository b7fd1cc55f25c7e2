"""`vttig sample`: sample the posterior of logs, or of the fit in a run folder."""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import click

from ...base.errors import InputError, NotConvergedError, UsageError
from ...base.files.atomic_write import settle_if_free
from ...base.files.run_folder import data_sha256
from ...base.logger import LOGGER
from ...identify.fit_settings import fields
from ...logs.readers.open_table import with_standard_input
from ...posterior.until import Until
from ...runs.fit_run import perform, resolve, save_fit, write_report
from ...runs.run import open_run
from ...runs.run_file import CHECKPOINT, RunOptions, RunRecord, read_run
from ..drive_options import GROUPS, Drive
from ..fit_options import OF_A_FIT, Settings
from ..options import (
    Argument,
    Positive,
    arguments_as_options,
    exclude_each_other,
    given,
    refuse_results,
    verb,
)
from ..output import Output, sampling_bar


@verb(
    "sample",
    example="""
vttig sample log.csv --ratio 64:23 --out run
vttig sample log.csv --pair pair.toml --out run --resume
vttig sample run --resume --until 5000
vttig fit log.csv --pair pair.toml --out run && vttig sample run --steps 5000 --seed 1
""",
    groups={
        **GROUPS,
        "The result": ("out", "resume", "overwrite", "no_figures", "readings"),
        "The sampler": ("seed", "steps", "until", "ensembles", "walkers"),
        "The model": tuple(field.name for field in fields()),
    },
)
def command(
    output: Output,
    *,
    logs: Annotated[tuple[Path, ...], Argument("[LOG]...")],
    out: Annotated[
        Path | None,
        "Run folder of fit, draws and pictures. Without LOG, or in its place, its fit is sampled.",
    ],
    resume: Annotated[bool, "Go on with the draws that are in --out; where there are none, start."],
    overwrite: Annotated[bool, "Replace the fit and the draws that are in --out."],
    no_figures: Annotated[bool, "Leave the pictures out of the run folder."],
    seed: Annotated[
        int | None, click.IntRange(0, 2**63 - 1), "Of the sampler; 0, or that of the draws."
    ],
    steps: Annotated[int | None, click.IntRange(40, 1_000_000_000), "Make this many steps in all."],
    until: Annotated[
        Positive | None,
        "Sample until there are this many effective draws of every coordinate (1000 by default)"
        " and the ensembles agree (R-hat 1.01), 20 000 steps at most.",
    ],
    ensembles: Annotated[int | None, click.IntRange(4, 1000), "Independent ones; 4 by default."],
    walkers: Annotated[
        int | None,
        click.IntRange(4, 1_000_000),
        "Of each ensemble, even and at least twice the coordinates; 32 or more by default.",
    ],
    readings: Annotated[
        Path | None,
        "--backlash-readings",
        "CSV of driving_deg,backlash_deg to check the fit against.",
    ],
    drive: Drive,
    settings: Settings,
) -> None:
    """Sample the posterior of the fit of LOG, or of the fit in a run folder.

    LOG may be - for stdin; it is then kept in --out. Several independent ensembles run until they
    have enough effective draws and agree. The draws are brought up to date in posterior.h5 every
    5 s: after an interrupt or a kill, --resume goes on and ends with the same draws as a run that
    was never stopped; seed, walkers and ensembles are then those of the draws unless given. A
    command with --resume may be repeated. The exit code is 5 if the sampler has not converged.
    """
    logs, out = _logs_and_folder(logs, out)
    draws = out / CHECKPOINT
    settle_if_free(out)  # a kill may have left a fit that is not yet at its place
    exclude_each_other("resume", "overwrite")
    exclude_each_other("steps", "until")
    if not (drive.explain_columns or resume or overwrite):
        cure = "add --resume to go on with it, --overwrite to replace it"
        refuse_results(out, [CHECKPOINT], cure)
        cure = "sample it without LOG and --pair, add --overwrite to replace it"
        refuse_results(out, ["fit.json"] if logs else [], cure)
    from ...posterior.sampler import sample, settings_of

    fit = None
    if logs:
        logs = with_standard_input(logs)
        how = RunOptions(drive.reading, settings)
        run = resolve(logs, drive.pair, readings, how, drive.request)
        if drive.only_explains(output, logs, run.spec, run.guesses):
            return
        if resume and (out / "fit.json").exists():
            _require_same_request(run, out)
        else:
            fit, run = perform(run)
            if not (resume and draws.exists()):
                save_fit(fit, out, overwrite=overwrite, figures=not no_figures, record=run)
    elif asked := given({"readings", *OF_A_FIT}):
        raise UsageError(
            f"{' and '.join(asked)} belong to a fit, but without LOG the fit in {out} is"
            " sampled; give LOG too, or leave it out."
        )
    if fit is None:
        fit = open_run(out).fit
    start = settings_of(draws) if resume and draws.exists() else {}
    chosen = {"seed": seed, "ensembles": ensembles, "walkers": walkers}
    start |= {name: value for name, value in chosen.items() if value is not None}
    length = {"steps": steps, "until": None if until is None else Until(effective=until)}
    files = {"checkpoint": draws, "resume": resume, "overwrite": overwrite}
    again = f"`vttig sample {shlex.quote(str(out))} --resume`"
    try:
        # The least number of walkers is known only after the fit.
        with sampling_bar(output) as follow, arguments_as_options():
            posterior = sample(fit, **start, **length, **files, progress=follow)
        write_report(out, posterior, figures=not no_figures)
    except BaseException as error:
        if not isinstance(error, Exception) and draws.exists():  # an interrupt
            error.args = (f"interrupted; the draws in {draws} are kept: go on with {again}.",)
        raise
    LOGGER.info("written to %s", out)
    output.emit(posterior.to_json(), posterior)
    if not posterior.diagnosis.converged:
        text = str(posterior.diagnosis).replace("--resume", again).removeprefix("converged: no; ")
        raise NotConvergedError(f"the sampler has not converged: {text}.", where=str(draws))


def _logs_and_folder(logs: tuple[Path, ...], out: Path | None) -> tuple[tuple[Path, ...], Path]:
    """Return the logs and the run folder, which may be the only argument.

    **Raises** `UsageError` without a run folder, with the command to give.
    """
    if runs := [path for path in logs if (path / "fit.json").is_file()]:
        if len(logs) == 1 and out in (None, runs[0]):
            return (), runs[0]
        cure = f"`vttig sample {shlex.quote(str(runs[0]))}` samples the fit in it"
        cure += " and writes the draws beside it, without --out" if out is not None else ""
        raise UsageError(f"a run folder is no log; {cure}.", where=str(runs[0]))
    if out is None:
        raise UsageError(
            f"the draws need a run folder: `vttig sample {shlex.join(map(str, logs)) or 'log.csv'}"
            " --out run`, with the other options, fits and samples a log, and `vttig sample run`"
            " samples the fit in run."
        )
    return logs, out


def _require_same_request(record: RunRecord, out: Path) -> None:
    """Raise `InputError` if `out` holds the fit of other logs or options."""
    digests = tuple(map(data_sha256, record.logs))
    readings = data_sha256(record.readings) if record.readings else ""
    asked, stored = replace(record, sha256=digests, readings_sha256=readings), read_run(out)
    names = {"sha256": "data sha256", "readings_sha256": "readings sha256", "spec": "pair file"}
    differing = [
        text
        for name, text in (names | {"options": "options"}).items()
        if getattr(asked, name) != getattr(stored, name)
    ]
    if differing:
        raise InputError(
            f"this folder holds another fit ({', '.join(differing)} differ);"
            " repeat the command that made it, choose another folder, or replace the fit with"
            " --overwrite.",
            where=str(out),
        )

"""`vttig fit-many`: fit many logs, each of another rig, in batches; the result is one table."""

from pathlib import Path
from typing import Annotated

import click

from ...base.errors import NoAnswerError, UsageError
from ...base.files.limits import STDIN
from ...base.logger import LOGGER
from ...identify.fit_settings import BATCH
from ...logs.readers.open_table import with_standard_input
from ..drive_options import GROUPS, Drive
from ..fit_options import BatchSettings
from ..options import Argument, Dask, exclude_each_other, need, refuse_existing, verb
from ..output import Output


@verb(
    "fit-many",
    example="""
vttig fit-many rigs/*.csv --ratio 64:23 --out fitted
vttig fit-many rigs/*.csv --pair pair.toml --out fitted
vttig fit-many rigs/*.csv --pair pair.toml --out fitted --resume
vttig fit-many rigs/*.csv --pair pair.toml --delay off --csv fits.csv
""",
    groups={
        **GROUPS,
        "The result": ("out", "resume", "overwrite", "csv_file", "jobs", "dask"),
        "The model": BATCH,
    },
)
def command(
    output: Output,
    *,
    logs: Annotated[tuple[Path, ...], Argument("LOG...", required=True)],
    out: Annotated[Path | None, "Folder for fits.parquet."],
    resume: Annotated[
        bool, "Go on with the table that is unfinished in --out; where there is none, start."
    ],
    overwrite: Annotated[bool, "Replace the table in --out."],
    csv_file: Annotated[Path | None, "--csv", "Write the table as CSV."],
    jobs: Annotated[
        int | None,
        click.IntRange(1, 1024),
        "Processes that fit blocks of 16 logs at the same time; by default one for each core"
        " and 1.5 GiB of free memory.",
    ],
    dask: Dask,
    drive: Drive,
    settings: BatchSettings,
) -> None:
    """Identify the parameters of many logs, each of a rig of its own, in one table.

    All rigs are built to one pair file, or have the same ratio and columns that are read alike.
    Every log has the parameters of `vttig fit` with the same options. A log that cannot be read or
    fitted has a code and a reason in its row, and the others are fitted.
    Blocks of logs are written as they are done: after Ctrl-C or a kill --resume goes on and ends
    with the same table. A command with --resume may be repeated: it starts, goes on, or only prints
    the table that is complete. One LOG may be - for stdin, which --resume needs again.
    """
    need("out", "resume", "overwrite")
    exclude_each_other("resume", "overwrite")
    exclude_each_other("jobs", "dask")
    if csv_file is not None:
        refuse_existing(csv_file, overwrite=overwrite or resume)
    from ...runs.many_fits import ManyFits, fit_files

    if STDIN in logs:
        if dask is not None or (jobs or 1) > 1:
            raise UsageError(
                "stdin (-) is not read by other processes (--jobs, --dask); save the log as a file."
            )
        jobs = 1
    logs = with_standard_input(logs)
    task = ManyFits.of(logs, drive.pair, settings, drive.reading, drive.request)
    if drive.only_explains(output, logs, task.spec, task.guesses):
        return
    how = {"out": out, "resume": resume, "overwrite": overwrite, "dask": dask, "jobs": jobs}
    with output.progress(len(logs), "logs") as bar:
        found = fit_files(task, **how, progress=bar.update)
    if csv_file is not None:
        found.to_csv(csv_file)
    output.emit(found.to_json(), found)
    failed = len(found) - int(found.is_fitted.sum())
    if failed == len(found):
        output.finish()  # with --json the table is the only object; no error object follows
        LOGGER.error("no log could be fitted; the reasons are in the table.")
        raise click.exceptions.Exit(NoAnswerError.exit_code)
    if failed:
        LOGGER.warning("%d of %d logs were not fitted; see their reasons", failed, len(found))

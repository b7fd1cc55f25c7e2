"""`vttig fit-many`: fit many logs, each of another rig, in batches; the result is one table."""

from pathlib import Path
from typing import Any

import click

from ...base.errors import NoAnswerError, UsageError
from ...base.files.limits import STDIN
from ...base.logger import LOGGER
from ...identify.fit_settings import BATCH
from ...logs.readers.open_table import with_standard_input
from ...runs.options import options_of
from ..drive_options import GROUPS, DriveOptions, drive_options, pair_option
from ..fit_options import batch_options
from ..options import exclude_each_other, log_options, need, refuse_existing, verb
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
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=click.Path(path_type=Path))
@pair_option
@click.option("--out", type=click.Path(path_type=Path), help="Folder for fits.parquet.")
@click.option(
    "--resume",
    is_flag=True,
    help="Go on with the table that is unfinished in --out; where there is none, start.",
)
@click.option("--overwrite", is_flag=True, help="Replace the table in --out.")
@click.option("--csv", "csv_file", type=click.Path(path_type=Path), help="Write the table as CSV.")
@click.option(
    "--jobs",
    type=click.IntRange(1, 1024),
    help="Processes that fit blocks of 16 logs at the same time; by default one for each core"
    " and 1.5 GiB of free memory.",
)
@click.option("--dask", metavar="ADDRESS", help="Scheduler of dask.distributed to send blocks to.")
@drive_options
@log_options
@batch_options
def command(
    output: Output,
    logs: tuple[Path, ...],
    pair: Path | None,
    out: Path | None,
    resume: bool,
    overwrite: bool,
    csv_file: Path | None,
    jobs: int | None,
    dask: str | None,
    drive: DriveOptions,
    **options: Any,
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

    chosen = options_of(options)
    if STDIN in logs:
        if dask is not None or (jobs or 1) > 1:
            raise UsageError(
                "stdin (-) is not read by other processes (--jobs, --dask); save the log as a file."
            )
        jobs = 1
    logs = with_standard_input(logs)
    task = ManyFits.of(logs, pair, chosen.settings, chosen.reading, drive.request)
    if drive.only_explains(output, logs, (task.spec, task.guesses, task.reading)):
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

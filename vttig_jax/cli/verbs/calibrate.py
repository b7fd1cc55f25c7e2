"""`vttig calibrate`: check that the intervals of a fit hold the truth of rigs like this one."""

from contextlib import nullcontext
from pathlib import Path

import click

from ...base.errors import NoAnswerError
from ...base.files.json_io import dumps
from ...base.files.run_folder import RunFolder
from ...base.logger import LOGGER
from ...runs.fit_run import perform
from ...runs.run_file import read_run, require_same_data
from ..options import need, verb
from ..output import Output

_FEWEST, _MOST = 20, 100_000
"""Fewest and most rigs (chosen): fewer say nothing, more take hours."""

FILE = "calibration.json"


@verb(
    "calibrate",
    example="""
vttig calibrate run
vttig calibrate run --rigs 1000 --seed 1 --out calibration
""",
)
@click.argument("run", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "--rigs",
    type=click.IntRange(_FEWEST, _MOST),
    default=400,
    show_default=True,
    help="Drawn and fitted; about 20 a second.",
)
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), help=f"Folder for {FILE}.")
@click.option("--overwrite", is_flag=True, help="Replace the calibration in that folder.")
def command(
    output: Output, run: Path, rigs: int, seed: int, out: Path | None, overwrite: bool
) -> None:
    """Say whether the intervals of the fit in a run folder hold, on rigs whose truth is known.

    The logs of RUN are fitted again. Rigs like this one are drawn from the posterior of the fit:
    the same motion, noise, orders and drift. All of them are fitted by the same model, and the
    intervals that hold the truth are counted. Exit code 4 where intervals are too narrow.
    """
    need("out", "overwrite")
    from ...posterior.calibration.calibrate import calibrate

    # A folder that must not be overwritten is refused before the computation.
    kept = nullcontext() if out is None else RunFolder(out, overwrite=overwrite, results=(FILE,))
    with kept as folder:
        record = read_run(run)
        require_same_data(record)
        fit, _ = perform(record)
        with output.progress(rigs, "rigs") as bar:
            found = calibrate(fit, rigs=rigs, seed=seed, progress=bar.update)
        if folder is not None:
            folder.write_text(FILE, dumps(found.to_json()) + "\n")
    if out is not None:
        LOGGER.info("written to %s", out)
    output.emit(found.to_json(), found)
    if not found.is_calibrated:
        raise NoAnswerError(
            f"intervals are too narrow: {', '.join(found.failed)}.", where=found.source
        )

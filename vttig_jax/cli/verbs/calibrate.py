"""`vttig calibrate`: check that the intervals of a fit hold the truth of rigs like this one."""

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import click

from ...base.errors import NoAnswerError
from ...base.files.json_io import dumps
from ...base.files.run_folder import RunFolder
from ...base.logger import LOGGER
from ...runs.fit_run import perform
from ...runs.run_file import read_run, require_same_data
from ..options import RunPath, need, verb
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
def command(
    output: Output,
    *,
    run: RunPath,
    rigs: Annotated[
        int,
        click.IntRange(_FEWEST, _MOST),
        {"show_default": True},
        "Drawn and fitted; about 20 a second.",
    ] = 400,
    seed: Annotated[int, click.IntRange(0, 2**32 - 1), {"show_default": True}] = 0,
    out: Annotated[Path | None, f"Folder for {FILE}."],
    overwrite: Annotated[bool, "Replace the calibration in that folder."],
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

"""`vttig compare`: the differences between two runs, and which of them count."""

from pathlib import Path
from typing import Annotated

from ... import report as reports
from ..options import Argument, RunPath, verb
from ..output import Output


@verb("compare", example="vttig compare before after")
def command(
    output: Output, *, run_folder: RunPath, other: Annotated[Path, Argument("RUN2")]
) -> None:
    """Compare the fits in RUN and RUN2, such as before and after an adjustment.

    Each difference is that of RUN2 less RUN, with its 95 % interval. It counts from three standard
    errors on. The noise of both runs is taken as independent.
    """
    found = reports.compare_runs(run_folder, other)
    output.emit(found.to_json(), found)

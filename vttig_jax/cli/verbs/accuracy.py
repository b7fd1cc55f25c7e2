"""`vttig accuracy`: a run in the terms of the standards on gears and on rotary axes."""

from ...runs.run import open_run
from ..options import RunPath, verb
from ..output import Output


@verb("accuracy", example="vttig accuracy run")
def command(output: Output, *, run_folder: RunPath) -> None:
    """Say how accurate the drive of RUN is, in the terms of ISO 1328-1 and ISO 230-2.

    Single flank: total and tooth-to-tooth deviation of the measured transmission error, averaged
    over the turns of each shaft, for each flank, and of the pair. Rotary axis: reversal value,
    repeatability and accuracy from repeated passes or from a table of readings at standstill. Each
    number stands as read, without what noise adds to it, and with its 95 % interval. This is a pair
    in its machine without a master gear: not a conformity statement.
    """
    found = open_run(run_folder).fit.accuracy
    output.emit(found.to_json(), found)

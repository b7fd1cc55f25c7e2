"""`vttig verify`: does the compensation of an axis work, by its own log."""

from pathlib import Path
from typing import Annotated, Any

from ...base.errors import UsageError
from ...logs.recognition.request import ReadingOptions
from ...runs.run import Run
from ..axis_options import AXIS, Axis
from ..options import READING, Argument, RunPath, StepDeg, verb
from ..output import Output


@verb(
    "verify",
    example="""
vttig verify run log.csv --travel 0 360
vttig verify run before.csv after.csv --column command=joint.0.pos-cmd
""",
    groups={"The axis": AXIS, "The log": ReadingOptions.__struct_fields__},
)
def command(
    output: Output,
    *,
    run_folder: RunPath,
    logs: Annotated[tuple[Path, ...], Argument("LOG", required=True)],
    axis: Axis,
    step_deg: Annotated[StepDeg | None, "Distance of the positions of the table."],
    reading: Annotated[ReadingOptions, READING],
) -> None:
    """Say whether the error table of RUN works on its axis, by a LOG of it.

    The log holds the commanded position of the axis (role `command`) and the encoder of the driven
    shaft; two encoders alone show the same with a table and without. The options of the axis are
    those that `vttig export` was called with. What is left by direction, without the noise of the
    log, stands beside the prediction for the same places, with 95 % intervals. By likelihood the
    command names what is wrong: the sign, the zero, the directions, the turn, a correction that is
    too slow, nothing loaded, or another table than these options give. With two logs, before and
    after, it says whether the axis became better, or how long to record to tell.
    """
    if len(logs) > 2:
        raise UsageError("verify takes one log, or one before and one after.")
    from ...runs.axis_table import AxisSetting
    from ...runs.verification import verify

    run = Run(run_folder)
    found = verify(run, logs, AxisSetting(**axis._asdict()), step_deg, reading, run.drawn)
    output.emit(found, _text(found))


def _text(record: dict[str, Any]) -> str:
    from ...base.files.text_tables import key_values
    from ...base.units import duration_text

    rows = []
    for one in record["logs"]:
        span, (low, high) = duration_text(one["span_s"]), one["travel_deg"]
        rows.append(("log", f"{one['source']}, {span}, {low:.6g}° … {high:.6g}°"))
        first, last = record["table_deg"]
        if low < first - 0.01 or high > last + 0.01:  # a table is written in single precision
            rows.append(("beyond the table", f"{first:.6g}° … {last:.6g}°; its ends are held"))
        for name, left in one["left_arcsec"].items():
            text = f"{left['rms']:.3g}″ rms left ({left['low95']:.3g}″ … {left['high95']:.3g}″)"
            low, high = left["predicted95"]
            rows.append((name, f"{text}, predicted {low:.3g}″ … {high:.3g}″"))
        rows.append(("likely", one["sentence"]))
    for name, one in record["change"].items():
        needed = one["needed_s"] and f"cannot be told; log {duration_text(one['needed_s'])}"
        rows.append((f"change {name}", needed or one["outcome"]))
    return key_values(rows, title="compensation of the axis")

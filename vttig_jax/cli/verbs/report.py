"""`vttig report`: one page of a run, or of two side by side, to read, send and print."""

from pathlib import Path
from typing import Annotated

from ... import report as reports
from ..options import Argument, RunPath, verb
from ..output import Output


@verb(
    "report",
    example="""
vttig report run
vttig report before after --out adjustment.html
""",
)
def command(
    output: Output,
    *,
    run_folder: RunPath,
    other: Annotated[Path | None, Argument("[RUN2]")],
    out: Annotated[
        Path | None, "HTML file to write; report.html in the (second) run folder by default."
    ],
    overwrite: Annotated[bool, "Replace a report that exists."],
) -> None:
    """Write the fit in RUN as one HTML page that says what it means.

    The page opens with three sentences. Below them stand the numbers with their intervals, charts
    that can be enlarged and read out, the findings and what to record next. It holds all that it
    shows, so that it can be sent and printed; a browser loads nothing from elsewhere. The charts
    need the extra `report`. With RUN2 the page shows both runs side by side, such as before and
    after an adjustment, and which of their differences count; `vttig compare` prints these.
    """
    report = reports.write_report(run_folder, other, out=out, overwrite=overwrite)
    output.emit(report.to_json(), report)

"""`vttig report`: one page of a run, or of two side by side, to read, send and print."""

from pathlib import Path

import click

from ... import report as reports
from ..options import verb
from ..output import Output


@verb(
    "report",
    example="""
vttig report run
vttig report before after --out adjustment.html
""",
)
@click.argument("run_folder", metavar="RUN", type=click.Path(path_type=Path))
@click.argument("other", metavar="[RUN2]", required=False, type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="HTML file to write; report.html in the (second) run folder by default.",
)
@click.option("--overwrite", is_flag=True, help="Replace a report that exists.")
def command(
    output: Output, run_folder: Path, other: Path | None, out: Path | None, overwrite: bool
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

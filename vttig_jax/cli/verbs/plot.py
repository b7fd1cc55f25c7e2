"""`vttig plot`: one picture of a run as PNG, SVG or PDF."""

from io import BytesIO
from pathlib import Path
from typing import Annotated, Any

import click

from ...base.files.run_folder import write_files
from ...runs.run import open_run
from ..options import Argument, RunPath, refuse_out, verb
from ..output import Output

PICTURES = (".png", ".svg", ".pdf")
NAMES = ("te", "map", "orders", "residual", "corner", "trace")


@verb("plot", example="vttig plot run map --out map.svg")
def command(
    output: Output,
    *,
    run_folder: RunPath,
    name: Annotated[str, Argument("NAME"), click.Choice(NAMES)],
    out: Annotated[Path, "File to write."],
    overwrite: Annotated[bool, "Replace a file that exists."],
) -> None:
    """Draw one picture of RUN: te, map, orders, residual, corner or trace.

    The end of the name of the file says whether it is a .png, .svg or .pdf. `corner` and `trace`
    show the draws of `vttig sample`, and `map` has their bands.
    """
    import vttig_jax

    refuse_out(out, *PICTURES, overwrite=overwrite)
    run = open_run(run_folder)
    run.refuse_own([out])
    if name == "map":
        figure = vttig_jax.plot(run.map)
    else:
        figure = vttig_jax.plot(run.posterior if name in NAMES[-2:] else run.fit, name)
    write_picture(figure, out, overwrite=overwrite)
    output.emit({"schema": "vttig.plot/1", "picture": str(out), "name": name}, f"picture: {out}")


def write_picture(figure: Any, out: Path, *, overwrite: bool) -> None:
    """Write a figure in the format that the end of the name says."""
    buffer = BytesIO()
    figure.savefig(buffer, format=out.suffix[1:].lower(), dpi=150)
    write_files({out: buffer.getvalue()}, overwrite=overwrite)

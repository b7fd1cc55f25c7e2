"""`vttig plot`: one picture of a run as PNG, SVG or PDF."""

from io import BytesIO
from pathlib import Path

import click

from ...base.errors import UsageError
from ...base.files.run_folder import RunFolder
from ...runs.run import open_run
from ..options import verb
from ..output import Output

NAMES = ("te", "map", "orders", "residual", "corner", "trace")


@verb("plot", example="vttig plot run map --out map.svg")
@click.argument("run_folder", metavar="RUN", type=click.Path(path_type=Path))
@click.argument("name", metavar="NAME", type=click.Choice(NAMES))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="File to write.")
@click.option("--overwrite", is_flag=True, help="Replace a file that exists.")
def command(output: Output, run_folder: Path, name: str, out: Path, overwrite: bool) -> None:
    """Draw one picture of RUN: te, map, orders, residual, corner or trace.

    The end of the name of the file says whether it is a .png, .svg or .pdf. `corner` and `trace`
    show the draws of `vttig sample`, and `map` has their bands.
    """
    import vttig_jax

    if (form := out.suffix[1:].lower()) not in ("png", "svg", "pdf"):
        raise UsageError("a picture is a .png, .svg or .pdf file; name one.", where=str(out))
    vttig_jax.enable_x64()
    run, buffer = open_run(run_folder), BytesIO()
    run.refuse_own([out])
    if name == "map":
        figure = vttig_jax.plot(run.map)
    else:
        figure = vttig_jax.plot(run.posterior if name in NAMES[-2:] else run.fit, name)
    figure.savefig(buffer, format=form, dpi=150)
    with RunFolder(out.parent, overwrite=overwrite, results=(out.name,)) as folder:
        folder.write_bytes(out.name, buffer.getvalue())
    output.emit({"schema": "vttig.plot/1", "picture": str(out), "name": name}, f"picture: {out}")

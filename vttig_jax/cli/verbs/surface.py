"""`vttig surface`: write a gear as a mesh, a CAD solid, the drawing of a section or a picture."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import click
import numpy as np

from ...base.files.run_folder import write_files
from ...base.files.text_tables import key_values
from ...pair.pair_file import PAIR_FILE, load_pair_spec
from ..drive_options import gears_of
from ..options import Argument, NotNegative, Positive, Real, refuse_out, takes_no, verb
from ..output import Output

if TYPE_CHECKING:
    from ...geometry.tooth import Tooth

_MESHES, _SOLIDS, _DRAWINGS = (".stl",), (".step", ".stp"), (".svg", ".dxf")
_PICTURES = (".png",)
_SHOWN = {
    "teeth": ("teeth", "{teeth}"),
    "triangles": ("triangles", "{triangles}"),
    "faces": ("faces", "{faces}"),
    "points": ("points", "{points}"),
    "sections": ("sections", "{sections}"),
    "section_mm": ("section at z", "{section_mm:g} mm"),
    "volume_mm3": ("volume", "{volume_mm3:.1f} mm³"),
    "area_mm2": ("area", "{area_mm2:.3f} mm²"),
    "error_um": ("measured error", "{error_um:.3g} µm of {tolerance_um:g} µm allowed"),
    "bytes": ("file size", "{bytes} bytes"),
}
"""Entry of the record → its name and its value in the text."""

_STAGES = 4
"""Largest number of stages of the progress bar: surfaces, sewing, volume and file of a solid."""


@verb(
    "surface",
    example="""
vttig surface pair.toml --gear driving --out gear.stl
vttig surface pair.toml --gear driven --out gear.step --bore-mm 40
vttig surface pair.toml --gear driving --out tooth.stl --teeth 1 --tolerance-um 0.5
vttig surface pair.toml --gear driving --out section.svg --section-mm -10
vttig surface pair.toml --gear driving --out tooth.png
""",
)
def command(
    output: Output,
    *,
    pair: Annotated[Path, Argument("PAIR")],
    gear: Annotated[Literal["driving", "driven"], "Which gear of the pair."],
    out: Annotated[
        Path,
        "File to write: .stl a closed mesh; .step, .stp a solid with B-spline flanks;"
        " .svg, .dxf a section; .png a picture of one tooth, which takes none of the options below"
        " but --overwrite.",
    ],
    teeth: Annotated[
        int | None,
        click.IntRange(min=1),
        "Only as many teeth, as a closed sector cut in the middle of its outer spaces.",
    ],
    tolerance_um: Annotated[
        Positive,
        {"show_default": True},
        "Largest distance of the true surface from what is written; it is measured.",
    ] = 1.0,
    bore_mm: Annotated[
        NotNegative | None, "Diameter of the bore, 0 for none; by default 0.3 of the root diameter."
    ],
    section_mm: Annotated[
        Real,
        "With .svg and .dxf: height of the section along the axis of the gear, whose teeth thin"
        " towards +z; 0, the middle of the face, by default.",
    ] = 0.0,
    overwrite: Annotated[bool, "Replace a file that exists."],
) -> None:
    """Write a gear of the pair file PAIR as a mesh, a CAD solid, a section or a picture.

    All teeth with their fillets, the end faces and the bore, closed, in the frame of the gear: its
    axis is z with the middle of the face at 0, the teeth thin towards +z, lengths are mm. Where the
    fillets of neighbouring teeth overlap, the bottom of the space is where they cross. The picture
    shows a tooth at both ends and in the middle, and how thick it is between them.
    """
    suffix = out.suffix.lower()
    cure = ""
    if suffix in (".ply", ".obj"):
        cure = f"write .stl and convert it: trimesh.load('gear.stl').export('gear{suffix}')"
    refuse_out(out, *_MESHES, *_SOLIDS, *_DRAWINGS, *_PICTURES, overwrite=overwrite, cure=cure)
    ignored = () if suffix in _DRAWINGS else ("section_mm",)
    ignored += ("teeth", "tolerance_um", "bore_mm") if suffix in _PICTURES else ()
    takes_no(f"a {suffix} file", *ignored)
    from ...geometry.tooth import tooth_of

    spec = load_pair_spec(pair)
    tooth = tooth_of(gears_of(spec, pair, "no surface"), gear)
    name = f"{spec.name}, {gear} gear" if spec.name else f"{gear} gear"
    build = {"tolerance_mm": tolerance_um * 1e-3, "teeth": teeth, "bore_mm": bore_mm}
    with output.progress(_STAGES, "surface") as bar:
        with PAIR_FILE.error_context(f"{pair}: {gear}"):
            data, found, notes = _built(suffix, tooth, name, section_mm, build, bar)
        write_files({out: data}, overwrite=overwrite)
        bar.update(bar.total - bar.n)
    record = {
        "schema": "vttig.surface/1",
        "pair": spec.name,
        "source": str(pair),
        "gear": gear,
        "file": str(out),
        "format": suffix[1:].replace("stp", "step"),
        "bytes": len(data),
        "teeth": teeth or tooth.teeth,
        **({} if suffix in _PICTURES else {"tolerance_um": tolerance_um}),
        **found,
        "notes": list(notes),
    }
    output.emit(record, _text(record, name))


def _built(
    suffix: str, tooth: "Tooth", name: str, section_mm: float, build: dict[str, Any], bar: Any
) -> tuple[bytes, dict[str, Any], tuple[str, ...]]:
    """Return the content of the file, the fields of the record that describe it, and notes."""
    if suffix in _MESHES:
        from ...geometry.mesh import gear_mesh, stl_bytes

        made = gear_mesh(tooth, rounding=np.float32, progress=bar.update, **build)
        data = stl_bytes(made, name)
        found = {"triangles": len(made.triangles), "points": len(made.vertices)}
        found |= {"sections": made.sections, "volume_mm3": made.volume_mm3}
    elif suffix in _SOLIDS:
        from ...geometry.solid import gear_solid, step_bytes

        made = gear_solid(tooth, progress=bar.update, **build)
        data = step_bytes(made, name)
        found = {"faces": made.faces, "sections": made.sections, "volume_mm3": made.volume_mm3}
    elif suffix in _DRAWINGS:
        from ...geometry.drawing import dxf_bytes, section_drawing, svg_bytes

        made = section_drawing(tooth, section_mm, **build)
        data = svg_bytes(made, name) if suffix == ".svg" else dxf_bytes(made, name)
        found = {"points": len(made.points), "section_mm": section_mm, "area_mm2": made.area_mm2}
    else:
        from ...geometry.outline import blank_of
        from ...plotting.save import png
        from ...plotting.tooth import plot_tooth

        blank = blank_of(tooth, teeth=None, bore_mm=0.0, tolerance_mm=build["tolerance_mm"])
        return png(plot_tooth(tooth, name=name)), {}, blank.notes
    return data, {"error_um": made.error_mm * 1e3, **found}, made.notes


def _text(record: dict[str, Any], name: str) -> str:
    rows = [("format", str(record["format"]).upper())]
    for key, (label, value) in _SHOWN.items():
        if key in record:
            rows.append((label, value.format(**record)))
    lines = [key_values(rows, title=name), *(f"  {note}" for note in record["notes"])]
    return "\n".join([*lines, f"written to {record['file']}"])

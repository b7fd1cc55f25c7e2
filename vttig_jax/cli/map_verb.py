"""`vttig map`: the backlash at every angle, from a run folder."""

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .options import POSITIVE, Finite, verb
from .output import LOGGER, Output
from .run_file import read_run

if TYPE_CHECKING:
    from ..identify.result import Fit
    from ..kinematics.backlash_map import BacklashMap, Extreme

MOST_ROWS = 200_000
COLUMNS = ("driving_deg", "backlash_deg", "backlash_mm", "axial_mm", "backlash_first_order_deg")


@verb("map", example="vttig map run --step-deg 0.5 --out map.csv")
@click.argument("run_folder", metavar="D", type=click.Path(path_type=Path))
@click.option("--step-deg", type=POSITIVE, default=1.0)
@click.option(
    "--span-rev",
    type=POSITIVE,
    help="Driving turns to cover; the hunting period by default, 200 000 rows at most.",
)
@click.option("--constant-backlash-deg", type=Finite(min=0), help="Replaces the fitted one.")
@click.option("--out", type=click.Path(path_type=Path), help="CSV to write, with a JSON beside it.")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
def command(
    output: Output,
    run_folder: Path,
    step_deg: float,
    span_rev: float | None,
    constant_backlash_deg: float | None,
    out: Path | None,
    overwrite: bool,
) -> None:
    """Show the backlash over the hunting period of the fit in run folder D, and write it.

    The CSV has the order-complete backlash in degrees of the driven gear, in mm at its reference
    circle and in mm of axial displacement, and the first-order backlash beside it.
    """
    import vttig_jax

    from ..identify.mapping import backlash_map
    from ..identify.store import read_fit
    from ..pair.gears import pair_from_spec

    vttig_jax.enable_x64()
    pair = pair_from_spec(read_run(run_folder).spec)
    fit = read_fit(run_folder, pair)
    grid = backlash_map(fit, constant_backlash_deg=constant_backlash_deg)
    turns = _span(pair.hunting_turns, step_deg, span_rev)
    table = map_table(grid, step_deg, turns)
    record = map_record(fit, grid, step_deg, turns, len(table), out)
    if out is not None:
        _write(out, table, record, overwrite)
    output.emit(record, grid)


def map_table(grid: "BacklashMap", step_deg: float, turns: float) -> Any:
    """Rows of the contract's columns, shape (rows, 5); NaN where there is no geometry."""
    import numpy as np

    from ..base.units import DEG
    from ..pair.gears import GearPair

    driving_deg = np.arange(int(np.ceil(turns * 360.0 / step_deg - 1e-9))) * step_deg
    backlash = grid.over(driving_deg * DEG)
    millimetres = axial = np.full(len(driving_deg), np.nan)
    if isinstance(grid.pair, GearPair):
        millimetres = backlash * float(grid.pair.reference_radii[1])
        if thinning := float(grid.pair.thinning):
            axial = millimetres / thinning
    first = grid.first_order_over(driving_deg * DEG)
    return np.stack([driving_deg, backlash / DEG, millimetres, axial, first / DEG], axis=1)


def map_record(
    fit: "Fit", grid: "BacklashMap", step_deg: float, turns: float, rows: int, out: Path | None
) -> dict[str, Any]:
    """The object of schema `vttig.map/1`."""
    return {
        "schema": "vttig.map/1",
        "pair": fit.pair.name,
        "source": fit.source,
        "conditional_on": list(fit.conditional_on),
        "zero": fit.zero,
        "hunting_turns": grid.pair.hunting_turns,
        "span_turns": turns,
        "step_deg": step_deg,
        "rows": rows,
        "smallest": _extreme(grid.smallest),
        "largest": _extreme(grid.largest),
        "safe_closing_mm": grid.safe_closing_mm,
        "constant_backlash_deg": fit.parameters["constant_backlash_deg"].value,
        "csv": None if out is None else out.name,
    }


def _span(hunting_turns: int, step_deg: float, span_rev: float | None) -> float:
    if span_rev is not None:
        return span_rev
    limit = MOST_ROWS * step_deg / 360.0
    if hunting_turns > limit:
        LOGGER.warning(
            "the hunting period of %d turns is cut to %.4g turns (%d rows); --span-rev %d covers it"
            " all",
            hunting_turns,
            limit,
            MOST_ROWS,
            hunting_turns,
        )
    return min(float(hunting_turns), limit)


def _extreme(extreme: "Extreme") -> dict[str, Any]:
    from ..base.units import DEG

    return {
        "backlash_deg": extreme.backlash / DEG,
        "driving_deg": extreme.driving_angle / DEG,
        "tooth_pair": None if extreme.tooth_pair is None else list(extreme.tooth_pair),
    }


def csv_text(table: Any) -> str:
    """The map as CSV, empty where there is no geometry."""
    import numpy as np

    buffer = io.StringIO()
    np.savetxt(buffer, table, fmt="%.9g", delimiter=",", header=",".join(COLUMNS), comments="")
    return buffer.getvalue().replace("nan", "")


def _write(out: Path, table: Any, record: dict[str, Any], overwrite: bool) -> None:
    from ..base.jsonio import dumps
    from ..base.runfolder import RunFolder

    with RunFolder(out.parent, overwrite=overwrite, results=(out.name,)) as folder:
        folder.write_text(out.with_suffix(".json").name, dumps(record) + "\n")
        folder.write_text(out.name, csv_text(table))

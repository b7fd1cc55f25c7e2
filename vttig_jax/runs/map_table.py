"""Table and record of a backlash map: the contents of `map.csv` and `map.json`."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.units import DEG

if TYPE_CHECKING:
    from ..identify.result import Fit
    from ..kinematics.backlash_map import BacklashMap, Extreme
    from ..pair.gear_pair import Drive, GearPair
    from ..posterior.summary.bands import BandedMap

COLUMNS: tuple[str, ...] = (
    "driving_deg",
    "backlash_deg",
    "backlash_mm",
    "axial_mm",
    "backlash_first_order_deg",
)
"""Columns of `map.csv` for a map without posterior draws."""

INTERVAL = ("low95_deg", "high95_deg")
"""Further columns if a delay that the logs do not contain may shift the map."""


def columns_of(grid: "BacklashMap") -> tuple[str, ...]:
    """Return the names of the columns of `map_table`."""
    return COLUMNS if grid.shift is None else COLUMNS + INTERVAL


def map_table(grid: "BacklashMap", step_deg: float, turns: float) -> Any:
    """Return the values of `columns_of(grid)`, a row each, at driving angles 0°, `step_deg`, ….

    The rows cover `turns` driving revolutions. Lengths in mm are NaN if the pair does not define
    them.
    """
    from ..pair.gear_pair import GearPair

    driving_deg = np.arange(int(np.ceil(turns * 360.0 / step_deg - 1e-9))) * step_deg
    backlash = grid.over(driving_deg * DEG)
    millimetres = axial = np.full(len(driving_deg), np.nan)
    if isinstance(grid.pair, GearPair):
        millimetres = backlash * float(grid.pair.reference_radii[1])
        if thinning := float(grid.pair.thinning):
            axial = millimetres / thinning
    first = grid.first_order_over(driving_deg * DEG)
    found = [driving_deg, backlash / DEG, millimetres, axial, first / DEG]
    if grid.shift is not None:
        found += [end / DEG for end in grid.interval(backlash)]
    return np.stack(found, axis=1)


def shift_first(
    table: Any, columns: Sequence[str], pair: "GearPair | Drive"
) -> tuple[Any, tuple[str, ...]]:
    """Return a table of the backlash with its axial columns behind the angle, and their names.

    **Raises** `UsageError` for a pair whose backlash no axial displacement closes.
    """
    from ..control.compensation.compensation import closing_of, require_closing

    require_closing(closing_of(pair))
    behind = [place for place, name in enumerate(columns) if not name.startswith("axial")]
    order = [0, *sorted(set(range(len(columns))) - set(behind)), *behind[1:]]
    return table[:, order], tuple(columns[place] for place in order)


def map_record(
    fit: "Fit", grid: "BacklashMap", step_deg: float, turns: float, rows: int, out: Path | None
) -> dict[str, Any]:
    """Return the content of `map.json`, an object of schema `vttig.map/1`.

    `rows` and `out` are the number of rows and the path of the CSV file. In the object,
    `coverage.spans_deg` are the driving angles that were measured on both flanks; the rows of
    `map.csv` outside them are extrapolated.
    """
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
        "no_period": grid.no_period,
        "coverage": None if grid.coverage is None else grid.coverage.to_json(),
        "smallest": None if grid.unknown else _extreme(grid, grid.smallest),
        "largest": None if grid.unknown else _extreme(grid, grid.largest),
        "safe_closing_mm": None if grid.unknown else grid.safe_closing_mm,
        "gap_over_angles_covered": fit.checks.gap_over_angles_covered.to_json(),
        "constant_backlash_deg": fit.parameters["constant_backlash_deg"].value,
        "csv": None if out is None else out.name,
    }


def banded_record(
    fit: "Fit",
    banded: "BandedMap",
    rows: int,
    out: Path | None,
    closing_mm: tuple[float, ...] = (),
) -> dict[str, Any]:
    """Return the object of schema `vttig.map/1` for a map with bands; see `map_record`.

    It also contains the probability of the band, the smallest gap of the draws and, for each axial
    displacement in `closing_mm`, the probability that the gears bind.
    """
    chances = [(closing, banded.smallest.probability_of_binding(closing)) for closing in closing_mm]
    return map_record(
        fit, grid=banded.map, step_deg=banded.step_deg, turns=banded.turns, rows=rows, out=out
    ) | {
        "probability": banded.band.probability,
        "critical": banded.band.critical,
        "smallest_gap": None if banded.map.unknown else banded.smallest.to_json(),
        "binding": [
            {"closing_mm": closing, "probability": chance.value, "std_error": chance.std_error}
            for closing, chance in chances
        ],
    }


def _extreme(grid: "BacklashMap", extreme: "Extreme") -> dict[str, Any]:
    low, high = grid.interval(extreme.backlash)
    return {
        "backlash_deg": extreme.backlash / DEG,
        "low95_deg": None if grid.shift is None else float(low) / DEG,
        "high95_deg": None if grid.shift is None else float(high) / DEG,
        "driving_deg": extreme.driving_angle / DEG,
        "tooth_pair": None if extreme.tooth_pair is None else list(extreme.tooth_pair),
        "extrapolated": grid.is_extrapolated(extreme),
    }


def resolution(fit: "Fit", step_deg: float) -> str:
    """Return a sentence about how finely rows at steps of `step_deg` have the highest order."""
    order = fit.model.highest_order
    return (
        f"{360.0 / step_deg / order:.3g} rows in a cycle of the highest order, {order:g} a driving"
        " turn; the extremes above also lie between the rows"
    )


def csv_text(table: Any, columns: Sequence[str] = COLUMNS) -> str:
    """Return an array of shape (rows, columns) as CSV with a header; NaN becomes an empty field."""
    buffer = io.StringIO()
    np.savetxt(buffer, table, fmt="%.9g", delimiter=",", header=",".join(columns), comments="")
    return buffer.getvalue().replace("nan", "")

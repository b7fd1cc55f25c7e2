"""What a run says over the driving angle: the contents of `map.csv`, `map.json` and `error.csv`."""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..base.angles import angles_over_turns_deg
from ..base.units import DEG

if TYPE_CHECKING:
    from ..identify.result import Fit
    from ..kinematics.backlash_map import BacklashMap, Extreme
    from ..posterior.summary.bands import BandedMap
    from ..posterior.summary.posterior import Posterior

QuantityName = Literal["backlash", "error", "shift"]


@dataclass(frozen=True)
class RunTable:
    """A quantity of a run over the driving angle.

    **Arguments**
    - `record`: object of schema `vttig.map/1`. - `columns`: name → values, one per driving angle.
    - `text`: its report.
    """

    record: dict[str, Any]
    columns: dict[str, np.ndarray]
    text: str = ""


def run_table(
    fit: "Fit",
    quantity: QuantityName,
    step_deg: float,
    turns: float,
    *,
    posterior: "Posterior | None" = None,
    constant_backlash_deg: float | None = None,
    probability: float = 0.95,
    closing_mm: tuple[float, ...] = (),
    out: Path | None = None,
) -> RunTable:
    """Return a quantity of a fit at driving angles 0°, `step_deg`, … over `turns` driving turns.

    **Arguments**
    - `posterior`: draws of the fit, which give bands of the `probability`.
    - `closing_mm`: axial displacements whose probability to bind the record has, with draws.
    - `out`: path of the CSV file.

    **Raises** `NoAnswerError` for a backlash that the fit does not tell, and `UsageError` for the
    shift of a pair whose backlash no axial displacement closes.
    """
    if quantity == "error":
        from .error_table import error_table

        return RunTable(*error_table(fit, posterior, step_deg, turns, probability, out))
    if posterior is not None:
        from ..posterior.summary.bands import band_map

        found = banded_table(
            band_map(posterior, step_deg, turns, probability), fit, out, closing_mm
        )
    else:
        from ..identify.backlash import backlash_map
        from ..posterior.summary.draws import millimetres

        grid = backlash_map(fit, constant_backlash_deg=constant_backlash_deg)
        driving_deg = angles_over_turns_deg(step_deg, turns)
        backlash = grid.over(driving_deg * DEG)
        radius, axial = millimetres(grid.pair)
        columns = {
            "driving_deg": driving_deg,
            "backlash_deg": backlash / DEG,
            "backlash_mm": backlash * radius,  # NaN where the pair does not define lengths
            "axial_mm": backlash * axial,
            "backlash_first_order_deg": grid.first_order_over(driving_deg * DEG) / DEG,
        }
        if grid.shift is not None:  # a delay that the logs do not contain may shift the map
            low, high = grid.interval(backlash)
            columns |= {"low95_deg": low / DEG, "high95_deg": high / DEG}
        record = map_record(fit, grid, step_deg, turns, len(driving_deg), out)
        found = RunTable(record, columns, str(grid))
    columns = found.columns
    if quantity == "shift":
        from ..control.compensation.compensation import closing_of, require_closing

        require_closing(closing_of(fit.pair))
        ahead = [name for name in columns if name.startswith(("driving", "axial"))]
        columns = {name: columns[name] for name in (*ahead, *columns)}
    return RunTable(found.record | {"quantity": quantity}, columns, found.text)


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


def banded_table(
    banded: "BandedMap", fit: "Fit", out: Path | None, closing_mm: tuple[float, ...] = ()
) -> RunTable:
    """Return the table of a map with bands; its record is that of `map_record` with more entries.

    They are the probability of the band, the smallest gap of the draws and, for each axial
    displacement in `closing_mm`, the probability that the gears bind.
    """
    chances = [(closing, banded.smallest.probability_of_binding(closing)) for closing in closing_mm]
    rows = len(banded.driving_angle)
    record = map_record(fit, banded.map, banded.step_deg, banded.turns, rows, out) | {
        "probability": banded.band.probability,
        "critical": banded.band.critical,
        "smallest_gap": None if banded.map.unknown else banded.smallest.to_json(),
        "binding": [
            {"closing_mm": closing, "probability": chance.value, "std_error": chance.std_error}
            for closing, chance in chances
        ],
    }
    return RunTable(record, banded.columns, str(banded))


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


def csv_text(columns: Mapping[str, np.ndarray]) -> str:
    """Return columns of equal length as CSV with a header; NaN becomes an empty field."""
    buffer, table = io.StringIO(), np.stack(list(columns.values()), axis=1)
    np.savetxt(buffer, table, fmt="%.9g", delimiter=",", header=",".join(columns), comments="")
    return buffer.getvalue().replace("nan", "")

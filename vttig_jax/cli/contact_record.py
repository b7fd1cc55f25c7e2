"""What `vttig contact` says: the object of its schema, its text and its table."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from .map_verb import csv_text

if TYPE_CHECKING:
    from ..geometry.contact_report import Contacts
    from ..geometry.deviations import Deviations
    from ..geometry.gap_report import GapReport
    from ..pair.gears import GearPair

TABLE = "contact.csv"

Flanks = dict[str, "Contacts"]
"""Contact of flank A and of flank B at the same driving angles."""


def contact_record(
    gears: "GearPair",
    said: dict[str, Any],
    flanks: Flanks,
    gap: "GapReport",
    out: Path | None,
) -> dict[str, Any]:
    """The object of schema `vttig.contact/1`; `said` is what was asked for, by its keys."""
    import numpy as np

    from ..base.units import DEG

    left, angle = _backlash(flanks) / DEG, flanks["A"].driving_angle / DEG
    known = np.flatnonzero(np.isfinite(left))
    return {
        "schema": "vttig.contact/1",
        "pair": gears.name,
        **said,
        "centre_distance_mm": gap.centre_distance_mm,
        "axial_mm": gap.axial_mm,
        "rows": len(left),
        "rows_with_backlash": len(known),
        "flanks": {name: _flank(found) for name, found in flanks.items()},
        "smallest": _extreme(left, angle, known[np.argmin(left[known])] if len(known) else None),
        "largest": _extreme(left, angle, known[np.argmax(left[known])] if len(known) else None),
        "drawn_backlash_deg": gap.backlash / DEG,
        "apparent_backlash_deg": None if gap.apparent is None else gap.apparent / DEG,
        "csv": None if out is None else TABLE,
    }


def _extreme(backlash_deg: Any, driving_deg: Any, row: int | None) -> dict[str, float | None]:
    if row is None:
        return {"backlash_deg": None, "driving_deg": None}
    return {"backlash_deg": float(backlash_deg[row]), "driving_deg": float(driving_deg[row])}


def _backlash(flanks: Flanks) -> Any:
    """TE_B − TE_A in rad, NaN where one of the flanks touches nothing."""
    return flanks["B"].transmission_error - flanks["A"].transmission_error


def _flank(found: "Contacts") -> dict[str, Any]:
    from collections import Counter

    from ..base.units import DEG

    kinds = Counter(found.kind(place) for place in range(len(found.driving_angle)))
    error = found.transmission_error[found.found] / DEG
    return {
        "transmission_error_min_deg": error.min() if len(error) else None,
        "transmission_error_max_deg": error.max() if len(error) else None,
        "pairs_in_contact": float(found.pairs_in_contact.mean()),
        "largest_misfit_deg": found.largest_misfit / DEG,
        "kinds": dict(kinds.most_common()),
    }


def contact_text(
    flanks: Flanks,
    record: dict[str, Any],
    gap: "GapReport",
    deviations: "Deviations | None",
    out: Path | None,
) -> str:
    """What is printed without `--json`."""
    from ..base.tables import key_values

    rows = [
        (word, f"{one['backlash_deg']:.5f}° at {one['driving_deg']:g}°{_warning(one)}")
        for word in ("smallest", "largest")
        if (one := record[word])["backlash_deg"] is not None
    ]
    if (without := record["rows"] - record["rows_with_backlash"]) or not rows:
        rows.append(("undefined", f"at {without} of {record['rows']} angles: no tooth in reach"))
    if record["rig"] is not None:
        rows.append(("of the run", "eccentricities, not its constant backlash and higher orders"))
    if out is not None:
        rows.append(("table", str(out / TABLE)))
    over = f"backlash of the surfaces over {record['span_turns']:g} turns"
    measured = [] if deviations is None else [str(deviations)]
    parts = [str(found) for found in flanks.values()]
    return "\n".join([*measured, *parts, key_values(rows, title=over), str(gap)])


def _warning(place: dict[str, float]) -> str:
    return ", where the teeth interfere" if place["backlash_deg"] < 0 else ""


def contact_table(flanks: Flanks) -> str:
    """CSV, a driving angle a line; fields are empty where nothing touches."""
    import numpy as np

    from ..base.units import DEG

    left, angle = _backlash(flanks), flanks["A"].driving_angle
    columns = {"driving_deg": angle / DEG, "backlash_deg": left / DEG}
    for name, found in flanks.items():
        end = f"_{name.lower()}"
        teeth = np.where(found.found[:, None], found.tooth_pair, np.nan)
        columns |= {
            f"transmission_error{end}_deg": found.transmission_error / DEG,
            f"driving_tooth{end}": teeth[:, 0],
            f"driven_tooth{end}": teeth[:, 1],
            f"z{end}_mm": found.z_mm,
            f"driving_radius{end}_mm": found.radius_mm[:, 0],
            f"driven_radius{end}_mm": found.radius_mm[:, 1],
            f"line{end}_mm": found.length_mm,
        }
    return csv_text(np.stack(list(columns.values()), axis=1), tuple(columns))

"""Gear pairs from the tables of a pair file."""

from typing import Any

from vttig_jax.pair.gear_pair import GearPair, pair_from_spec
from vttig_jax.pair.pair_file import parse_pair_spec

Table = dict[str, Any]


def pair_of_table(
    rack: Table | None = None,
    driving: Table | None = None,
    driven: Table | None = None,
    *,
    teeth: tuple[int, int] = (45, 80),
    both: Table | None = None,
    **pair: Any,
) -> GearPair:
    """A pair with m = 2 mm and 20° unless `pair` says otherwise; `both` holds for both gears."""
    if not pair.keys() & {"module_mm", "normal_module_mm", "diametral_pitch"}:
        pair["module_mm"] = 2.0
    if not pair.keys() & {"pressure_angle_deg", "normal_pressure_angle_deg"}:
        pair["pressure_angle_deg"] = 20.0
    gears = [
        {"teeth": count} | (both or {}) | (own or {})
        for count, own in zip(teeth, (driving, driven), strict=True)
    ]
    table = {"pair": pair, "driving": gears[0], "driven": gears[1], "rack": rack or {}}
    found = pair_from_spec(parse_pair_spec(table))
    assert isinstance(found, GearPair)
    return found

"""Gear pairs for the tests of contact and backlash."""

from typing import Any

from vttig_jax.pair.gear_pair import Gear, GearPair
from vttig_jax.pair.schema import FLANKS as FLANKS


def pair_of(
    helix: Any = (3.0, 3.0),
    crowning: tuple[float, float] = (0.0, 0.0),
    widths: tuple[float, float] = (20.0, 20.0),
    *,
    teeth: tuple[int, int] = (45, 80),
    driven_helix: Any = None,
    shifts: tuple[float, float] = (0.0, 0.0),
    distance: Any = 125.12,
    pressure: Any = 20.0,
    **rack: Any,
) -> GearPair:
    """Gears of m = 2 mm; helix angles (left, right) in degrees, all else (driving, driven)."""
    helices = helix, helix if driven_helix is None else driven_helix
    gears = (
        Gear(
            teeth[k], both[0], both[1], widths[k], profile_shift=shifts[k], crowning_um=crowning[k]
        )
        for k, both in enumerate(helices)
    )
    sizes: dict[str, Any] = {"module_mm": 2.0, "pressure_angles_deg": pressure}
    return GearPair(*gears, **sizes, centre_distance_mm=distance, **rack)

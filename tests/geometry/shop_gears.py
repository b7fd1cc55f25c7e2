"""Gears for the tests of shop measures, and their flanks written down without the package."""

import math
from typing import Any, TypeVar

import equinox as eqx
import numpy as np

from tests.pair.tables import pair_of_table
from vttig_jax.geometry.tooth import Tooth, tooth_of

T = TypeVar("T")


def known(value: T | None) -> T:
    """A value that has to be there."""
    assert value is not None
    return value


def shop_gear(
    teeth: int = 45,
    *,
    helix: tuple[float, float] = (0.0, 0.0),
    shift: float = 0.0,
    crowning_um: float = 0.0,
    width: float | None = 20.0,
    rack: dict[str, float] | None = None,
    **pair: Any,
) -> Tooth:
    """The driving gear of a pair file: m = 2 mm and 20° unless `pair` says otherwise."""
    gear: dict[str, float] = {"helix_left_deg": helix[0], "helix_right_deg": helix[1]}
    if width is not None:
        gear |= {"face_width_mm": width}
    # The mate has the opposite shift, which leaves the centre distance as it is.
    shifts = {"profile_shift": shift, "crowning_um": crowning_um}, {"profile_shift": -shift}
    found = pair_of_table(rack, *shifts, teeth=(teeth, 100), both=gear, **pair)
    return tooth_of(found, "driving")


def scaled(tooth: Tooth, factor: float) -> Tooth:
    """The same gear `factor` times as large in all directions; straight or crowned flanks."""
    names = ("module_mm", "addendum_mm", "dedendum_mm", "fillet_radius_mm", "profile_shift_mm")
    tooth = eqx.tree_at(
        lambda t: [getattr(t, name) for name in (*names, "face_width_mm")],
        tooth,
        [getattr(tooth, name) * factor for name in (*names, "face_width_mm")],
    )
    return eqx.tree_at(
        lambda t: [getattr(f, n) for f in t.recession for n in ("crowning_mm", "face_width_mm")],
        tooth,
        [
            getattr(flank, name) * factor
            for flank in tooth.recession
            for name in ("crowning_mm", "face_width_mm")
        ],
    )


def flank_points(tooth: Tooth, side: int, roll: Any, z: Any) -> np.ndarray:
    """Points of a flank from the string that unwinds from the base circle, shape (..., 3).

    The tooth points along y; a right flank (side 1) is mirrored, so that it is a left one.
    """
    radius, angle = float(tooth.reference_radius), math.radians(tooth.pressure_angles_deg[side])
    half = math.pi * float(tooth.module_mm) / 4 + float(tooth.profile_shift_mm) * math.tan(angle)
    base = radius * math.cos(angle)
    # From the foot of the involute to the middle of the tooth, clockwise.
    foot = (half - tooth.recession[side](np.asarray(z))) / radius + math.tan(angle) - angle
    tangency = math.pi / 2 + foot - roll  # where the string leaves the circle
    x = base * (np.cos(tangency) - roll * np.sin(tangency))
    y = base * (np.sin(tangency) + roll * np.cos(tangency))
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)

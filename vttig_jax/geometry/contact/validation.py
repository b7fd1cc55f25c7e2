"""Checks of a pair before its contact is computed, and starts of its flanks."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...base.arrays import Number, Numbers, known
from ...base.errors import PairError
from ..mounting import Mounting
from ..tooth.form_circle import form_radius, undercut_depth
from ..tooth.rack_cutter import SIDES, rack_side
from ..tooth.recession import Taper
from ..tooth.tooth import Tooth
from ..tooth.validation import check_tooth
from .deviations import Deviations
from .first_contact import SearchGrid

Scalar = Float[Number, ""]
_SHAFTS = "driving", "driven"
_MARGIN = 1.2
"""Contact ratio above which eccentricities are assumed to cause no tip edge contact (chosen)."""

_SPARE = 0.2
"""Smallest excess of the number of searched tooth pairs over the contact ratio (chosen)."""


def flank_starts(teeth: tuple[Tooth, Tooth]) -> Float[Numbers, "gear=2 flank=2"]:
    """Return roll angles √(r²/r_b² − 1), rad, at form circles; rows gears, columns flanks A and B.

    An undercut flank begins where the fillet cuts it; if numbers are traced, on the base circle.

    **Raises** `PairError` if an undercut removes a flank completely.
    """
    rows = []
    for gear, tooth in enumerate(teeth):
        order = (0, 1) if gear == 0 else (1, 0)
        rows.append([_start(tooth, index, _SHAFTS[gear]) for index in order])
    if known(teeth):
        return np.array(rows, float)
    return jnp.stack([jnp.stack([jnp.asarray(roll) for roll in row]) for row in rows])


def _start(tooth: Tooth, index: int, shaft: str) -> Any:
    side, base = SIDES[index], tooth.base_radii[index]
    if known(tooth) and undercut_depth(tooth, side) > 0:
        radius = form_radius(tooth, side)
        if np.isnan(radius):
            raise PairError(
                f"undercut removes the whole {side} flank; give more teeth or profile shift.",
                where=shaft,
            )
        return np.sqrt(max((radius / float(base)) ** 2 - 1, 0.0))
    rack = rack_side(tooth, side)
    xp = np if known(tooth) else jnp
    sine = xp.sin(rack.pressure_angle)
    length = tooth.reference_radius * sine + rack.flank_start / sine
    return xp.maximum(length, 0.0) / base


def check_contact(
    teeth: tuple[Tooth, Tooth],
    mounting: Mounting,
    search_grid: SearchGrid,
    deviations: Deviations | None,
) -> None:
    """Raise `PairError` for gears that cannot be in contact; numbers must not be traced."""
    _check_distance(teeth, mounting)
    distance = float(mounting.centre_distance)
    if (needed := least_tooth_pairs(teeth, distance)) > search_grid.tooth_pairs:
        raise PairError(
            f"{search_grid.tooth_pairs} tooth pairs are too few for a contact ratio of"
            f" {_contact_ratios(teeth, distance).max():.2f}; give tooth_pairs={needed}.",
            where="contact ratio",
        )
    if search_grid.sections > 1 and all(np.isnan(float(tooth.face_width_mm)) for tooth in teeth):
        raise PairError(
            "the face width is missing, but contact differs along the face; give a face width.",
            where="driving.face_width_mm",
        )
    for shaft, tooth in zip(_SHAFTS, teeth, strict=True):
        _check_solid(tooth, shaft, float(tooth.face_width_mm))
    if deviations is not None:
        _check_pitches(teeth, deviations)


def _check_distance(teeth: tuple[Tooth, Tooth], mounting: Mounting) -> None:
    """Raise `PairError` if at some angle tip circles are apart or base circles overlap."""
    distance, offset = float(mounting.centre_distance), 0.0
    if known(mounting):
        offsets = mounting.driving_offset, mounting.driven_offset
        offset = float(sum(abs(np.asarray(value)) for value in offsets))
    change = f", eccentricities change the distance by ±{offset:.3f} mm" if offset else ""
    base = max(float(teeth[0].base_radii[k] + teeth[1].base_radii[1 - k]) for k in (0, 1))
    if not distance - offset > base:
        raise PairError(
            f"{distance:g} mm lets the base circles overlap (their radii sum to {base:.3f}"
            f" mm{change}); move the axes apart.",
            where="centre_distance_mm",
        )
    tips = sum(float(tooth.tip_radius) for tooth in teeth)
    if not distance + offset < tips:
        raise PairError(
            f"{distance:g} mm is too far for the teeth to touch (the tip radii sum to {tips:.3f}"
            f" mm{change}); move the axes together.",
            where="centre_distance_mm",
        )


def _check_solid(tooth: Tooth, shaft: str, width: float) -> None:
    """Raise `PairError` for a pointed tooth, whose flanks end below the tip circle."""
    heights = np.zeros(1) if np.isnan(width) else np.linspace(-width / 2, width / 2, 41)
    check_tooth(tooth, heights)
    tips = np.asarray(tooth.thickness(np.full(heights.shape, float(tooth.tip_radius)), heights))
    if tips.min() <= 0:
        height = heights[int(np.argmin(tips))]
        raise PairError(
            f"the flanks cross below the tip circle at z = {height:g} mm; make the face narrower,"
            " the addendum shorter or the profile shift smaller.",
            where=f"{shaft} tooth",
        )


def _check_pitches(teeth: tuple[Tooth, Tooth], deviations: Deviations) -> None:
    for shaft, tooth in zip(_SHAFTS, teeth, strict=True):
        pitch = getattr(deviations, f"{shaft}_pitch_um")
        if pitch is not None and pitch.shape != (2, tooth.teeth):
            raise PairError(
                f"the shape is {pitch.shape}; give one value for each flank and tooth, shape (2,"
                f" {tooth.teeth}).",
                where=f"{shaft}_pitch_um",
            )


def same_everywhere(teeth: tuple[Tooth, Tooth], distance: Scalar) -> bool:
    """Return whether all sections touch at once.

    They do if the recessions are linear and equal on both gears and no tip edge touches alone; a
    tip edge touches in one section later than in the next.
    """
    if not known(teeth, distance):
        return False
    for index in (0, 1):
        driving, driven = teeth[0].recession[index], teeth[1].recession[1 - index]
        if not (isinstance(driving, Taper) and isinstance(driven, Taper)):
            return False
        crowned = np.any(driving.crowning_mm) or np.any(driven.crowning_mm)
        if crowned or driving.slope != driven.slope:
            return False
    return bool(_contact_ratios(teeth, float(distance)).min() > _MARGIN)


def least_tooth_pairs(teeth: tuple[Tooth, Tooth], distance: Scalar | float) -> int:
    """Return the number of tooth pairs that must be searched to include the first contact."""
    return int(np.ceil(_contact_ratios(teeth, float(distance)).max() + _SPARE))


def _contact_ratios(teeth: tuple[Tooth, Tooth], distance: float) -> Float[np.ndarray, "2"]:
    """Return the contact ratios of flanks A and B at a centre distance, mm.

    `GearPair.contact_ratios` gives the same at the centre distance of the pair.
    """
    base = np.stack([teeth[0].base_radii, teeth[1].base_radii[::-1]])
    tips = np.array([[float(tooth.tip_radius)] for tooth in teeth])
    line = np.sqrt(np.maximum(distance**2 - base.sum(axis=0) ** 2, 0.0))
    path = np.sqrt(np.maximum(tips**2 - base**2, 0.0)).sum(axis=0) - line
    return path / base[0] * teeth[0].teeth / (2 * np.pi)

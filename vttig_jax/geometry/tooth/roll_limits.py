"""Roll angles at which the parts of a tooth begin and end.

All are roll angles of `tooth_surface`, counted from the receded flank, in the order root to tip.
Those of flank and fillet are the same in every section; where the lands meet in the middle depends
on the recession of both flanks, so these take z.
"""

import math
from collections.abc import Callable

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float, Real

from ...base.arrays import Number, Numbers, namespace
from .rack_cutter import SIDES, RackSide, Side, arc_roll, rack_side, side_index
from .tooth import Tooth

Scalar = Float[Number, ""]


def flank_roll(
    tooth: Tooth, radius: Real[ArrayLike, "*shape"], side: Side
) -> Float[Number, "*shape"]:
    """Roll angle at which the flank is made at a radius in mm, rad; NaN below the base circle.

        roll = ± [√(r²/r_b² − 1) − tan α − (π m/4 + shift tan α)/R]

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import flank_roll
    >>> from vttig_jax.geometry import tooth_of
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> np.degrees(flank_roll(tooth_of(pair, "driving"), np.array([44.0, 47.0]), "left")).round(3)
    array([-6.377,  4.943])

    ```
    """
    rack, index = rack_side(tooth, side), side_index(side)
    xp = namespace(tooth, radius)
    unwound = xp.sqrt((xp.asarray(radius, float) / tooth.base_radii[index]) ** 2 - 1)
    return rack.mirror * (unwound - xp.tan(rack.pressure_angle) - half_tooth(rack))


def flank_span(tooth: Tooth, side: Side) -> Float[Numbers, "2"]:
    """Roll angles at the end of the fillet and at the tip circle, rad.

    The first is where the arc of the cutter ends; on an undercut tooth the fillet has cut that part
    of the flank away. It rises on the left flank and falls on the right one.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import flank_span
    >>> from vttig_jax.geometry import tooth_of
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> np.degrees(flank_span(tooth_of(pair, "driving"), "right")).round(3)
    array([ 9.923, -4.943])

    ```
    """
    rack = rack_side(tooth, side)
    xp = namespace(tooth)
    return xp.stack([_joint(rack), flank_roll(tooth, tooth.tip_radius, side)])


def fillet_span(tooth: Tooth, side: Side) -> Float[Numbers, "2"]:
    """Roll angles at the root circle and where the flank begins, rad.

    The second is the first of `flank_span`. While the centre of the arc is below the pitch line, as
    usual, the fillet is made in the other sense of roll than the flank. Both limits are one where
    the centre lies on that line: the fillet is then the arc itself, made at once, and the roll
    angle does not tell its points apart.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import fillet_span
    >>> from vttig_jax.geometry import tooth_of
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> np.degrees(fillet_span(tooth_of(pair, "driving"), "right")).round(3)
    array([3.836, 9.923])

    ```
    """
    rack = rack_side(tooth, side)
    return namespace(tooth).stack([arc_roll(rack, _upright(tooth)), _joint(rack)])


def tip_span(tooth: Tooth, z: Real[ArrayLike, "*shape"], side: Side) -> Float[Numbers, "*shape 2"]:
    """Roll angles at the end of the flank on the tip circle and in the middle of the tip, rad.

    The tip is pointed where the second lies beyond the first; nothing is clipped.
    """
    return _roll_of_land(tooth, z, side, tip_arcs)


def root_span(tooth: Tooth, z: Real[ArrayLike, "*shape"], side: Side) -> Float[Numbers, "*shape 2"]:
    """Roll angles in the middle of the root land and where the fillet leaves the root circle, rad.

    The middle is that between this tooth and its neighbour on the side. Where the fillets of both
    overlap, it lies beyond the second; nothing is clipped.
    """
    return _roll_of_land(tooth, z, side, root_arcs)


def tip_arcs(tooth: Tooth, z: Float[Numbers, "*shape"]) -> Float[Numbers, "*shape 2 2"]:
    """Clockwise angles at which each half (left, right) of the tip land (starts, ends), rad."""
    xp = namespace(tooth, z)
    ends = tooth.half_angles(xp.zeros_like(z) + tooth.tip_radius, z)
    middle = (ends - ends[..., ::-1]) / 2
    return _clockwise(xp.stack([ends, middle], axis=-1))


def root_arcs(tooth: Tooth, z: Float[Numbers, "*shape"]) -> Float[Numbers, "*shape 2 2"]:
    """Clockwise angles at which each half (left, right) of the root land (starts, ends), rad."""
    xp = namespace(tooth, z)
    ends = root_angles(tooth, z)
    middle = (ends - ends[..., ::-1]) / 2 + math.pi / tooth.teeth
    return _clockwise(xp.stack([middle, ends], axis=-1))


def root_angles(tooth: Tooth, z: Float[Numbers, "*shape"]) -> Float[Numbers, "*shape 2"]:
    """Angles from the centre line of the tooth to where its fillets reach the root, rad."""
    xp = namespace(tooth, z)
    racks = [rack_side(tooth, side) for side in SIDES]
    ends = [r.mirror * -arc_roll(r, _upright(tooth)) for r in racks]
    return xp.stack(ends) - tooth.recessions(z) / tooth.reference_radius


def _clockwise(angles: Numbers) -> Numbers:
    """From angles towards each side (left, right) to angles that are positive on the right."""
    return angles * np.array([[-1.0], [1.0]])


def _roll_of_land(
    tooth: Tooth, z: Real[ArrayLike, "..."], side: Side, arcs: Callable[..., Numbers]
) -> Numbers:
    """A land is made straight above the pitch point, so that φ is the clockwise angle."""
    rack, xp = rack_side(tooth, side), namespace(tooth, z)
    height = xp.asarray(z, float)
    behind = xp.asarray(rack.mirror * rack.recedes(height) / rack.pitch_radius)
    return arcs(tooth, height)[..., side_index(side), :] - behind[..., None]


def _joint(rack: RackSide) -> Scalar:
    """Roll angle at which the end of the arc, the start of the straight flank, makes gear."""
    tangent = namespace(rack).tan(rack.pressure_angle)
    along = rack.flank_start * (tangent + 1 / tangent) / rack.pitch_radius
    return rack.mirror * (along - half_tooth(rack))


def half_tooth(rack: RackSide) -> Scalar:
    """(π m/4 + shift tan α)/R: half of the tooth at the reference circle where δ = 0, rad."""
    tangent = namespace(rack).tan(rack.pressure_angle)
    return (rack.quarter_pitch + rack.shift * tangent) / rack.pitch_radius


def _upright(tooth: Tooth) -> Scalar:
    return namespace(tooth).asarray(math.pi / 2)

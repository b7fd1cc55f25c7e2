"""Roll angles at the limits of the parts of a tooth.

They are roll angles of `tooth_surface`, counted from the receded flank, ordered from root to tip.
The limits of flank and fillet are the same in every section. The middle of a land depends on the
recession of both flanks, so the functions for the lands take z.
"""

import math
from collections.abc import Callable

from jax.typing import ArrayLike
from jaxtyping import Float, Real

from ...base.arrays import Number, Numbers, namespace
from .rack_cutter import SIDES, RackSide, Side, arc_roll, rack_side, side_index
from .tooth import Tooth

Scalar = Float[Number, ""]


def flank_roll(
    tooth: Tooth, radius: Real[ArrayLike, "*shape"], side: Side
) -> Float[Number, "*shape"]:
    """Return the roll angle of a flank point at a radius, rad; NaN below the base circle.

        roll = ± [√(r²/r_b² − 1) − tan α − (π m/4 + shift tan α)/R],    + left, − right flank

    Without recession it is the counter-clockwise rotation of the gear, from the position in which
    the centre line of the tooth passes through the pitch point, to the position in which the rack
    cuts this point. The radius r, the profile shift and the reference radius R are in mm.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import flank_roll, tooth_of
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
    """Return the roll angles at the end of the fillet and at the tip circle, rad.

    The first limit belongs to the end of the cutter's arc; on an undercut tooth the fillet removes
    that part of the flank. From root to tip the angle increases on the left flank and decreases on
    the right one.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import flank_span, tooth_of
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
    """Return the roll angles at the root circle and at the start of the flank, rad.

    The second limit is the first one of `flank_span`. If the arc centre is below the pitch line,
    which is usual, the roll angle changes in the opposite sense on fillet and flank. If it lies on
    the pitch line, both limits are equal: the fillet is the arc itself, generated at one roll
    angle, so the roll angle does not distinguish its points.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import fillet_span, tooth_of
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> np.degrees(fillet_span(tooth_of(pair, "driving"), "right")).round(3)
    array([3.836, 9.923])

    ```
    """
    rack = rack_side(tooth, side)
    return namespace(tooth).stack([arc_roll(rack, _right_angle(tooth)), _joint(rack)])


def tip_span(tooth: Tooth, z: Real[ArrayLike, "*shape"], side: Side) -> Float[Numbers, "*shape 2"]:
    """Return the roll angles at both ends of one half of the tip land at height z (mm), rad.

    The first angle belongs to the end of the flank on the tip circle, the second one to the middle
    of the tip land on the tip circle. From the first to the second the angle increases on the left
    side and decreases on the right side. If the order is reversed, the tooth is pointed: its flanks
    intersect below the tip circle. The angles are not clipped then.
    """
    return _roll_of_land(tooth, z, side, tip_arcs)


def root_span(tooth: Tooth, z: Real[ArrayLike, "*shape"], side: Side) -> Float[Numbers, "*shape 2"]:
    """Return the roll angles at both ends of one half of the root land at height z (mm), rad.

    The first angle belongs to the middle of the root land, between this tooth and its neighbour on
    that side, and the second one to the end of the fillet on the root circle. From the first to the
    second the angle increases on the left side and decreases on the right side. If the order is
    reversed, the fillets of both teeth overlap. The angles are not clipped then.
    """
    return _roll_of_land(tooth, z, side, root_arcs)


def tip_arcs(tooth: Tooth, z: Float[Numbers, "*shape"]) -> Float[Numbers, "*shape 2 2"]:
    """Return the clockwise angles, rad, of both ends of each half of the tip land.

    Axis −2 is the half (left, right). Axis −1 is (end of the flank, middle of the land).
    """
    xp = namespace(tooth, z)
    ends = tooth.half_angles(xp.zeros_like(z) + tooth.tip_radius, z)
    middle = (ends - ends[..., ::-1]) / 2
    return _clockwise(xp.stack([ends, middle], axis=-1))


def root_arcs(tooth: Tooth, z: Float[Numbers, "*shape"]) -> Float[Numbers, "*shape 2 2"]:
    """Return the clockwise angles, rad, of both ends of each half of the root land.

    Axis −2 is the half (left, right). Axis −1 is (middle of the land, end of the fillet).
    """
    xp = namespace(tooth, z)
    ends = root_angles(tooth, z)
    middle = (ends - ends[..., ::-1]) / 2 + math.pi / tooth.teeth
    return _clockwise(xp.stack([middle, ends], axis=-1))


def root_angles(tooth: Tooth, z: Float[Numbers, "*shape"]) -> Float[Numbers, "*shape 2"]:
    """Return the angles, rad, from the tooth's centre line to its fillets on the root circle."""
    racks = [rack_side(tooth, side) for side in SIDES]
    ends = [
        rack.mirror * -arc_roll(rack, _right_angle(tooth)) - rack.recedes(z) / rack.pitch_radius
        for rack in racks
    ]
    return namespace(tooth, z).stack(ends, axis=-1)


def _clockwise(angles: Numbers) -> Numbers:
    """Return clockwise angles from angles measured towards each side; axis −2 is (left, right)."""
    left, right = angles[..., 0, :], angles[..., 1, :]
    return namespace(angles).stack([-left, right], axis=-2)


def _roll_of_land(
    tooth: Tooth, z: Real[ArrayLike, "..."], side: Side, arcs: Callable[..., Numbers]
) -> Numbers:
    """Return the roll angles, rad, of a land; `arcs` is `tip_arcs` or `root_arcs`.

    The normal of a land is vertical, so that φ is the clockwise angle.
    """
    rack, xp = rack_side(tooth, side), namespace(tooth, z)
    height = xp.asarray(z, float)
    offset = xp.asarray(rack.mirror * rack.recedes(height) / rack.pitch_radius)
    return arcs(tooth, height)[..., side_index(side), :] - offset[..., None]


def _joint(rack: RackSide) -> Scalar:
    """Return the roll angle, rad, at which the joint of arc and straight flank is in contact."""
    tangent = namespace(rack).tan(rack.pressure_angle)
    along = rack.flank_start * (tangent + 1 / tangent) / rack.pitch_radius
    return rack.mirror * (along - half_tooth(rack))


def half_tooth(rack: RackSide) -> Scalar:
    """Return (π m/4 + shift tan α)/R, rad: half the tooth at the reference circle for δ = 0."""
    tangent = namespace(rack).tan(rack.pressure_angle)
    return (rack.quarter_pitch + rack.shift * tangent) / rack.pitch_radius


def _right_angle(tooth: Tooth) -> Scalar:
    return namespace(tooth).asarray(math.pi / 2)

"""How the rack makes the gear, (5)–(15): meshing and the way from the rack's frame to the gear's.

The gear turns by +φ (counter-clockwise) while the rack stands at x = −φ r₂, so that the pitch point
is at (φ r₂, 0) in S₁. A point of the rack makes gear where its normal passes through that point,

    y₁ = −(x₁ − φ r₂) tan α    on AC (10),    y₁ = (x₁ − φ r₂) tan α    on DF.

Inside, φ is the paper's. A flank that recedes by δ meets the pitch point later by δ/r₂, so `roll`
is counted from there, φ = roll ± δ(l)/r₂ (left, right): the same roll is then the same height on
the tooth in every section.
"""

import jax.numpy as jnp
from jaxtyping import Array

from ..base.arrays import namespace
from .rack import Points, RackSide, Values


def paper_angle(rack: RackSide, roll: Values, z: Values) -> Values:
    """φ of the paper at a roll angle counted from the receded flank, rad."""
    return roll + rack.mirror * rack.recedes(z) / rack.pitch_radius


def flank_distance(rack: RackSide, phi: Values, z: Values) -> Values:
    """Distance d of the contact from A or F: (1) in (10) gives (11), solved for d (14).

    d = sin α [π m/4 + h_ap tan α + (h_ap − shift)/tan α ± φ r₂ − δ(l)]
    """
    xp = namespace(rack, phi, z)
    tangent = xp.tan(rack.pressure_angle)
    height = rack.addendum * tangent + (rack.addendum - rack.shift) / tangent
    travel = rack.mirror * phi * rack.pitch_radius - rack.recedes(z)
    return xp.sin(rack.pressure_angle) * (rack.quarter_pitch + height + travel)


def arc_steepness(rack: RackSide, phi: Values, z: Values) -> Values:
    """By how much the normal at the contact on the arc falls, rad: (10) with the arc's centre.

    tan θ = −y_c/(x_c + δ ∓ φ r₂) with θ in (0, π).
    """
    xp = namespace(rack, phi, z)
    x, y = rack.arc_centre
    across = x + rack.recedes(z) - rack.mirror * phi * rack.pitch_radius
    return xp.arctan2(xp.abs(y), -xp.sign(y) * across)


def arc_roll(rack: RackSide, steep: Values) -> Values:
    """Roll angle at which the arc touches with a normal that falls by `steep`, rad."""
    x, y = rack.arc_centre
    return rack.mirror * (x + y / namespace(rack, steep).tan(steep)) / rack.pitch_radius


def to_gear(rack: RackSide, point: Points, phi: Values) -> Points:
    """From S₁ to S₂, (13) and (15).

    x₂ = x₁ cos φ + y₁ sin φ + r₂ (sin φ − φ cos φ)
    y₂ = −x₁ sin φ + y₁ cos φ + r₂ (cos φ + φ sin φ)
    z₂ = l
    """
    xp = namespace(point, phi)
    x, y, z = point[..., 0], point[..., 1], point[..., 2]
    radius, cosine, sine = rack.pitch_radius, xp.cos(phi), xp.sin(phi)
    # Gathered by φ r₂, which x₁ nearly cancels: the sum of large terms would cost digits.
    across, up = x - phi * radius, y + radius
    turned = across * cosine + up * sine, up * cosine - across * sine, z
    return xp.stack(xp.broadcast_arrays(*turned), axis=-1)


def turn_to_gear(vector: Points, phi: Values) -> Array:
    """A direction from S₁ to S₂: the rotation in (13)."""
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    cosine, sine = jnp.cos(phi), jnp.sin(phi)
    return jnp.stack([x * cosine + y * sine, y * cosine - x * sine, z], axis=-1)


def contact(rack: RackSide, part: str, roll: Array, z: Array) -> tuple[Points, Array, Array]:
    """Where a part of the rack makes gear: the point in S₁, how its normal falls, and φ."""
    phi = jnp.asarray(paper_angle(rack, roll, z))
    upright = jnp.full_like(phi, jnp.pi / 2)
    if part == "flank":
        point = rack.flank(flank_distance(rack, phi, z), z)
        return point, jnp.broadcast_to(rack.pressure_angle, phi.shape), phi
    if part == "fillet":
        steep = jnp.asarray(arc_steepness(rack, phi, z))
        return rack.arc(steep, z), steep, phi
    pitch_point = rack.mirror * phi * rack.pitch_radius  # normals of the lines are upright
    if part == "root":
        return rack.tip_line(pitch_point, z), upright, phi
    return rack.root_line(pitch_point, z), upright, phi

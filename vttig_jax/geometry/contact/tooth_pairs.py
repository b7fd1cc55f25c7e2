"""Tooth pairs that can touch at a driving angle, and the zero of φ₂."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.arrays import Number, Numbers
from ..mounting import Mounting, Values
from ..tooth.tooth import Tooth
from .deviations import Deviations
from .flanks import Mates, Pose, flank_of

Scalar = Float[Number, ""]


class Path(eqx.Module):
    """Path of contact from tip to tip in roll angles of the driving flank, rad.

    **Arguments**
    - `pitch_roll`: roll angle at the pitch point.
    - `pitch_angle`: angle from the line of centres to the driving tooth that touches at the pitch
      point on flank A.
    - `approach`: roll angle from the pitch point to the driven tip on the line of action.
    - `recess`: roll angle from the pitch point to the driving tip.
    """

    pitch_roll: Values
    pitch_angle: Values
    approach: Values
    recess: Values


def path_of(mates: Mates, distance: Scalar) -> Path:
    """Return the path of contact of concentric gears at a centre distance, mm."""
    driving, driven = mates.driving, mates.driven
    cosine = (driving.base_radius + driven.base_radius) / distance
    alpha = jnp.arccos(cosine)
    roll = jnp.tan(alpha)
    half = driving.base_half_angle - driving.recession(jnp.zeros(())) / driving.reference_radius
    return Path(
        pitch_roll=roll,
        pitch_angle=roll - alpha - half,
        approach=(driven.tip - roll) * driven.base_radius / driving.base_radius,
        recess=driving.tip - roll,
    )


def chosen_pairs(
    path: Path, mates: Mates, driving_angle: Float[Array, " n"], pairs: int
) -> tuple[Values, Values]:
    """Return the `pairs` driving teeth that are nearest to the middle of the path of contact.

    **Returns** two arrays of shape (pair, n): the angle, rad, of each tooth from the line of
    centres, and its number. Whole pitches are subtracted from `driving_angle`, rad, so that angles
    over many turns keep their digits.
    """
    middle = mates.sense * (path.pitch_angle + (path.recess - path.approach) / 2)
    nearest = jnp.floor((driving_angle - middle) / mates.pitch + pairs % 2 / 2)
    number = nearest[None] + (jnp.arange(pairs)[:, None] - (pairs - 1) // 2)
    number = jax.lax.stop_gradient(number)
    return driving_angle[None] - number * mates.pitch, number


def concentric_touch(mates: Mates, distance: Scalar) -> Values:
    """Return TE, rad, at which the flanks of concentric gears touch at their pitch point.

    The gears are as drawn with s = 0 in the section z = 0. The value defines the zero of φ₂ and the
    start of the search; the search does not assume that TE is constant along the path of contact.
    """
    path, zero = path_of(mates, distance), jnp.zeros(())
    centre = zero.astype(complex)
    mounting = Mounting(distance, zero, centre, centre, jnp.full(2, jnp.nan))
    pose = Pose(mates.sense * path.pitch_angle, zero, (zero, zero), (zero, zero))
    return mates.reach(mounting, pose, path.pitch_roll, zero).error


def mates_of(
    teeth: tuple[Tooth, Tooth],
    starts: Float[Numbers, "gear=2 flank=2"],
    ratio: Float[Array, ""],
    deviations: Deviations | None,
    side: int,
) -> Mates:
    """Return the flanks A (`side` 0) or B (1) of both gears; their `standing` is still 0."""
    driving, driven = teeth
    given: list[dict[str, Any]] = [{}, {}]
    if deviations is not None:
        maps = deviations.driving[side], deviations.driven[side]
        pitches = deviations.driving_pitch_um, deviations.driven_pitch_um
        for gear, (flank_map, pitch) in enumerate(zip(maps, pitches, strict=True)):
            given[gear]["map"] = None if flank_map is None else flank_map.prepared()
            given[gear]["pitch"] = None if pitch is None else jnp.asarray(pitch)[side]
    return Mates(
        sense=jnp.asarray(1.0 - 2.0 * side),
        ratio=ratio,
        pitch=jnp.asarray(2 * math.pi / driving.teeth),
        driving=flank_of(driving, side, starts[0, side], **given[0]),
        driven=flank_of(driven, 1 - side, starts[1, side], **given[1]),
        standing=jnp.zeros(()),
    )

"""Which teeth can touch at a driving angle, and where the driven gear has its zero of φ₂."""

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
    """Of contact from tip to tip, in roll angles of the driving flank from the pitch point.

    **Arguments**
    - `pitch_roll`: at the pitch point.
    - `pitch_angle`: from the line of centres to the driving tooth that touches there, on flank A.
    - `approach`: to where the driven tip is on the line of action.
    - `recess`: to where the driving tip is.
    """

    pitch_roll: Values
    pitch_angle: Values
    approach: Values
    recess: Values


def path_of(mates: Mates, distance: Scalar) -> Path:
    """Path of contact of concentric gears at a centre distance, mm."""
    driving, driven = mates.driving, mates.driven
    cosine = (driving.base_radius + driven.base_radius) / distance
    alpha = jnp.arccos(cosine)
    roll = jnp.tan(alpha)
    half = driving.foot - driving.recession(jnp.zeros(())) / driving.reference_radius
    return Path(
        pitch_roll=roll,
        pitch_angle=roll - alpha - half,
        approach=(driven.tip - roll) * driven.base_radius / driving.base_radius,
        recess=driving.tip - roll,
    )


def chosen_pairs(
    path: Path, mates: Mates, driving_angle: Float[Array, " n"], pairs: int
) -> tuple[Values, Values]:
    """Driving teeth around the path of contact: their angles from the line of centres, and numbers.

    Whole pitches come off first, so that angles over many turns keep their digits. Shape (pair, n).
    """
    middle = mates.sense * (path.pitch_angle + (path.recess - path.approach) / 2)
    nearest = jnp.floor((driving_angle - middle) / mates.pitch + pairs % 2 / 2)
    number = nearest + (jnp.arange(pairs)[:, None] - (pairs - 1) // 2)
    number = jax.lax.stop_gradient(number)
    return driving_angle - number * mates.pitch, number


def concentric_touch(mates: Mates, distance: Scalar) -> Values:
    """TE at which the flanks of concentric gears meet at their pitch point, rad.

    As drawn, s = 0, in the section z = 0. This says where φ₂ is 0 and where to start a search; that
    involutes keep this transmission error along their whole path is left for the search to find.
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
    """Flank A (0) or B (1) of both gears, standing at 0."""
    driving, driven = teeth
    given: list[dict[str, Any]] = [{}, {}]
    if deviations is not None:
        maps = deviations.driving[side], deviations.driven[side]
        pitches = deviations.driving_pitch_um, deviations.driven_pitch_um
        for place, (found, pitch) in enumerate(zip(maps, pitches, strict=True)):
            given[place]["map"] = None if found is None else found.prepared()
            given[place]["pitch"] = None if pitch is None else jnp.asarray(pitch)[side]
    return Mates(
        sense=jnp.asarray(1.0 - 2.0 * side),
        ratio=ratio,
        pitch=jnp.asarray(2 * math.pi / driving.teeth),
        driving=flank_of(driving, side, starts[0, side], **given[0]),
        driven=flank_of(driven, 1 - side, starts[1, side], **given[1]),
        standing=jnp.zeros(()),
    )

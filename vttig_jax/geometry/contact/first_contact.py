"""The first of all touches at each driving angle, and the transmission error there."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..mounting import Mounting, Values
from .flanks import Mates, Pose
from .search import Place, Scene, TouchPoint, nearest_best, search, share_of_middle
from .tooth_pairs import chosen_pairs, concentric_touch, path_of

_AT_ONCE = 2**17
"""Points of flanks that are looked at together: what stays in a processor's cache."""

_FEWEST = 64
"""Driving angles that are."""


class Effort(eqx.Module):
    """What is searched.

    **Arguments**
    - `sections`: over the common face; 1 for the section z = 0 alone.
    - `tooth_pairs`: pairs of teeth around the line of centres.
    - `points`: roll angles on the grid of a flank.
    """

    sections: int = eqx.field(static=True)
    tooth_pairs: int = eqx.field(static=True)
    points: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        for name, least in (("sections", 1), ("tooth_pairs", 1), ("points", 3)):
            if getattr(self, name) < least:
                raise ValueError(
                    f"Argument `{name}` must be {least} or more, but is {getattr(self, name)}."
                )

    @property
    def at_once(self) -> int:
        """Driving angles that are looked at together."""
        cacheful = _AT_ONCE // (self.points * self.tooth_pairs)
        return max(cacheful // _FEWEST, 1) * _FEWEST

    def filled_up(self, *rows: Float[Array, " n"]) -> tuple[Float[Array, " m"], ...]:
        """Rows of one length made longer by their last value, to one of a few lengths.

        A power of two, or whole cachefuls: other numbers of angles then compile nothing.
        """
        count = rows[0].shape[0]
        fuller = min(max(_FEWEST, 1 << (count - 1).bit_length()), self.at_once)
        pieces = -(-count // self.at_once)
        if pieces > 1:
            fuller = pieces * -(-count // pieces // _FEWEST) * _FEWEST
        # NumPy compiles nothing for a new length.
        pads = (jnp if isinstance(row, Tracer) else np for row in rows)
        filled = (
            xp.pad(row, (0, fuller - count), mode="edge")
            for xp, row in zip(pads, rows, strict=True)
        )
        return tuple(jnp.asarray(row) for row in filled)


class Winner(eqx.Module):
    """The touch that comes first, by driving angle; nothing in it is differentiated."""

    error: Float[Array, " n"]
    roll: Float[Array, " n"]
    share: Float[Array, " n"]
    place: Float[Array, " n"]
    tooth: Float[Array, " n"]


def scene_of(
    mates: Mates,
    mounting: Mounting,
    effort: Effort,
    driving_angle: Float[Array, " n"],
    driven_angle: Float[Array, " n"] | None,
) -> Scene:
    """What is searched at driving angles; the driven centre stays where `driven_angle` has it."""
    path = path_of(mates, mounting.centre_distance)
    turned, number = chosen_pairs(path, mates, driving_angle, effort.tooth_pairs)
    guess = None
    if driven_angle is None:
        guess = concentric_touch(mates, mounting.centre_distance)
        driven_angle = mates.ratio * driving_angle + guess
    centres = mounting.driving_centre(driving_angle), mounting.driven_centre(driven_angle)
    return Scene(mates, mounting, Pose(turned, number, *centres), guess, effort.points)


def first_of(scene: Scene, found: TouchPoint) -> Winner:
    """The first of all touches."""
    section, pair = nearest_best(scene.mates.sense * found.error)
    column = jnp.arange(found.error.shape[-1])

    def taken(values: Array) -> Array:
        return values[section, pair, column].astype(float)

    tooth = scene.pose.tooth[pair, column]
    error, roll, share = (taken(one) for one in (found.error, found.roll, found.share))
    return Winner(error, roll, share, taken(found.place), tooth)


def winners(
    mates: Mates,
    mounting: Mounting,
    effort: Effort,
    driving_angle: Float[Array, " n"],
    driven_angle: Float[Array, " n"] | None,
) -> Winner:
    """First touches at driving angles that `Effort.filled_up` has filled up.

    Compiled by itself and not differentiated, so that a derivative does not compile it again.
    """
    given = jax.tree.map(jax.lax.stop_gradient, (mates, mounting, driving_angle, driven_angle))
    found = _winners(given[0], given[1], effort, given[2], given[3])
    if effort.sections > 1:
        return found
    # The section z = 0 stays where it is, whatever the ends of the face do.
    share = jnp.broadcast_to(share_of_middle(mounting), found.share.shape)
    return eqx.tree_at(lambda winner: winner.share, found, share)


@eqx.filter_jit
def _winners(
    mates: Mates,
    mounting: Mounting,
    effort: Effort,
    driving_angle: Float[Array, " n"],
    driven_angle: Float[Array, " n"] | None,
) -> Winner:
    """A cacheful of angles at once."""

    def some(angles: tuple[Array, Array | None]) -> Winner:
        scene = scene_of(mates, mounting, effort, *angles)
        return first_of(scene, search(scene, effort.sections))

    pieces = -(-len(driving_angle) // effort.at_once)
    if pieces == 1:
        return some((driving_angle, driven_angle))

    def cut(values: Array) -> Array:
        return values.reshape(pieces, -1)

    found = jax.lax.map(some, jax.tree.map(cut, (driving_angle, driven_angle)))
    return jax.tree.map(jnp.ravel, found)


@eqx.filter_jit
def error_of(
    mates: Mates, mounting: Mounting, driving_angle: Float[Array, " n"], winner: Winner
) -> Float[Array, " n"]:
    """TE at a touch that is known, with the driven centre where it then is, rad.

    By the envelope theorem its derivative is that of first touch: the point on the flank, the
    section and the pair of teeth stay; a tip edge and an end of the face move with the gear. The
    search knows φ₂ to second order in what moves the driven centre, so that one step of Newton's
    method is left; its derivative is that of the solution.
    """
    guess = jnp.where(winner.place == Place.NOTHING, 0.0, winner.error)
    error, lag = _held_at(
        mates, mounting, driving_angle, mates.ratio * driving_angle + guess, winner
    )
    return guess + (error - guess) / (1 - lag)


@eqx.filter_jit
def error_at(
    mates: Mates,
    mounting: Mounting,
    driving_angle: Float[Array, " n"],
    driven_angle: Float[Array, " n"],
    winner: Winner,
) -> Float[Array, " n"]:
    """TE at a touch that is known, with the driven centre where φ₂ has it, rad."""
    return _held_at(mates, mounting, driving_angle, driven_angle, winner)[0]


def _held_at(
    mates: Mates,
    mounting: Mounting,
    driving_angle: Float[Array, " n"],
    driven_angle: Float[Array, " n"],
    winner: Winner,
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """TE, and how it changes with the φ₂ that places the driven centre; that is a number."""
    pose = Pose(
        driving_angle - winner.tooth * mates.pitch,
        winner.tooth,
        mounting.driving_centre(driving_angle),
        mounting.driven_centre(driven_angle),
    )
    driving, driven = mates.driving, mates.driven
    on_tip = winner.place == Place.DRIVEN_TIP
    on_end = on_tip | (winner.place == Place.DRIVEN_START)
    end = jnp.where(on_tip, driven.tip, driven.start)

    def seen(roll: Values) -> tuple[Values, Values]:
        reach = mates.reach(mounting, pose, roll, winner.share)
        return reach.error, reach.radius

    ones = jnp.ones_like(winner.roll)
    (_, there), slopes = jax.jvp(seen, (winner.roll,), (ones,))
    rise, widening = jax.lax.stop_gradient(slopes)
    widening = jnp.where(widening == 0, 1.0, widening)
    # A step of Newton's method to an end of the driven flank; its derivative is that of the end.
    beyond = there - driven.base_radius * jnp.sqrt(1 + end**2)
    roll = jnp.where(on_end, winner.roll - beyond / widening, winner.roll)
    roll = jnp.where(winner.place == Place.DRIVING_TIP, driving.tip, roll)
    roll = jnp.where(winner.place == Place.DRIVING_START, driving.start, roll)
    reach = mates.reach(mounting, pose, roll, winner.share)
    lag = reach.lag - jnp.where(on_end, rise * reach.drift / widening, 0.0)
    error = jnp.where(winner.place == Place.NOTHING, jnp.nan, reach.error)
    return error, jax.lax.stop_gradient(lag)

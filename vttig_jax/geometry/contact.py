"""Flank model of the unloaded contact of two tooth surfaces, and the search for first contact.

In one section and for one tooth pair, φ₂(u) is the driven angle at which the driving flank touches
with its roll angle u. The gears cannot penetrate, so the largest φ₂(u) is the first contact on
flank A and the smallest on flank B. A grid of u is followed by Newton's method between the
neighbours on that grid; if the extreme is outside the driven flank, first contact is at the end of
that flank. Arrays have the axes (section, pair, angle); the last axis is long and vectorised.
"""

import math
from dataclasses import replace
from enum import IntEnum
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..base.arrays import Numbers, float64, known
from ..base.errors import PairError
from ..base.numerics.implicit import at_extreme, known_root
from ..kinematics.flank_model import (
    FIRST_ORDERS,
    Angles,
    AnglesLike,
    GridOrders,
    ImplicitModel,
    flank_index,
)
from ..pair.gear_pair import Eccentricities, Flank, GearPair
from .checks import check_pointed, check_tooth, section_heights
from .deviations import Deviations
from .flanks import Mates, Pose, Reach, concentric_touch, flank_starts, mates_of, pitch_point
from .mounting import Misalignment, Mounting, Values
from .tooth import SHAFTS, Scalar, Tooth, tooth_of

# Chosen values:
_SECTIONS, _TOOTH_PAIRS, _POINTS = 9, 3, 9  # of the default grid; points are roll angles
_STEPS = 6  # of Newton's method, to the extreme and to the ends of the driven flank
_CLIMBS = 3  # sections are searched on the grid, and then twice on the parabola through each
_REFINEMENTS, _NEAR = 10, 1e-4  # of the section, and least distance for a parabola, in the face
TIE = 1e-13  # difference, rad, below which contacts are equal; the middle one is then used
_AT_ONCE, _FEWEST = 2**17, 64  # flank points in one batch (a cache's worth), and least angles
_MARGIN = 1.2  # contact ratio above which eccentricities are assumed to cause no edge contact
_SPARE = 0.2  # smallest excess of the number of searched tooth pairs over the contact ratio


class Place(IntEnum):
    """Part of the flanks that touches."""

    FLANK = 0
    DRIVING_TIP = 1
    DRIVEN_TIP = 2
    DRIVING_START = 3
    DRIVEN_START = 4
    NOTHING = 5

    def __str__(self) -> str:
        return self.name.lower().replace("_", " ")


class SearchGrid(eqx.Module):
    """Grid of the search for first contact.

    **Arguments**
    - `sections`: number of sections over the common face; 1 for the section z = 0 alone.
    - `tooth_pairs`: number of tooth pairs around the line of centres.
    - `points`: number of roll angles on a flank.
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

    def batches(self, row: Float[Numbers, " n"]) -> Float[Array, "batches size"]:
        """Pad a row with its last value and divide it, so that few lengths are compiled.

        A single batch has a power of two as length.
        """
        size = max(_AT_ONCE // (self.points * self.tooth_pairs * _FEWEST), 1) * _FEWEST
        count = row.shape[0]
        batches = -(-count // size)
        length = -(-count // (batches * _FEWEST)) * _FEWEST
        length = length if batches > 1 else min(max(_FEWEST, 1 << (count - 1).bit_length()), size)
        # Known values are padded by NumPy, which does not compile for a new length.
        xp = np if known(row) else jnp
        padded = xp.pad(row, (0, batches * length - count), mode="edge")
        return jnp.asarray(padded).reshape(batches, length)


class TouchPoint(eqx.Module):
    """Contact of a tooth pair in a section; the first over all roll angles, without derivatives.

    **Arguments**
    - `error`: TE, rad; −∞ on flank A and +∞ on flank B if the pair does not touch.
    - `roll`: roll angle of the driving flank, rad.
    - `share`: place of the section in the common face, 0 … 1; None for the section z = 0.
    - `place`: part of the flanks that touches, a number of `Place`.
    - `tooth`: number of the driving tooth, 0 for the one between the axes at φ = 0.
    """

    error: Float[Array, "*shape"]
    roll: Float[Array, "*shape"]
    share: Float[Array, "*shape"] | None
    place: Float[Array, "*shape"]
    tooth: Float[Array, "*shape"]


class ContactSearch(eqx.Module):
    """Problem of the search for first contact.

    **Arguments**
    - `mates`, `mounting`: flanks and position of the gears; they are not differentiated.
    - `pose`: n positions of the driving gear, arrays of shape (pair, n) or (1, n).
    - `guess`: TE, rad, that places the driven base circle centre first; None if it is fixed.
    - `grid`: grid of the search.
    """

    mates: Mates
    mounting: Mounting
    pose: Pose
    guess: Values | None
    grid: SearchGrid

    def reach(self, roll: Values, share: Values) -> Reach:
        """Return `Mates.reach`, corrected by one Newton step for the motion of the driven centre.

        If `guess` is None, the centre is fixed and nothing is corrected.
        """
        reach = self.mates.reach(self.mounting, self.pose, roll, share)
        if self.guess is None:
            return reach
        step = (reach.error - self.guess) / (1 - reach.error_by_driven)
        corrected = self.guess + step, reach.radius + reach.radius_by_driven * step
        return eqx.tree_at(lambda tree: (tree.error, tree.radius), reach, corrected)

    def touch_at(self, share: Float[Array, "pair n"]) -> TouchPoint:
        """Return the first contact of each tooth pair in one section, given for each position."""
        driving, driven, sense = self.mates.driving, self.mates.driven, self.mates.sense
        low, high = driving.limits[:2]
        radii = driven.base_radius * jnp.sqrt(1 + driven.limits**2)
        ones = jnp.ones_like(share)

        def height(roll: Values) -> Values:
            return sense * self.reach(roll, share).error

        def radius(roll: Values) -> Values:
            return self.reach(roll, share).radius

        def rising(roll: Values) -> tuple[Values, Values]:
            return jax.jvp(height, (roll,), (ones,))

        def newton(_, state: tuple[Values, ...]) -> tuple[Values, ...]:
            roll, low, high, best, highest = state
            (value, rise), (_, bend) = jax.jvp(rising, (roll,), (ones,))
            better = value > highest - TIE  # the latest of equal steps is the most precise
            best, highest = jnp.where(better, roll, best), jnp.where(better, value, highest)
            low, high = jnp.where(rise > 0, roll, low), jnp.where(rise < 0, roll, high)
            halfway = jnp.where(rise > 0, roll + high, roll + low) / 2
            top = jnp.clip(roll - rise / jnp.where(bend < 0, bend, 1.0), low, high)
            following = jnp.where(bend < 0, top, halfway)
            return jnp.where(jnp.isnan(rise), roll, following), low, high, best, highest

        def to_ends(_, rolls: Values) -> Values:
            at, change = jax.jvp(jax.vmap(radius), (rolls,), (jnp.ones_like(rolls),))
            excess = at - radii[:, None, None]
            return jnp.clip(rolls - excess / jnp.where(change == 0, 1.0, change), low, high)

        middle = jnp.broadcast_to((low + high) / 2, (len(radii), *share.shape))
        last, first, *edges = jax.lax.fori_loop(0, _STEPS, to_ends, middle)
        edges += [jnp.full_like(last, edge) for edge in driving.limits[2:]]
        rolls = jnp.linspace(first, last, self.grid.points)
        spacing, heights = rolls[1] - rolls[0], jax.vmap(height)(rolls)
        # Of hills between points of the grid, the highest can have the lower points: the tops of
        # the parabolas through each three points take part, and the edges at which maps end.
        rise, bend = (heights[2:] - heights[:-2]) / 2, jnp.diff(heights, 2, axis=0)
        step = jnp.clip(-rise / jnp.where(bend < 0, bend, jnp.inf), -1.0, 1.0)
        tops = rolls[1:-1] + spacing[None] * step
        tops = jnp.concatenate([tops, *(jnp.clip(edge, first, last)[None] for edge in edges)])
        heights = jnp.concatenate([heights, jax.vmap(height)(tops)])
        rolls = jnp.concatenate([rolls, tops])
        start = jnp.take_along_axis(rolls, jnp.argmax(heights, axis=0)[None], 0)[0]
        ends = jnp.maximum(start - spacing, first), jnp.minimum(start + spacing, last)
        initial = (start, *ends, start, jnp.full_like(start, -jnp.inf))
        *_, roll, _ = jax.lax.fori_loop(0, _STEPS, newton, initial)
        at = self.reach(roll, share)
        missed = jnp.abs(at.radius - jnp.clip(at.radius, *radii[:2])) > 1e-9 * radii[1]
        nothing = missed | jnp.less(*self.mounting.face()[::-1]) | jnp.isnan(at.error)
        upper = jnp.where(last >= high, Place.DRIVING_TIP, Place.DRIVEN_START)
        lower = jnp.where(first <= low, Place.DRIVING_START, Place.DRIVEN_TIP)
        place = jnp.where(roll >= last, upper, jnp.where(roll <= first, lower, Place.FLANK))
        return TouchPoint(
            error=jnp.where(nothing, -sense * jnp.inf, at.error),
            roll=roll,
            share=share,
            place=jnp.where(nothing, Place.NOTHING, place).astype(float),
            tooth=jnp.broadcast_to(self.pose.tooth, share.shape),
        )

    def touches(self) -> TouchPoint:
        """Return the first contact of every tooth pair in the sections of the grid.

        The rows are evenly spaced sections from end to end of the common face, and the section in
        which each tooth pair touches first, refined between them; for a single section, which is
        the middle of the face, there is only one row.
        """
        shape = jnp.broadcast_shapes(*(leaf.shape for leaf in jax.tree.leaves(self.pose)))
        sections = self.grid.sections
        if sections == 1:
            middle = self.touch_at(jnp.broadcast_to(share_of(self.mounting, jnp.zeros(())), shape))
            return jax.tree.map(lambda values: values[None], middle)

        def first(heights: Values) -> Int[Array, "pair n"]:
            """Return the row of the earliest contact, of the grid unless a later row is earlier."""
            on_grid, later = heights[:sections], heights[sections:]
            best, highest = nearest(on_grid, (sections,)), jnp.max(later, axis=0)
            earlier = highest > jnp.take_along_axis(on_grid, best[None], 0)[0]
            # The last of equal refinements is the most precise.
            last = len(later) - jnp.argmax(later[::-1] >= highest[None] - TIE, axis=0)
            return jnp.where(earlier, sections + last - 1, best)

        # On a tilted axis the edges of the driven map are only nearly in one section.
        maps = self.mates.driving.map, self.mates.driven.map
        edges = [] if maps[0] is None else [maps[0].z[0], maps[0].z[-1]]
        edges += [] if maps[1] is None else [-maps[1].z[k] - self.mounting.axial for k in (0, -1)]
        given = [*jnp.linspace(0.0, 1.0, sections), *(share_of(self.mounting, z) for z in edges)]
        climbing, rows = _CLIMBS * len(given), _CLIMBS * len(given) + _REFINEMENTS

        def step(known: tuple[Values, Values], row: Array) -> tuple[tuple[Values, Values], Any]:
            shares, heights = known
            climbs = jnp.where(row < climbing, row - len(given), first(heights))
            following = next_share(shares, heights, climbs)
            on_grid = jnp.broadcast_to(jnp.stack(given)[row], shape)
            touch = self.touch_at(jnp.where(row < len(given), on_grid, following))
            height = self.mates.sense * touch.error
            return (shares.at[row].set(touch.share), heights.at[row].set(height)), touch

        blank = jnp.full((rows, *shape), jnp.nan), jnp.full((rows, *shape), -jnp.inf)
        (_, heights), found = jax.lax.scan(step, blank, jnp.arange(rows))
        best = first(heights)[None]
        return jax.tree.map(
            lambda all_: jnp.concatenate([all_[:sections], jnp.take_along_axis(all_, best, 0)]),
            found,
        )


def next_share(shares: Values, heights: Values, best: Int[Array, "pair n"]) -> Values:
    """Return the share at the top of the parabola through the best section and its neighbours.

    Without a top it is halfway to the neighbour on the longer side. At an end of the face the
    section itself replaces the missing neighbour. Neighbours are `_NEAR` away or more, since the
    curvature over less is that of rounding.
    """

    def at(rows: Int[Array, "1 pair n"]) -> tuple[Values, Values]:
        return jnp.take_along_axis(shares, rows, 0), jnp.take_along_axis(heights, rows, 0)

    best = best[None]
    middle, top = at(best)
    below, above = shares < middle - _NEAR, shares > middle + _NEAR
    left = jnp.argmax(jnp.where(below, shares, -jnp.inf), axis=0, keepdims=True)
    right = jnp.argmin(jnp.where(above, shares, jnp.inf), axis=0, keepdims=True)
    back, left_top = at(jnp.where(below.any(axis=0, keepdims=True), left, best))
    ahead, right_top = at(jnp.where(above.any(axis=0, keepdims=True), right, best))
    back, ahead, fall, drop = back - middle, ahead - middle, top - left_top, top - right_top
    # For a (x − v)² these are −a back·ahead (back − ahead) and 2 v times that.
    spread, crossed = back * drop - ahead * fall, back**2 * drop - ahead**2 * fall
    good = jnp.isfinite(crossed) & (spread < -TIE * (ahead - back))
    longer = jnp.where(ahead > -back, ahead, back)
    step = jnp.where(good, crossed / jnp.where(good, 2 * spread, 1.0), longer / 2)
    short = (jnp.abs(step) < _NEAR) & (jnp.abs(longer) > 4 * _NEAR)
    step = jnp.where(short, jnp.sign(longer) * 2 * _NEAR, step)
    return (middle + jnp.clip(step, back, ahead))[0]


def nearest(height: Values, sizes: tuple[int, ...]) -> Int[Array, "..."]:
    """Return the index of the largest height along the first axis.

    Of equal heights the one closest to the middle of the grid is taken. `sizes` is the shape of the
    grid that the first axis flattens.
    """
    places = jnp.unravel_index(jnp.arange(height.shape[0]), sizes)
    off_middle = sum(
        abs(place - (size - 1) / 2) / size for place, size in zip(places, sizes, strict=True)
    )
    off_middle = jnp.asarray(off_middle).reshape(-1, *[1] * (height.ndim - 1))
    tied = height >= jnp.max(height, axis=0, keepdims=True) - TIE
    return jnp.argmin(jnp.where(tied, off_middle, jnp.inf), axis=0)


def share_of(mounting: Mounting, z: Values) -> Values:
    """Return the share of a height, mm, in the common face, or of the closest end of the face."""
    low, high = mounting.face()
    wide = high > low
    return jnp.where(wide, jnp.clip((z - low) / jnp.where(wide, high - low, 1.0), 0.0, 1.0), 0.0)


def contact_search(
    mates: Mates,
    mounting: Mounting,
    grid: SearchGrid,
    driving_angle: Float[Array, " n"],
    driven_angle: Float[Array, " n"] | None,
) -> ContactSearch:
    """Return the search problem at driving angles, rad, for the teeth nearest to the path's middle.

    `driven_angle`, rad, fixes the centre of the driven base circle. If it is None, the centre is
    placed at the φ₂ of the contact. Whole pitches are subtracted from the driving angle, so that
    angles over many turns keep their digits.
    """
    distance, pairs = mounting.centre_distance, grid.tooth_pairs
    roll, angle = pitch_point(mates, distance)
    driving, driven = mates.driving, mates.driven
    approach = (driven.tip - roll) * driven.base_radius / driving.base_radius
    middle = mates.sense * (angle + (driving.tip - roll - approach) / 2)
    closest = jnp.floor((driving_angle - middle) / mates.pitch + pairs % 2 / 2)
    number = closest[None] + (jnp.arange(pairs)[:, None] - (pairs - 1) // 2)
    guess = None
    if driven_angle is None:
        guess = concentric_touch(mates, distance)
        driven_angle = mates.ratio * driving_angle + guess
    pose = mates.pose(mounting, driving_angle[None], driven_angle[None], number)
    return ContactSearch(mates, mounting, pose, guess, grid)


def earliest(height: Float[Array, "section pair n"], values: Any) -> Any:
    """Return what arrays of shape (section, pair, n) hold at the largest height of each angle."""
    flat = height.reshape(-1, height.shape[-1])
    best = nearest(flat, height.shape[:2])[None]

    def select(array: Array) -> Array:
        return jnp.take_along_axis(array.reshape(flat.shape), best, 0)[0]

    return jax.tree.map(select, values)


@eqx.filter_jit
def _first_contacts(mates: Mates, mounting: Mounting, grid: SearchGrid, angles: Any) -> TouchPoint:
    """Return the first contacts, batch by batch, at driving angles and driven angles or None.

    The search is compiled alone and is not differentiated, so a derivative does not recompile it.
    """

    def search(angles: Any) -> TouchPoint:
        scene = contact_search(mates, mounting, grid, *angles)
        touch = scene.touches()
        return earliest(mates.sense * touch.error, touch)

    return jax.tree.map(jnp.ravel, jax.lax.map(search, angles))


Gears = tuple[Mates, Mounting, Float[Array, " n"], Float[Array, " n"] | None]
"""Flanks, mounting, driving angles, and driven angles that place the driven base circle centre.

Without driven angles the centre is at the φ₂ of the contact. Angles are in rad.
"""

Slopes = tuple[Float[Array, " n"], Float[Array, " n"]]


@eqx.filter_jit
def error_of(gears: Gears, contact: TouchPoint) -> Float[Array, " n"]:
    """Return TE at a known contact, rad.

    By the envelope theorem its derivative is that of first contact: the point on the flank, the
    section and the tooth pair are constant; a tip edge and an end of the face move with the gear.
    Higher derivatives also need the motion of the point on the flank and of the section.
    """
    slopes = _slopes(contact, jax.lax.stop_gradient(gears))
    return at_extreme(_error, _moved, (contact, slopes), gears)


def _error(place: tuple[TouchPoint, Slopes], gears: Gears) -> Float[Array, " n"]:
    """Return TE, rad; at an end of the driven flank the Lagrange function of this constraint.

    The search gives φ₂ to second order in the motion of the driven centre, so one step of Newton's
    method completes it; the derivative of that step is that of the solution.
    """
    contact, (multiplier, by_driven) = place
    driving = gears[0].driving
    roll = jnp.where(contact.place == Place.DRIVING_TIP, driving.tip, contact.roll)
    roll = jnp.where(contact.place == Place.DRIVING_START, driving.start, roll)
    reach = _reach(replace(contact, roll=roll), gears)
    nothing = contact.place == Place.NOTHING
    error = reach.error - multiplier * (reach.radius - _end_radius(gears[0], contact))
    error = jnp.where(nothing, jnp.nan, error)
    if gears[3] is not None:
        return error
    guess = jnp.where(nothing, 0.0, contact.error)
    return guess + (error - guess) / (1 - by_driven)


def _slopes(contact: TouchPoint, gears: Gears) -> Slopes:
    """Return ∂TE/∂r of the constraint r = driven radius, and ∂TE/∂φ₂ of the driven centre.

    The first is a Lagrange multiplier, rad/mm, at an end of the driven flank, and elsewhere zero.
    """
    reach, error_slope, radius_slope = _along("roll", contact, gears)
    bound = _on_driven_end(contact) & (radius_slope != 0)
    multiplier = jnp.where(bound, error_slope / jnp.where(bound, radius_slope, 1.0), 0.0)
    return multiplier, reach.error_by_driven - multiplier * reach.radius_by_driven


def _moved(place: tuple[TouchPoint, Slopes], gears: Gears) -> tuple[TouchPoint, Slopes]:
    """Return the same contact and slopes with their derivatives, from what defines them."""
    contact, _ = place
    if gears[3] is None:
        contact = replace(contact, error=error_of(gears, contact))
    if contact.share is not None:
        share = known_root(_face_condition, contact.share, (contact, gears))
        contact = replace(contact, share=share)
    contact = _on_flank(contact, gears)
    return contact, _slopes(contact, gears)


def _on_flank(contact: TouchPoint, gears: Gears) -> TouchPoint:
    """Return the contact with the roll angle that follows the gears and the section."""
    return replace(contact, roll=known_root(_flank_condition, contact.roll, (contact, gears)))


def _flank_condition(roll: Values, args: tuple[TouchPoint, Gears]) -> Values:
    """Return what is zero at the roll angle of first contact in a section.

    It is the slope of TE within the flanks, the excess radius at an end of the driven flank, and
    the distance from an end of the driving flank.
    """
    contact, gears = args
    driving = gears[0].driving
    reach, slope, _ = _along("roll", replace(contact, roll=roll), gears)
    excess = reach.radius - _end_radius(gears[0], contact)
    zero = jnp.where(_on_driven_end(contact), excess, slope)
    zero = jnp.where(contact.place == Place.DRIVING_TIP, roll - driving.tip, zero)
    return jnp.where(contact.place == Place.DRIVING_START, roll - driving.start, zero)


def _face_condition(share: Values, args: tuple[TouchPoint, Gears]) -> Values:
    """Return what is zero at the section of first contact: the slope of TE along the face.

    The section stays at an end of the face, and where the neighbouring sections touch as early.
    """

    def rise(share: Values, contact: TouchPoint, gears: Gears) -> Values:
        contact = _on_flank(replace(contact, share=share), gears)
        _, error_slope, radius_slope = _along("share", contact, gears)
        return error_slope - _slopes(contact, gears)[0] * radius_slope

    start, (contact, gears) = jax.lax.stop_gradient((share, args))
    ones = jnp.ones_like(start)
    _, bend = jax.jvp(lambda share: rise(share, contact, gears), (start,), (ones,))
    moves = (start > 0) & (start < 1) & (gears[0].sense * bend < -TIE)
    return jnp.where(moves, rise(share, *args), share - start)


def _along(name: str, contact: TouchPoint, gears: Gears) -> tuple[Reach, Values, Values]:
    """Return the reach at a contact, and the derivatives of TE and driven radius by a field of it.

    `name` is "roll" or "share".
    """

    def values(value: Values) -> tuple[tuple[Values, Values], Reach]:
        reach = _reach(replace(contact, **{name: value}), gears)
        return (reach.error, reach.radius), reach

    value = getattr(contact, name)
    _, slopes, reach = jax.jvp(values, (value,), (jnp.ones_like(value),), has_aux=True)
    return reach, *slopes


def _reach(contact: TouchPoint, gears: Gears) -> Reach:
    """Return where the driven flank touches the driving flank at a contact."""
    mates, mounting, driving_angle, driven_angle = gears
    if driven_angle is None:
        error = jnp.where(contact.place == Place.NOTHING, 0.0, contact.error)
        driven_angle = mates.ratio * driving_angle + error
    pose = mates.pose(mounting, driving_angle, driven_angle, contact.tooth)
    share = share_of(mounting, jnp.zeros(())) if contact.share is None else contact.share
    return mates.reach(mounting, pose, contact.roll, share)


def _on_driven_end(contact: TouchPoint) -> Bool[Array, " n"]:
    return (contact.place == Place.DRIVEN_TIP) | (contact.place == Place.DRIVEN_START)


def _end_radius(mates: Mates, contact: TouchPoint) -> Values:
    """Return the radius at the tip of the driven flank, or at its start if contact is there, mm."""
    driven = mates.driven
    end = jnp.where(contact.place == Place.DRIVEN_START, driven.start, driven.tip)
    return driven.base_radius * jnp.sqrt(1 + end**2)


class ContactModel(ImplicitModel):
    """Flank model of the first contact of two tooth surfaces; see `contact_model`.

    **Arguments**
    - `teeth`: driving and driven gear.
    - `starts`: roll angles at the start of each flank, rad; rows are gears, columns flanks A and B.
    - `nominal_distance`: centre distance at which concentric gears define the zero of φ₂, mm.
    - `mounting`: position of the axes and the base circles.
    - `deviations`: deviations of all flanks, or None.
    - `search_grid`: grid of the search for first contact.
    - `uniform`: whether all sections and all teeth touch alike.
    """

    ratio: Float[Numbers, ""]
    teeth: tuple[Tooth, Tooth]
    starts: Float[Numbers, "gear=2 flank=2"]
    nominal_distance: Scalar
    mounting: Mounting
    deviations: Deviations | None
    search_grid: SearchGrid
    uniform: bool = eqx.field(static=True)

    @property
    def grid_orders(self) -> GridOrders:
        """Order z₁ of the driving shaft if the contact varies over a tooth mesh.

        Otherwise they are the first orders of both shafts.
        """
        return FIRST_ORDERS if self.uniform else ((self.teeth[0].teeth, 0),)

    def transmission_error(self, driving_angle: AnglesLike, flank: Flank) -> Angles:
        """Return TE = φ₂ − i φ₁ at first contact on `flank`, rad; NaN without contact."""
        angle = jnp.asarray(driving_angle, float)
        return self._error(flank, angle.ravel(), None).reshape(angle.shape)

    def at_both_angles(self, driving_angle: Angles, driven_angle: Angles, flank: Flank) -> Angles:
        """Return TE at first contact, rad, with the driven base circle centre at the given φ₂."""
        first, second = jnp.broadcast_arrays(driving_angle, driven_angle)
        return self._error(flank, first.ravel(), second.ravel()).reshape(first.shape)

    def _error(
        self, flank: Flank, driving: Float[Array, " n"], driven: Float[Array, " n"] | None
    ) -> Float[Array, " n"]:
        if not driving.size:
            return driving
        mates, mounting, grid = mates_on(self, flank_index(flank)), self.mounting, self.search_grid
        angles = jax.tree.map(grid.batches, (driving, driven))
        fixed = jax.tree.map(jax.lax.stop_gradient, (mates, mounting, angles))
        contact = _first_contacts(fixed[0], fixed[1], grid, fixed[2])
        if grid.sections == 1:
            # The section stays at z = 0 also when derivatives move the ends of the face.
            contact = replace(contact, share=None)
        rows = jax.tree.map(jnp.ravel, angles)
        return error_of((mates, mounting, *rows), contact)[: driving.size]


@eqx.filter_jit
def mates_on(model: ContactModel, side: int) -> Mates:
    """Return flank A (0) or B (1) of both gears; φ₂ = 0 is first contact on flank A as drawn.

    The function is separate so that the code compiled for flank A is used for flank B too.
    """
    drawn = mates_of(model.teeth, model.starts, jnp.asarray(model.ratio), None, 0)
    # Flank B of a driving tooth touches the next tooth of the driven gear.
    on_b = 2 * math.pi / model.teeth[1].teeth
    standing = side * on_b - concentric_touch(drawn, model.nominal_distance)
    mates = mates_of(model.teeth, model.starts, jnp.asarray(model.ratio), model.deviations, side)
    return eqx.tree_at(lambda tree: tree.standing, mates, standing)


def contact_model(
    pair: GearPair,
    eccentricities: Eccentricities = Eccentricities(),
    *,
    misalignment: Misalignment | None = None,
    deviations: Deviations | None = None,
    sections: int | None = None,
    centre_distance_mm: Scalar | float | None = None,
    tooth_pairs: int | None = None,
    points: int | None = None,
) -> ContactModel:
    """Return the flank model of two gears from the first contact of their surfaces.

    For every driving angle φ₂ is that of first contact over all points of the flanks from the end
    of the fillet to the tip, all sections of the common face and the neighbouring tooth pairs. This
    includes contact lines, points, tip edges and ends of the face. The contact is unloaded and the
    surfaces are rigid. At φ₁ = φ₂ = 0 concentric gears as drawn touch on flank A, at the nominal
    centre distance, s = 0, in the section z = 0.

    Derivatives with respect to every number of the arguments follow from the contact point alone
    (envelope theorem); those of second and higher order contain its motion on the flanks and along
    the face, by the implicit function theorem. Where several points touch at once, they are the
    derivatives of the point closest to the middle of the face and of the path of contact: for lines
    on unmodified flanks all points give the same result, at a kink it is a one-sided derivative. A
    section whose neighbours touch as early is then kept.

    **Arguments**
    - `pair`: gear pair.
    - `eccentricities`: offsets of the base circles and axial displacement; their constant backlash
      is not used, because the backlash is that of the drawn teeth.
    - `misalignment`: tilt of the driven axis; None for parallel axes.
    - `deviations`: deviations of the flanks from the drawing, as maps and for each tooth.
    - `sections`: number of sections over the common face; the best section between them is searched
      too. The default is 9, or the number of columns of the finest map; it is the section z = 0
      alone if the recessions are linear and equal and the contact ratio is well above 1, because
      all sections then touch at once.
    - `centre_distance_mm`: centre distance, by default the nominal one.
    - `tooth_pairs`: number of tooth pairs searched; by default 3, or more if the contact ratio
      requires it.
    - `points`: number of roll angles on the grid of each flank; by default 9, or 2 for each row of
      the finest map.

    **Returns** `ContactModel`, a flank model. Its transmission error is NaN if the faces do not
    overlap, or if at a large centre distance no tooth is close enough to the line of centres.

    **Raises** `PairError` for gears that do not touch or have pointed or missing teeth, and
    `ValueError` for invalid options. Traced numbers are not checked; an undercut flank then begins
    on its base circle.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Eccentricities, Gear, GearPair
    >>> from vttig_jax.geometry import Misalignment, contact_model
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(
    ...     *gears, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12
    ... )
    >>> rig = Eccentricities(0.0226, 49.5, 0.0273, 79.3)
    >>> np.degrees(contact_model(pair, rig).transmission_error(np.array([0.0, 0.05]), "A")).round(5)
    array([0.03402, 0.03459])
    >>> tilted = contact_model(pair, rig, misalignment=Misalignment(deviation_rad=1e-4))
    >>> np.degrees(tilted.transmission_error(np.array([0.0, 0.05]), "A")).round(5)
    array([0.03474, 0.03532])

    ```
    """
    if not known(pair):
        pair = jax.tree.map(jnp.asarray, pair)  # so that no formula mixes NumPy and traced numbers
    gears = tooth_of(pair, "driving"), tooth_of(pair, "driven")
    distance = (
        pair.centre_distance_mm if centre_distance_mm is None else float64(centre_distance_mm)
    )
    driving_offset, driven_offset = eccentricities.cartesian
    mounting = Mounting(
        centre_distance=distance,
        axial=eccentricities.axial_mm,
        driving_offset=driving_offset,
        driven_offset=driven_offset,
        half_widths=jnp.stack([jnp.asarray(gear.face_width_mm) / 2 for gear in gears]),
        misalignment=misalignment,
    )
    checked, uniform, largest = known(pair, distance), False, 0.0
    if checked:
        _check(gears, mounting, deviations)
        moved = eqx.tree_at(lambda tree: tree.centre_distance_mm, pair, distance)
        least, largest = sorted(map(float, moved.contact_ratios))
        # A tip edge alone touches in one section later than in the next.
        plain = misalignment is None and deviations is None and least > _MARGIN
        straight = not (pair.driving.crowning_um or pair.driven.crowning_um)
        uniform = bool(plain and straight and pair.driving.helix_deg == pair.driven.helix_deg)
    if sections is None:
        sections = 1 if uniform else max(_SECTIONS, _knots(deviations, "z_mm"))
    if points is None:
        points = max(_POINTS, 2 * _knots(deviations, "roll_mm"))
    needed = math.ceil(largest + _SPARE)
    pairs = max(_TOOTH_PAIRS, needed) if tooth_pairs is None else tooth_pairs
    search_grid = SearchGrid(sections, pairs, points)
    if needed > pairs:
        raise PairError(
            f"{pairs} tooth pairs are too few for a contact ratio of {largest:.2f}; give"
            f" tooth_pairs={needed}.",
            where="contact ratio",
        )
    if checked and sections > 1 and np.isnan([float(gear.face_width_mm) for gear in gears]).all():
        raise PairError(
            "the face width is missing, but contact differs along the face; give a face width.",
            where="driving.face_width_mm",
        )
    return ContactModel(
        ratio=jnp.asarray(float(pair.ratio), float),
        teeth=gears,
        starts=flank_starts(gears),
        nominal_distance=pair.centre_distance_mm,
        mounting=mounting,
        deviations=deviations,
        search_grid=search_grid,
        uniform=uniform,
    )


def _knots(deviations: Deviations | None, direction: str) -> int:
    """Return the number of points of the finest map along `direction`, a field of `FlankMap`."""
    maps = () if deviations is None else deviations.maps
    return max((len(getattr(flank_map, direction)) for flank_map in maps), default=0)


def _check(teeth: tuple[Tooth, Tooth], mounting: Mounting, deviations: Deviations | None) -> None:
    """Raise `PairError` for gears that cannot be in contact; numbers must not be traced."""
    distance, offset = float(mounting.centre_distance), 0.0
    if known(mounting):
        offsets = mounting.driving_offset, mounting.driven_offset
        offset = float(sum(abs(np.asarray(value)) for value in offsets))
    change = f", eccentricities change the distance by ±{offset:.3f} mm" if offset else ""
    base = max(float(teeth[0].base_radii[k] + teeth[1].base_radii[1 - k]) for k in (0, 1))
    tips = sum(float(tooth.tip_radius) for tooth in teeth)
    # At some angle tip circles are apart or base circles overlap.
    if not base < distance - offset <= distance + offset < tips:
        near = not base < distance - offset
        seen, limit = ("lets the base circles overlap", base) if near else ("is too far", tips)
        raise PairError(
            f"{distance:g} mm {seen} (their radii sum to {limit:.3f} mm{change}); move the axes"
            f" {'apart' if near else 'together'}.",
            where="centre_distance_mm",
        )
    for shaft, tooth in zip(SHAFTS, teeth, strict=True):
        widthless = np.isnan(float(tooth.face_width_mm))
        heights = section_heights(tooth, [0.0] if widthless else None)
        try:
            check_tooth(tooth, heights)
            check_pointed(tooth, heights)
        except PairError as error:
            raise PairError(error.message, where=f"{shaft}: {error.where}") from None
        pitch = None if deviations is None else getattr(deviations, f"{shaft}_pitch_um")
        if pitch is not None and pitch.shape != (2, tooth.teeth):
            raise PairError(
                f"the shape is {pitch.shape}; give one value for each flank and tooth, shape (2,"
                f" {tooth.teeth}).",
                where=f"{shaft}_pitch_um",
            )

"""First touch of two flanks: the extreme over roll angle, section and pair of teeth.

In one section and for one pair of teeth the driven gear would have to stand at φ₂(u) to be touched
at the roll angle u of the driving flank. Gear 1 cannot pass through gear 2, so that the largest
φ₂(u) is first touch on flank A and the smallest on flank B. It is found on a grid of u and then by
Newton's method on the slope, kept between the neighbours on that grid. Where it lies outside the
other flank, first touch is at the end of that flank. Arrays here have the axes (section, pair,
angle), the last one long and in vector lanes.
"""

from enum import IntEnum
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..mounting import Mounting, Values
from .flanks import Mates, Pose, Reach

_CLIMBS = 8
"""Steps of the secant method to the top, of which the first only looks."""

_SHORT = 1e-5
"""rad of roll that tell a bend in five digits."""

_STEPS = 5
"""Steps of Newton's method to the end of the other flank."""

_ROUNDS = 10
"""Times that the section is refined: where nothing is found inside, a thousandth is left."""

_TIE = 1e-13
"""rad below which two touches are one; the one nearest to the middle is then taken."""

Index = Int[Array, "..."]


class Place(IntEnum):
    """What touches."""

    FLANK = 0
    DRIVING_TIP = 1
    DRIVEN_TIP = 2
    DRIVING_START = 3
    DRIVEN_START = 4
    NOTHING = 5

    def __str__(self) -> str:
        return self.name.lower().replace("_", " ")


class TouchPoint(NamedTuple):
    """First touch of each pair of teeth in a section; `error` in rad is −σ∞ where nothing meets."""

    error: Float[Array, "*section pair n"]
    roll: Float[Array, "*section pair n"]
    share: Float[Array, "*section pair n"]
    place: Int[Array, "*section pair n"]


Three = tuple[TouchPoint, TouchPoint, TouchPoint]


class Scene(eqx.Module):
    """What is being searched.

    **Arguments**
    - `mates`, `mounting`: the gears; numbers that are not differentiated.
    - `pose`: arrays of shape (pair, n).
    - `guess`: TE at which the driven centre has been placed, rad, or None where it stays there.
    - `points`: roll angles on the grid.
    """

    mates: Mates
    mounting: Mounting
    pose: Pose
    guess: Values | None
    points: int = eqx.field(static=True)

    def reach(self, roll: Values, share: Values) -> Reach:
        """See `Mates`; with one step of Newton's method to where the driven centre really is."""
        found = self.mates.reach(self.mounting, self.pose, roll, share)
        if self.guess is None:
            return found
        off = (found.error - self.guess) / (1 - found.lag)
        moved = self.guess + off, found.radius + found.drift * off
        return eqx.tree_at(lambda reach: (reach.error, reach.radius), found, moved)

    @property
    def limits(self) -> tuple[Array, Array]:
        """Roll angles between which the driving flank is searched."""
        flank = self.mates.driving
        return jnp.asarray(flank.start), jnp.asarray(flank.tip)

    @property
    def radii(self) -> tuple[Array, Array]:
        """Distances from the driven centre between which its flank is."""
        flank = self.mates.driven
        start, tip = jnp.asarray(flank.start), jnp.asarray(flank.tip)
        base = flank.base_radius
        return base * jnp.sqrt(1 + start**2), base * jnp.sqrt(1 + tip**2)


def search(scene: Scene, sections: int) -> TouchPoint:
    """First touch in sections over the common face, and below them the best one between them."""
    shape = jnp.broadcast_shapes(*(leaf.shape for leaf in jax.tree.leaves(scene.pose)))
    if sections == 1:
        only = touch_at(scene, jnp.broadcast_to(share_of_middle(scene.mounting), shape))
        return jax.tree.map(lambda values: values[None], only)

    # One loop for both is half to compile; a touch is used one step later, see `_climbed`.
    def look(
        step, state: tuple[TouchPoint, Three, TouchPoint]
    ) -> tuple[TouchPoint, Three, TouchPoint]:
        grid, three, tried = state
        row = jnp.where((step > 0) & (step <= sections), step - 1, sections)
        grid = jax.tree.map(lambda rows, values: rows.at[row].set(values), grid, tried)
        three = _closer(scene, three, tried)
        three = jax.lax.cond(step == sections, lambda: _around_best(scene, grid), lambda: three)
        on_grid = jnp.broadcast_to(step / (sections - 1), shape)
        share = jnp.where(step < sections, on_grid, _between(scene, three))
        return grid, three, touch_at(scene, share)

    zero = jnp.zeros(shape)
    blank = TouchPoint(zero, zero, zero, zero.astype(int))
    grid = jax.tree.map(lambda values: jnp.stack([values] * (sections + 1)), blank)
    before = grid, (blank, blank, blank), blank
    grid, three, tried = jax.lax.fori_loop(0, sections + _ROUNDS, look, before)
    _, best, _ = _closer(scene, three, tried)
    return jax.tree.map(lambda rows, values: rows.at[sections].set(values), grid, best)


def _around_best(scene: Scene, grid: TouchPoint) -> Three:
    """Neighbours on the grid with the best in the middle, or that twice at an end of the face."""
    rows = jax.tree.map(lambda values: values[:-1], grid)
    count = rows.error.shape[0]
    best = _best(scene.mates.sense * rows.error, (count,))
    around = jnp.clip(best + jnp.array([-1, 0, 1])[:, None, None], 0, count - 1)
    taken = jax.tree.map(lambda values: jnp.take_along_axis(values, around, axis=0), rows)
    left, middle, right = (jax.tree.map(lambda values, k=k: values[k], taken) for k in range(3))
    return left, middle, right


def _closer(scene: Scene, three: Three, tried: TouchPoint) -> Three:
    """Three sections with the best in the middle, after one more between them."""
    left, middle, right = three
    better = scene.mates.sense * tried.error > scene.mates.sense * middle.error
    inner, outer = _chosen(better, tried, middle), _chosen(better, middle, tried)
    return (
        _chosen(outer.share < inner.share, outer, left),
        inner,
        _chosen(outer.share > inner.share, outer, right),
    )


def touch_at(scene: Scene, share: Float[Array, "pair n"]) -> TouchPoint:
    """First touch of each pair of teeth in a section."""
    low, high = scene.limits
    spacing = (high - low) / (scene.points - 1)
    grid = low + spacing * jnp.arange(scene.points)[:, None, None]
    found = scene.reach(grid, share[None])
    inner, outer = scene.radii
    beside = jnp.maximum(found.radius - outer, inner - found.radius)
    height = jnp.where(beside > 0, -1e6 - beside / outer, scene.mates.sense * found.error)
    start = low + spacing * jnp.argmax(height, axis=0)
    between = jnp.maximum(start - spacing, low), jnp.minimum(start + spacing, high)
    return _touch_of(scene, share, _climbed(scene, share, start, *between))


class Climb(NamedTuple):
    """A search under way, at `roll` between `low` and `high`; it was at `last_roll` before.

    The last four are seen there: TE, distance from the driven centre, and the slopes of what first
    touch makes largest and of this distance. `bend` is the change of the slope, `over` the distance
    of the top.
    """

    roll: Values
    low: Values
    high: Values
    last_roll: Values
    last_rise: Values
    bend: Values
    over: Values
    error: Values
    radius: Values
    rise: Values
    widening: Values


def _climbed(scene: Scene, share: Values, start: Values, low: Values, high: Values) -> Climb:
    """To the top, and from there to the end of the driven flank if the top is beyond it.

    The secant method on the slope, then Newton's method on the radius. What needs the slope is done
    one step later, when it is at hand: XLA would compute it again for each of its uses.
    """
    ones = jnp.ones_like(start)

    def seen(roll: Values) -> tuple[Values, Values]:
        reach = scene.reach(roll, share)
        return reach.error, reach.radius

    def step(number: int | Array, at: Climb) -> Climb:
        ahead, low, high, bend = _uphill(at)
        over = jnp.where(number <= _CLIMBS, at.radius, at.over)
        ahead = jnp.where(number < _CLIMBS, ahead, _towards_end(scene, at._replace(over=over)))
        (error, radius), (rise, widening) = jax.jvp(seen, (ahead,), (ones,))
        rise = scene.mates.sense * rise
        known = bend, over, error, radius, rise, widening
        return Climb._make((ahead, low, high, at.roll, at.rise, *known))

    unknown = jnp.full_like(start, jnp.nan)
    before = Climb._make((start, low, high, start, *(unknown,) * 7))
    return jax.lax.fori_loop(0, _CLIMBS + _STEPS, step, before)


def _uphill(at: Climb) -> tuple[Values, Values, Values, Values]:
    """A step of the secant method towards the top, the new limits, and the bend."""
    low, high = jnp.where(at.rise > 0, at.roll, at.low), jnp.where(at.rise < 0, at.roll, at.high)
    moved = at.roll - at.last_roll
    # A shorter move would measure the bend of rounding errors.
    bend = jnp.where(jnp.abs(moved) > _SHORT, (at.rise - at.last_rise) / moved, at.bend)
    hollow = ~(bend < 0)
    halfway = jnp.where(at.rise > 0, at.roll + high, at.roll + low) / 2
    secant = jnp.clip(at.roll - at.rise / jnp.where(hollow, 1.0, bend), low, high)
    ahead = jnp.where(hollow, halfway, secant)
    return jnp.where(jnp.isnan(at.rise), at.roll, ahead), low, high, bend


def _towards_end(scene: Scene, at: Climb) -> Values:
    """A step of Newton's method to the end of the driven flank, none where the top is on it."""
    beyond = at.radius - jnp.clip(at.over, *scene.radii)
    return jnp.clip(at.roll - beyond / jnp.where(at.widening == 0, 1.0, at.widening), *scene.limits)


def _touch_of(scene: Scene, share: Values, found: Climb) -> TouchPoint:
    """What it is that touches where a search has ended."""
    low, high = scene.limits
    inner, outer = scene.radii
    roll, over, radius, error = found.roll, found.over, found.radius, found.error
    missed = jnp.abs(radius - jnp.clip(radius, inner, outer)) > 1e-9 * outer
    empty = jnp.less(*scene.mounting.face()[::-1])
    place = jnp.where(roll >= high, Place.DRIVING_TIP, Place.FLANK)
    place = jnp.where(roll <= low, Place.DRIVING_START, place)
    place = jnp.where(over > outer, Place.DRIVEN_TIP, place)
    place = jnp.where(over < inner, Place.DRIVEN_START, place)
    nothing = missed | empty | jnp.isnan(error)
    return TouchPoint(
        error=jnp.where(nothing, -scene.mates.sense * jnp.inf, error),
        roll=roll,
        share=share,
        place=jnp.where(nothing, Place.NOTHING, place),
    )


def nearest_best(height: Values) -> tuple[Index, Index]:
    """Section and pair of the largest of (section, pair, n), of equal ones the middle one."""
    pairs = height.shape[1]
    best = _best(height.reshape(-1, height.shape[2]), height.shape[:2])
    return best // pairs, best % pairs


def _best(height: Values, sizes: tuple[int, ...]) -> Index:
    """Index of the largest along the first axis, of those that tie the one nearest to the middle.

    `sizes` is the grid that this axis counts through.
    """
    count = height.shape[0]
    places = jnp.unravel_index(jnp.arange(count), sizes)
    aside = sum(
        abs(place - (size - 1) / 2) / size for place, size in zip(places, sizes, strict=True)
    )
    aside = jnp.asarray(aside).reshape((count,) + (1,) * (height.ndim - 1))
    tied = height >= jnp.max(height, axis=0, keepdims=True) - _TIE
    return jnp.argmin(jnp.where(tied, aside, jnp.inf), axis=0)


def _chosen(condition: Bool[Array, "..."], one: TouchPoint, other: TouchPoint) -> TouchPoint:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), one, other)


def _between(scene: Scene, three: Three) -> Values:
    """Share at the top of the parabola through three sections, else halfway to the longer side."""
    left, middle, right = three
    fall, drop = (scene.mates.sense * (side.error - middle.error) for side in (left, right))
    back, ahead = left.share - middle.share, right.share - middle.share
    # With a (x − v)² these are a back·ahead (back − ahead) and 2 v times that.
    spread, crossed = ahead * fall - back * drop, ahead**2 * fall - back**2 * drop
    good = jnp.isfinite(crossed) & (spread < -_TIE * (ahead - back))
    longer = jnp.where(ahead > -back, ahead, back)
    move = jnp.where(good, crossed / jnp.where(good, 2 * spread, 1.0), longer / 2)
    near = jnp.abs(move) < 1e-3 * jnp.abs(longer)
    return middle.share + jnp.where(near, 1e-3 * longer, move)


def share_of_middle(mounting: Mounting) -> Values:
    """Share of z = 0 in the common face, or of its end nearest to there."""
    low, high = mounting.face()
    wide = high > low
    return jnp.where(wide, jnp.clip(-low / jnp.where(wide, high - low, 1.0), 0.0, 1.0), 0.0)

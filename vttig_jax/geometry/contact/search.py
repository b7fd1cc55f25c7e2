"""Search for the first contact of two flanks over roll angle, section and tooth pair.

In one section and for one tooth pair, φ₂(u) is the driven angle at which the driving flank touches
with its roll angle u. The gears cannot penetrate, so the largest φ₂(u) is the first contact on
flank A and the smallest on flank B. The search starts on a grid of u and continues with the secant
method on the slope, limited by the neighbours on that grid. If the extreme is outside the driven
flank, first contact is at the end of that flank. Arrays have the axes (section, pair, angle); the
last axis is long and vectorised.
"""

from dataclasses import replace
from enum import IntEnum

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..mounting import Mounting, Values
from .flanks import Mates, Pose, Reach

# The settings of the search are chosen values.
_SECANT_STEPS = 8  # steps of the secant method to the extreme; the first only evaluates the start
_SHORTEST_STEP = 1e-5  # smallest roll step, rad, for a curvature, which then has five digits
_NEWTON_STEPS = 5  # steps of Newton's method to the end of the driven flank
_REFINEMENTS = 10  # refinements of the section; ten halvings reduce the interval to a thousandth
TIE = 1e-13  # difference, rad, below which contacts are equal; the middle one is then used

Index = Int[Array, "..."]


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


class TouchPoint(eqx.Module):
    """First contact of each tooth pair in a section, at n positions of the driving gear.

    Of all roll angles, the first contact has the largest driven angle φ₂ on flank A and the
    smallest on flank B.

    - `error`: transmission error, rad; −∞ on flank A and +∞ on flank B if the pair does not touch.
    - `roll`: roll angle of the driving flank, rad.
    - `share`: place of the section in the common face, 0 … 1.
    - `place`: part of the flanks that touches, a `Place`.
    """

    error: Float[Array, "*section pair n"]
    roll: Float[Array, "*section pair n"]
    share: Float[Array, "*section pair n"]
    place: Int[Array, "*section pair n"]


Bracket = tuple[TouchPoint, TouchPoint, TouchPoint]


class ContactSearch(eqx.Module):
    """Problem of the search for first contact.

    **Arguments**
    - `mates`, `mounting`: flanks and position of the gears; they are not differentiated.
    - `pose`: n positions of the driving gear, arrays of shape (pair, n) or (1, n).
    - `guess`: TE, rad, that places the driven base circle centre first; None if it is fixed.
    - `points`: number of roll angles on the grid.
    """

    mates: Mates
    mounting: Mounting
    pose: Pose
    guess: Values | None
    points: int = eqx.field(static=True)

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

    @property
    def limits(self) -> tuple[Array, Array]:
        """Limits of the roll angle of the driving flank, rad."""
        flank = self.mates.driving
        return jnp.asarray(flank.start), jnp.asarray(flank.tip)

    @property
    def radii(self) -> tuple[Array, Array]:
        """Radii at the start and at the tip of the driven flank, mm."""
        flank = self.mates.driven
        start, tip = jnp.asarray(flank.start), jnp.asarray(flank.tip)
        base = flank.base_radius
        return base * jnp.sqrt(1 + start**2), base * jnp.sqrt(1 + tip**2)


def search(scene: ContactSearch, sections: int) -> TouchPoint:
    """Return the first contact of every tooth pair in some sections of the common face.

    The result has `sections` + 1 rows. The first rows are evenly spaced sections from end to end
    of the common face. The last row is, for each tooth pair, the section in which it touches first,
    refined between the neighbouring sections. If `sections` is 1, the result has only one row, the
    middle of the face. The gears and their positions are those of `scene`.
    """
    shape = jnp.broadcast_shapes(*(leaf.shape for leaf in jax.tree.leaves(scene.pose)))
    if sections == 1:
        middle = touch_at(scene, jnp.broadcast_to(share_of_middle(scene.mounting), shape))
        return jax.tree.map(lambda values: values[None], middle)

    # One loop for grid and refinement halves the compilation; a trial is used one step later.
    def iterate(
        step, state: tuple[TouchPoint, Bracket, TouchPoint]
    ) -> tuple[TouchPoint, Bracket, TouchPoint]:
        grid, bracket, trial = state
        row = jnp.where((step > 0) & (step <= sections), step - 1, sections)
        grid = jax.tree.map(lambda rows, values: rows.at[row].set(values), grid, trial)
        bracket = _narrowed(scene, bracket, trial)
        bracket = jax.lax.cond(step == sections, lambda: _bracket(scene, grid), lambda: bracket)
        on_grid = jnp.broadcast_to(step / (sections - 1), shape)
        share = jnp.where(step < sections, on_grid, _next_share(scene, bracket))
        return grid, bracket, touch_at(scene, share)

    zero = jnp.zeros(shape)
    blank = TouchPoint(zero, zero, zero, zero.astype(int))
    grid = jax.tree.map(lambda values: jnp.stack([values] * (sections + 1)), blank)
    initial = grid, (blank, blank, blank), blank
    grid, bracket, trial = jax.lax.fori_loop(0, sections + _REFINEMENTS, iterate, initial)
    _, best, _ = _narrowed(scene, bracket, trial)
    return jax.tree.map(lambda rows, values: rows.at[sections].set(values), grid, best)


def _bracket(scene: ContactSearch, grid: TouchPoint) -> Bracket:
    """Return the section of the grid with the first contact between its two neighbours.

    At an end of the face the section itself replaces the missing neighbour.
    """
    rows = jax.tree.map(lambda values: values[:-1], grid)
    count = rows.error.shape[0]
    best = _best(scene.mates.sense * rows.error, (count,))
    index = jnp.clip(best[None] + jnp.array([-1, 0, 1])[:, None, None], 0, count - 1)
    three = jax.tree.map(lambda values: jnp.take_along_axis(values, index, axis=0), rows)
    left, middle, right = (jax.tree.map(lambda values, k=k: values[k], three) for k in range(3))
    return left, middle, right


def _narrowed(scene: ContactSearch, bracket: Bracket, trial: TouchPoint) -> Bracket:
    """Return the bracket narrowed by a trial section; the earliest contact is in the middle."""
    left, middle, right = bracket
    better = scene.mates.sense * trial.error > scene.mates.sense * middle.error
    inner, outer = _where(better, trial, middle), _where(better, middle, trial)
    return (
        _where(outer.share < inner.share, outer, left),
        inner,
        _where(outer.share > inner.share, outer, right),
    )


def touch_at(scene: ContactSearch, share: Float[Array, "pair n"]) -> TouchPoint:
    """Return the first contact of each tooth pair in one section; see `TouchPoint`.

    `share` is the place of the section in the common face, from 0 at one end to 1 at the other. It
    is given for each tooth pair and for each of the n positions of the driving gear in `scene`.
    """
    low, high = scene.limits
    spacing = (high - low) / (scene.points - 1)
    grid = low + spacing * jnp.arange(scene.points)[:, None, None]
    reach = jax.vmap(scene.reach, in_axes=(0, None))(grid, share)
    inner, outer = scene.radii
    excess = jnp.maximum(reach.radius - outer, inner - reach.radius)
    height = jnp.where(excess > 0, -1e6 - excess / outer, scene.mates.sense * reach.error)
    start = low + spacing * jnp.argmax(height, axis=0)
    limits = jnp.maximum(start - spacing, low), jnp.minimum(start + spacing, high)
    return _touch_point(scene, share, _maximised(scene, share, start, *limits))


class RollSearch(eqx.Module):
    """State of the search over roll angles, rad, at `roll` between `low` and `high`.

    At `roll` there are the TE `error`, the distance `radius` from the driven base circle centre,
    mm, the `slope` of σφ₂, the quantity that first contact maximises, and the `radius_slope`.
    `last_roll` and `last_slope` belong to the step before, `curvature` is the derivative of the
    slope, and `top_radius` is the radius at the extreme.
    """

    roll: Values
    low: Values
    high: Values
    last_roll: Values
    last_slope: Values
    curvature: Values
    top_radius: Values
    error: Values
    radius: Values
    slope: Values
    radius_slope: Values


def _maximised(
    scene: ContactSearch, share: Values, start: Values, low: Values, high: Values
) -> RollSearch:
    """Search the roll angle at which σφ₂ is largest, between `low` and `high`, rad.

    If the extreme is outside the driven flank, the end of this flank is searched instead.
    The secant method on the slope is followed by Newton's method on the radius. The slope is used
    one step after its evaluation, because XLA would compute it again for each use.
    """
    ones = jnp.ones_like(start)

    def error_and_radius(roll: Values) -> tuple[Values, Values]:
        reach = scene.reach(roll, share)
        return reach.error, reach.radius

    def step(number: int | Array, state: RollSearch) -> RollSearch:
        roll, low, high, curvature = _secant_step(state)
        top_radius = jnp.where(number <= _SECANT_STEPS, state.radius, state.top_radius)
        to_end = _newton_step(scene, replace(state, top_radius=top_radius))
        roll = jnp.where(number < _SECANT_STEPS, roll, to_end)
        (error, radius), (slope, radius_slope) = jax.jvp(error_and_radius, (roll,), (ones,))
        slope = scene.mates.sense * slope
        return RollSearch(
            roll=roll,
            low=low,
            high=high,
            last_roll=state.roll,
            last_slope=state.slope,
            curvature=curvature,
            top_radius=top_radius,
            error=error,
            radius=radius,
            slope=slope,
            radius_slope=radius_slope,
        )

    unknown = jnp.full_like(start, jnp.nan)
    initial = RollSearch(start, low, high, start, *(unknown,) * 7)
    return jax.lax.fori_loop(0, _SECANT_STEPS + _NEWTON_STEPS, step, initial)


def _secant_step(state: RollSearch) -> tuple[Values, Values, Values, Values]:
    """Return the next roll angle of the secant method, its new limits and the curvature."""
    low = jnp.where(state.slope > 0, state.roll, state.low)
    high = jnp.where(state.slope < 0, state.roll, state.high)
    step = state.roll - state.last_roll
    # The curvature of a shorter step would be that of rounding errors.
    secant = (state.slope - state.last_slope) / step
    curvature = jnp.where(jnp.abs(step) > _SHORTEST_STEP, secant, state.curvature)
    convex = ~(curvature < 0)
    halfway = jnp.where(state.slope > 0, state.roll + high, state.roll + low) / 2
    top = jnp.clip(state.roll - state.slope / jnp.where(convex, 1.0, curvature), low, high)
    following = jnp.where(convex, halfway, top)
    return jnp.where(jnp.isnan(state.slope), state.roll, following), low, high, curvature


def _newton_step(scene: ContactSearch, state: RollSearch) -> Values:
    """Return the next roll angle of Newton's method to the end of the driven flank.

    The step is zero if the extreme is on the driven flank.
    """
    excess = state.radius - jnp.clip(state.top_radius, *scene.radii)
    slope = jnp.where(state.radius_slope == 0, 1.0, state.radius_slope)
    return jnp.clip(state.roll - excess / slope, *scene.limits)


def _touch_point(scene: ContactSearch, share: Values, state: RollSearch) -> TouchPoint:
    """Return the contact that a finished search found, with the part of the flanks that touches."""
    low, high = scene.limits
    inner, outer = scene.radii
    roll, top_radius, radius, error = state.roll, state.top_radius, state.radius, state.error
    missed = jnp.abs(radius - jnp.clip(radius, inner, outer)) > 1e-9 * outer
    empty = jnp.less(*scene.mounting.face()[::-1])
    place = jnp.where(roll >= high, Place.DRIVING_TIP, Place.FLANK)
    place = jnp.where(roll <= low, Place.DRIVING_START, place)
    place = jnp.where(top_radius > outer, Place.DRIVEN_TIP, place)
    place = jnp.where(top_radius < inner, Place.DRIVEN_START, place)
    nothing = missed | empty | jnp.isnan(error)
    return TouchPoint(
        error=jnp.where(nothing, -scene.mates.sense * jnp.inf, error),
        roll=roll,
        share=share,
        place=jnp.where(nothing, Place.NOTHING, place),
    )


def nearest_best(height: Values) -> tuple[Index, Index]:
    """Return indices of section and pair of the largest `height`, shape (section, pair, n).

    Both results have shape (n,). Of equal heights the one closest to mid-grid is taken.
    """
    pairs = height.shape[1]
    best = _best(height.reshape(-1, height.shape[2]), height.shape[:2])
    return best // pairs, best % pairs


def _best(height: Values, sizes: tuple[int, ...]) -> Index:
    """Return the index of the largest height along the first axis.

    Of equal heights the one closest to the middle of the grid is taken. `sizes` is the shape of the
    grid that the first axis flattens.
    """
    count = height.shape[0]
    indices = jnp.unravel_index(jnp.arange(count), sizes)
    off_middle = sum(
        abs(index - (size - 1) / 2) / size for index, size in zip(indices, sizes, strict=True)
    )
    off_middle = jnp.asarray(off_middle).reshape((count,) + (1,) * (height.ndim - 1))
    tied = height >= jnp.max(height, axis=0, keepdims=True) - TIE
    return jnp.argmin(jnp.where(tied, off_middle, jnp.inf), axis=0)


def _where(condition: Bool[Array, "..."], first: TouchPoint, second: TouchPoint) -> TouchPoint:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), first, second)


def _next_share(scene: ContactSearch, bracket: Bracket) -> Values:
    """Return the share at the top of the parabola through three sections.

    Without a top it is halfway to the section on the longer side.
    """
    left, middle, right = bracket
    fall, drop = (scene.mates.sense * (side.error - middle.error) for side in (left, right))
    back, ahead = left.share - middle.share, right.share - middle.share
    # For a (x − v)² these are a back·ahead (back − ahead) and 2 v times that.
    spread, crossed = ahead * fall - back * drop, ahead**2 * fall - back**2 * drop
    good = jnp.isfinite(crossed) & (spread < -TIE * (ahead - back))
    longer = jnp.where(ahead > -back, ahead, back)
    step = jnp.where(good, crossed / jnp.where(good, 2 * spread, 1.0), longer / 2)
    short = jnp.abs(step) < 1e-3 * jnp.abs(longer)
    return middle.share + jnp.where(short, 1e-3 * longer, step)


def share_of_middle(mounting: Mounting) -> Values:
    """Return the share of z = 0 in the common face, or of the closest end of the face."""
    low, high = mounting.face()
    wide = high > low
    return jnp.where(wide, jnp.clip(-low / jnp.where(wide, high - low, 1.0), 0.0, 1.0), 0.0)

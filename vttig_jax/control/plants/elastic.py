"""Plant with elastic teeth: free flight through the gap, spring and damper at the flanks.

An impact is computed without small time steps. At a penetration p of the body into the flank
(negative outside) the torque per inertia is

    F/J = max(0, ω² p + clip(2 ζ ω ṗ, ±ω² p)),  ω = √(c/J)

(Modelica's ElastoBacklash: the damping is limited to the spring torque; the flank never pulls).
An ordinary integrator would need steps much shorter than the contact, which lasts about π/ω. The
law is piecewise linear, and an impact passes its pieces in a fixed order (torque in brackets):

    flight → stiff (2 c p) → both (c p + d ṗ) → loose (0) → flight

In each piece p is a power series in time. The piece ends at the root of a second power series, its
condition of validity. All times are in units of 1/ω.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, float64, known
from ...base.errors import ScenarioError
from ...kinematics.flank_table import Bounds
from ...pair.gear_pair import GearPair
from ..fields import Quantity, number, positive
from ..hermite import cubic, nonzero
from ..motion.motion import MotionPoint
from .plant import (
    FREE,
    ON_A,
    ON_B,
    ContactEvent,
    Drag,
    Plant,
    Shafts,
    Slide,
    Walls,
    flown,
    touching,
    walls_of,
)

Scalar = Float[Array, ""]
Truth = Bool[Array, ""]
Series = Sequence[Scalar]
"""Coefficients of a power series in time, lowest power first."""

_ORDER = 12  # highest power of a series; a chosen value
_SERIES_TIME = 1.3
"""Longest time (1/ω) for one series; the truncation error is 1.3¹³/13! = 5e-9 of the depth or less.
"""
_SERIES_TIME_OVERDAMPED = 2.0
"""Longest time for one series if ζ > 1, in decay times of the faster mode; a chosen value."""
_NEWTON = 4  # Newton iterations; a chosen value


class Press(eqx.Module):
    """Penetration into a flank, rad, and its rate, rad per 1/ω."""

    depth: Scalar
    rate: Scalar


class Impact(eqx.Module):
    """Result of an impact.

    - `press`: penetration at the end of the given time. - `met`: whether there was any contact.
    - `entry`: time until the first contact, 1/ω; if there was no contact, the whole time.
    """

    press: Press
    entry: Scalar
    met: Truth


class Pulls(eqx.Module):
    """Acceleration of the body into the flank by all torques except the contact torque.

    It is in rad per 1/ω² and constant in each of three phases: `before` the contact, during the
    contact (`pressed`), and `after` the contact. Its value differs only by the friction.
    """

    before: Scalar
    pressed: Scalar
    after: Scalar


_Progress = tuple[Press, Scalar, Truth]
"""State of an impact between two pieces of the contact law: penetration and its rate, time until
the end of the step (1/ω), and whether the contact torque has become zero."""

_STIFF = (2.0, 0.0, -1.0, 1.0, 0.0)
_BOTH = (1.0, 1.0, 1.0, 1.0, 1.0)
_PIECES = np.array([_STIFF, _BOTH, _BOTH, _BOTH])
"""Linear pieces of the contact law: spring, damper, depth, rate, releases.

The torque is spring · c p + damper · d ṗ, while depth · p + rate · (d/c) ṗ is positive. `releases`
is 1 if the contact torque is zero after the piece. The piece `_BOTH` is computed with three
consecutive series. Together they cover 3.9/ω. For damping ratios up to 5 a contact with a rebound
is shorter; at 5 the rebound has 7 % of the speed.
"""


def impact(start: Press, pulls: Pulls, time: Scalar, damping_ratio: Scalar) -> Impact:
    """Return the state of a body after a time (1/ω) with at most one impact.

    If the contact outlasts the series, or if the body would meet the flank again within the time,
    the body ends at rest at p = max(0, pull). The energy therefore never increases.
    """
    entry = jnp.where(start.depth > 0, 0.0, _arrival(start, pulls.before))
    met = entry <= time
    flown = _flight(start, pulls.before, jnp.minimum(entry, time))
    depth = jnp.where(met & (start.depth <= 0), 0.0, flown.depth)
    remaining = jnp.where(met, time - jnp.minimum(entry, time), 0.0)
    begun = Press(depth, flown.rate), remaining, jnp.zeros_like(met)
    pull = pulls.pressed
    advance = partial(_advance, pull=pull, damping_ratio=damping_ratio)
    (press, remaining, loose), _ = jax.lax.scan(advance, begun, jnp.asarray(_PIECES))
    loose = met & loose
    press, remaining, thrown = _separation(press, remaining, loose, pull, damping_ratio)
    flight = jnp.where(thrown, jnp.minimum(remaining, _arrival(press, pulls.after)), 0.0)
    stays = remaining > flight
    flown = _flight(press, pulls.after, flight)
    depth = jnp.where(stays, jnp.maximum(pull, 0.0), flown.depth)
    rate = jnp.where(stays, 0.0, flown.rate)
    return Impact(Press(depth, rate), jnp.where(met, entry, time), met)


def _advance(
    state: _Progress, piece: Float[Array, "5"], pull: Scalar, damping_ratio: Scalar
) -> tuple[_Progress, None]:
    """Advance until the piece, the validity of its series or the remaining time ends.

    The earliest of these three ends counts. `pull` is the acceleration by other torques.
    """
    press, remaining, loose = state
    spring, damper, of_depth, of_rate, releases = piece
    of_rate, damping = of_rate * (2 * damping_ratio), damper * (2 * damping_ratio)
    inside = of_depth * press.depth + of_rate * press.rate
    covered = jnp.minimum(remaining, _series_time(damper, damping_ratio))
    limit = jnp.where((inside >= 0) & ~loose, covered, 0.0)
    depth = _series(press, pull, spring, damping)
    slopes = [n * c for n, c in enumerate(depth)][1:]
    margin = [of_depth * c + of_rate * s for c, s in zip(depth, slopes, strict=False)]
    ends = ~loose & (_value_slope(margin, limit)[0] <= 0)
    time = jnp.where(ends, _root(margin, limit), limit)
    press = Press(*_value_slope(depth, time))
    return (press, remaining - time, loose | (ends & (releases > 0))), None


def _separation(press: Press, remaining: Scalar, loose: Truth, pull: Scalar, damping_ratio: Scalar):
    """Move a body that is still inside the flank but has no contact torque.

    The contact torque is zero when the damper cancels the spring (`loose`). The body then moves at
    the constant acceleration `pull` (rad per 1/ω²) until one of three events: it leaves the flank
    at the penetration zero, the law p + 2 ζ ṗ gives a torque again, or the `remaining` time (1/ω)
    has passed. After the second event the body stays where it is until the end of this time step,
    and the next time step continues from there. A body that is not `loose` is not moved.

    **Returns** the penetration and its rate, the time that remains (1/ω), and True if the body left
    the flank.
    """
    damper = 2 * damping_ratio
    square = press.rate**2 - 2 * pull * press.depth
    leaves = (press.rate < 0) & (square >= 0)
    speed = _sqrt(square) - press.rate
    leaving_time = 2 * jnp.maximum(press.depth, 0.0) / jnp.where(leaves, speed, 1.0)
    force = Press(press.depth + damper * press.rate, press.rate + damper * pull)
    duration = jnp.where(leaves, leaving_time, _arrival(force, pull))
    time = jnp.where(loose, jnp.minimum(remaining, duration), 0.0)
    thrown = loose & leaves & (duration <= remaining)
    press = _flight(press, pull, time)
    remaining = jnp.where(loose & ~thrown, 0.0, remaining - time)
    return Press(jnp.where(thrown, 0.0, press.depth), press.rate), remaining, thrown


def _series_time(damper: Scalar, damping_ratio: Scalar) -> Scalar:
    """Return the time (1/ω) over which the series of a piece with this damper is accurate."""
    square = damping_ratio**2 - 1
    over = (square > 0) & (damper > 0)
    fast = jnp.where(over, damping_ratio + _sqrt(square), 1.0)
    return jnp.where(over, _SERIES_TIME_OVERDAMPED / fast, _SERIES_TIME)


def _series(press: Press, pull: Scalar, spring: Scalar, damper: Scalar) -> Series:
    """Return the power series of p̈ = pull − spring p − damper ṗ."""
    series = [press.depth, press.rate]
    for n in range(_ORDER - 1):
        force = spring * series[n] + (n + 1) * damper * series[n + 1]
        series.append(((pull if n == 0 else 0.0) - force) / ((n + 1) * (n + 2)))
    return series


def _value_slope(series: Series, time: Scalar) -> tuple[Scalar, Scalar]:
    value, slope = series[-1], jnp.zeros_like(series[-1])
    for coefficient in series[-2::-1]:
        slope = slope * time + value
        value = value * time + coefficient
    return value, slope


def _root(series: Series, limit: Scalar) -> Scalar:
    """Return the root of a series between the time 0 (value ≥ 0) and `limit` (value ≤ 0)."""
    end, _ = _value_slope(series, limit)

    # `fori_loop` prevents that XLA recomputes these operations for every use of the root.
    def newton(_, time):
        value, slope = _value_slope(series, time)
        return jnp.clip(time - value / nonzero(slope), 0.0, limit)

    first = limit * jnp.clip(series[0] / nonzero(series[0] - end), 0.0, 1.0)
    return jax.lax.fori_loop(0, _NEWTON, newton, first)


def _flight(press: Press, pull: Scalar, time: Scalar) -> Press:
    return Press(press.depth + time * (press.rate + 0.5 * time * pull), press.rate + time * pull)


def _arrival(press: Press, pull: Scalar) -> Scalar:
    """Return the time (1/ω) until a body in flight from depth ≤ 0 enters the flank; ∞ if never."""
    square = press.rate**2 - 2 * pull * press.depth
    root = _sqrt(square)
    inwards = press.rate > 0
    above = jnp.where(inwards, -2 * press.depth, root - press.rate)
    below = jnp.where(inwards, press.rate + root, pull)
    comes = (square >= 0) & (below > 0)
    return jnp.where(comes, jnp.maximum(above, 0.0) / jnp.where(comes, below, 1.0), jnp.inf)


def _sqrt(value: Scalar) -> Scalar:
    """Return the square root, or 0 for values ≤ 0; its derivative is finite everywhere."""
    positive = value > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, value, 1.0)), 0.0)


class Elastic(Plant):
    """Plant with inertia and friction in the gap, stiffness and damping at the flanks.

    At a penetration p of the driven shaft, the flank exerts the torque (d = 2 ζ √(c J₂))

        T₂ = max(0, c p + clip(d ṗ, ±c p))

    One time step covers a whole impact (see `impact`). In the step the flanks have constant
    acceleration, and friction is constant before, during and after the contact. A step of any
    length is stable, and the mesh never returns more energy than it has absorbed. At most one
    impact per step is computed: if the contact persists, or if the shaft would meet the flank again
    within the step, the shaft ends at rest relative to the flank. In a closed gap the shaft rests
    between both springs.

    **Arguments**
    - `stiffness_N_mm_um`: c_γ of ISO 6336. - `damping_ratio`: ζ; if the driving motion is
      prescribed, it is defined with J₂ alone.
    - `drag`: inertia and friction of the driven shaft. - `stiffness`: c, N m/rad at the driven
      shaft; see `mesh_stiffness`. `run` fills in both.
    - `effective`: inertia of the relative motion of both shafts, kg m², if the driving shaft can
      move (`coupled`); it replaces J₂ in the contact law and in the definition of ζ.
    """

    stiffness_N_mm_um: Quantity = positive(
        20.0, "elastic: mesh stiffness per face width, ISO 6336", "N/(mm um)"
    )
    damping_ratio: Quantity = number(
        0.1, "elastic: damping over critical damping", "1", ge=0, le=100
    )
    drag: Drag = Drag(1.0)
    stiffness: Float[Number, ""] = eqx.field(converter=float64, default=1.0)
    effective: Float[Number, ""] | None = None

    def with_shaft(self, drag: Drag, pair: Any) -> "Elastic":
        """See `Plant.with_shaft`.

        **Raises** `ScenarioError` for gears without face width.
        """
        width = pair.driven.face_width_mm if isinstance(pair, GearPair) else np.nan
        if known(width) and np.isnan(width):
            cure = "add `face_width_mm` to [driven] of the pair file"
            if not isinstance(pair, GearPair):
                cure = "a [drive] has none, so choose the rigid plant"
            raise ScenarioError(
                f"the elastic plant needs the face width of the driven gear; {cure}.", where="plant"
            )
        radius = pair.base_radii[1].mean()
        stiffness = mesh_stiffness(self.stiffness_N_mm_um, width, radius)
        return replace(self, drag=drag, stiffness=stiffness)

    def coupled(self, effective: Float[Number, ""]) -> "Elastic":
        """Return the same plant for a driving shaft that the teeth can move.

        `effective` is the inertia of the relative motion of both shafts, kg m². In this plant
        friction is constant over the whole step, including impacts, so the acceleration differs
        from `slowing` by the contact torque alone.
        """
        return replace(self, effective=effective)

    def torque(self, shafts: Shafts, now: Walls) -> Scalar:
        """Return the torque of both flanks on the driven shaft, N m; flank A acts positively.

        `now` holds the position and the rate of both flanks.
        """
        on_a, on_b = map(self._torque, _depths(now, shafts.offset, shafts.drift))
        return on_a - on_b

    def slowing(self, shafts: Shafts, now: Walls, ratio: Scalar, step: Scalar) -> Scalar:
        """Return the acceleration of the driven shaft by friction and load, rad/s².

        It is the mean over a time step (`step`, s), and negative where it slows a positive speed.
        The acceleration by the contact torque is not included, but friction and load oppose the
        contact torque as far as they can balance it at standstill. `ratio` is i.
        """
        force = self.torque(shafts, now)
        push = jnp.where(force == 0, 0.0, self._friction_limited(force))
        driven_speed = ratio * shafts.speed + shafts.drift
        return self.drag.acceleration(driven_speed, push, step) - push / self.drag.inertia

    def _friction_limited(self, torque: Scalar) -> Scalar:
        """Return `torque` (N m), limited to what friction and the load can balance at standstill.

        The range is T_load ± (T_c + T_s).
        """
        limit = jnp.asarray(self.drag.coulomb) + self.drag.stribeck
        return jnp.clip(torque, self.drag.load - limit, self.drag.load + limit)

    def step(
        self, shafts: Shafts, driving: MotionPoint, slide: Slide, bounds: Bounds, step: Number
    ) -> tuple[Shafts, ContactEvent]:
        """See `Plant.step`."""
        ratio = jnp.asarray(bounds.ratio)
        step = jnp.asarray(step)
        flanks, now, then, low, high = walls_of(shafts, driving, slide, bounds, step)
        driven_speed = ratio * shafts.speed + shafts.drift
        if self.effective is None:
            slowing = self.drag.acceleration(driven_speed, 0.0, step)
        else:
            slowing = self.slowing(shafts, now, ratio, step)
        # The flight without contact, and the penetration of the nearer flank at both of its ends.
        free, drift = flown(shafts, driving, ratio, slowing, step)
        rate = jnp.sqrt(jnp.asarray(self.stiffness) / self._inertia)
        start_a, start_b = _depths(now, shafts.offset, shafts.drift)
        end_a, end_b = _depths(then, free, drift)
        nearer_a = (start_b.depth <= 0) & (end_a.depth > end_b.depth)
        on_a = (start_a.depth > 0) | nearer_a
        sense = jnp.where(on_a, 1.0, -1.0)
        start, end = (
            jax.tree.map(lambda a, b: jnp.where(on_a, a, b), *both)
            for both in ((start_a, start_b), (end_a, end_b))
        )
        pull = loaded = (end.rate - start.rate) / step
        if self.effective is None:
            lag = sense * end.rate
            change = self._friction_change(driven_speed, slowing, start, lag, sense, step)
            loaded = pull - sense * change
        pulls = Pulls(pull, loaded, jnp.where(start.depth > 0, pull, loaded))
        result = impact(
            Press(start.depth, start.rate / rate),
            jax.tree.map(lambda pull: pull / rate**2, pulls),
            rate * step,
            jnp.asarray(self.damping_ratio),
        )
        depth, speed = result.press.depth, rate * result.press.rate
        offset = jnp.where(on_a, then.lower - depth, then.upper + depth)
        offset = jnp.where(result.met, offset, free)
        # If the rebound also reaches the other flank, the shaft stops there until the next step.
        offset = jnp.where(on_a, jnp.minimum(offset, then.upper), jnp.maximum(offset, then.lower))
        after = jnp.where(on_a, then.lower_rate - speed, then.upper_rate + speed)
        drift = jnp.where(result.met, after, drift)
        share = jnp.minimum(result.entry / (rate * step), 1.0)
        # In a closed gap the springs of both flanks balance the pull towards flank A by c/J, rad.
        # If the pull exceeds the overlap, one of the flanks is unloaded.
        pull, overlap = (end_a.rate - start_a.rate) / (step * rate**2), then.lower - then.upper
        depth = jnp.minimum(jnp.maximum(0.5 * (overlap + pull), pull), overlap + pull)
        closed = overlap > 0
        offset = jnp.where(closed, then.lower - depth, offset)
        drift = jnp.where(closed, 0.5 * (then.lower_rate + then.upper_rate), drift)
        share = jnp.where(closed, 1.0, share)

        flank = jnp.where(on_a, ON_A, ON_B)
        met = jnp.where(result.met & (flank != shafts.side), flank, FREE)
        # As with rigid teeth: when the gap closes, the flank opposite to `side` is newly loaded.
        met = jnp.where(closed, -shafts.side, met)
        side = touching(offset < then.lower, offset > then.upper, shafts.side)
        way = cubic(shafts.angle, driving.angle, shafts.speed, driving.speed, step)
        touch = ContactEvent(met, way.at(share), high.at(share) - low.at(share))
        return Shafts(driving.angle, driving.speed, offset, drift, side, flanks), touch

    def _friction_change(
        self, speed: Scalar, slowing: Scalar, start: Press, lag: Scalar, sense: Scalar, step: Scalar
    ) -> Scalar:
        """Return the acceleration by friction with contact minus that in flight, rad/s².

        If the flank is loaded at the start of the step, friction opposes the contact torque up to
        the friction limit. If the impact occurs within the step, friction opposes the motion after
        the rebound; 1/(1 + 3 ζ) approximates the coefficient of restitution.

        **Arguments**
        - `speed`: of the driven shaft at the start. - `slowing`: its acceleration in flight.
        - `start`: penetration at the start. - `sense`: 1 for flank A, −1 for flank B.
        - `lag`: rate of the flank minus rate of the shaft at the end of the flight, rad/s.
        """
        pressed = start.depth > 0
        rebound = (1 + 1 / (1 + 3 * jnp.asarray(self.damping_ratio))) * lag
        later = jnp.where(pressed, 0.0, step * slowing + rebound)
        push = jnp.where(pressed, sense * self._torque(start), 0.0)
        push = jnp.where(pressed, self._friction_limited(push), 0.0)
        pressed_slowing = self.drag.acceleration(speed + later, push, step)
        return pressed_slowing - push / self.drag.inertia - slowing

    def _torque(self, press: Press) -> Scalar:
        stiffness = jnp.asarray(self.stiffness)
        spring = stiffness * jnp.maximum(press.depth, 0.0)
        damping = 2 * self.damping_ratio * jnp.sqrt(stiffness * self._inertia)
        return spring + jnp.clip(damping * press.rate, -spring, spring)

    @property
    def _inertia(self) -> Float[Number, ""]:
        return self.drag.inertia if self.effective is None else self.effective


def mesh_stiffness(c_gamma_N_mm_um: Any, face_width_mm: Any, base_radius_mm: Any) -> Any:
    """Return the torsional mesh stiffness c (N m/rad at the driven shaft) from that of ISO 6336.

        c = c_γ b r_b2²

    **Arguments**
    - `c_gamma_N_mm_um`: c_γ, N per mm of face width and µm on the line of action.
    - `face_width_mm`: b. - `base_radius_mm`: base circle radius r_b2 of the driven gear.

    **Example**
    ```python
    >>> from vttig_jax.control import mesh_stiffness
    >>> round(mesh_stiffness(20.0, 20.0, 75.18))
    2260813

    ```
    """
    return c_gamma_N_mm_um * face_width_mm * base_radius_mm**2


def largest_step(stiffness: Any, damping_ratio: Any, inertia: Any) -> Float[Array, "*shape"]:
    """Return the longest time step (s) that resolves the oscillation in a lasting contact.

    Longer steps are stable too, but then a shaft in lasting contact is set to rest, and its
    oscillation is lost. Positions stay accurate to an arcsecond with much longer steps.

    **Arguments**
    - `stiffness`: c, N m/rad. - `damping_ratio`: ζ. - `inertia`: J₂, kg m².

    **Example**
    ```python
    >>> from vttig_jax.control.plants.elastic import largest_step
    >>> round(float(largest_step(2.26e6, 0.1, 0.01)), 6)
    0.000259

    ```
    """
    dampers = [damper for _, damper, *_ in jnp.asarray(_PIECES) if damper > 0]
    times = [_series_time(damper, jnp.asarray(damping_ratio)) for damper in dampers]
    return jnp.sum(jnp.stack(times), 0) * jnp.sqrt(jnp.asarray(inertia / stiffness))


def _depths(bounds: Walls, offset: Scalar, drift: Scalar) -> tuple[Press, Press]:
    """Return the penetration of the driven shaft into flanks A and B, rad, and its rate, rad/s."""
    return (
        Press(bounds.lower - offset, bounds.lower_rate - drift),
        Press(offset - bounds.upper, drift - bounds.upper_rate),
    )

"""The part of a run that decides what a closing controller leaves and where it closes too far.

With a prescribed motion neither the driving angle nor its reading depends on the controller: both
are computed beforehand, counts and noise of the encoder included, and what is left to go through a
scan is observer, controller and actuator. The window begins shortly before the brakes, with the gap
open and an observer that has settled, and ends when the shaft has reached its speed after the turn
(of a motion that never turns back: with the run).
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...base.arrays import Number, Numbers, float64
from ..controllers.controller import Controller, Measurement
from ..controllers.smooth import smoothed
from ..hardware.actuator import Actuator, Carriage
from ..hardware.encoder import shocks
from ..hardware.observer import MotionEstimate, Observer
from ..simulation.case import Case

LEAD_IN_S = 0.2
"""s before the brakes at which the window begins."""

_FULL, _PLACES = 0.98, 256
"""Share of the highest speed after the turn at which the window ends; times looked at for it."""


class Window(eqx.Module):
    """One case from shortly before its brakes on; n periods of the controller.

    - `reading`: of the driving encoder, rad. - `closed`: axial displacement that closes the gap at
      the end of every step of the plant, mm; `closed_first`: at the start of the window.
    - `counts`: false for periods that only fill up. - `after`: whether the motion has turned.
    - `turn`: the period nearest to the turn, −1 without one.
    - `estimate`: of the observer a period before: the motion itself.
    - `period`: s. - `closing`: rad of backlash a mm. - the rest: parts of the case.
    """

    reading: Float[Numbers, " n"]
    closed: Float[Numbers, "n substeps"]
    closed_first: Float[Numbers, ""]
    counts: Bool[Numbers, " n"]
    after: Bool[Numbers, " n"]
    turn: Int[Numbers, ""]
    estimate: MotionEstimate
    actuator: Actuator
    observer: Observer
    controller: Controller
    period: Float[Number, ""] = eqx.field(converter=float64)
    closing: Float[Number, ""] = eqx.field(converter=float64)


class Extent(NamedTuple):
    """First period of a window, and how many there are."""

    first: int
    periods: int


def extent_of(case: Case) -> Extent:
    """Where the window of a case lies."""
    start, until = map(float, _ends(case))
    period, duration = float(case.period), float(case.motion.duration_s)
    first = math.floor(start / period)
    last = min(math.ceil(until / period), math.floor(duration / period * (1 + 1e-12)))
    return Extent(first, max(last - first + 1, 1))


@eqx.filter_jit
def _ends(case: Case) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Start and end of the window, s."""
    motion = case.motion
    turn, end = jnp.asarray(motion.turn_s), jnp.asarray(motion.duration_s)
    times = turn + (end - turn) * jnp.linspace(0.0, 1.0, _PLACES + 1)
    speed = jnp.abs(motion.at(times).speed)
    reached = jnp.argmax(speed >= _FULL * jnp.max(speed))
    until = jnp.where(turn < end, times[jnp.minimum(reached + 1, _PLACES)], end)
    return jnp.maximum(motion.braking_s - LEAD_IN_S, 0.0), until


def window_of(case: Case, extent: Extent, periods: int) -> Window:
    """The window of a case, filled up to so many periods."""
    made = _made(case, jnp.asarray(extent.first), jnp.asarray(extent.periods), periods)
    return Window(
        *jax.tree.map(np.asarray, made),
        actuator=case.actuator,
        observer=case.observer,
        controller=case.controller,
        period=case.period,
        closing=float(case.bounds.closing_sum),
    )


@eqx.filter_jit
def _made(
    case: Case, first: Int[Array, ""], periods: Int[Array, ""], length: int
) -> tuple[Array, Array, Array, Array, Array, Array, MotionEstimate]:
    motion, period = case.motion, jnp.asarray(case.period)
    numbers = first + jnp.arange(length)
    time = numbers * period
    point = motion.at(time)
    noise = jnp.zeros(length)
    if case.noisy:
        key = jax.random.key(case.seed)
        noise = jax.vmap(lambda number: shocks(key, number)[0])(numbers)
    reading = jax.vmap(case.driving_sensor.read)(point.angle, noise)
    places = jnp.arange(1.0, case.substeps + 1) / case.substeps
    steps = time[:, None] + period * places
    sum_ = case.bounds.closing_sum
    closed = jnp.maximum(case.bounds.gap(motion.at(steps).angle) / sum_, 0.0)
    counts = (jnp.arange(length) < periods) & (time <= motion.duration_s)
    turns = (time >= motion.turn_s - 0.5 * period) & (time < motion.duration_s)
    begin = jax.tree.map(lambda values: values[0], point)
    before = motion.at(time[0] - period)
    return (
        reading,
        closed,
        jnp.maximum(case.bounds.gap(begin.angle) / sum_, 0.0),
        counts,
        time > motion.turn_s,
        jnp.where(jnp.any(turns & counts), jnp.argmax(turns), -1),
        MotionEstimate(*before),
    )


class Left(NamedTuple):
    """What a window ends with, mm of axial displacement.

    - `gap`: left when the motion turns, 0 without a turn. - `interference`: most by which the
      actuator wanted further than the closed gap lets it, until the gap is opened again.
    """

    gap: Float[Array, ""]
    interference: Float[Array, ""]


class _Carry(NamedTuple):
    estimate: MotionEstimate
    state: object
    carriage: Carriage
    closed: Float[Array, ""]
    left: Left
    peak: Float[Array, ""]
    opened: Bool[Array, ""]


def left_of(window: Window, width: Float[Array, ""], blur_mm: Float[Array, ""]) -> Left:
    """Run a window with smoothed judgements.

    What the actuator wants beyond the closed gap, max(0, wanted − closed), becomes
    b ln(1 + exp((wanted − closed)/b)); its rounding down to a resolution becomes half a step, the
    mean of it. Everything else of the actuator has slopes as it is.

    **Arguments**
    - `width`: of the judgements, relative; see `smooth_controllers`. - `blur_mm`: b, mm.
    """
    controller, actuator = smoothed(window.controller, width), window.actuator
    half = 0.5 * jnp.asarray(actuator.resolution)
    fine = eqx.tree_at(lambda one: one.resolution, actuator, jnp.zeros(()))
    period, substeps = jnp.asarray(window.period), window.closed.shape[1]

    def over(carriage: Carriage, closed: Float[Array, ""]) -> Float[Array, ""]:
        return blur_mm * jnp.logaddexp((carriage.wanted - closed) / blur_mm, 0.0)

    def one(carry: _Carry, given: tuple[Array, ...]) -> tuple[_Carry, None]:
        number, reading, closed, counts, after = given
        estimate = window.observer.step(carry.estimate, reading, period)
        speed, acceleration = estimate.speed, estimate.acceleration
        seen = Measurement(number * period, reading, reading, speed, acceleration, reading, speed)
        state, found = controller.step(carry.state, seen)
        command = jnp.asarray(controller.ordered(found).shift)
        here = carry.closed - carry.carriage.wanted + over(carry.carriage, carry.closed)
        gap = jnp.where(number == window.turn, here, carry.left.gap)
        carriage, target = fine.commanded(carry.carriage, command)
        target = jnp.maximum(target - half, 0.0)
        peak = jnp.maximum(carry.peak, command)
        # The hard one is opened by a command of 0, which a blurred one need not reach.
        opened = carry.opened | (after & (command < 0.5 * peak))
        most = carry.left.interference
        for step in range(substeps):
            free = jnp.full((), jnp.inf)
            carriage, _, _ = fine.step(carriage, target, free, period / substeps)
            worse = jnp.maximum(most, over(carriage, closed[step]))
            most = jnp.where(counts & ~opened, worse, most)
        left = Left(gap, most)
        return _Carry(estimate, state, carriage, closed[-1], left, peak, opened), None

    zero = jnp.zeros(())
    begin = _Carry(
        jax.tree.map(jnp.asarray, window.estimate),
        controller.start(),
        fine.at_rest(),
        jnp.asarray(window.closed_first),
        Left(zero, zero),
        zero,
        jnp.zeros((), bool),
    )
    numbers = jnp.arange(window.reading.shape[0])
    given = (numbers, window.reading, window.closed, window.counts, window.after)
    return jax.lax.scan(one, begin, jax.tree.map(jnp.asarray, given))[0].left

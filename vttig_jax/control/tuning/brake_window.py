"""Window of a run around the turn, which determines the residual gap and the interference.

With a prescribed motion neither the driving angle nor its reading depends on the controller. Both
are computed beforehand, with counts and noise of the encoder, so the loop over the periods contains
only observer, controller and actuator. The window begins shortly before the braking, with an open
gap and an observer without transients. It ends when the shaft has reached its speed after the turn,
or at the end of the run if the motion never turns back.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...base.arrays import Number, Numbers, float64
from ...kinematics.flank_table import Bounds
from ..controllers.controller import Controller, Measurement
from ..controllers.retreat import Retreat
from ..controllers.smooth import smoothed
from ..hardware.actuator import Actuator, Carriage
from ..hardware.encoder import noise_draws
from ..hardware.observer import MotionEstimate, Observer
from ..simulation.case import Case

LEAD_IN_S = 0.2
"""Time from the start of the window to the start of braking, s; a chosen value."""

_FULL, _TIMES = 0.98, 256
"""Fraction of the highest speed after the turn at which the window ends, and number of times at
which the speed is computed to find this end; chosen values."""


class Window(eqx.Module):
    """Part of the motion of one case that is simulated: n periods of the controller.

    It begins `LEAD_IN_S` before braking and ends when the speed after the turn is nearly the
    highest speed again. Without a turn it ends with the motion.

    - `reading`: readings of the driving encoder, rad. - `closed`: axial displacement that closes
      the gap at the end of each plant step, mm. - `closed_first`: at the start of the window.
    - `counts`: false for periods that only fill the arrays. - `after`: true after the turn.
    - `turn`: index of the period nearest to the turn, −1 without a turn.
    - `estimate`: observer estimate one period before the window, equal to the true motion.
    - `period`: controller period, s. - `closing`: decrease of backlash per displacement, rad/mm.
    - `actuator`, `observer`, `controller`, `believed`, `lead_s`, `retreat`: parts of the case.
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
    believed: Bounds
    lead_s: Float[Number, ""]
    retreat: Retreat | None
    period: Float[Number, ""] = eqx.field(converter=float64)
    closing: Float[Number, ""] = eqx.field(converter=float64)


class Extent(NamedTuple):
    """Number of the first controller period of a window, and how many periods the window has."""

    first: int
    periods: int


def extent_of(case: Case) -> Extent:
    """Return the first controller period of the window of a case, and its number of periods."""
    start, until = map(float, _window_times(case))
    period, duration = float(case.period), float(case.motion.duration_s)
    first = math.floor(start / period)
    last = min(math.ceil(until / period), math.floor(duration / period * (1 + 1e-12)))
    return Extent(first, max(last - first + 1, 1))


@eqx.filter_jit
def _window_times(case: Case) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return start and end of the window, s."""
    motion = case.motion
    turn, end = jnp.asarray(motion.turn_s), jnp.asarray(motion.duration_s)
    times = turn + (end - turn) * jnp.linspace(0.0, 1.0, _TIMES + 1)
    speed = jnp.abs(motion.at(times).speed)
    reached = jnp.argmax(speed >= _FULL * jnp.max(speed))
    until = jnp.where(turn < end, times[jnp.minimum(reached + 1, _TIMES)], end)
    return jnp.maximum(motion.braking_s - LEAD_IN_S, 0.0), until


def window_of(case: Case, extent: Extent, periods: int) -> Window:
    """Return the window of a case, filled up to an array length of `periods`."""
    arrays = _window_arrays(case, jnp.asarray(extent.first), jnp.asarray(extent.periods), periods)
    return Window(
        *jax.tree.map(np.asarray, arrays),
        actuator=case.actuator,
        observer=case.observer,
        controller=case.controller,
        believed=case.believed,
        lead_s=case.lead_s,
        retreat=case.retreat,
        period=case.period,
        closing=float(case.bounds.closing_sum),
    )


@eqx.filter_jit
def _window_arrays(
    case: Case, first: Int[Array, ""], periods: Int[Array, ""], length: int
) -> tuple[Array, Array, Array, Array, Array, Array, MotionEstimate]:
    motion, period = case.motion, jnp.asarray(case.period)
    numbers = first + jnp.arange(length)
    time = numbers * period
    point = motion.at(time)
    noise = jnp.zeros(length)
    if case.noisy:
        key = jax.random.key(case.seed)
        noise = jax.vmap(lambda number: noise_draws(key, number)[0])(numbers)
    reading = jax.vmap(case.driving_encoder.read)(point.angle, noise)
    shares = jnp.arange(1.0, case.substeps + 1) / case.substeps
    steps = time[:, None] + period * shares[None]
    closing = case.bounds.closing_sum
    closed = jnp.maximum(case.bounds.gap(motion.at(steps).angle) / closing, 0.0)
    counts = (jnp.arange(length) < periods) & (time <= motion.duration_s)
    turns = (time >= motion.turn_s - 0.5 * period) & (time < motion.duration_s)
    start = jax.tree.map(lambda values: values[0], point)
    before = motion.at(time[0] - period)
    return (
        reading,
        closed,
        jnp.maximum(case.bounds.gap(start.angle) / closing, 0.0),
        counts,
        time > motion.turn_s,
        jnp.where(jnp.any(turns & counts), jnp.argmax(turns), -1),
        MotionEstimate(before.angle, before.speed, before.acceleration),
    )


class WindowResult(eqx.Module):
    """Result of a window, mm of axial displacement.

    - `gap`: further displacement that would close the gap at the turn; 0 without a turn.
    - `interference`: largest distance by which the closed gap holds the actuator back until the
      controller opens the gap again.
    """

    gap: Float[Array, ""]
    interference: Float[Array, ""]


class _Carry(eqx.Module):
    estimate: MotionEstimate
    state: object
    carriage: Carriage
    closed: Float[Array, ""]
    result: WindowResult
    peak: Float[Array, ""]
    opened: Bool[Array, ""]


def _first_carry(window: Window, state: object, carriage: Carriage) -> _Carry:
    zero = jnp.zeros(())
    return _Carry(
        estimate=jax.tree.map(jnp.asarray, window.estimate),
        state=state,
        carriage=carriage,
        closed=jnp.asarray(window.closed_first),
        result=WindowResult(zero, zero),
        peak=zero,
        opened=jnp.zeros((), bool),
    )


def run_window(window: Window, width: Float[Array, ""], blur_mm: Float[Array, ""]) -> WindowResult:
    """Simulate a window with smoothed comparisons.

    The excess x of the unobstructed position over the closed gap, max(0, x), becomes the softplus
    b ln(1 + exp(x/b)). Rounding down to the resolution becomes a shift by half a step, its mean.
    The rest of the actuator is differentiable.

    **Arguments**
    - `width`: relative width of the comparisons; see `controllers/smooth.py`.
    - `blur_mm`: width b of the softplus function, mm.
    """
    controller, actuator = smoothed(window.controller, width), window.actuator
    half_step = 0.5 * jnp.asarray(actuator.resolution_mm)
    actuator = eqx.tree_at(lambda part: part.resolution_mm, actuator, jnp.zeros(()))
    period, substeps = jnp.asarray(window.period), window.closed.shape[1]

    def excess(carriage: Carriage, closed: Float[Array, ""]) -> Float[Array, ""]:
        return blur_mm * jnp.logaddexp((carriage.unobstructed - closed) / blur_mm, 0.0)

    def step(carry: _Carry, inputs: tuple[Array, ...]) -> tuple[_Carry, None]:
        number, reading, closed, counts, after = inputs
        estimate = window.observer.step(carry.estimate, reading, period)
        speed, acceleration = estimate.speed, estimate.acceleration
        time = number * period
        measurement = Measurement(
            time=time,
            driving=reading,
            driven=reading,
            speed=speed,
            acceleration=acceleration,
            reference=reading,
            reference_speed=speed,
            map=window.believed,
            delay=window.lead_s,
            retreat=window.retreat,
        )
        state, output = controller.step(carry.state, measurement)
        command = jnp.asarray(controller.as_command(output).shift)
        gap = carry.closed - carry.carriage.unobstructed + excess(carry.carriage, carry.closed)
        gap = jnp.where(number == window.turn, gap, carry.result.gap)
        carriage, target = actuator.commanded(carry.carriage, command)
        target = jnp.maximum(target - half_step, 0.0)
        peak = jnp.maximum(carry.peak, command)
        # The original controller opens the gap with a command of 0; a smoothed one may not reach 0.
        opened = carry.opened | (after & (command < 0.5 * peak))
        interference = carry.result.interference
        for substep in range(substeps):
            unlimited = jnp.full((), jnp.inf)
            carriage, _, _ = actuator.step(carriage, target, unlimited, period / substeps)
            larger = jnp.maximum(interference, excess(carriage, closed[substep]))
            interference = jnp.where(counts & ~opened, larger, interference)
        result = WindowResult(gap, interference)
        return _Carry(
            estimate=estimate,
            state=state,
            carriage=carriage,
            closed=closed[-1],
            result=result,
            peak=peak,
            opened=opened,
        ), None

    start = _first_carry(window, controller.start(), actuator.at_rest())
    numbers = jnp.arange(window.reading.shape[0])
    inputs = (numbers, window.reading, window.closed, window.counts, window.after)
    return jax.lax.scan(step, start, jax.tree.map(jnp.asarray, inputs))[0].result

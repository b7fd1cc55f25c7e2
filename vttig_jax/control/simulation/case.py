"""One case of a simulation, ready to run: every number an array, every choice a type."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...base.arrays import Number, Numbers, float64
from ..controllers.controller import Controller, Measurement
from ..hardware.actuator import Actuator, Carriage
from ..hardware.encoder import Sensor, shocks
from ..hardware.observer import MotionEstimate, Observer
from ..hardware.shaft_drive import Lead, Prescribed, ShaftDrive, led, next_lead, no_lead
from ..hermite import cubic
from ..motion.motion import Motion, MotionPoint
from ..plants.flank_bounds import Bounds
from ..plants.plant import ON_A, ON_B, Plant, Shafts
from .accumulators import Accumulators, RunFacts, empty, moved, sampled


class Case(eqx.Module):
    """A rig, its motion and its controller.

    **Arguments**
    - `motion`, `bounds`, `plant`, `actuator`, `observer`, `controller`: the parts.
    - `driving_sensor`, `driven_sensor`: what the controller sees of both shafts.
    - `period`: of the controller, s. - `seed`: of the noise of the encoders.
    - `sense`: 1 for a run that begins forwards, −1 backwards.
    - `substeps`: steps of the plant in a period.
    - `noisy`: whether the encoders have noise at all; without it no random numbers are drawn.
    - `drive`: how the driving shaft follows the motion.
    """

    motion: Motion
    bounds: Bounds
    plant: Plant
    actuator: Actuator
    observer: Observer
    controller: Controller
    driving_sensor: Sensor
    driven_sensor: Sensor
    period: Float[Number, ""] = eqx.field(converter=float64)
    sense: Float[Number, ""] = eqx.field(converter=float64)
    seed: Int[Numbers, ""]
    substeps: int = eqx.field(static=True, default=1)
    noisy: bool = eqx.field(static=True, default=False)
    drive: ShaftDrive = Prescribed()


class State(NamedTuple):
    """Everything that one period hands to the next.

    - `lead`: of the driving shaft over its motion, where the controller moves the motor at all.
    - `asked`: the motion at this time; None where the driving shaft is exactly there.
    - `motor`: state of the drive.
    """

    shafts: Shafts
    carriage: Carriage
    estimate: MotionEstimate
    controller: Any
    tally: Accumulators
    lead: Lead | None = None
    asked: MotionPoint | None = None
    motor: Any = ()


class Sample(NamedTuple):
    """One period as a trace shows it: s, rad and mm.

    - `driving`, `error`: true driving angle and transmission error φ₂ − i φ₁.
    - `shown`: transmission error of both readings. - `speed`, `acceleration`: as estimated.
    - `lower`, `upper`: TE on flank A and flank B at the axial displacement `reached`.
    - `command`: axial displacement asked for.
    """

    time: Float[Numbers, "*shape"]
    driving: Float[Numbers, "*shape"]
    error: Float[Numbers, "*shape"]
    shown: Float[Numbers, "*shape"]
    speed: Float[Numbers, "*shape"]
    acceleration: Float[Numbers, "*shape"]
    lower: Float[Numbers, "*shape"]
    upper: Float[Numbers, "*shape"]
    command: Float[Numbers, "*shape"]
    reached: Float[Numbers, "*shape"]


def started(case: Case) -> State:
    """At rest at angle zero on flank A, fully open."""
    point = case.motion.at(jnp.zeros(()))
    flanks = case.bounds.at(point.angle)
    still = jnp.zeros(())
    shafts = Shafts(point.angle, point.speed, flanks.lower, still, jnp.full((), ON_A), flanks)
    driving, _ = _read(case, shafts, jnp.zeros((), int))
    return State(
        shafts,
        case.actuator.at_rest(),
        MotionEstimate(driving, still, still),
        case.controller.start(),
        empty(),
        no_lead() if case.controller.advances else None,
        point if _apart(case) else None,
        case.drive.start(point),
    )


def _apart(case: Case) -> bool:
    """Whether the driving shaft is ever anywhere else than its motion has it."""
    return case.controller.advances or not isinstance(case.drive, Prescribed)


def advance(case: Case, state: State, periods: Int[Array, " n"]) -> tuple[State, Sample]:
    """Run the periods with these numbers, one after the other, and give a sample of each."""

    def one(state: State, number: Int[Array, ""]) -> tuple[State, Sample]:
        return _period(case, state, number)

    return jax.lax.scan(one, state, periods)


def finished(case: Case, state: State, periods: Int[Array, " n"]) -> State:
    """Run the periods and keep nothing but the state."""

    def one(state: State, number: Int[Array, ""]) -> tuple[State, None]:
        return _period(case, state, number)[0], None

    return jax.lax.scan(one, state, periods)[0]


def _period(case: Case, state: State, number: Int[Array, ""]) -> tuple[State, Sample]:
    run = _run(case)
    time = number * jnp.asarray(case.period)
    shafts, carriage = state.shafts, state.carriage
    driving, driven = _read(case, shafts, number)
    estimate = case.observer.step(state.estimate, driving, jnp.asarray(case.period))
    asked = shafts if state.asked is None else state.asked
    known = estimate.speed, estimate.acceleration, asked.angle, asked.speed
    seen = Measurement(time, driving, driven, *known)
    controller, found = case.controller.step(state.controller, seen)
    order = case.controller.ordered(found)
    command, period = jnp.asarray(order.shift), jnp.asarray(case.period)
    lead = state.lead and next_lead(state.lead, jnp.asarray(order.advance), period)
    carriage, target = case.actuator.commanded(carriage, command)
    shown = driven - case.bounds.ratio * driving
    gap = shafts.flanks.upper - shafts.flanks.lower
    tally = sampled(
        state.tally,
        run,
        time,
        shown,
        shafts.angle,
        command,
        target,
        gap,
        shafts.side,
        carriage,
    )
    sample = Sample(
        time,
        shafts.angle,
        shafts.offset,
        shown,
        estimate.speed,
        estimate.acceleration,
        shafts.flanks.lower + run.closing[0] * carriage.reached,
        shafts.flanks.upper - run.closing[1] * carriage.reached,
        command,
        carriage.reached,
    )
    moving = _Moving(shafts, carriage, tally, state.asked, state.motor)
    told = _PeriodInputs(target, time, state.lead, lead)
    if case.substeps == 1:
        moving = _moved(case, run, told, moving, jnp.ones(()))
    else:

        def one(moving: _Moving, place: Float[Array, ""]) -> tuple[_Moving, None]:
            return _moved(case, run, told, moving, place), None

        moving, _ = jax.lax.scan(one, moving, jnp.arange(1.0, case.substeps + 1))
    shafts, carriage, tally, asked, motor = moving
    return State(shafts, carriage, estimate, controller, tally, lead, asked, motor), sample


class _Moving(NamedTuple):
    """What the steps of the plant change."""

    shafts: Shafts
    carriage: Carriage
    tally: Accumulators
    asked: MotionPoint | None
    motor: Any


class _PeriodInputs(NamedTuple):
    """What holds over one period.

    - `target`: of the actuator, mm. - `time`: of its start, s.
    - `before`, `after`: lead of the driving shaft at both ends, if there is any.
    """

    target: Float[Array, ""]
    time: Float[Array, ""]
    before: Lead | None
    after: Lead | None


def _moved(
    case: Case,
    run: RunFacts,
    told: _PeriodInputs,
    moving: _Moving,
    place: Float[Array, ""],
) -> _Moving:
    """One step of the plant, the `place`-th of a period."""
    step = jnp.asarray(case.period) / case.substeps
    then = told.time + place * step
    ahead = asked = case.motion.at(then)
    if told.before is not None and told.after is not None:
        share = place / case.substeps
        ahead = led(asked, told.before, told.after, share, jnp.asarray(case.period))
    expected = case.drive.expected(moving.shafts, ahead, step)
    closed = case.bounds.gap(expected) * (1.0 / case.bounds.closing_sum)
    push, thrust = None, case.actuator.thrust
    if thrust is not None:
        push = thrust.at(moving.shafts.side, moving.shafts.speed, ahead.acceleration)
    carriage, slide, blocked = case.actuator.step(moving.carriage, told.target, closed, step, push)
    motor, shafts, touch = case.drive.step(
        moving.motor, case.plant, moving.shafts, ahead, slide, case.bounds, step
    )
    way = slide.end - slide.start
    behind = None
    if moving.asked is not None:
        was = moving.asked
        course = cubic(was.angle, asked.angle, was.speed, asked.speed, step)
        behind = course.at(touch.share) - touch.angle
    gone = shafts, touch, carriage, way, blocked, behind, case.drive.missed(motor, shafts)
    tally = moved(moving.tally, run, then, step, *gone)
    return _Moving(shafts, carriage, tally, asked if _apart(case) else None, motor)


def _run(case: Case) -> RunFacts:
    motion = case.motion
    return RunFacts(
        jnp.asarray(motion.braking_s),
        jnp.asarray(motion.turn_s),
        jnp.asarray(motion.duration_s),
        jnp.asarray(case.period),
        jnp.where(jnp.asarray(case.sense) > 0, ON_B, ON_A),
        jnp.asarray(case.bounds.closing),
    )


def _read(
    case: Case, shafts: Shafts, number: Int[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Readings of both encoders, rad."""
    noise = jnp.zeros(2)
    if case.noisy:
        noise = shocks(jax.random.key(case.seed), number)
    driven = jnp.asarray(case.bounds.ratio) * shafts.angle + shafts.offset
    return (
        case.driving_sensor.read(shafts.angle, noise[0]),
        case.driven_sensor.read(driven, noise[1]),
    )

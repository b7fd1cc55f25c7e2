"""Case of a simulation that is ready to run, and its loop over the controller periods.

The numbers of a case are arrays of JAX or NumPy. Choices, such as the kind of controller, are the
classes of its parts, and decide which program is compiled.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...base.arrays import Number, Numbers, float64
from ...kinematics.flank_table import Bounds
from ..controllers.controller import Controller, Measurement
from ..controllers.retreat import Retreat
from ..hardware.actuator import Actuator, Carriage
from ..hardware.encoder import Encoder, noise_draws
from ..hardware.observer import MotionEstimate, Observer
from ..hardware.servo import ServoDrive
from ..hardware.shaft_drive import Lead, led, next_lead
from ..motion.motion import Motion, MotionPoint
from ..plants.plant import ON_A, ON_B, Plant, Shafts
from .accumulators import Accumulators, RunFacts, add_plant_step, add_sample, empty_accumulators


class Case(eqx.Module):
    """Scenario that is prepared to run: its parts, and what is computed from them once.

    **Arguments**
    - `motion`: motion of the driving shaft. - `bounds`, `believed`: TE on flank A and flank B over
      its angle, as they are and as the controller believes them.
    - `plant`, `actuator`, `observer`, `controller`: further parts of the case.
    - `driving_encoder`, `driven_encoder`: encoders that the controller reads.
    - `lead_s`: time from a reading to the resulting position of the actuator, s.
    - `retreat`: how the actuator follows teeth that pass; see `Measurement`.
    - `period`: period of the controller, s. - `seed`: seed of the encoder noise.
    - `sense`: 1 if the run begins forwards, −1 if backwards.
    - `substeps`: number of plant steps per period.
    - `noisy`: whether the encoders have noise; without noise no random numbers are drawn.
    - `drive`: servo that lets the driving shaft follow the motion; None if it follows exactly.
    - `periods`: number of controller periods in a run; 0 to compute it from the motion.
    """

    motion: Motion
    bounds: Bounds
    believed: Bounds
    plant: Plant
    actuator: Actuator
    observer: Observer
    controller: Controller
    driving_encoder: Encoder
    driven_encoder: Encoder
    lead_s: Float[Number, ""] = eqx.field(converter=float64)
    period: Float[Number, ""] = eqx.field(converter=float64)
    sense: Float[Number, ""] = eqx.field(converter=float64)
    seed: Int[Numbers, ""]
    substeps: int = eqx.field(static=True, default=1)
    noisy: bool = eqx.field(static=True, default=False)
    drive: ServoDrive | None = None
    retreat: Retreat | None = None
    periods: int = eqx.field(static=True, default=0)


class PlantState(eqx.Module):
    """Part of the state of a run that changes in every plant step.

    - `shafts`: motion of both shafts and the flank in contact. - `carriage`: state of the actuator.
    - `accumulators`: sums, extremes and first times of the run so far.
    - `target`: present point of the motion; None if the driving shaft follows it exactly.
    - `motor`: state of the drive.
    """

    shafts: Shafts
    carriage: Carriage
    accumulators: Accumulators
    target: MotionPoint | None
    motor: Any


class State(PlantState):
    """State of a run at the start of a controller period.

    - `estimate`: motion of the driving shaft that the observer estimates.
    - `controller`: state of the controller.
    - `lead`: angle by which the driving shaft leads its motion; None if the controller sets none.
    """

    estimate: MotionEstimate
    controller: Any
    lead: Lead | None


class Sample(eqx.Module):
    """Sample of one period in a trace, in s, rad and mm.

    - `driving`, `error`: true driving angle and true transmission error φ₂ − i φ₁.
    - `shown`: transmission error computed from both encoder readings.
    - `speed`, `acceleration`: estimates of the observer for the driving shaft.
    - `lower`, `upper`: TE on flank A and flank B at the axial displacement `reached`.
    - `command`, `reached`: commanded and actual axial displacement.
    - `output`: φ₂ − i φ₁ with φ₁ of the reference, the error of the driven shaft.
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
    output: Float[Numbers, "*shape"]


def initial_state(case: Case) -> State:
    """Return the state at the start of the motion: at rest on flank A with the gap open."""
    point = case.motion.at(jnp.zeros(()))
    flanks = case.bounds.at(point.angle)
    still = jnp.zeros(())
    shafts = Shafts(
        angle=point.angle,
        speed=point.speed,
        offset=flanks.lower,
        drift=still,
        side=jnp.full((), ON_A),
        flanks=flanks,
    )
    driving, _ = _read(case, shafts, jnp.zeros((), int))
    return State(
        shafts=shafts,
        carriage=case.actuator.at_rest(),
        estimate=MotionEstimate(driving, still, still),
        controller=case.controller.start(),
        accumulators=empty_accumulators(flanks.lower, case.controller.advances),
        lead=Lead(still, still) if case.controller.advances else None,
        target=point if _can_deviate(case) else None,
        motor=None if case.drive is None else case.drive.start(point),
    )


def _can_deviate(case: Case) -> bool:
    """Return whether the driving shaft can deviate from its motion."""
    return case.controller.advances or case.drive is not None


def trace_periods(case: Case, state: State, periods: Int[Array, " n"]) -> tuple[State, Sample]:
    """Run the given periods from `state` on; return the last state and a sample of each period.

    `periods` holds consecutive numbers of controller periods, counted from 0 at the time 0.
    """

    def step(state: State, number: Int[Array, ""]) -> tuple[State, Sample]:
        return _period(case, state, number)

    return jax.lax.scan(step, state, periods)


def run_periods(case: Case, state: State, periods: Int[Array, " n"]) -> State:
    """Run the given periods from `state` on and return the last state; see `trace_periods`."""

    def step(state: State, number: Int[Array, ""]) -> tuple[State, None]:
        return _period(case, state, number)[0], None

    return jax.lax.scan(step, state, periods)[0]


def _period(case: Case, state: State, number: Int[Array, ""]) -> tuple[State, Sample]:
    run = _run(case)
    time = number * jnp.asarray(case.period)
    shafts, carriage = state.shafts, state.carriage
    driving, driven = _read(case, shafts, number)
    estimate = case.observer.step(state.estimate, driving, jnp.asarray(case.period))
    reference = shafts if state.target is None else state.target
    motions = estimate.speed, estimate.acceleration, reference.angle, reference.speed
    known = case.believed, case.lead_s, case.retreat
    measurement = Measurement(time, driving, driven, *motions, *known)
    controller, output = case.controller.step(state.controller, measurement)
    output = case.controller.as_command(output)
    command, period = jnp.asarray(output.shift), jnp.asarray(case.period)
    lead = None
    if state.lead is not None:
        lead = next_lead(state.lead, jnp.asarray(output.advance), period)
    carriage, position = case.actuator.commanded(carriage, command)
    # The offset is some 1e-5 of both angles; as a sum of small terms it keeps its digits.
    ratio = jnp.asarray(case.bounds.ratio)
    shown = driven - (ratio * shafts.angle + shafts.offset) - ratio * (driving - shafts.angle)
    shown = shafts.offset + shown
    flanks = shafts.flanks if state.target is None else case.bounds.at(reference.angle)
    first = jnp.where(run.other_flank > 0, flanks.lower, flanks.upper)
    reached = shafts.offset + case.bounds.ratio * (shafts.angle - reference.angle)
    accumulators = add_sample(
        state.accumulators,
        run=run,
        time=time,
        error=shown,
        angle=shafts.angle,
        command=command,
        target=position,
        open_gap=shafts.flanks.upper - shafts.flanks.lower,
        side=shafts.side,
        carriage=carriage,
        output=reached,
        lost=reached - first,
        speed=reference.speed,
    )
    sample = Sample(
        time=time,
        driving=shafts.angle,
        error=shafts.offset,
        shown=shown,
        speed=estimate.speed,
        acceleration=estimate.acceleration,
        lower=shafts.flanks.lower + run.closing[0] * carriage.reached,
        upper=shafts.flanks.upper - run.closing[1] * carriage.reached,
        command=command,
        reached=carriage.reached,
        output=reached,
    )
    plant = PlantState(shafts, carriage, accumulators, state.target, state.motor)
    inputs = _PeriodInputs(position, time, state.lead, lead)
    if case.substeps == 1:
        plant = _plant_step(case, run, inputs, plant, jnp.ones(()))
    else:

        def step(plant: PlantState, number: Float[Array, ""]) -> tuple[PlantState, None]:
            return _plant_step(case, run, inputs, plant, number), None

        plant, _ = jax.lax.scan(step, plant, jnp.arange(1.0, case.substeps + 1))
    return State(**vars(plant), estimate=estimate, controller=controller, lead=lead), sample


class _PeriodInputs(eqx.Module):
    """Values that are constant in all plant steps of one controller period.

    - `target`: position that the actuator approaches, mm. - `time`: start of the period, s.
    - `before`, `after`: angle by which the driving shaft leads its motion at the start and at the
      end of the period, or None if the controller sets no lead.
    """

    target: Float[Array, ""]
    time: Float[Array, ""]
    before: Lead | None
    after: Lead | None


def _plant_step(
    case: Case,
    run: RunFacts,
    inputs: _PeriodInputs,
    plant: PlantState,
    number: Float[Array, ""],
) -> PlantState:
    """Return the state after the plant step with this number, counted from 1 in each period."""
    step = jnp.asarray(case.period) / case.substeps
    end = inputs.time + number * step
    target = point = case.motion.at(end)
    if inputs.before is not None and inputs.after is not None:
        share = number / case.substeps
        target = led(point, inputs.before, inputs.after, share, jnp.asarray(case.period))
    shafts = plant.shafts
    # A servo is expected to turn the driving shaft on at constant speed.
    expected = target.angle if case.drive is None else shafts.angle + step * shafts.speed
    closed = case.bounds.closed_at(case.bounds.gap(expected))
    push, thrust = None, case.actuator.thrust
    if thrust is not None:
        push = thrust.at(shafts.side, shafts.speed, target.acceleration)
    carriage, slide, blocked = case.actuator.step(plant.carriage, inputs.target, closed, step, push)
    motor, taken = plant.motor, (slide, case.bounds, step)
    if case.drive is None:
        tracking, (shafts, contact) = None, case.plant.step(shafts, target, *taken)
    else:
        motor, shafts, contact = case.drive.step(motor, case.plant, shafts, target, *taken)
        tracking = case.drive.tracking(motor, shafts)
    travel = slide.end - slide.start
    changes = contact, carriage, travel, blocked, tracking
    turned = shafts.angle - plant.shafts.angle
    apart = jnp.zeros(())
    if case.controller.advances:
        ends = shafts.flanks.upper - shafts.offset, shafts.offset - shafts.flanks.lower
        brakes = point.speed * point.acceleration < 0
        apart = jnp.where(brakes, 0.0, jnp.where(run.other_flank > 0, *ends))
    accumulators = add_plant_step(
        plant.accumulators, run, end, step, *changes, turned=turned, side=shafts.side, apart=apart
    )
    kept = point if _can_deviate(case) else None
    return PlantState(shafts, carriage, accumulators, kept, motor)


def _run(case: Case) -> RunFacts:
    motion = case.motion
    return RunFacts(
        braking_s=jnp.asarray(motion.braking_s),
        turn_s=jnp.asarray(motion.turn_s),
        duration_s=jnp.asarray(motion.duration_s),
        period=jnp.asarray(case.period),
        other_flank=jnp.where(jnp.asarray(case.sense) > 0, ON_B, ON_A),
        closing=jnp.asarray(case.bounds.closing),
    )


def _read(
    case: Case, shafts: Shafts, number: Int[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return the readings of the driving and the driven encoder in period `number`, rad."""
    noise = jnp.zeros(2)
    if case.noisy:
        noise = noise_draws(jax.random.key(case.seed), number)
    driven = jnp.asarray(case.bounds.ratio) * shafts.angle + shafts.offset
    return (
        case.driving_encoder.read(shafts.angle, noise[0]),
        case.driven_encoder.read(driven, noise[1]),
    )

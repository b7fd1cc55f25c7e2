"""Case of a simulation that is ready to run, its loop over the controller periods, and its metrics.

The numbers of a case are arrays of JAX or NumPy. Choices, such as the kind of controller, are the
classes of its parts, and decide which program is compiled.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...base.arrays import Number, Numbers, float64
from ...base.units import DEG
from ...kinematics.flank_table import Bounds
from ..controllers.controller import Controller, LostController, Measurement
from ..controllers.retreat import Retreat
from ..hardware.actuator import Actuator, Carriage
from ..hardware.encoder import Encoder, Observer, noise_draws
from ..hardware.servo import Motor, ServoDrive
from ..hermite import cubic
from ..motion.motion import Motion, MotionPoint
from ..plants.plant import ON_A, ON_B, ContactEvent, Plant, Shafts

TIMES = 4097
"""Times of a motion at which its travel is read: a chosen value."""

_CLOSED = 1e-12
"""Gap, rad, up to which the teeth touch on both flanks: a chosen value."""


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

    @property
    def other_flank(self) -> Float[Array, ""]:
        """Flank that carries after the turn, `ON_A` or `ON_B`."""
        return jnp.where(jnp.asarray(self.sense) > 0, ON_B, ON_A)

    @property
    def deviates(self) -> bool:
        """Whether the driving shaft can deviate from its motion."""
        return self.controller.advances or self.drive is not None


Tally = Float[Numbers, "*shape"]
Truth = Bool[Numbers, "*shape"]


def _begins(value: float | bool) -> Any:
    """Return the field of an accumulator that has this value before the first sample."""
    return eqx.field(default_factory=lambda: jnp.full((), value, type(value)))


class Accumulators(eqx.Module):
    """Running metrics in rad, mm and s; NaN for events that have not happened.

    The crossing is the first contact with the other flank after the start of braking.

    - `samples`, `total`, `highest`, `lowest`: number, sum and extremes of the samples of the TE
      from both encoder readings, minus its value `first` in the first sample.
    - `before`, `after`: last such TE on the old flank, and first such TE after the crossing.
    - `gap`, `crossing`: backlash and driving angle at the crossing.
    - `crossing_s`: time of the first sample after the crossing.
    - `detection`, `detection_s`: driving angle and time of the first command to close between
      braking and the turn. - `false_closings`: number of commands to close before braking.
    - `residual_gap`, `shortfall`: backlash at the turn, and distance that the actuator still lacks
      to its target at the turn.
    - `opened`: whether a command to open the gap came after the turn. It ends the reversal; a stop
      at the end of the run does not belong to the reversal.
    - `retracted`: whether the controller closed the gap again after `opened`.
    - `largest_command`: largest command until `opened`.
    - `interference`: largest distance by which the closed gap held the actuator back until
      `opened`.
    - `travel`, `farthest`: path length and farthest position of the actuator until `retracted`.
    - `following_error`: largest tracking error of a servo motor, rad. - `limited_s`: time of the
      motor at its torque limit. - `forced`: whether the teeth exceeded the actuator's force limit.
    - `carrier`: flank that was loaded last, `ON_A` or `ON_B`. - `largest_jump`, `early_jump`:
      largest gap that the teeth crossed to the other flank, in the run and before the turn.
    - `wrong_travel`: travel of the driving shaft before the turn since the flank carries, rebounds
      included, that carries after it.
    - `output_start`, `output_error`, `output_squares`: φ₂ − i φ₁ of the reference, minus its value
      `output_start` in the first sample: the largest after the turn, and the sum of its squares.
    - `lost`: ∫ |φ₂ − i φ₁ − TE| dφ₁ after the turn, with φ₁ of the reference and TE
      of the flank that carries first.
    - `beyond`, `rebound`: None unless the controller moves the motor. ∫ of the same difference, not
      its amount, positive beyond that flank; and the largest distance from the other flank since it
      was met, while the reference does not brake.
    - `commanded`: last command, mm. - `blocked`, `blocked_s`: whether and since when the drive is
      blocked by contact on both flanks.
    """

    samples: Tally = _begins(0.0)
    total: Tally = _begins(0.0)
    highest: Tally = _begins(jnp.nan)
    lowest: Tally = _begins(jnp.nan)
    first: Tally = _begins(jnp.nan)
    before: Tally = _begins(jnp.nan)
    after: Tally = _begins(jnp.nan)
    gap: Tally = _begins(jnp.nan)
    crossing: Tally = _begins(jnp.nan)
    crossing_s: Tally = _begins(jnp.nan)
    detection: Tally = _begins(jnp.nan)
    detection_s: Tally = _begins(jnp.nan)
    false_closings: Tally = _begins(0.0)
    residual_gap: Tally = _begins(jnp.nan)
    shortfall: Tally = _begins(jnp.nan)
    opened: Truth = _begins(False)
    retracted: Truth = _begins(False)
    largest_command: Tally = _begins(0.0)
    interference: Tally = _begins(0.0)
    travel: Tally = _begins(0.0)
    farthest: Tally = _begins(0.0)
    following_error: Tally = _begins(0.0)
    limited_s: Tally = _begins(0.0)
    forced: Truth = _begins(False)
    carrier: Tally = _begins(0.0)
    largest_jump: Tally = _begins(0.0)
    early_jump: Tally = _begins(0.0)
    wrong_travel: Tally = _begins(0.0)
    output_start: Tally = eqx.field(kw_only=True)
    output_error: Tally = _begins(0.0)
    output_squares: Tally = _begins(0.0)
    lost: Tally = _begins(0.0)
    commanded: Tally = _begins(0.0)
    blocked: Truth = _begins(False)
    blocked_s: Tally = _begins(jnp.nan)
    beyond: Tally | None = None
    rebound: Tally | None = None


class Sample(eqx.Module):
    """Sample of one period in a trace, in s, rad and mm.

    - `driving`, `error`: true driving angle and true transmission error φ₂ − i φ₁.
    - `shown`: transmission error computed from both encoder readings.
    - `speed`, `acceleration`: estimates of the observer for the driving shaft.
    - `lower`, `upper`: TE on flank A and flank B at the axial displacement `reached`.
    - `command`, `reached`: commanded and actual axial displacement.
    - `output`: φ₂ − i φ₁ with φ₁ of the reference, the error of the driven shaft.
    """

    time: Tally
    driving: Tally
    error: Tally
    shown: Tally
    speed: Tally
    acceleration: Tally
    lower: Tally
    upper: Tally
    command: Tally
    reached: Tally
    output: Tally


class Lead(eqx.Module):
    """Angle by which the driving shaft leads its prescribed motion, rad, and its rate, rad/s."""

    angle: Float[Array, ""]
    speed: Float[Array, ""]


class State(eqx.Module):
    """State of a run at the start of a controller period.

    - `shafts`: motion of both shafts and the flank in contact. - `carriage`: state of the actuator.
    - `estimate`: motion of the driving shaft that the observer estimates.
    - `controller`: state of the controller.
    - `accumulators`: sums, extremes and first times of the run so far.
    - `lead`: angle by which the driving shaft leads its motion; None if the controller sets none.
    - `target`: present point of the motion; None if the driving shaft follows it exactly.
    - `motor`: state of the drive.
    """

    shafts: Shafts
    carriage: Carriage
    estimate: MotionPoint
    controller: Any
    accumulators: Accumulators
    lead: Lead | None
    target: MotionPoint | None
    motor: Motor | None


def initial_state(case: Case) -> State:
    """Return the state at the start of the motion: at rest on flank A with the gap open."""
    point, still = case.motion.at(jnp.zeros(())), jnp.zeros(())
    flanks = case.bounds.at(point.angle)
    on_a = jnp.full((), ON_A)
    shafts = Shafts(point.angle, point.speed, flanks.lower, still, on_a, flanks)
    driving, _ = _read(case, shafts, jnp.zeros((), int))
    advances = case.controller.advances
    signed = {"beyond": still, "rebound": still} if advances else {}
    return State(
        shafts=shafts,
        carriage=case.actuator.at_rest(),
        estimate=MotionPoint(driving, still, still),
        controller=case.controller.start(),
        accumulators=Accumulators(output_start=flanks.lower, **signed),
        lead=Lead(still, still) if advances else None,
        target=point if case.deviates else None,
        motor=None if case.drive is None else case.drive.start(point),
    )


def run_periods(
    case: Case, state: State, periods: Int[Array, " n"], trace: bool = False
) -> tuple[State, Sample | None]:
    """Run the given periods from `state` on; return the last state and, as `trace`, all samples.

    `periods` holds consecutive numbers of controller periods, counted from 0 at the time 0.
    """

    def period(state: State, number: Int[Array, ""]) -> tuple[State, Sample | None]:
        state, sample = _period(case, state, number)
        return state, sample if trace else None

    return jax.lax.scan(period, state, periods)


def _period(case: Case, state: State, number: Int[Array, ""]) -> tuple[State, Sample]:
    period, bounds = jnp.asarray(case.period), case.bounds
    time, shafts, closing = number * period, state.shafts, jnp.asarray(bounds.closing)
    driving, driven = _read(case, shafts, number)
    estimate = case.observer.step(state.estimate, driving, period)
    reference = shafts if state.target is None else state.target
    motions = estimate.speed, estimate.acceleration, reference.angle, reference.speed
    known = case.believed, case.lead_s, case.retreat
    answer = case.controller.step(
        state.controller, Measurement(time, driving, driven, *motions, *known)
    )
    controller, output = case.controller.as_answer(answer)
    command, lead = jnp.asarray(output.shift), None
    if state.lead is not None:  # which the shaft reaches at the end of this period
        advance = jnp.asarray(output.advance)
        lead = Lead(advance, (advance - state.lead.angle) / period)
    carriage, position = case.actuator.commanded(state.carriage, command)
    # The offset is some 1e-5 of both angles; as a sum of small terms it keeps its digits.
    ratio = jnp.asarray(bounds.ratio)
    shown = driven - (ratio * shafts.angle + shafts.offset) - ratio * (driving - shafts.angle)
    sample = Sample(
        time=time,
        driving=shafts.angle,
        error=shafts.offset,
        shown=shafts.offset + shown,
        speed=estimate.speed,
        acceleration=estimate.acceleration,
        lower=shafts.flanks.lower + closing[0] * carriage.reached,
        upper=shafts.flanks.upper - closing[1] * carriage.reached,
        command=command,
        reached=carriage.reached,
        output=shafts.offset + bounds.ratio * (shafts.angle - reference.angle),
    )
    accumulators = _with_sample(case, state, sample, reference, position)
    state = replace(state, carriage=carriage, accumulators=accumulators)
    if case.substeps == 1:
        state = _plant_step(case, state, jnp.ones(()), time, position, lead)
    else:
        state, _ = jax.lax.scan(
            lambda state, number: (_plant_step(case, state, number, time, position, lead), None),
            state,
            jnp.arange(1.0, case.substeps + 1),
        )
    return replace(state, estimate=estimate, controller=controller, lead=lead), sample


def _with_sample(
    case: Case, state: State, sample: Sample, reference: Any, position: Float[Array, ""]
) -> Accumulators:
    """Return the accumulators after the sample of one period.

    `reference`: point of the motion. `position`: what the actuator approaches (delayed command).
    """
    old, motion, shafts, carriage = state.accumulators, case.motion, state.shafts, state.carriage
    time, command, period = sample.time, sample.command, jnp.asarray(case.period)
    closing, flank = jnp.asarray(case.bounds.closing), case.other_flank
    counts = (time <= motion.duration_s) & ~old.blocked
    first = jnp.where(old.samples == 0, sample.shown, old.first)
    error = sample.shown - first
    crossed = ~jnp.isnan(old.gap)
    just_crossed = counts & crossed & jnp.isnan(old.after)
    closes = counts & (command > 0)
    starts = closes & (old.commanded == 0)
    braking = time >= motion.braking_s
    detects = closes & braking & (time < motion.turn_s) & jnp.isnan(old.detection)
    # The residual gap is taken in the period nearest to the turn, where the shaft moves least.
    turned = counts & (time >= motion.turn_s - 0.5 * period) & (time < motion.duration_s)
    at_turn = turned & jnp.isnan(old.residual_gap)
    gap = shafts.flanks.upper - shafts.flanks.lower - (closing[0] + closing[1]) * carriage.reached
    flanks = shafts.flanks if state.target is None else case.bounds.at(reference.angle)
    lost = sample.output - jnp.where(flank > 0, flanks.lower, flanks.upper)
    output, back = jnp.abs(sample.output - old.output_start), counts & (time > motion.turn_s)
    lost = jnp.where(back, period * jnp.abs(reference.speed), 0.0) * lost
    largest = jnp.where(counts & ~old.opened, command, 0.0)
    return replace(
        old,
        output_error=jnp.where(back, jnp.maximum(old.output_error, output), old.output_error),
        output_squares=old.output_squares + jnp.where(counts, output**2, 0.0),
        lost=old.lost + jnp.abs(lost),
        beyond=None if old.beyond is None else old.beyond - flank * lost,
        samples=old.samples + counts,
        total=old.total + jnp.where(counts, error, 0.0),
        highest=jnp.where(counts, jnp.fmax(old.highest, error), old.highest),
        lowest=jnp.where(counts, jnp.fmin(old.lowest, error), old.lowest),
        first=first,
        before=jnp.where(counts & ~crossed & (shafts.side == -flank), error, old.before),
        after=jnp.where(just_crossed, error, old.after),
        crossing_s=jnp.where(just_crossed, time, old.crossing_s),
        detection=jnp.where(detects, shafts.angle, old.detection),
        detection_s=jnp.where(detects, time, old.detection_s),
        false_closings=old.false_closings + (starts & ~braking),
        residual_gap=jnp.where(at_turn, gap, old.residual_gap),
        shortfall=jnp.where(at_turn, position - carriage.unobstructed, old.shortfall),
        retracted=old.retracted | (starts & old.opened),
        opened=old.opened | (counts & (time > motion.turn_s) & (command == 0)),
        largest_command=jnp.maximum(old.largest_command, largest),
        commanded=jnp.where(counts, command, old.commanded),
    )


def _plant_step(
    case: Case,
    state: State,
    number: Float[Array, ""],
    time: Float[Array, ""],
    position: Float[Array, ""],
    lead: Lead | None,
) -> State:
    """Return the state after the plant step with this number, counted from 1 in each period.

    `time`: start of the period, s. `position`: what the actuator approaches, mm. `lead`: that of
    the driving shaft at the end of the period.
    """
    period, bounds, shafts = jnp.asarray(case.period), case.bounds, state.shafts
    step = period / case.substeps
    end = time + number * step
    target = point = case.motion.at(end)
    if state.lead is not None and lead is not None:
        # The lead is a cubic from the start to the end of the period.
        way = cubic(state.lead.angle, lead.angle, state.lead.speed, lead.speed, period)
        share, rate = number / case.substeps, 1.0 / period
        target = MotionPoint(
            point.angle + way.at(share),
            point.speed + way.slope(share) * rate,
            point.acceleration + way.bend(share) * rate**2,
        )
    # A servo is expected to turn the driving shaft on at constant speed.
    expected = target.angle if case.drive is None else shafts.angle + step * shafts.speed
    closed, push, thrust = bounds.closed_at(bounds.gap(expected)), None, case.actuator.thrust
    if thrust is not None:
        push = thrust.at(shafts.side, shafts.speed, target.acceleration)
    carriage, slide, blocked = case.actuator.step(state.carriage, position, closed, step, push)
    motor, taken = state.motor, (slide, bounds, step)
    if case.drive is None or motor is None:
        moved, contact = case.plant.step(shafts, target, *taken)
    else:
        motor, moved, contact = case.drive.step(motor, case.plant, shafts, target, *taken)
    kept = point if case.deviates else None
    after = replace(state, shafts=moved, carriage=carriage, target=kept, motor=motor)
    return replace(after, accumulators=_with_step(case, state, after, contact, end, blocked))


def _with_step(
    case: Case,
    before: State,
    after: State,
    contact: ContactEvent,
    time: Float[Array, ""],
    blocked: Bool[Array, ""],
) -> Accumulators:
    """Return the accumulators after a plant step that ends at `time`, s.

    `before` and `after`: states at its ends. `contact`: first new contact in it. `blocked`: whether
    the drive blocks.
    """
    old, motion, flank = before.accumulators, case.motion, case.other_flank
    shafts, carriage, motor, point = after.shafts, after.carriage, after.motor, after.target
    counts = (time <= motion.duration_s) & ~old.blocked
    crosses = counts & (contact.side == flank) & (time > motion.braking_s) & jnp.isnan(old.gap)
    stops = counts & blocked
    error, limited_s, rebound = old.following_error, old.limited_s, old.rebound
    if motor is not None:
        off = jnp.abs(motor.angle - shafts.angle)
        error = jnp.where(counts, jnp.maximum(error, off), error)
        step = jnp.asarray(case.period) / case.substeps
        limited_s = limited_s + jnp.where(counts & motor.limited, step, 0.0)
    travels, early = counts & ~old.retracted, counts & (time < motion.turn_s)
    if rebound is not None and point is not None:  # while the reference does not brake
        ends = shafts.flanks.upper - shafts.offset, shafts.offset - shafts.flanks.lower
        apart = jnp.where(point.speed * point.acceleration < 0, 0.0, jnp.where(flank > 0, *ends))
        met_before = counts & ~jnp.isnan(old.gap)
        rebound = jnp.where(met_before, jnp.maximum(rebound, apart), rebound)
    carrier = jnp.where(old.carrier == 0, -flank, old.carrier)  # before any contact
    # In a closed gap rounding decides which flank is met; the state of the plant then tells it.
    met = jnp.where(contact.gap > _CLOSED, contact.side, 0.0)
    jump = jnp.where(counts & (met == -carrier), contact.gap, 0.0)
    now = jnp.where(met != 0, met, shafts.side)
    carrier = jnp.where(counts & (now != 0), now, carrier)
    obstructed = carriage.unobstructed - carriage.reached
    turned = jnp.abs(shafts.angle - before.shafts.angle)
    moved = jnp.abs(carriage.reached - before.carriage.reached)
    forced = carriage.stalled
    return replace(
        old,
        carrier=carrier,
        largest_jump=jnp.maximum(old.largest_jump, jump),
        early_jump=jnp.where(early, jnp.maximum(old.early_jump, jump), old.early_jump),
        wrong_travel=old.wrong_travel + jnp.where(early & (carrier == flank), turned, 0.0),
        gap=jnp.where(crosses, contact.gap, old.gap),
        crossing=jnp.where(crosses, contact.angle, old.crossing),
        interference=jnp.where(
            counts & ~old.opened, jnp.maximum(old.interference, obstructed), old.interference
        ),
        travel=old.travel + jnp.where(travels, moved, 0.0),
        farthest=jnp.where(travels, jnp.maximum(old.farthest, carriage.reached), old.farthest),
        following_error=error,
        limited_s=limited_s,
        forced=old.forced if forced is None else old.forced | (travels & forced),
        blocked=old.blocked | stops,
        blocked_s=jnp.where(stops, time, old.blocked_s),
        rebound=rebound,
    )


def _read(
    case: Case, shafts: Shafts, number: Int[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return the readings of the driving and the driven encoder in period `number`, rad."""
    noise = noise_draws(jax.random.key(case.seed), number) if case.noisy else jnp.zeros(2)
    driven = jnp.asarray(case.bounds.ratio) * shafts.angle + shafts.offset
    sensors = case.driving_encoder.read, case.driven_encoder.read
    return sensors[0](shafts.angle, noise[0]), sensors[1](driven, noise[1])


Metrics = tuple[dict[str, Tally], Int[Numbers, "*shape"]]
"""Name → value, in the unit at the end of the name, and the outcome, an index in `OUTCOMES`."""

Outcome = Literal["ok", "unlocated", "bound", "missed", "stroke", "force", "slow"]
"""`unlocated`: the controller could not locate the turn of the hunting period and did not start.
`bound`: both flanks were in contact and blocked the drive. `missed`: the controller did not detect
the braking. `stroke`: a command exceeded the stroke of the actuator. `force`: the force of the
teeth exceeded the force limit of the actuator. `slow`: the actuator had not reached its target when
the motion turned."""

OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)
"""All outcomes; the code of an outcome is its index here."""

_METRICS: dict[str, Callable[[Accumulators, Case, Any], Any]] = {
    "te_mean_deg": lambda t, case, back: t.total / t.samples / DEG,
    "te_max_deg": lambda t, case, back: t.highest / DEG,
    "te_min_deg": lambda t, case, back: t.lowest / DEG,
    "jump_deg": lambda t, case, back: case.sense * t.gap / DEG,
    "jump_paper_deg": lambda t, case, back: (t.before - t.after) / DEG,
    "axial_step_deg": lambda t, case, back: (
        t.farthest * jnp.where(jnp.asarray(case.sense) > 0, *jnp.asarray(case.bounds.closing)) / DEG
    ),
    "detection_deg": lambda t, case, back: t.detection / DEG,
    "detection_delay_s": lambda t, case, back: t.detection_s - case.motion.braking_s,
    "residual_gap_deg": lambda t, case, back: t.residual_gap / DEG,
    "interference_mm": lambda t, case, back: t.interference,
    "actuator_travel_mm": lambda t, case, back: t.travel,
    "lost_motion_deg": lambda t, case, back: t.lost / back / DEG,
    "output_error_deg": lambda t, case, back: (
        jnp.where(jnp.isnan(back), jnp.nan, t.output_error) / DEG
    ),
    "output_error_rms_deg": lambda t, case, back: jnp.sqrt(t.output_squares / t.samples) / DEG,
    "largest_jump_deg": lambda t, case, back: t.largest_jump / DEG,
    "early_jump_deg": lambda t, case, back: t.early_jump / DEG,
    "wrong_flank_deg": lambda t, case, back: t.wrong_travel / DEG,
    "over_compensation_deg": lambda t, case, back: (
        jnp.nan if t.beyond is None else t.beyond / back / DEG
    ),
    "thrown_back_deg": lambda t, case, back: jnp.nan if t.rebound is None else t.rebound / DEG,
}
"""Metrics of the accumulators, the case, and the travel on the way back, rad; see `metrics_of`."""

METRICS = tuple(_METRICS)

NEAR_MM, NEAR_DEG = 1e-4, 1e-6
"""Axial displacements (mm) and backlash (deg) that count as zero; chosen tolerances."""


@eqx.filter_jit
def metrics_of(case: Case, accumulators: Accumulators) -> Metrics:
    """Return the metrics of a run by name, NaN for events that did not happen, and its outcome.

    The outcome is an index in `OUTCOMES`: if several other than ok apply, the first counts. The
    crossing is the first contact with the other flank.

    - `te_mean_deg`, `te_max_deg`, `te_min_deg`: transmission error from both encoder readings,
      relative to the first sample.
    - `jump_deg`: TE of the other flank minus TE of the old flank at the driving angle of the
      crossing.
    - `jump_paper_deg`: last sample on the old flank minus the first one after the crossing, as the
      paper reads it from its curves.
    - `axial_step_deg`: change of the TE on the first carrying flank by the axial displacement.
    - `detection_deg`, `detection_delay_s`: driving angle of the first command to close, and its
      delay after the start of braking. - `residual_gap_deg`: backlash when the motion turns.
    - `interference_mm`: largest distance by which the closed gap held the actuator back.
    - `actuator_travel_mm`: path length of the actuator, in both directions together.
    - `lost_motion_deg`: distance of the driven shaft, on the way back, from where the flank that
      carried first would hold it: mean over the travel. Too much compensation counts as too little.
    - `output_error_deg`, `output_error_rms_deg`: deviation of the driven shaft from i φ₁ of the
      reference, relative to the first sample: the largest after the turn, and the rms of the run.
    - `largest_jump_deg`, `early_jump_deg`: largest gap that the teeth crossed to the other flank,
      anywhere in the run and before the turn.
    - `wrong_flank_deg`: travel of the driving shaft before the turn with the flank in contact that
      carries after it, rebounds from this flank included.
    - `over_compensation_deg`: lost motion with its sign, positive where the motor makes up for more
      than the gap. - `thrown_back_deg`: largest distance of the driven shaft from the other flank
      after they met, while the reference does not brake. Both exist only if the controller moves
      the motor.

    Interference, travel and axial step are those of the reversal, which ends with the command to
    open the gap after the turn. If the motion never turns back, they are those of the whole run.
    """
    t, motion = accumulators, case.motion
    turn, end = jnp.asarray(motion.turn_s), jnp.asarray(motion.duration_s)
    turns = turn < end
    angle = motion.at(turn + (end - turn) * jnp.linspace(0.0, 1.0, TIMES)).angle
    way_back = jnp.where(turns, jnp.sum(jnp.abs(jnp.diff(angle))), jnp.nan)
    values = {name: value(t, case, way_back) for name, value in _METRICS.items()}
    holds = (
        isinstance(case.controller, LostController),
        t.blocked,
        case.controller.closes & turns & jnp.isnan(t.detection),
        t.largest_command > case.actuator.stroke_mm + NEAR_MM,
        t.forced,
        t.shortfall > NEAR_MM,
    )
    codes = [jnp.full((), code) for code in range(1, len(OUTCOMES))]
    outcome = jnp.select([jnp.asarray(one) for one in holds], codes, 0)
    return jax.tree.map(jnp.asarray, values), outcome


def overdone(metrics: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return whether the motor makes up for too much, and whether it throws the driven shaft back.

    Too much is over 1 % of the gap; thrown back is a shaft that flies over half of it.
    """
    gap = metrics["largest_jump_deg"]
    return (
        metrics["over_compensation_deg"] > 0.01 * gap + NEAR_DEG,
        metrics["thrown_back_deg"] > 0.5 * gap + NEAR_DEG,
    )

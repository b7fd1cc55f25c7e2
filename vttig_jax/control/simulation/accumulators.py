"""Accumulators of a run: sums, extremes and first times, updated in every period and plant step."""

from dataclasses import fields, replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...base.arrays import Numbers
from ..hardware.actuator import Carriage
from ..hardware.shaft_drive import Tracking
from ..plants.plant import ContactEvent

_CLOSED = 1e-12
"""Gap, rad, up to which the teeth touch on both flanks: a chosen value."""


class RunFacts(eqx.Module):
    """Constants of a run that its accumulators need.

    - `braking_s`, `turn_s`, `duration_s`: times of the motion, s. - `period`: controller period, s.
    - `other_flank`: flank that carries after the turn, `ON_A` or `ON_B`.
    - `closing`: change of the TE per axial displacement on flanks A and B, rad/mm, shape (2,).
    """

    braking_s: Float[Array, ""]
    turn_s: Float[Array, ""]
    duration_s: Float[Array, ""]
    period: Float[Array, ""]
    other_flank: Float[Array, ""]
    closing: Float[Array, "2"]


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

    samples: Float[Numbers, "*shape"]
    total: Float[Numbers, "*shape"]
    highest: Float[Numbers, "*shape"]
    lowest: Float[Numbers, "*shape"]
    first: Float[Numbers, "*shape"]
    before: Float[Numbers, "*shape"]
    after: Float[Numbers, "*shape"]
    gap: Float[Numbers, "*shape"]
    crossing: Float[Numbers, "*shape"]
    crossing_s: Float[Numbers, "*shape"]
    detection: Float[Numbers, "*shape"]
    detection_s: Float[Numbers, "*shape"]
    false_closings: Float[Numbers, "*shape"]
    residual_gap: Float[Numbers, "*shape"]
    shortfall: Float[Numbers, "*shape"]
    opened: Bool[Numbers, "*shape"]
    retracted: Bool[Numbers, "*shape"]
    largest_command: Float[Numbers, "*shape"]
    interference: Float[Numbers, "*shape"]
    travel: Float[Numbers, "*shape"]
    farthest: Float[Numbers, "*shape"]
    following_error: Float[Numbers, "*shape"]
    limited_s: Float[Numbers, "*shape"]
    forced: Bool[Numbers, "*shape"]
    carrier: Float[Numbers, "*shape"]
    largest_jump: Float[Numbers, "*shape"]
    early_jump: Float[Numbers, "*shape"]
    wrong_travel: Float[Numbers, "*shape"]
    output_start: Float[Numbers, "*shape"]
    output_error: Float[Numbers, "*shape"]
    output_squares: Float[Numbers, "*shape"]
    lost: Float[Numbers, "*shape"]
    commanded: Float[Numbers, "*shape"]
    blocked: Bool[Numbers, "*shape"]
    blocked_s: Float[Numbers, "*shape"]
    beyond: Float[Numbers, "*shape"] | None = None
    rebound: Float[Numbers, "*shape"] | None = None


def empty_accumulators(output: Float[Array, ""], advances: bool = False) -> Accumulators:
    """Return the accumulators before the first sample, in which φ₂ − i φ₁ is `output`, rad.

    `advances`: whether the controller moves the motor.
    """
    zero, never = jnp.zeros(()), jnp.full((), jnp.nan, float)
    zeros = (
        *("samples", "total", "false_closings", "largest_command", "interference", "travel"),
        *("farthest", "commanded", "following_error", "limited_s", "carrier"),
        *("largest_jump", "early_jump", "wrong_travel", "output_error", "output_squares"),
        "lost",
    )
    values: dict[str, Any] = {field.name: never for field in fields(Accumulators)} | dict.fromkeys(
        zeros, zero
    )
    values |= dict.fromkeys(("opened", "retracted", "forced", "blocked"), jnp.zeros((), bool))
    values |= dict.fromkeys(("beyond", "rebound"), zero if advances else None)
    return Accumulators(**values | {"output_start": output})


def add_sample(
    old: Accumulators,
    run: RunFacts,
    time: Float[Array, ""],
    error: Float[Array, ""],
    angle: Float[Array, ""],
    command: Float[Array, ""],
    target: Float[Array, ""],
    open_gap: Float[Array, ""],
    side: Float[Array, ""],
    carriage: Carriage,
    output: Float[Array, ""],
    lost: Float[Array, ""],
    speed: Float[Array, ""],
) -> Accumulators:
    """Return the accumulators after the sample of one period at `time` (s); units rad and mm.

    `error`: TE from both encoder readings. `angle`: true driving angle. `command`: displacement
    that the controller commands. `target`: position that the actuator approaches (delayed command).
    `open_gap`: backlash for a displacement of zero. `side`: loaded flank. `output`: φ₂ − i φ₁ with
    φ₁ of the reference. `lost`: the same minus the TE of the flank that carries first, at this φ₁.
    `speed`: speed of the reference, rad/s.
    """
    counts = (time <= run.duration_s) & ~old.blocked
    first = jnp.where(old.samples == 0, error, old.first)
    error = error - first
    crossed = ~jnp.isnan(old.gap)
    just_crossed = counts & crossed & jnp.isnan(old.after)
    closes = counts & (command > 0)
    starts = closes & (old.commanded == 0)
    braking = time >= run.braking_s
    detects = closes & braking & (time < run.turn_s) & jnp.isnan(old.detection)
    # The residual gap is taken in the period nearest to the turn, where the shaft moves least.
    turned = counts & (time >= run.turn_s - 0.5 * run.period) & (time < run.duration_s)
    at_turn = turned & jnp.isnan(old.residual_gap)
    gap = open_gap - (run.closing[0] + run.closing[1]) * carriage.reached
    in_reversal = counts & ~old.opened
    output, back = jnp.abs(output - old.output_start), counts & (time > run.turn_s)
    lost, beyond = jnp.where(back, run.period * jnp.abs(speed), 0.0) * lost, old.beyond
    if beyond is not None:
        beyond = beyond - run.other_flank * lost
    return replace(
        old,
        output_error=jnp.where(back, jnp.maximum(old.output_error, output), old.output_error),
        output_squares=old.output_squares + jnp.where(counts, output**2, 0.0),
        lost=old.lost + jnp.abs(lost),
        beyond=beyond,
        samples=old.samples + counts,
        total=old.total + jnp.where(counts, error, 0.0),
        highest=jnp.where(counts, jnp.fmax(old.highest, error), old.highest),
        lowest=jnp.where(counts, jnp.fmin(old.lowest, error), old.lowest),
        first=first,
        before=jnp.where(counts & ~crossed & (side == -run.other_flank), error, old.before),
        after=jnp.where(just_crossed, error, old.after),
        crossing_s=jnp.where(just_crossed, time, old.crossing_s),
        detection=jnp.where(detects, angle, old.detection),
        detection_s=jnp.where(detects, time, old.detection_s),
        false_closings=old.false_closings + (starts & ~braking),
        residual_gap=jnp.where(at_turn, gap, old.residual_gap),
        shortfall=jnp.where(at_turn, target - carriage.unobstructed, old.shortfall),
        retracted=old.retracted | (starts & old.opened),
        opened=old.opened | (counts & (time > run.turn_s) & (command == 0)),
        largest_command=jnp.where(
            in_reversal, jnp.maximum(old.largest_command, command), old.largest_command
        ),
        commanded=jnp.where(counts, command, old.commanded),
    )


def add_plant_step(
    old: Accumulators,
    run: RunFacts,
    time: Float[Array, ""],
    step: Float[Array, ""],
    contact: ContactEvent,
    carriage: Carriage,
    travel: Float[Array, ""],
    blocked: Bool[Array, ""],
    tracking: Tracking | None = None,
    turned: Float[Array, ""] | float = 0.0,
    side: Float[Array, ""] | float = 0.0,
    apart: Float[Array, ""] | float = 0.0,
) -> Accumulators:
    """Return the accumulators after a plant step of length `step` that ends at `time`, both in s.

    `contact`: first new contact in the step. `travel`: movement of the actuator, mm. `blocked`:
    whether the drive blocks. `tracking`: tracking error and torque limit of a servo motor, or None.
    `turned`: rotation of the driving shaft in the step, rad. `side`: loaded flank at its end.
    `apart`: distance from the other flank at its end, rad.
    """
    counts = (time <= run.duration_s) & ~old.blocked
    meets = counts & (contact.side == run.other_flank)
    crosses = meets & (time > run.braking_s) & jnp.isnan(old.gap)
    stops = counts & blocked
    error, limited_s = old.following_error, old.limited_s
    if tracking is not None:
        error = jnp.where(counts, jnp.maximum(error, tracking.error), error)
        limited_s += jnp.where(counts & tracking.limited, step, 0.0)
    in_reversal, travels = counts & ~old.opened, counts & ~old.retracted
    early, rebound = counts & (time < run.turn_s), old.rebound
    if rebound is not None:
        met_before = counts & ~jnp.isnan(old.gap)
        rebound = jnp.where(met_before, jnp.maximum(rebound, apart), rebound)
    carrier = jnp.where(old.carrier == 0, -run.other_flank, old.carrier)  # before any contact
    # In a closed gap rounding decides which flank is met; the state of the plant then tells it.
    met = jnp.where(contact.gap > _CLOSED, contact.side, 0.0)
    jump = jnp.where(counts & (met == -carrier), contact.gap, 0.0)
    now = jnp.where(met != 0, met, jnp.asarray(side))
    carrier = jnp.where(counts & (now != 0), now, carrier)
    return replace(
        old,
        carrier=carrier,
        largest_jump=jnp.maximum(old.largest_jump, jump),
        early_jump=jnp.where(early, jnp.maximum(old.early_jump, jump), old.early_jump),
        wrong_travel=old.wrong_travel
        + jnp.where(early & (carrier == run.other_flank), jnp.abs(turned), 0.0),
        gap=jnp.where(crosses, contact.gap, old.gap),
        crossing=jnp.where(crosses, contact.angle, old.crossing),
        interference=jnp.where(
            in_reversal,
            jnp.maximum(old.interference, carriage.unobstructed - carriage.reached),
            old.interference,
        ),
        travel=old.travel + jnp.where(travels, jnp.abs(travel), 0.0),
        farthest=jnp.where(travels, jnp.maximum(old.farthest, carriage.reached), old.farthest),
        following_error=error,
        limited_s=limited_s,
        forced=(
            old.forced if carriage.stalled is None else old.forced | (travels & carriage.stalled)
        ),
        blocked=old.blocked | stops,
        blocked_s=jnp.where(stops, time, old.blocked_s),
        rebound=rebound,
    )

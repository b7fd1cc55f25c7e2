"""What is kept of a run while it goes on: sums, extremes and first times, never a trace."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...base.arrays import Numbers
from ..hardware.actuator import Carriage
from ..hardware.shaft_drive import Missed
from ..plants.plant import ContactEvent, Shafts


class RunFacts(NamedTuple):
    """What a run is judged by.

    - `braking_s`, `turn_s`, `duration_s`: of its motion. - `period`: of the controller, s.
    - `other`: the flank that carries after the turn.
    - `closing`: rad/mm of both flanks, shape (2,).
    """

    braking_s: Float[Array, ""]
    turn_s: Float[Array, ""]
    duration_s: Float[Array, ""]
    period: Float[Array, ""]
    other: Float[Array, ""]
    closing: Float[Array, "2"]


class Accumulators(NamedTuple):
    """Running metrics; rad, mm and s, NaN for what has not happened.

    - `samples`, `total`, `highest`, `lowest`: of the transmission error as the encoders show it,
      from that of the first sample `first` on.
    - `before`, `after`: TE shown last on the old flank, and first after the other flank is met.
    - `gap`, `crossing`: backlash left and driving angle where it is met; `crossing_s`: time of the
      first sample after it. `behind`: how far the driving shaft is then behind its motion.
    - `detection`, `detection_s`: driving angle and time of the first command to close from
      braking on and before the turn; `false_closings`: commands to close before.
    - `left`: backlash left where the motion turns; `short`: way the actuator then still lacks.
    - `asked`: farthest command.
    - `opened`: the gap was opened again after the turn; what follows, such as the stop at the end
      of the run, is no part of the reversal. `retracted`: it is closed another time.
    - `interference`: most by which the actuator wanted further than the closed gap let it.
    - `travel`: way of the actuator; `farthest`: its farthest place.
    - `astray`: most by which a servo motor missed the angle it was told, rad; `limited_s`: time
      that it spent at its torque limit.
    - `forced`: the teeth were stronger than the actuator.
    - `commanded`: the command of the last period. - `blocked`: the drive stands, at `blocked_s`.
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
    behind: Float[Numbers, "*shape"]
    detection: Float[Numbers, "*shape"]
    detection_s: Float[Numbers, "*shape"]
    false_closings: Float[Numbers, "*shape"]
    left: Float[Numbers, "*shape"]
    short: Float[Numbers, "*shape"]
    opened: Bool[Numbers, "*shape"]
    retracted: Bool[Numbers, "*shape"]
    asked: Float[Numbers, "*shape"]
    interference: Float[Numbers, "*shape"]
    travel: Float[Numbers, "*shape"]
    farthest: Float[Numbers, "*shape"]
    astray: Float[Numbers, "*shape"]
    limited_s: Float[Numbers, "*shape"]
    forced: Bool[Numbers, "*shape"]
    commanded: Float[Numbers, "*shape"]
    blocked: Bool[Numbers, "*shape"]
    blocked_s: Float[Numbers, "*shape"]


def empty() -> Accumulators:
    """Before the first sample."""
    zero, never = jnp.zeros(()), jnp.full((), jnp.nan, float)
    counted = dict.fromkeys(
        (
            *("samples", "total", "false_closings", "asked"),
            *("interference", "travel", "farthest", "commanded", "behind", "astray", "limited_s"),
        ),
        zero,
    )
    fields = dict.fromkeys(Accumulators._fields, never) | counted
    fields |= dict.fromkeys(("opened", "retracted", "forced", "blocked"), jnp.zeros((), bool))
    return Accumulators(**fields)


def sampled(
    tally: Accumulators,
    run: RunFacts,
    time: Float[Array, ""],
    error: Float[Array, ""],
    angle: Float[Array, ""],
    command: Float[Array, ""],
    target: Float[Array, ""],
    flanks_gap: Float[Array, ""],
    side: Float[Array, ""],
    carriage: Carriage,
) -> Accumulators:
    """After the sample of one period: TE shown, true driving angle, command, backlash left."""
    counts = (time <= run.duration_s) & ~tally.blocked
    first = jnp.where(tally.samples == 0, error, tally.first)
    error = error - first
    crossed = ~jnp.isnan(tally.gap)
    just_crossed = counts & crossed & jnp.isnan(tally.after)
    starts = counts & (command > 0) & (tally.commanded == 0)
    braking = time >= run.braking_s
    closes = counts & (command > 0)
    detects = closes & braking & (time < run.turn_s) & jnp.isnan(tally.detection)
    # The period nearest to the turn: at the turn itself the shaft moves least.
    turns = (
        counts
        & (time >= run.turn_s - 0.5 * run.period)
        & (time < run.duration_s)
        & jnp.isnan(tally.left)
    )
    left = flanks_gap - (run.closing[0] + run.closing[1]) * carriage.reached
    return tally._replace(
        samples=tally.samples + counts,
        total=tally.total + jnp.where(counts, error, 0.0),
        highest=jnp.where(counts, jnp.fmax(tally.highest, error), tally.highest),
        lowest=jnp.where(counts, jnp.fmin(tally.lowest, error), tally.lowest),
        first=first,
        before=jnp.where(counts & ~crossed & (side == -run.other), error, tally.before),
        after=jnp.where(just_crossed, error, tally.after),
        crossing_s=jnp.where(just_crossed, time, tally.crossing_s),
        detection=jnp.where(detects, angle, tally.detection),
        detection_s=jnp.where(detects, time, tally.detection_s),
        false_closings=tally.false_closings + (starts & ~braking),
        left=jnp.where(turns, left, tally.left),
        short=jnp.where(turns, target - carriage.wanted, tally.short),
        retracted=tally.retracted | (starts & tally.opened),
        opened=tally.opened | (counts & (time > run.turn_s) & (command == 0)),
        asked=jnp.where(counts & ~tally.opened, jnp.maximum(tally.asked, command), tally.asked),
        commanded=jnp.where(counts, command, tally.commanded),
    )


def moved(
    tally: Accumulators,
    run: RunFacts,
    time: Float[Array, ""],
    step: Float[Array, ""],
    shafts: Shafts,
    touch: ContactEvent,
    carriage: Carriage,
    way: Float[Array, ""],
    blocked: Bool[Array, ""],
    behind: Float[Array, ""] | None = None,
    missed: Missed | None = None,
) -> Accumulators:
    """After a step of the plant that ends at `time`, with the way of the actuator in it.

    `behind`: how far the driving shaft is behind its motion at the touch, rad; None: it never is.
    `missed`: how a servo motor does; None: there is none.
    """
    counts = (time <= run.duration_s) & ~tally.blocked
    crosses = counts & (touch.side == run.other) & (time > run.braking_s) & jnp.isnan(tally.gap)
    stops = counts & blocked
    astray, limited_s = tally.astray, tally.limited_s
    if missed is not None:
        astray = jnp.where(counts, jnp.maximum(astray, missed.astray), astray)
        limited_s += jnp.where(counts & missed.limited, step, 0.0)
    reverses, slides = counts & ~tally.opened, counts & ~tally.retracted
    return tally._replace(
        gap=jnp.where(crosses, touch.gap, tally.gap),
        crossing=jnp.where(crosses, touch.angle, tally.crossing),
        behind=tally.behind if behind is None else jnp.where(crosses, behind, tally.behind),
        interference=jnp.where(
            reverses,
            jnp.maximum(tally.interference, carriage.wanted - carriage.reached),
            tally.interference,
        ),
        travel=tally.travel + jnp.where(slides, jnp.abs(way), 0.0),
        farthest=jnp.where(slides, jnp.maximum(tally.farthest, carriage.reached), tally.farthest),
        astray=astray,
        limited_s=limited_s,
        forced=(
            tally.forced if carriage.stalled is None else tally.forced | (slides & carriage.stalled)
        ),
        blocked=tally.blocked | stops,
        blocked_s=jnp.where(stops, time, tally.blocked_s),
    )

"""The metrics of the contract and the outcome, for one run or for an array of runs."""

from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...base.arrays import Numbers
from ...base.units import DEG
from ..controllers.turn_location import LostController
from .accumulators import Accumulators
from .case import Case

Outcome = Literal["ok", "unlocated", "bound", "missed", "stroke", "force", "slow"]
"""`unlocated`: the controller did not know the turn of the hunting period and refused to start.
`bound`: the drive stands between both flanks. `missed`: the controller did not see the motor brake.
`stroke`: the actuator was asked for more than it has. `force`: the teeth were stronger than it.
`slow`: it was still on its way when the motion turned."""

METRICS = (
    "te_mean_deg",
    "te_max_deg",
    "te_min_deg",
    "jump_deg",
    "jump_paper_deg",
    "axial_step_deg",
    "detection_deg",
    "detection_delay_s",
    "residual_gap_deg",
    "interference_mm",
    "actuator_travel_mm",
    "lost_motion_deg",
)

NEAR_MM = 1e-4
"""mm within which the actuator has arrived."""


class MetricInputs(NamedTuple):
    """What of a case its metrics are read with.

    - `sense`: 1 for a run that begins forwards, −1 backwards.
    - `closing`: rad by which a mm of axial displacement moves the flank that carries at first.
    - `braking_s`, `turns`: when the motion brakes, and whether it turns back.
    - `idle`: nobody closes the gap. - `lost`: the controller refused to start.
    - `stroke`: of the actuator, mm.
    - `turn_s`, `turn`: when and where the motion turns, s and rad of the driving shaft.
    - `ratio`: i.
    """

    sense: Float[Numbers, "*shape"]
    closing: Float[Numbers, "*shape"]
    braking_s: Float[Numbers, "*shape"]
    turns: Bool[Numbers, "*shape"]
    idle: Bool[Numbers, "*shape"]
    lost: Bool[Numbers, "*shape"]
    stroke: Float[Numbers, "*shape"]
    turn_s: Float[Numbers, "*shape"]
    turn: Float[Numbers, "*shape"]
    ratio: Float[Numbers, "*shape"]


def facts_of(case: Case) -> MetricInputs:
    """The facts of one case."""
    sense, closing = jnp.asarray(case.sense), jnp.asarray(case.bounds.closing)
    return MetricInputs(
        sense,
        jnp.where(sense > 0, closing[0], closing[1]),
        jnp.asarray(case.motion.braking_s),
        jnp.asarray(case.motion.turn_s) < case.motion.duration_s,
        jnp.full((), not case.controller.closes),
        jnp.full((), isinstance(case.controller, LostController)),
        jnp.asarray(case.actuator.stroke),
        jnp.asarray(case.motion.turn_s),
        case.motion.at(jnp.asarray(case.motion.turn_s)).angle,
        jnp.asarray(case.bounds.ratio),
    )


def metrics_of(facts: MetricInputs, tally: Accumulators) -> dict[str, Float[np.ndarray, "*shape"]]:
    """The metrics by name, NaN for what did not happen.

    - `te_mean_deg`, `te_max_deg`, `te_min_deg`: of the transmission error the encoders show.
    - `jump_deg`: TE at the first contact of the other flank less that of the old flank at the same
      driving angle; `jump_paper_deg`: last sample on the old flank less the first after that
      contact, as the paper reads its curves.
    - `axial_step_deg`: TE by which closing pushes the driven gear on the flank that carries.
    - `detection_deg`, `detection_delay_s`: driving angle of the first command to close, and the
      time since the motor began to brake.
    - `residual_gap_deg`: backlash left when the motion turns.
    - `interference_mm`: most by which the actuator wanted further than the closed gap let it.
    - `actuator_travel_mm`: its way to and fro.
    - `lost_motion_deg`: how far the motion has gone back, at the driven gear, when the other flank
      is first met; 0 where that is before the turn.

    Interference, travel and the axial step are those of the reversal: they end when the gap is
    opened again after it. Of a motion that never turns back they are those of the whole run.
    """
    f, t = MetricInputs(*map(np.asarray, facts)), Accumulators(*map(np.asarray, tally))
    back = f.sense * f.ratio * (f.turn - t.crossing - t.behind)
    lost = np.where(t.crossing_s <= f.turn_s, 0.0, back)
    values = (
        t.total / t.samples / DEG,
        t.highest / DEG,
        t.lowest / DEG,
        f.sense * t.gap / DEG,
        (t.before - t.after) / DEG,
        t.farthest * f.closing / DEG,
        t.detection / DEG,
        t.detection_s - f.braking_s,
        t.left / DEG,
        t.interference,
        t.travel,
        np.where(f.turns, lost, np.nan) / DEG,
    )
    return {name: np.asarray(value) for name, value in zip(METRICS, values, strict=True)}


def outcomes_of(facts: MetricInputs, tally: Accumulators) -> Any:
    """How each ended: the first that holds, in the order of `Outcome` behind ok."""
    f, t = MetricInputs(*map(np.asarray, facts)), Accumulators(*map(np.asarray, tally))
    return np.select(
        [
            f.lost,
            t.blocked,
            f.turns & ~f.idle & np.isnan(t.detection),
            t.asked > f.stroke + NEAR_MM,
            t.forced,
            t.short > NEAR_MM,
        ],
        ["unlocated", "bound", "missed", "stroke", "force", "slow"],
        "ok",
    )

"""Metrics and outcome of one run or of an array of runs."""

from typing import Any, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.arrays import Numbers, namespace
from ...base.units import DEG
from ..controllers.turn_location import LostController
from .accumulators import Accumulators
from .case import Case

Outcome = Literal["ok", "unlocated", "bound", "missed", "stroke", "force", "slow"]
"""`unlocated`: the controller could not locate the turn of the hunting period and did not start.
`bound`: both flanks were in contact and blocked the drive. `missed`: the controller did not detect
the braking. `stroke`: a command exceeded the stroke of the actuator. `force`: the force of the
teeth exceeded the force limit of the actuator. `slow`: the actuator had not reached its target when
the motion turned."""

OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)
"""All outcomes; the code of an outcome is its index here."""

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
"""Axial displacements up to this value, in mm, count as zero; a chosen tolerance."""


class MetricInputs(eqx.Module):
    """Values of a case from which its metrics are computed.

    - `sense`: 1 if the run begins forwards, −1 if backwards.
    - `closing`: TE change per axial displacement on the flank that carries first, rad/mm.
    - `braking_s`, `turns`: start of braking, s, and whether the motion turns back.
    - `idle`: whether the controller is of a kind that never closes the gap.
    - `lost`: whether the controller could not locate its turn within the hunting period.
    - `stroke`: stroke of the actuator, mm.
    - `turn_s`, `turn`: time (s) and driving angle (rad) at which the motion turns back.
    - `ratio`: ratio i of the driven to the driving speed.
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


def metric_inputs_of(case: Case) -> MetricInputs:
    """Return the inputs of the metrics of one case."""
    sense, closing = jnp.asarray(case.sense), jnp.asarray(case.bounds.closing)
    return MetricInputs(
        sense=sense,
        closing=jnp.where(sense > 0, closing[0], closing[1]),
        braking_s=jnp.asarray(case.motion.braking_s),
        turns=jnp.asarray(case.motion.turn_s) < case.motion.duration_s,
        idle=jnp.full((), not case.controller.closes),
        lost=jnp.full((), isinstance(case.controller, LostController)),
        stroke=jnp.asarray(case.actuator.stroke),
        turn_s=jnp.asarray(case.motion.turn_s),
        turn=case.motion.at(jnp.asarray(case.motion.turn_s)).angle,
        ratio=jnp.asarray(case.bounds.ratio),
    )


def metrics_of(
    inputs: MetricInputs, accumulators: Accumulators
) -> dict[str, Float[Numbers, "*shape"]]:
    """Return the metrics by name; NaN for events that did not happen.

    NumPy arguments give NumPy arrays, JAX arguments give JAX arrays. The crossing is the first
    contact with the other flank.

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
    - `lost_motion_deg`: angle, at the driven gear, that the motion turns back until the crossing;
      0 if the crossing comes before the turn.

    Interference, travel and axial step are those of the reversal, which ends with the command to
    open the gap after the turn. If the motion never turns back, they are those of the whole run.
    """
    f, t, xp = inputs, accumulators, namespace(inputs, accumulators)
    back = f.sense * f.ratio * (f.turn - t.crossing - t.behind)
    lost = xp.where(t.crossing_s <= f.turn_s, 0.0, back)
    values = (
        t.total / t.samples / DEG,
        t.highest / DEG,
        t.lowest / DEG,
        f.sense * t.gap / DEG,
        (t.before - t.after) / DEG,
        t.farthest * f.closing / DEG,
        t.detection / DEG,
        t.detection_s - f.braking_s,
        t.residual_gap / DEG,
        t.interference,
        t.travel,
        xp.where(f.turns, lost, np.nan) / DEG,
    )
    return {name: xp.asarray(value) for name, value in zip(METRICS, values, strict=True)}


def outcome_codes(inputs: MetricInputs, accumulators: Accumulators) -> Int[Numbers, "*shape"]:
    """Return the code of each run, its index in `OUTCOMES`.

    If several outcomes other than ok apply, the first in `OUTCOMES` counts; if none applies, ok.
    """
    f, t, xp = inputs, accumulators, namespace(inputs, accumulators)
    holds = [
        f.lost,
        t.blocked,
        f.turns & ~f.idle & xp.isnan(t.detection),
        t.largest_command > f.stroke + NEAR_MM,
        t.forced,
        t.shortfall > NEAR_MM,
    ]
    shape = xp.broadcast_shapes(*(xp.shape(one) for one in holds))
    holds = [xp.broadcast_to(one, shape) for one in holds]
    return xp.select(holds, [xp.full(shape, code) for code in range(1, len(OUTCOMES))], 0)


def outcomes_of(inputs: MetricInputs, accumulators: Accumulators) -> Any:
    """Return the outcome of each run as text; the arguments must hold NumPy arrays."""
    return np.asarray(OUTCOMES)[outcome_codes(inputs, accumulators)]

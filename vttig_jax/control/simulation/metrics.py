"""Metrics and outcome of one run or of an array of runs."""

from collections.abc import Mapping
from typing import Any, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...base.arrays import Numbers, namespace
from ...base.units import DEG
from ..controllers.turn_location import LostController
from ..motion.motion import Motion
from .accumulators import Accumulators
from .case import Case
from .prepare import TIMES

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
    "output_error_deg",
    "output_error_rms_deg",
    "largest_jump_deg",
    "early_jump_deg",
    "wrong_flank_deg",
    "over_compensation_deg",
    "thrown_back_deg",
)

NEAR_MM, NEAR_DEG = 1e-4, 1e-6
"""Axial displacements (mm) and backlash (deg) that count as zero; chosen tolerances."""


class MetricInputs(eqx.Module):
    """Values of a case from which its metrics are computed.

    - `sense`: 1 if the run begins forwards, −1 if backwards.
    - `closing`: TE change per axial displacement on the flank that carries first, rad/mm.
    - `braking_s`, `turns`: start of braking, s, and whether the motion turns back.
    - `idle`: whether the controller is of a kind that never closes the gap.
    - `lost`: whether the controller could not locate its turn within the hunting period.
    - `stroke`: stroke of the actuator, mm. - `way_back`: travel of the motion after the turn, rad;
      NaN without a turn.
    """

    sense: Float[Numbers, "*shape"]
    closing: Float[Numbers, "*shape"]
    braking_s: Float[Numbers, "*shape"]
    turns: Bool[Numbers, "*shape"]
    idle: Bool[Numbers, "*shape"]
    lost: Bool[Numbers, "*shape"]
    stroke: Float[Numbers, "*shape"]
    way_back: Float[Numbers, "*shape"]


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
        stroke=jnp.asarray(case.actuator.stroke_mm),
        way_back=_way_back(case.motion),
    )


def _way_back(motion: Motion) -> Float[Array, ""]:
    turn, end = jnp.asarray(motion.turn_s), jnp.asarray(motion.duration_s)
    angle = motion.at(turn + (end - turn) * jnp.linspace(0.0, 1.0, TIMES)).angle
    return jnp.where(turn < end, jnp.sum(jnp.abs(jnp.diff(angle))), jnp.nan)


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
    f, t, xp = inputs, accumulators, namespace(inputs, accumulators)
    none = xp.full_like(t.total, np.nan)
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
        t.lost / f.way_back / DEG,
        xp.where(f.turns, t.output_error, np.nan) / DEG,
        xp.sqrt(t.output_squares / t.samples) / DEG,
        t.largest_jump / DEG,
        t.early_jump / DEG,
        t.wrong_travel / DEG,
        none if t.beyond is None else t.beyond / f.way_back / DEG,
        none if t.rebound is None else t.rebound / DEG,
    )
    return {name: xp.asarray(value) for name, value in zip(METRICS, values, strict=True)}


def overdone(metrics: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return whether the motor makes up for too much, and whether it throws the driven shaft back.

    Too much is over 1 % of the gap; thrown back is a shaft that flies over half of it.
    """
    gap = metrics["largest_jump_deg"]
    return (
        metrics["over_compensation_deg"] > 0.01 * gap + NEAR_DEG,
        metrics["thrown_back_deg"] > 0.5 * gap + NEAR_DEG,
    )


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

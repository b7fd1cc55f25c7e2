"""Combinations of keys that no scenario can have, each with the key that says it."""

import math
from typing import TYPE_CHECKING

from ..base.errors import ScenarioError

if TYPE_CHECKING:
    from .spec import ScenarioSpec
    from .spec_tables import MotionTable, SamplingTable


def check_scenario(spec: "ScenarioSpec") -> None:
    """Raise `ScenarioError` whose `where` is the dotted key at fault."""
    check_rig(spec)
    _check_motion(spec.motion)
    _check_rates(spec.sampling)


def check_rig(spec: "ScenarioSpec") -> None:
    """Raise `ScenarioError` unless the rig is given in one way."""
    if (spec.eccentricities is None) == (spec.rig is None):
        seen = "neither" if spec.rig is None else "both"
        raise ScenarioError(
            f"{seen} of [eccentricities] and `rig` given; write [eccentricities], or"
            ' rig = { from = "RUN" } for those of a run folder.',
            where="eccentricities",
        )


def smallest_reversal_deg(motion: "MotionTable") -> float:
    """Driving angle that a trapezoid or S-curve needs for its ramps, in deg.

    A ramp covers half of what the steady speed would in its time. A slow-down to the share s and
    back adds two ramps of (1 − s) the time between speeds 1 and s, and the time at s.
    """
    ramps, share = motion.ramp_s, motion.slow_share
    if motion.event in ("slow_down", "aborted"):
        ramps += motion.ramp_s * (1 - share) * (1 + share)
    if motion.event == "slow_down":
        ramps += share * motion.dwell_s
    if motion.event == "emergency_stop":
        ramps = max(ramps, (motion.ramp_s + motion.stop_s) / 2)
    return motion.speed_rpm * 6.0 * ramps


def _check_motion(motion: "MotionTable") -> None:
    if motion.kind == "recorded" and not motion.file:
        raise ScenarioError(
            'missing; kind = "recorded" follows a CSV with time_s and driving_deg.',
            where="motion.file",
        )
    if motion.kind != "recorded" and motion.file:
        raise ScenarioError(
            f'given, but kind is "{motion.kind}"; write kind = "recorded" to follow this file, or'
            " remove it.",
            where="motion.file",
        )
    if motion.kind not in ("trapezoid", "s_curve"):
        if motion.event != "reversal":
            raise ScenarioError(
                f'"{motion.event}" needs kind = "trapezoid" or "s_curve", but kind is'
                f' "{motion.kind}".',
                where="motion.event",
            )
        return
    smallest = smallest_reversal_deg(motion)
    if motion.reversal_deg < smallest * (1 - 1e-12):
        raise ScenarioError(
            f"{motion.reversal_deg:g} lies inside the ramps of this {motion.event}; at"
            f" {motion.speed_rpm:g} rpm with ramp_s = {motion.ramp_s:g} it must be at least"
            f" {_up(smallest)}.",
            where="motion.reversal_deg",
        )


def _up(value: float) -> str:
    """A number of six digits that is not below the value."""
    step = 10.0 ** (math.floor(math.log10(value)) - 5)
    return f"{math.ceil(value / step * (1 - 1e-12)) * step:.6g}"


def _check_rates(sampling: "SamplingTable") -> None:
    plant, controller = sampling.plant_hz, sampling.controller_hz
    steps = plant / controller
    whole = max(1, round(steps))
    if plant and abs(steps - whole) > 1e-9 * whole:
        raise ScenarioError(
            f"{plant:g} Hz is {steps:g} times controller_hz; write a whole multiple such as"
            f" {whole * controller:g}, or 0 for controller_hz itself.",
            where="sampling.plant_hz",
        )

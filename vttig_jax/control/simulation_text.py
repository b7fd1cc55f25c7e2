"""A simulated run in words, laid out to be read from top to bottom."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ..base.tables import key_values
from ..base.units import ARCSEC, DEG

if TYPE_CHECKING:
    from .simulation import Simulation

_NEAR_MM = 1e-4
_NEAR_DEG = 1e-6
"""Less interference in mm and less backlash in degrees are not worth a sentence."""

_EVENTS = {
    "reversal": "reversal",
    "slow_down": "slow-down, stop",
    "aborted": "slow-down, reversal",
    "emergency_stop": "emergency stop, reversal",
}
_MISSED = {
    "acceleration": "; lower judgement.threshold_rad_s2",
    "predictive": "; raise judgement.horizon_s",
}


def simulation_text(found: "Simulation") -> str:
    """Rig, motion, outcome, metrics and remarks."""
    head = key_values(list(_rows(found)), title=found.pair.name or "simulation")
    if not found.remarks:
        return head
    return "\n".join([head, "", "notes:", *(f"  {sentence}" for sentence in found.remarks)])


def sentences(found: "Simulation") -> Iterator[str]:
    """What a reader must not overlook."""
    t, outcome = found.tally, found.outcome
    if outcome != "ok":
        yield _ending(found)
    if float(t.interference) > _NEAR_MM and not bool(t.blocked):
        yield (
            f"At its worst the controller closes {float(t.interference):.3f} mm further than the"
            " gap allows: the actuator stalls and is pushed back."
        )
    closings = int(t.false_closings)
    if closings:
        yield (
            f"The controller closes {closings} time{'s' if closings > 1 else ''} before the"
            " deceleration that precedes the turn."
        )
    if not found.turns and not np.isnan(t.detection):
        yield "The controller closes although the motion never turns back."
    if float(t.limited_s) > 0:
        yield (
            f"The motor is at servo.torque_limit_Nm for {float(t.limited_s):.3g} s; the driving"
            f" shaft is up to {_angle(float(t.astray))} from where it is told to be."
        )
    margin = found.spec.judgement.margin_mm * float(found.case.bounds.closing_sum)
    meant = _NEAR_DEG * DEG + 1.01 * max(margin, 0.0)
    if outcome == "ok" and found.case.controller.closes and float(t.left) > meant:
        yield (
            f"The motion turns with {_angle(float(t.left))} of backlash left, more than"
            " judgement.margin_mm means to leave."
        )


def _ending(found: "Simulation") -> str:
    """An outcome other than ok, with its cure."""
    t = found.tally
    return {
        "bound": f"The drive blocks after {float(t.blocked_s):.3f} s: the gap has shrunk below what"
        " the actuator holds, and the teeth cannot push it back; a larger judgement.margin_mm, or a"
        " smaller mesh.friction_coefficient, keeps it going.",
        "unlocated": "The controller does not know in which turn of the hunting period it is, and"
        " refuses to start; encoders good enough to tell the turns apart (judgement.turn ="
        ' "located"), or a reference (judgement.turn = "known"), let it.',
        "missed": f"The controller never sees the motor brake{_MISSED.get(found.controller, '')}.",
        "stroke": f"The controller asks for {float(t.asked):.3f} mm, but actuator.stroke_mm is"
        f" {float(found.case.actuator.stroke):g}.",
        "force": "The teeth are stronger than actuator.force_limit_N ="
        f" {found.spec.actuator.force_limit_N:g}: the actuator stalls or is pushed back; a higher"
        " limit, or less torque on the drive while it moves, lets it pass.",
        "slow": f"When the motion turns the actuator still lacks {float(t.short):.3f} mm; a faster"
        " actuator or a longer standstill gives it the time.",
    }[found.outcome]


def _rows(found: "Simulation") -> Iterator[tuple[str, str]]:
    t, spec, metrics = found.tally, found.spec, _numbers(found)
    yield "simulated", f"{spec.plant} plant, {spec.flanks} flanks, controller {found.controller}"
    yield "motion", _motion(found)
    yield "outcome", found.outcome
    mean, most, least = (metrics[f"te_{name}_deg"] for name in ("mean", "max", "min"))
    shown = f"{least:+.5f}° … {most:+.5f}°, mean {mean:+.5f}°"
    yield "transmission error", f"{shown}, as the encoders show it"
    if found.servo:
        yield "following error", f"{_angle(float(t.astray))} of the driving shaft at most"
    moves, closes = found.case.controller.advances, found.case.controller.closes
    if closes or not moves:
        yield "closing begins", _detection(found)
    if found.turns:
        _, open_gap = found.place(found.case.motion.turn_s)
        left = "–" if np.isnan(t.left) else _angle(float(t.left))
        yield "backlash at the turn", f"{left} left of {open_gap / DEG:.5f}°"
    yield "jump", _jump(found)
    if (moves or found.servo) and "lost_motion_deg" in metrics:
        yield "lost motion", _lost(found)
    if closes:
        yield "axial step", _angle(metrics["axial_step_deg"] * DEG)
        yield "interference", f"{float(t.interference):.4f} mm at most"
        yield (
            "actuator",
            f"{float(t.travel):.3f} mm to and fro, {float(t.farthest):.3f} mm at the farthest",
        )


def _motion(found: "Simulation") -> str:
    """What the driving shaft does, and for how long."""
    table, hertz = found.spec.motion, found.spec.sampling.controller_hz
    time = f"{float(found.case.motion.duration_s):g} s at {hertz:g} Hz"
    if table.kind == "recorded":
        return f"recorded in {table.file}, {time}"
    event, shape = _EVENTS[table.event], table.kind.replace("_", "-")
    return f"{event} at {table.reversal_deg:g}°, {shape} of {table.speed_rpm:g} rpm, {time}"


def _detection(found: "Simulation") -> str:
    """When the controller closes, against what the motor does."""
    t = found.tally
    if np.isnan(t.detection):
        return "never"
    after = float(t.detection_s - found.case.motion.braking_s)
    delay = f"{1e3 * after:.4g} ms" if after < 1 else f"{after:.4g} s"
    said = f"{delay} after the motor brakes, at {float(t.detection) / DEG:.3f}°"
    if not found.turns:
        return said
    angle, _ = found.place(found.case.motion.turn_s)
    return f"{said}, {abs(angle - float(t.detection)) / DEG:.3f}° before the turn"


def _jump(found: "Simulation") -> str:
    """Of the transmission error where the flanks change, in both definitions."""
    metrics = _numbers(found)
    if "jump_deg" not in metrics:
        return "none: the other flank is never met"
    said = f"{_angle(metrics['jump_deg'] * DEG)} at {float(found.tally.crossing) / DEG:.3f}°"
    paper = metrics.get("jump_paper_deg")
    return said if paper is None else f"{said}; reading before less reading after {paper:+.5f}°"


def _lost(found: "Simulation") -> str:
    """How far the motion goes back until the driven shaft follows, and for how long."""
    since = max(float(found.tally.crossing_s - found.case.motion.turn_s), 0.0)
    said = _angle(_numbers(found)["lost_motion_deg"] * DEG)
    return f"{said}, the other flank carries {1e3 * since:.3g} ms after the turn"


def _numbers(found: "Simulation") -> dict[str, float]:
    """The metrics that are there."""
    return {name: value for name, value in found.metrics.items() if isinstance(value, float)}


def _angle(value: float) -> str:
    """An angle in rad."""
    shown = max(value, 0.0) if value > -_NEAR_DEG * DEG else value  # no −0
    return f"{shown / DEG:.5f}° ({shown / ARCSEC:.1f}″)"

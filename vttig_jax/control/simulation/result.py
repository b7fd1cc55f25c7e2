"""The result of a simulated run: metrics, outcome, remarks, a trace on request, and its report."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...base.arrays import Number
from ...base.files.text_tables import key_values
from ...base.units import ARCSEC, DEG
from ...pair.gear_pair import GearPair
from ..hardware.shaft_drive import Prescribed
from ..scenario.spec import ScenarioSpec, spec_table
from .accumulators import Accumulators
from .case import Case, Sample
from .metrics import Outcome, facts_of, metrics_of, outcomes_of

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


@dataclass(frozen=True)
class Trace:
    """Samples of a run, shape (n,): s, rad and mm; the fields are those of `Sample`."""

    samples: Sample

    @classmethod
    def of(cls, pieces: Sequence[Sample]) -> "Trace":
        """The pieces one after the other."""
        return cls(Sample(*(np.concatenate(part) for part in zip(*pieces, strict=True))))

    def columns(self) -> dict[str, Float[np.ndarray, " n"]]:
        """Columns of a table, with their units."""
        s = self.samples
        angles = {"driving": s.driving, "te": s.error, "te_shown": s.shown}
        angles |= {"flank_a": s.lower, "flank_b": s.upper}
        return (
            {"time_s": np.asarray(s.time)}
            | {f"{name}_deg": np.asarray(values) / DEG for name, values in angles.items()}
            | {
                "speed_rad_s": np.asarray(s.speed),
                "acceleration_rad_s2": np.asarray(s.acceleration),
                "command_mm": np.asarray(s.command),
                "axial_mm": np.asarray(s.reached),
            }
        )


@dataclass(frozen=True)
class Simulation:
    """One simulated run.

    **Arguments**
    - `spec`, `pair`, `case`: what was simulated. - `tally`: its metrics in internal units.
    - `trace`: samples, where they were asked for.
    """

    spec: ScenarioSpec
    pair: GearPair
    case: Case
    tally: Accumulators
    trace: Trace | None = None

    @property
    def metrics(self) -> dict[str, float | str | None]:
        """The metrics of the contract and the outcome; None for what did not happen.

        See `metrics_of` for what each is.
        """
        found = metrics_of(facts_of(self.case), self.tally)
        return {name: _finite(float(value)) for name, value in found.items()} | {
            "outcome": self.outcome
        }

    @property
    def outcome(self) -> Outcome:
        """How it ended: the first that holds, in the order of `Outcome` behind ok."""
        return outcomes_of(facts_of(self.case), self.tally).item()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a reader must not overlook, in sentences."""
        return tuple(sentences(self))

    @property
    def controller(self) -> str:
        """Name of the controller; that of its class where it is one of your own."""
        own = type(self.case.controller)
        ours = own.__module__.startswith("vttig_jax.")
        return self.spec.controller if ours else own.__name__

    @property
    def servo(self) -> bool:
        """Whether a servo motor moves the driving shaft, which may be elsewhere than it is told."""
        return not isinstance(self.case.drive, Prescribed)

    @property
    def turns(self) -> bool:
        """Whether the motion turns back."""
        return float(self.case.motion.turn_s) < float(self.case.motion.duration_s)

    def place(self, time_s: Float[Number, ""] | float) -> tuple[float, float]:
        """Driving angle at a time in s, and the backlash there with the gap fully open: rad."""
        angle = self.case.motion.at(float(time_s)).angle
        return float(angle), float(self.case.bounds.gap(angle))

    def columns(self) -> dict[str, Float[np.ndarray, " n"]]:
        """Columns of the trace, up to where the drive blocks; see `Trace.columns`.

        **Raises** `ValueError` where no trace was kept.
        """
        if self.trace is None:
            raise ValueError(
                "Argument `trace_every` must be at least 1 for a trace, but this run kept none."
            )
        table = self.trace.columns()
        last = np.inf if np.isnan(self.tally.blocked_s) else float(self.tally.blocked_s)
        return {name: values[table["time_s"] <= last] for name, values in table.items()}

    def to_json(self) -> dict:
        """The object of schema `vttig.simulate/1`."""
        t, motion = self.tally, self.case.motion
        angle, gap = self.place(motion.turn_s)
        turn = {
            "time_s": float(motion.turn_s),
            "driving_deg": angle / DEG,
            "backlash_deg": gap / DEG,
        }
        return {
            "schema": "vttig.simulate/1",
            "pair": self.pair.name,
            "controller": self.controller,
            "metrics": self.metrics,
            "duration_s": float(motion.duration_s),
            "turn": turn if self.turns else None,
            "crossing_deg": _finite(float(t.crossing) / DEG),
            "crossing_s": _finite(float(t.crossing_s)),
            "following_error_deg": float(t.astray) / DEG if self.servo else None,
            "false_closings": int(t.false_closings),
            "blocked_s": _finite(float(t.blocked_s)),
            "samples": int(t.samples),
            "remarks": list(self.remarks),
            "scenario": spec_table(self.spec),
        }

    def __str__(self) -> str:
        return simulation_text(self)


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None

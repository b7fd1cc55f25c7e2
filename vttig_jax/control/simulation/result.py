"""Result of a simulated run: metrics, outcome, remarks, an optional trace, and its report."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from ...base.arrays import Number
from ...base.files.text_tables import key_values
from ...base.files.toml_io import plain_table
from ...base.results import PlottedResult
from ...base.units import ARCSEC, DEG
from ..controllers.controller import Acceleration, NoController
from ..motion.motion import Reversal, Sine
from ..motion.recorded import RecordedMotion
from ..scenario.scenario import CONTROLLERS, PLANTS, Scenario, name_of
from ..scenario.spec import ECCENTRICITIES, ScenarioSpec, believed_flanks, spec_table
from .case import (
    METRICS,
    NEAR_DEG,
    NEAR_MM,
    OUTCOMES,
    Accumulators,
    Case,
    Outcome,
    Sample,
    metrics_of,
    overdone,
)

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


def _sentences(run: "Simulation") -> Iterator[str]:
    """Yield the remarks about a run, each of them one sentence."""
    t, outcome = run.tally, run.outcome
    if run.changes_early:
        wrong = t.wrong_travel / DEG
        yield (
            f"The flanks change before the turn, with a jump of {_angle(t.early_jump / DEG)}, and"
            f" the driving shaft then turns by {wrong:.3g}° with the wrong flank in contact: the"
            " driven shaft overruns when the motor brakes; choose a longer motion.ramp_s, or more"
            " friction or load on the driven shaft."
        )
    values, jump_s = run.numbers[0], getattr(run.case.controller, "jump_s", None)
    than = "" if jump_s is None else f" than {float(jump_s):g} s"
    over, thrown = overdone(values)
    if over:
        yield (
            "The controller makes up for more than the gap: on the way back the driven shaft is on"
            f" the average {_angle(values['over_compensation_deg'])} beyond the place"
            " where the first flank would hold it; the gap that the controller believes is too"
            " large by as much (controller_map, map.constant_backlash_deg)."
        )
    if thrown:
        yield (
            "The motor throws the driven shaft off the flank that it meets, by up to"
            f" {_angle(values['thrown_back_deg'])} of the gap: it crosses the gap too"
            f" quickly; choose a longer judgement.jump_s{than}."
        )
    rest = float(run.case.motion.duration_s) - float(run.case.motion.turn_s)
    if run.turns and jump_s is not None and jump_s > rest:
        yield (
            f"The motor is still crossing the gap when the run ends, {rest:.3g} s after the turn;"
            f" choose a shorter judgement.jump_s{than}."
        )
    if outcome != "ok":
        yield _ending(run)
    if t.interference > NEAR_MM and not t.blocked:
        yield (
            f"At its worst the controller closes {t.interference:.3f} mm further than the"
            " gap allows: the actuator stalls and is pushed back."
        )
    closings = int(t.false_closings)
    if closings:
        yield (
            f"The controller closes {closings} time{'s' if closings > 1 else ''} before the"
            " deceleration that precedes the turn."
        )
    if not run.turns and not np.isnan(t.detection):
        yield "The controller closes although the motion never turns back."
    if t.limited_s > 0:
        yield (
            f"The motor is at servo.torque_limit_Nm for {t.limited_s:.3g} s; the driving"
            f" shaft is up to {_angle(t.following_error / DEG)} away from its target."
        )
    if outcome == "ok" and run.case.controller.closes and t.residual_gap > run.allowed:
        yield (
            f"The motion turns with {_angle(t.residual_gap / DEG)} of backlash left, more than"
            " judgement.margin_mm allows."
        )


def _ending(run: "Simulation") -> str:
    """Return the sentence that explains an outcome other than ok and proposes a remedy."""
    t = run.tally
    return {
        "bound": f"The drive blocks after {t.blocked_s:.3f} s: the gap has become smaller"
        " than the actuator allows, and the teeth cannot push the actuator back; choose a larger"
        " judgement.margin_mm or a smaller mesh.friction_coefficient.",
        "unlocated": "The controller does not know in which turn of the hunting period it is, and"
        " refuses to start; choose encoders that separate the turns (judgement.turn ="
        ' "located"), or a reference (judgement.turn = "known").',
        "missed": f"The controller never sees the motor brake{_MISSED.get(run.controller, '')}.",
        "stroke": f"The controller commands {t.largest_command:.3f} mm, but"
        f" actuator.stroke_mm is {float(run.case.actuator.stroke_mm):g}; choose a longer stroke.",
        "force": "The teeth are stronger than actuator.force_limit_N ="
        f" {float(run.case.actuator.force_limit_N):g}: the actuator stalls or is pushed back;"
        " choose a higher limit, or less torque on the drive while the actuator moves.",
        "slow": f"When the motion turns, the actuator still lacks {t.shortfall:.3f} mm;"
        " choose a faster actuator or a longer standstill.",
    }[run.outcome]


def _rows(run: "Simulation") -> Iterator[tuple[str, str]]:
    t, metrics = run.tally, _numeric_metrics(run)
    yield "simulated", f"{run.plant} plant, controller {run.controller}"
    if run.spec is not None:
        yield "flanks", flanks_text(run.spec, type(run.case.controller) is not NoController)
    yield "motion", _motion(run)
    yield "outcome", run.outcome
    mean, most, least = (metrics[f"te_{name}_deg"] for name in ("mean", "max", "min"))
    shown = f"{least:+.5f}° … {most:+.5f}°, mean {mean:+.5f}°"
    yield "transmission error", f"{shown}, as the encoders show it"
    if run.servo:
        yield "following error", f"{_angle(t.following_error / DEG)} of the driving shaft at most"
    closes = run.case.controller.closes
    if closes:
        yield "closing begins", _detection(run)
    if run.turns:
        _, open_gap = run.place(run.case.motion.turn_s)
        left = "–" if np.isnan(t.residual_gap) else _angle(t.residual_gap / DEG)
        yield "backlash at the turn", f"{left} left of {open_gap / DEG:.5f}°"
    yield "jump", _jump(run)
    if "lost_motion_deg" in metrics:
        yield "lost motion", f"{_angle(metrics['lost_motion_deg'])}, mean on the way back"
    largest = f"{metrics['output_error_rms_deg']:.5f}° rms over the run"
    if "output_error_deg" in metrics:
        largest = f"{_angle(metrics['output_error_deg'])} at most after the turn, {largest}"
    yield "error of the output", largest
    if closes:
        yield "axial step", _angle(metrics["axial_step_deg"])
        yield "interference", f"{t.interference:.4f} mm at most"
        yield (
            "actuator",
            f"{t.travel:.3f} mm to and fro, {t.farthest:.3f} mm at the farthest",
        )


def _motion(run: "Simulation") -> str:
    """Describe the motion of the driving shaft and its duration."""
    motion, hertz = run.scenario.motion, float(run.scenario.sampling.controller_hz)
    time = f"{float(run.case.motion.duration_s):g} s at {hertz:g} Hz"
    if not isinstance(motion, Reversal | Sine):
        file = "" if run.spec is None else f" in {run.spec.motion.file}"
        return f"{name_of(motion, {'recorded': RecordedMotion})}{file}, {time}"
    angle, speed = abs(float(motion.reversal_deg)), float(motion.speed_rpm)
    shape = motion.shape.replace("_", "-")
    return f"{_EVENTS[motion.event]} at {angle:g}°, {shape} of {speed:g} rpm, {time}"


def _detection(run: "Simulation") -> str:
    """Return as text when the first command to close came after the braking, and at which angle."""
    t = run.tally
    if np.isnan(t.detection):
        return "never"
    after = float(t.detection_s - run.case.motion.braking_s)
    delay = f"{1e3 * after:.4g} ms" if after < 1 else f"{after:.4g} s"
    text = f"{delay} after the motor brakes, at {t.detection / DEG:.3f}°"
    if not run.turns:
        return text
    angle, _ = run.place(run.case.motion.turn_s)
    return f"{text}, {abs(angle - t.detection) / DEG:.3f}° before the turn"


def _jump(run: "Simulation") -> str:
    """Return as text the jump of the transmission error, as `jump_deg` and `jump_paper_deg`."""
    metrics = _numeric_metrics(run)
    if "jump_deg" not in metrics:
        return "none: the other flank is never met"
    text = f"{_angle(metrics['jump_deg'])} at {run.tally.crossing / DEG:.3f}°"
    paper = metrics.get("jump_paper_deg")
    if metrics["largest_jump_deg"] > 1.01 * metrics["jump_deg"] + NEAR_DEG:
        text += f"; the largest of the run {_angle(metrics['largest_jump_deg'])}"
    return text if paper is None else f"{text}; the paper's, before minus after, {paper:+.5f}°"


def flanks_text(spec: ScenarioSpec, closes: bool = True) -> str:
    """Return as text where the flanks of plant and controller come from."""
    given = f"[eccentricities] ({spec.flanks})"
    plant = spec.plant_map if spec.rig is None else spec.rig.run
    plant, believed = (
        given if name == ECCENTRICITIES else f"map {name}"
        for name in (plant, believed_flanks(spec))
    )
    if not closes:
        return plant
    own = " with [map]" if plain_table(spec.map) else ""
    return f"{plant}; the controller believes {believed}{own}"


def _numeric_metrics(run: "Simulation") -> dict[str, float]:
    """Return the metrics that have a numeric value."""
    return {name: value for name, value in run.metrics.items() if isinstance(value, float)}


def _angle(value: float) -> str:
    """Format an angle given in degrees."""
    shown = max(value, 0.0) if value > -NEAR_DEG else value  # no −0
    return f"{shown:.5f}° ({shown * DEG / ARCSEC:.1f}″)"


@dataclass(frozen=True)
class Simulation(PlottedResult):
    """One simulated run.

    **Arguments**
    - `scenario`, `case`: the scenario as objects, and what is computed from it.
    - `spec`: the scenario as a file has it; None for a run of objects.
    - `accumulators`: running metrics at the end, in rad, mm and s.
    - `trace`: samples, arrays of shape (n,) in s, rad and mm, or None.
    """

    scenario: Scenario
    spec: ScenarioSpec | None
    case: Case
    accumulators: Accumulators
    trace: Sample | None = None

    @cached_property
    def tally(self) -> Any:
        """Running metrics at the end as Python numbers, in rad, mm and s; 0 and 1 for truths."""
        return jax.tree.map(float, self.accumulators)

    @cached_property
    def numbers(self) -> tuple[dict[str, float], Outcome]:
        """Metrics of `metrics_of`, NaN for events that did not happen, and the outcome."""
        values, code = metrics_of(self.case, self.accumulators)
        return {name: float(values[name]) for name in METRICS}, OUTCOMES[int(code)]

    @property
    def metrics(self) -> dict[str, float | str | None]:
        """Metrics of `metrics_of` and the outcome; None for events that did not happen."""
        values = {name: _finite(value) for name, value in self.numbers[0].items()}
        return values | {"outcome": self.outcome}

    @property
    def outcome(self) -> Outcome:
        """Outcome of the run. If several apply, the first in the order of `Outcome` counts."""
        return self.numbers[1]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences about the run that a reader must not overlook."""
        return tuple(_sentences(self))

    @property
    def allowed(self) -> float:
        """Gap that the margin of the controller leaves, rad, with a tolerance."""
        margin_mm = getattr(self.scenario.controller, "margin_mm", Acceleration().margin_mm)
        margin = float(margin_mm) * float(self.case.bounds.closing_sum)
        return NEAR_DEG * DEG + 1.01 * max(margin, 0.0)

    @property
    def changes_early(self) -> bool:
        """Whether the flanks change before the turn, with more than the allowed gap."""
        return self.tally.early_jump > self.allowed

    @property
    def controller(self) -> str:
        """Name of the controller in the scenario, or the class name of a controller of the user."""
        return name_of(self.scenario.controller, CONTROLLERS)

    @property
    def plant(self) -> str:
        """Name of the plant in the scenario, or the class name of a plant of the user."""
        return name_of(self.scenario.plant, PLANTS)

    @property
    def servo(self) -> bool:
        """Whether a servo motor turns the driving shaft, which then can deviate from its motion."""
        return self.case.drive is not None

    @property
    def turns(self) -> bool:
        """Whether the motion turns back."""
        return float(self.case.motion.turn_s) < float(self.case.motion.duration_s)

    def place(self, time_s: Float[Number, ""] | float) -> tuple[float, float]:
        """Return the driving angle of the motion and its backlash at a time in s, both in rad.

        The backlash is that for an axial displacement of zero.
        """
        angle = self.case.motion.at(float(time_s)).angle
        return float(angle), float(self.case.bounds.gap(angle))

    def columns(self) -> dict[str, Float[np.ndarray, " n"]]:
        """Return the samples as a table, column name → values.

        All angles are converted from rad to degrees: `driving_deg`, `te_deg`, `te_shown_deg`,
        `flank_a_deg`, `flank_b_deg` and `output_error_deg`, the deviation of the driven shaft from
        i φ₁ of the reference since the first sample. The other columns are `time_s`, `speed_rad_s`,
        `acceleration_rad_s2`, `command_mm` and `axial_mm`. If the drive blocks during the run, the
        table ends at this time.

        **Raises** `ValueError` for a run without a trace.
        """
        if self.trace is None:
            raise ValueError(
                "Argument `trace_every` must be at least 1 for a trace, but this run kept none."
            )
        s, blocked_s = self.trace, self.tally.blocked_s
        angles = {"driving": s.driving, "te": s.error, "te_shown": s.shown}
        angles |= {"flank_a": s.lower, "flank_b": s.upper, "output_error": s.output - s.output[0]}
        table = (
            {"time_s": s.time}
            | {f"{name}_deg": values / DEG for name, values in angles.items()}
            | {"speed_rad_s": s.speed, "acceleration_rad_s2": s.acceleration}
            | {"command_mm": s.command, "axial_mm": s.reached}
        )
        kept = s.time <= (np.inf if np.isnan(blocked_s) else blocked_s)
        return {name: np.asarray(values)[kept] for name, values in table.items()}

    def to_json(self) -> dict:
        """Return the object of schema `vttig.simulate/1`."""
        t, motion = self.tally, self.case.motion
        angle, gap = self.place(motion.turn_s)
        turn = {
            "time_s": float(motion.turn_s),
            "driving_deg": angle / DEG,
            "backlash_deg": gap / DEG,
        }
        return {
            "schema": "vttig.simulate/1",
            "pair": self.scenario.pair.name,
            "controller": self.controller,
            "metrics": self.metrics,
            "duration_s": float(motion.duration_s),
            "turn": turn if self.turns else None,
            "crossing_deg": _finite(t.crossing / DEG),
            "crossing_s": _finite(t.crossing_s),
            "following_error_deg": t.following_error / DEG if self.servo else None,
            "false_closings": int(t.false_closings),
            "blocked_s": _finite(t.blocked_s),
            "samples": int(t.samples),
            "remarks": list(self.remarks),
            "scenario": None if self.spec is None else spec_table(self.spec),
        }

    def __str__(self) -> str:
        head = key_values(list(_rows(self)), title=self.scenario.pair.name or "simulation")
        notes = ["", "notes:", *(f"  {one}" for one in self.remarks)]
        return "\n".join([head, *notes]) if self.remarks else head


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None

"""What a simulation says: metrics, outcome, remarks, and a trace where one was asked for."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from ..base.arrays import Number
from ..base.units import DEG
from ..pair.gears import GearPair
from .case import Case, Sample
from .controller import NoController
from .simulation_text import sentences, simulation_text
from .spec import ScenarioSpec, spec_table
from .tally import Tally

Outcome = Literal["ok", "bound", "missed", "stroke", "slow"]
"""`bound`: the drive stands between both flanks. `missed`: the controller did not see the motor
brake. `stroke`: the actuator was asked for more than it has. `slow`: it was still on its way when
the motion turned."""

_NEAR_MM = 1e-4
"""mm within which the actuator has arrived."""


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
    tally: Tally
    trace: Trace | None = None

    @property
    def metrics(self) -> dict[str, float | str | None]:
        """The metrics of the contract; None for what did not happen.

        - `te_mean_deg`, `te_max_deg`, `te_min_deg`: of the transmission error the encoders show.
        - `jump_deg`: TE at the first contact of the other flank less that of the old flank at the
          same driving angle; `jump_paper_deg`: last sample on the old flank less the first after
          that contact, as the paper reads its curves.
        - `axial_step_deg`: TE by which closing pushes the driven gear on the flank that carries.
        - `detection_deg`, `detection_delay_s`: driving angle of the first command to close, and
          the time since the motor began to brake.
        - `residual_gap_deg`: backlash left when the motion turns.
        - `interference_mm`: most by which the actuator wanted further than the closed gap let it.
        - `actuator_travel_mm`: its way to and fro.

        The last two and the axial step are those of the reversal: they end when the gap is opened
        again after it. Of a motion that never turns back they are those of the whole run.
        """
        t = self.tally
        carrying = 0 if float(self.case.sense) > 0 else 1
        values = {
            "te_mean_deg": float(t.total / t.samples) / DEG,
            "te_max_deg": float(t.highest) / DEG,
            "te_min_deg": float(t.lowest) / DEG,
            "jump_deg": float(self.case.sense * t.gap) / DEG,
            "jump_paper_deg": float(t.before - t.after) / DEG,
            "axial_step_deg": float(t.farthest * self.case.bounds.closing[carrying]) / DEG,
            "detection_deg": float(t.detection) / DEG,
            "detection_delay_s": float(t.detection_s - self.case.motion.braking_s),
            "residual_gap_deg": float(t.left) / DEG,
            "interference_mm": float(t.interference),
            "actuator_travel_mm": float(t.travel),
        }
        return {name: _finite(value) for name, value in values.items()} | {"outcome": self.outcome}

    @property
    def outcome(self) -> Outcome:
        """How it ended; the first that holds of bound, missed, stroke, slow, ok."""
        t = self.tally
        if bool(t.blocked):
            return "bound"
        idle = isinstance(self.case.controller, NoController)
        if self.turns and not idle and np.isnan(t.detection):
            return "missed"
        if float(t.asked) > float(self.case.actuator.stroke) + _NEAR_MM:
            return "stroke"
        return "slow" if float(t.short) > _NEAR_MM else "ok"

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a reader must not overlook, in sentences."""
        return tuple(sentences(self))

    @property
    def controller(self) -> str:
        """Name of the controller; that of its class where it is one of your own."""
        own = type(self.case.controller)
        ours = own.__module__.rpartition(".")[0] == __name__.rpartition(".")[0]
        return self.spec.controller if ours else own.__name__

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

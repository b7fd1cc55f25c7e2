"""What a simulation says: metrics, outcome, remarks, and a trace where one was asked for."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..base.arrays import Number
from ..base.units import DEG
from ..pair.gears import GearPair
from .case import Case, Sample
from .drive import Prescribed
from .metrics import Outcome, facts_of, metrics_of, outcomes_of
from .simulation_text import sentences, simulation_text
from .spec import ScenarioSpec, spec_table
from .tally import Tally


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
        ours = own.__module__.rpartition(".")[0] == __name__.rpartition(".")[0]
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

"""The runs of the paper's Figs. 16–20, simulated and set beside its Table 3."""

import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..base.files.text_tables import listed, text_table
from ..base.units import DEG
from ..control.scenario.scenario import EccentricityTable
from ..control.simulation.result import Simulation
from ..pair.gear_pair import GearPair
from ..plotting.paper_run import plot_paper_run
from ..plotting.save import png
from ..rig.paper import paper_eccentricities, paper_pair
from .simulations import simulate

CONTROLLERS = ("none", "acceleration", "predictive")
TABLE = "table.md"
"""File of the text."""


def printed_tables() -> dict[str, Any]:
    """Return Tables 1 and 3 of the paper as they are printed; see the file."""
    return tomllib.loads(Path(__file__).with_name("paper_printed.toml").read_text("utf-8"))


@dataclass(frozen=True)
class PaperRun:
    """One run of the paper: what its Table 3 prints, and what is simulated.

    - `figure`: number of its figure. - `speed_rpm`: of the driving gear.
    - `reversal_deg`: driving angle of the turn.
    - `printed`: "experiment" or "simulation" → "without_control" or "with_control" → name of the
      metric → value. - `simulated`: controller → run.
    """

    figure: int
    speed_rpm: int
    reversal_deg: int
    printed: dict[str, dict[str, dict[str, float]]]
    simulated: dict[str, Simulation]

    def __str__(self) -> str:
        return f"{self.speed_rpm} rpm to {self.reversal_deg}°, Fig. {self.figure}"


@dataclass(frozen=True)
class PaperRuns:
    """The five runs of the paper; the text has them beside Table 3, with what does not follow."""

    pair: GearPair
    runs: tuple[PaperRun, ...]

    def __str__(self) -> str:
        te = ["", "mean", "max", "min", "range", "jump", "as read"]
        reversal = ["", ("left at turn", "°"), ("jump", "°"), ("met at", "°")]
        reversal += [("axial step", "°"), ("closes at", "°"), ("delay", "ms"), ("too far", "mm")]
        early = [
            f"{run}: the flanks change before the turn with {', '.join(names)}; the driven shaft"
            " overruns when the motor brakes."
            for run in self.runs
            if (names := [name for name, one in run.simulated.items() if one.changes_early])
        ]
        return "\n\n".join(
            [
                *early,
                "TE of the whole runs beside Table 3, in degrees",
                text_table([row for run in self.runs for row in _te_rows(run)], te),
                "The reversals, simulated",
                text_table(
                    [row for run in self.runs for row in _reversal_rows(run)],
                    [*reversal, "outcome"],
                ),
                *listed("what does not follow from Table 2", self.remarks),
            ]
        )

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences about what Table 3 prints and the eccentricities of Table 2 do not allow."""
        rig, per_mm = paper_eccentricities(), 1 / float(self.pair.base_radii[1, 0]) / DEG
        rows = [row for run in self.runs for of in run.printed.values() for row in of.values()]
        means = [row["te_mean_deg"] for row in rows]
        ranges = sorted(row["te_max_deg"] - row["te_min_deg"] for row in rows)
        own: list[dict[str, Any]] = [run.simulated["none"].metrics for run in self.runs]
        slow, fast = self.runs[:2]
        turned = (fast.reversal_deg - slow.reversal_deg) * float(self.pair.ratio) * DEG
        span = 4 * per_mm * float(rig.driven_mm) * abs(np.sin(turned / 2))
        span *= float(np.sin(self.pair.working_pressure_angles[0]))
        jumps = " and ".join(
            f"{abs(_jump(fast, source) - _jump(slow, source)):.4f}°" for source in slow.printed
        )
        most = 2 * per_mm * float(rig.driving_mm + rig.driven_mm)
        widest = max(m["te_max_deg"] - m["te_min_deg"] for m in own)
        return (
            f"The TE of one flank cannot change by more than 2K(e₁ + e₂) = {most:.4f}°, whatever"
            f" the phases; Table 3 has ranges of {ranges[0]:.4f}° to {ranges[-1]:.4f}°, and the"
            f" lowest one lacks a minus sign (the others: {ranges[1]:.4f}° and more). Both flanks"
            f" and the open gap together give {widest:.4f}° here.",
            f"The means here are {min(m['te_mean_deg'] for m in own):+.4f}° to"
            f" {max(m['te_mean_deg'] for m in own):+.4f}° without control; those of Table 3 are"
            f" {min(means):+.4f}° to {max(means):+.4f}°.",
            f"{slow.reversal_deg}° and {fast.reversal_deg}° are whole turns of the driving gear:"
            f" the backlash there differs by {span:.4f}° at most, for any phase of e₂. The jumps"
            f" of Table 3 differ by {jumps}.",
        )

    def to_json(self) -> dict[str, Any]:
        """Return the object of schema `vttig.paper/1`."""
        return {
            "schema": "vttig.paper/1",
            "pair": self.pair.name,
            "runs": [
                {
                    "figure": run.figure,
                    "speed_rpm": run.speed_rpm,
                    "reversal_deg": run.reversal_deg,
                    "printed": run.printed,
                    "simulated": {name: one.to_json() for name, one in run.simulated.items()},
                }
                for run in self.runs
            ],
            "remarks": list(self.remarks),
        }

    def files(self) -> dict[str, bytes]:
        """Return the table and the picture of each run by file name; the runs need traces."""
        drawn = {
            f"fig_{run.figure}.png": png(plot_paper_run(run.simulated, str(run), run.printed))
            for run in self.runs
        }
        return drawn | {TABLE: f"```text\n{self}\n```\n".encode()}


def simulate_paper(
    trace_every: int = 0, progress: Callable[[], object] = lambda: None
) -> PaperRuns:
    """Simulate the five runs of the paper's Figs. 16–20, each with three controllers.

    The gears are those of Table 1 and the eccentricities those of Table 2. Speeds, turns and the
    standstill are printed; everything else has the default value of a scenario, and no value was
    chosen to bring the runs and Table 3 together.

    **Arguments**
    - `trace_every`: see `vttig_jax.simulate`. - `progress`: is called after each of 15 runs.
    """
    pair, rig = paper_pair(), paper_eccentricities()
    eccentricities = {
        name: float(getattr(rig, name)) for name in EccentricityTable.__struct_fields__
    }

    def simulated(motion: dict[str, float], controller: str) -> Simulation:
        scenario = {"eccentricities": eccentricities, "motion": motion, "controller": controller}
        scenario["pair"] = "pair.toml"  # a scenario names one; `pair` takes its place
        found = simulate(scenario, pair, trace_every=trace_every)
        progress()
        return found

    runs = []
    for (speed, turn, figure), printed in _printed_runs().items():
        motion = {"speed_rpm": float(speed), "reversal_deg": float(turn)}
        results = {name: simulated(motion, name) for name in CONTROLLERS}
        runs.append(PaperRun(figure, speed, turn, printed, results))
    return PaperRuns(pair, tuple(runs))


def _printed_runs() -> dict[tuple[int, int, int], dict[str, Any]]:
    """Return (speed in rpm, turn in degrees, figure) → rows of Table 3, as in `PaperRun`."""
    found: dict[tuple[int, int, int], dict[str, Any]] = {}
    for row in printed_tables()["table_3"]:
        for source, turn in row["reversal_deg"].items():
            names: tuple[str, ...] = ("te_mean_deg", "te_max_deg", "te_min_deg")
            place = row["speed_rpm"], turn, row["figure"][source]
            of: dict[str, dict[str, float]] = {
                control: dict(zip(names, row[control][source], strict=True))
                for control in ("without_control", "with_control")
            }
            of["without_control"]["jump_deg"] = row["backlash_deg"][source]
            found.setdefault(place, {})[source] = of
    return found


def _jump(run: PaperRun, source: str) -> float:
    return run.printed[source]["without_control"]["jump_deg"]


def _te_rows(run: PaperRun) -> Iterator[tuple[str | None, ...]]:
    yield (str(run), *[""] * 6)
    for control, controllers in (
        ("without_control", CONTROLLERS[:1]),
        ("with_control", CONTROLLERS[1:]),
    ):
        for source, of in run.printed.items():
            yield f"printed: {source}, {control.replace('_', ' ')}", *_te_cells(of[control])
        for name in controllers:
            yield f"simulated here: {name}", *_te_cells(run.simulated[name].metrics)


def _te_cells(values: dict[str, Any]) -> Iterator[str | None]:
    mean, most, least = (values[f"te_{name}_deg"] for name in ("mean", "max", "min"))
    yield from (f"{value:+.4f}" for value in (mean, most, least))
    read = values.get("jump_paper_deg")
    numbers = most - least, values.get("jump_deg"), None if read is None else -read
    yield from (_shown(value, 4) for value in numbers)


def _reversal_rows(run: PaperRun) -> Iterator[tuple[str | None, ...]]:
    yield (str(run), *[""] * 8)
    for controller, found in run.simulated.items():
        metrics: dict[str, Any] = found.metrics
        delay = metrics["detection_delay_s"]
        yield (
            controller,
            _shown(metrics["residual_gap_deg"], 5),
            _shown(metrics["jump_deg"], 5),
            _shown(found.to_json()["crossing_deg"], 1),
            _shown(metrics["axial_step_deg"], 5),
            _shown(metrics["detection_deg"], 2),
            _shown(None if delay is None else 1e3 * delay, 0),
            _shown(metrics["interference_mm"], 4),
            found.outcome,
        )


def _shown(value: float | None, places: int) -> str | None:
    """Return a number with so many decimals and without −0; None stays None."""
    return None if value is None else f"{value:z.{places}f}"

"""The base case of the simulator's benchmark, lanes of it, and what else is measured beside it."""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from vttig_jax.control.scenario.spec import ScenarioSpec, parse_scenario_spec, with_values
from vttig_jax.control.simulation.case import Case
from vttig_jax.control.simulation.prepare import Maps, motion_of, prepared_case
from vttig_jax.control.simulation.simulate import periods_of
from vttig_jax.control.sweeps.sweep import Lanes, compiled_s, mesh_of
from vttig_jax.pair.gear_pair import Eccentricities
from vttig_jax.rig.paper import paper_eccentricities, paper_pair, paper_rig

LANES = 512
CLOSE = 1e-9
"""Numbers that are compared before anything is timed differ by this at most."""

SPEED_RPM = 57.4637129
"""A speed at which no reading of steady running falls on the border of two counts, as many do at
round speeds: there the last bit of a sum decides, and two programs add in two orders."""

BASE: Mapping[str, Any] = {
    "flanks": "closed",
    "motion.speed_rpm": SPEED_RPM,
    "motion.dwell_s": 0.3,
}
PAIR = paper_pair()
RIG = {
    field.name: float(getattr(paper_eccentricities(), field.name))
    for field in fields(Eccentricities)
    if field.name != "axial_mm"
}


def spec_of(values: Mapping[str, Any]) -> ScenarioSpec:
    """The base case with other values for dotted keys."""
    table = {"pair": "pair.toml", "eccentricities": RIG}
    return with_values(parse_scenario_spec(table), {**BASE, **values})


def cases_of(
    lanes: int, values: Mapping[str, Any] = BASE, turns: tuple[float, float] = (360.0, 720.0)
) -> list[Case]:
    """Cases that differ in the angle where they turn, from the first to the last of `turns` deg.

    The map "rig" has mesh orders too.
    """
    maps, places = Maps({"rig": paper_rig().flank_model()}), np.linspace(*turns, lanes)
    specs = [spec_of({**values, "motion.reversal_deg": float(x)}) for x in places]
    _, one = prepared_case(specs[0], PAIR, maps=maps)
    return [replace(one, motion=motion_of(spec.motion, Path()).pieces) for spec in specs]


class BatchRunner:
    """Runner of cases side by side on some devices, and the time in which it has compiled."""

    def __init__(self, devices: Sequence[Any]) -> None:
        self._mesh, self.compile_s = mesh_of(devices), 0.0

    def run(self, batch: Lanes, periods: int) -> tuple[Any, Any]:
        """Run so many periods of every lane."""
        before = compiled_s()
        found = batch.run(np.full(width_of(batch), periods), self._mesh)
        self.compile_s += compiled_s() - before
        return found


def stack_of(cases: Sequence[Case], apart: bool = False) -> Lanes:
    """Cases side by side as `sweep` has them; `apart`: every number is a lane's own."""
    differs = jax.tree.map(lambda *x: apart or not np.array_equal(x[0], x[-1]), *cases)
    stacked = jax.tree.map(lambda *x: np.stack([np.asarray(one) for one in x]), *cases)
    return Lanes(eqx.filter(stacked, differs), eqx.filter(cases[0], differs, inverse=True))


def width_of(stack: Lanes) -> int:
    """Number of lanes."""
    return jax.tree.leaves(stack.mapped)[0].shape[0]


def periods_for(cases: Sequence[Case]) -> int:
    """Periods of the longest run."""
    return max(periods_of(case.motion, case.period) for case in cases)


def ns_per_lane_step(
    lanes: BatchRunner, stack: Lanes, substeps: int, periods: int, rounds: int
) -> list[float]:
    """ns of process time of each round; compiled before."""
    lanes.run(stack, max(1024 // substeps, 1))
    steps = width_of(stack) * periods * substeps
    return [1e9 * process_seconds(lambda: lanes.run(stack, periods)) / steps for _ in range(rounds)]


def process_seconds(function: Callable[[], Any]) -> float:
    """Processor time of a call in all threads, which other processes hardly change."""
    clock = time.process_time()
    function()
    return time.process_time() - clock


def seconds(function: Callable[[], Any]) -> float:
    """Wall time of a call."""
    clock = time.perf_counter()
    function()
    return time.perf_counter() - clock


def summary(values: Sequence[float]) -> dict[str, float]:
    """Median, least and number of some measurements."""
    return {
        "median": round(statistics.median(values), 3),
        "least": round(min(values), 3),
        "rounds": len(values),
    }


def ratio(one: Sequence[float], other: Sequence[float]) -> float:
    """Median of the ratios of paired rounds."""
    return round(statistics.median(a / b for a, b in zip(one, other, strict=True)), 3)

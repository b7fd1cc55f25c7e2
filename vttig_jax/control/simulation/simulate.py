"""Simulation of one case from its first period to its last."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...base.errors import ScenarioError
from ...base.runtime import require_x64
from ...pair.gear_pair import Drive, GearPair, load_pair
from ..controllers.controller import Controller
from ..motion.motion import Motion
from ..scenario.axes import SCENARIO_FILE
from ..scenario.scenario import Scenario
from ..scenario.spec import ScenarioSpec, load_scenario_spec
from .build import Maps, case_of, spec_of
from .case import Case, Sample, State, initial_state, run_periods, trace_periods
from .prepare import prepared
from .result import Simulation

CHUNK = 1024
"""Plant steps in one compiled call; a chosen value.

Between two calls Ctrl-C can interrupt the run; much shorter calls would be slow."""


def simulate(
    scenario: str | Path | ScenarioSpec | Scenario,
    pair: GearPair | Drive | None = None,
    *,
    folder: str | Path | None = None,
    controller: Controller | None = None,
    maps: Maps = Maps(),
    trace_every: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Simulation:
    """Simulate the run of one scenario: the gear drive, its motion and its controller.

    **Arguments**
    - `scenario`: a scenario file (TOML), its specification, or a `Scenario`, which goes with the
      arguments `trace_every` and `progress` alone.
    - `pair`: gears instead of the pair file that the scenario names.
    - `folder`: folder for relative paths; by default that of the scenario file, or else the working
      folder.
    - `controller`: controller of the user, instead of that of the scenario; see `Controller`.
    - `maps`: flank models of the run folders and map files that the scenario names;
      `vttig_jax.simulate` reads them.
    - `trace_every`: number of periods from one sample of the trace to the next; 0 for no trace.
    - `progress`: is called with the numbers of finished and of all periods.

    **Raises** `ScenarioError` with file and key, `PairError`, and `ValueError` without 64-bit
    floats or for a `trace_every` below 0.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.control import parse_scenario_spec
    >>> from vttig_jax.rig import paper_pair
    >>> vttig_jax.enable_x64()
    >>> rig = {"driving_mm": 0.0226, "driving_phase_deg": 49.5, "driven_mm": 0.0273}
    >>> rig |= {"driven_phase_deg": 79.3, "constant_backlash_deg": 0.038}
    >>> motion = {"reversal_deg": 720.0, "dwell_s": 0.2}
    >>> scenario = {"pair": "pair.toml", "eccentricities": rig, "motion": motion}
    >>> spec = parse_scenario_spec(scenario | {"controller": "predictive"})
    >>> run = vttig_jax.simulate(spec, paper_pair())
    >>> run.outcome, round(run.metrics["residual_gap_deg"], 5)
    ('ok', 0.00075)

    ```
    """
    require_x64("simulate")
    if trace_every < 0:
        raise ValueError(f"Argument `trace_every` must be at least 0, but is {trace_every}.")
    spec, pair, case = specified_case(scenario, pair, folder, controller, maps)
    state, trace = run_in_chunks(case, trace_every, progress)
    return Simulation(spec, pair, case, state.accumulators, trace)


def specified_case(
    scenario: str | Path | ScenarioSpec | Scenario,
    pair: GearPair | Drive | None = None,
    folder: str | Path | None = None,
    controller: Controller | None = None,
    maps: Maps = Maps(),
) -> tuple[ScenarioSpec, GearPair | Drive, Case]:
    """Return the specification, the gears and the case; the arguments are those of `simulate`."""
    if isinstance(scenario, Scenario):
        scenario = scenario if controller is None else replace(scenario, controller=controller)
        return spec_of(scenario), scenario.pair, prepared(scenario)[0]
    source = "" if isinstance(scenario, ScenarioSpec) else str(scenario)
    folder = Path(source).parent if folder is None else Path(folder)
    spec = scenario if isinstance(scenario, ScenarioSpec) else load_scenario_spec(scenario)
    with SCENARIO_FILE.error_context(source):
        pair = load_gears(folder / spec.pair) if pair is None else pair
        return spec, pair, case_of(spec, pair, folder, controller, maps)


def load_gears(path: Path) -> GearPair | Drive:
    """Read the gears of a pair file; **raises** `ScenarioError` for a missing file."""
    if not path.is_file():
        raise ScenarioError(
            f"there is no file {path}; name the pair file, relative to the scenario.", where="pair"
        )
    return load_pair(path)


def periods_of(motion: Motion, period: Any) -> int:
    """Return the number of periods (s) of the controller in a run of a motion."""
    return int(np.floor(float(motion.duration_s) / float(period) * (1 + 1e-12))) + 1


_trace_periods = eqx.filter_jit(trace_periods)
_run_periods = eqx.filter_jit(run_periods)


def run_in_chunks(
    case: Case, trace_every: int = 0, progress: Callable[[int, int], None] | None = None
) -> tuple[State, Sample | None]:
    """Run a case in chunks, between which Ctrl-C can interrupt it; return last state and trace.

    `trace_every`: see `simulate`. `progress` is called with the number of finished periods and the
    number of all periods.
    """
    periods = periods_of(case.motion, case.period)
    state, samples = initial_state(case), list[Sample]()
    chunk = max(CHUNK // case.substeps, 1)
    for first in range(0, periods, chunk):
        numbers = first + jnp.arange(chunk)
        if trace_every:
            state, sample = _trace_periods(case, state, numbers)
            chosen = np.flatnonzero((np.arange(first, first + chunk) % trace_every) == 0)
            chosen = chosen[first + chosen < periods]
            samples.append(
                jax.tree.map(lambda values, rows=chosen: np.asarray(values)[rows], sample)
            )
        else:
            state = _run_periods(case, state, numbers)
        if progress is not None:
            progress(min(first + chunk, periods), periods)
    if not trace_every:
        return state, None
    return state, jax.tree.map(lambda *values: np.concatenate(values), *samples)

"""Short sweeps of the paper's rig."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from tests.control.scenarios import PAIR, SHORT
from tests.control.texts import MINIMAL
from vttig_jax.control import Maps
from vttig_jax.control.scenario.spec import ScenarioSpec, parse_scenario_spec
from vttig_jax.control.simulation.case import METRICS
from vttig_jax.control.sweeps import sweep as sweep_work
from vttig_jax.control.sweeps.table import SweepTable
from vttig_jax.kinematics import closed_model
from vttig_jax.pair.gear_pair import Eccentricities

CONTROLLERS = ("none", "acceleration", "predictive")
AXES: Mapping[str, Any] = {
    "motion.reversal_deg": [200.0, 250.0, 300.0, 360.0],
    "controller": list(CONTROLLERS),
}


def sweep_spec(axes: Mapping[str, Any] = AXES, **settings: Any) -> ScenarioSpec:
    """The short motion with these axes, and other values for dotted keys (with __ for the dot).

    `rig` takes the place of the eccentricities.
    """
    given = {k: v for k, v in MINIMAL.items() if k != "eccentricities" or "rig" not in settings}
    table: dict[str, Any] = {**given, "sweep": dict(axes)}
    values = {**SHORT, **{name.replace("__", "."): value for name, value in settings.items()}}
    for name, value in values.items():
        above, _, last = name.rpartition(".")
        place = table.setdefault(above, {}) if above else table
        place[last] = value
    return parse_scenario_spec(table)


def drawn(believed: Eccentricities, *rigs: Eccentricities) -> Maps:
    """Closed maps of drawn rigs, and the map that the controllers believe, of rig.from = "RUN"."""
    draws = [closed_model(PAIR, rig) for rig in rigs]
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *draws)
    return Maps({"RUN": closed_model(PAIR, believed)}, stacked, len(draws))


def small_blocks(cases: int, monkeypatch: Any = None) -> None:
    """Blocks of so many cases of each program; for good where nothing undoes it."""
    change = setattr if monkeypatch is None else monkeypatch.setattr
    change(sweep_work, "_LEAST", cases)
    change(sweep_work, "_MOST", cases)


def table_of(**columns: np.ndarray) -> SweepTable:
    """A table of these axes whose metrics are made from the case number."""
    count = len(next(iter(columns.values())))
    case = np.arange(count)
    metrics = {
        "residual_gap_deg": 0.01 + 1e-4 * case,
        "interference_mm": 1e-3 * case,
        "lost_motion_deg": 0.02 + 1e-5 * case,
    }
    metrics |= {name: 0.1 * metrics["residual_gap_deg"] for name in METRICS if name not in metrics}
    outcome = np.full(count, "ok")
    everything = {"case": case, **columns, **metrics, "outcome": outcome}
    return SweepTable(sweep_spec(), "rig", everything, tuple(columns), 1, 1.0, 1.0, 1)


def assert_close(found: np.ndarray, expected: np.ndarray) -> None:
    """Equal as other blocks, lanes and devices promise it: numbers to 1e-9, the rest exactly."""
    if np.issubdtype(expected.dtype, np.floating):
        largest = float(np.nanmax(np.abs(expected), initial=0.0))
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * largest)
    else:
        np.testing.assert_array_equal(found, expected)

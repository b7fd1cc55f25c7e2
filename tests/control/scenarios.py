"""Short scenarios of the paper's rig, and their runs."""

import math
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from tests.control.texts import MINIMAL
from vttig_jax.base.units import DEG
from vttig_jax.control.controllers.controller import Controller
from vttig_jax.control.scenario.spec import ScenarioSpec, parse_scenario_spec, with_values
from vttig_jax.control.simulation.case import Case
from vttig_jax.control.simulation.prepare import prepared_case
from vttig_jax.control.simulation.result import Simulation
from vttig_jax.control.simulation.simulate import simulate
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.rig.paper import paper_eccentricities, paper_pair

PAIR = paper_pair()
CLOSING = 2 * math.tan(3 * DEG) / 80.0
"""rad of backlash of the paper's pair that a mm of axial displacement takes up, (16)."""

SHORT: Mapping[str, Any] = {
    "motion.reversal_deg": 360.0,
    "motion.dwell_s": 0.2,
    "motion.ramp_s": 0.2,
}
UNQUANTISED: Mapping[str, Any] = {
    "driving_encoder.counts_per_rev": 0,
    "driven_encoder.counts_per_rev": 0,
}
INSTANT: Mapping[str, Any] = {"actuator.speed_mm_s": 1e9, "actuator.acceleration_mm_s2": 1e9}
"""An actuator that is where it is told to be after one period."""


def spec_of(*tables: Mapping[str, Any]) -> ScenarioSpec:
    """The paper's rig with the values of some tables of dotted keys, the last first."""
    values = {name: value for table in tables for name, value in table.items()}
    return with_values(parse_scenario_spec(MINIMAL), values)


def case_of(spec: ScenarioSpec, *inputs: Any, **named: Any) -> Case:
    """The case of a scenario; further arguments are those of `scenario_of`."""
    return prepared_case(spec, *inputs, **named)[1]


def exact_gap(driving_angle: ArrayLike) -> np.ndarray:
    """j of the paper's rig by the exact kinematics: both flanks solved for φ₂, no harmonics."""
    angle = np.asarray(driving_angle, float)
    flat = np.pad(angle.ravel(), (0, -angle.size % 4096))  # one shape: one compilation
    blocks = [np.asarray(_gap(block)) for block in flat.reshape(-1, 4096)]
    return np.concatenate(blocks)[: angle.size].reshape(angle.shape)


@jax.jit
def _gap(angle):
    model = exact_model(PAIR, paper_eccentricities())
    return model.transmission_error(angle, "B") - model.transmission_error(angle, "A")


class HoldShift(Controller):
    """A controller of somebody else: holds one axial displacement from the first period on."""

    shift_mm: Any

    def start(self):
        return ()

    def step(self, state, seen):
        return state, jnp.asarray(self.shift_mm)


def simulated(*tables: Mapping[str, Any], controller: Controller | None = None) -> Simulation:
    """The run of a scenario with its samples."""
    return simulate(spec_of(*tables), PAIR, controller=controller, trace_every=1)


def samples_of(run: Simulation) -> Any:
    assert run.trace is not None
    return run.trace

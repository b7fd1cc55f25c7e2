"""Short scenarios of the paper's rig, and many of them run as one batch."""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from benchmarks.compiler import fast_to_compile
from tests.control.motion_points import at
from tests.control.texts import MINIMAL
from vttig_jax.base.units import DEG
from vttig_jax.control.controllers.controller import Controller
from vttig_jax.control.motion.motion import Motion, MotionPoint
from vttig_jax.control.scenario.spec import ScenarioSpec, parse_scenario_spec, with_values
from vttig_jax.control.simulation.case import Case, initial_state, run_periods
from vttig_jax.control.simulation.prepare import prepared_case
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

LANES = 32
CHUNK = 1024


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
    flat = np.pad(angle.ravel(), (0, -angle.size % _ROOM))  # one shape: one compilation
    blocks = [_exact(block) for block in flat.reshape(-1, _ROOM)]
    return np.concatenate(blocks)[: angle.size].reshape(angle.shape)


_ROOM = 512


@jax.jit
def _exact(angle):
    model = exact_model(PAIR, paper_eccentricities())
    return model.transmission_error(angle, "B") - model.transmission_error(angle, "A")


class HoldShift(Controller):
    """A controller of somebody else: holds one axial displacement from the first period on."""

    shift_mm: Any

    def start(self):
        return ()

    def step(self, state, seen):
        return state, jnp.asarray(self.shift_mm)


class Points(Motion):
    """Some points of a motion, one a step of the plant: all motions share one compiled program."""

    step: Any
    first: Any
    points: Any
    duration_s: Any
    braking_s: Any
    turn_s: Any

    def at(self, time: ArrayLike) -> MotionPoint:
        place = jnp.round(jnp.asarray(time) / self.step).astype(int) - self.first
        return jax.tree.map(lambda values: values[place], self.points)


class Run(NamedTuple):
    """One case that ran, with its samples; `Accumulators` and `Sample` of NumPy arrays."""

    case: Case
    tally: Any
    samples: Any


def together(
    specs: Sequence[ScenarioSpec],
    *,
    controllers: Sequence[Controller | None] = (None,),
    after_turn_s: float = math.inf,
) -> list[Run]:
    """Run cases of one structure, `LANES` at a time, to their end or beyond the latest turn.

    `controllers` are those of the cases in turn, over and over; None: that of the scenario.
    """
    chosen = itertools.cycle(controllers)
    return run_cases(
        [
            case_of(spec, PAIR, controller=controller)
            for spec, controller in zip(specs, chosen, strict=False)
        ],
        after_turn_s,
    )


def run_cases(cases: Sequence[Case], after_turn_s: float = math.inf) -> list[Run]:
    """The same of cases that are ready."""
    runs: list[Run] = []
    for first in range(0, len(cases), LANES):
        runs += _lanes(cases[first : first + LANES], after_turn_s)
    return runs


def _lanes(cases: Sequence[Case], after_turn_s: float) -> list[Run]:
    chunks = -(-max(_periods(case, after_turn_s) for case in cases) // CHUNK)
    moving = _stack([_points(case, chunks) for case in cases])
    still = _stack([eqx.tree_at(lambda case: case.motion, case, None) for case in cases])
    states: Any = eqx.filter_vmap(initial_state)(_moved(still, moving, 0))
    kept: list[Any] = []
    for chunk in range(chunks):
        numbers = chunk * CHUNK + jnp.arange(CHUNK)
        states, samples = _advanced(_moved(still, moving, chunk), states, numbers)
        kept.append(jax.tree.map(np.asarray, samples))
    tallies = jax.tree.map(np.asarray, states.accumulators)
    joined = jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *kept)

    def in_lane(lane: int, case: Case) -> Run:
        tally = jax.tree.map(lambda values: values[lane], tallies)
        samples = jax.tree.map(lambda values: values[lane, : _periods(case)], joined)
        return Run(case, tally, samples)

    return [in_lane(lane, case) for lane, case in enumerate(cases)]


def _periods(case: Case, after_turn_s: float = math.inf) -> int:
    """Samples of the motion, the first and the last included."""
    motion = case.motion
    end = min(float(motion.duration_s), float(motion.turn_s) + after_turn_s)
    return math.floor(end / float(case.period) * (1 + 1e-12)) + 1


def _points(case: Case, chunks: int) -> Points:
    motion, step = case.motion, np.asarray(case.period / case.substeps)
    points = at(motion, np.arange(chunks * CHUNK * case.substeps + 1) * step)
    ends = map(np.asarray, (motion.duration_s, motion.braking_s, motion.turn_s))
    return Points(step, np.zeros(()), points, *ends)


def _stack(parts: Sequence[Any]) -> Any:
    """As lanes; the last is repeated to fill them."""
    lanes = [*parts, *[parts[-1]] * (LANES - len(parts))]
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(x) for x in leaves]), *lanes)


def _moved(still: Case, moving: Points, chunk: int) -> Case:
    """All cases with the points of one chunk: the same shapes for every run."""
    first = chunk * CHUNK * still.substeps
    last = first + CHUNK * still.substeps + 1
    points = jax.tree.map(lambda values: values[:, first:last], moving.points)
    some = eqx.tree_at(lambda all_: all_.points, moving, points)
    some = eqx.tree_at(lambda all_: all_.first, some, np.full(LANES, first))
    return eqx.tree_at(lambda case: case.motion, still, some, is_leaf=lambda x: x is None)


def _advance_all(cases, states, numbers):
    return eqx.filter_vmap(run_periods, in_axes=(0, 0, None, None))(cases, states, numbers, True)


# The programs that users run are those of `simulate`.
_advanced = eqx.filter_jit(_advance_all, **fast_to_compile())

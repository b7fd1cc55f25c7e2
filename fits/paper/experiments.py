"""The paper's runs: what is simulated of them, and what the kinematics say without a simulation.

The runs are those of `scenario.toml` with the speeds and turns of `printed.toml`. Angles are
degrees of the driven gear unless they are driving angles.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from compare import HERE, PRINTED
from jaxtyping import Float

import vttig_jax
from vttig_jax.base.units import DEG
from vttig_jax.control.scenario.spec import load_scenario_spec, with_values
from vttig_jax.control.simulation.result import Simulation
from vttig_jax.kinematics.backlash_map import chunked

SCENARIO = load_scenario_spec(HERE / "scenario.toml")


def _gears() -> vttig_jax.GearPair:
    found = vttig_jax.load_pair(HERE / SCENARIO.pair)
    assert isinstance(found, vttig_jax.GearPair)
    return found


PAIR = _gears()

CONTROLLERS = ("none", "acceleration", "predictive")
HIGH_DRAG_NM = 0.2
"""Dry friction that keeps the driven shaft on its flank in a ramp of 100 rpm."""


@dataclass(frozen=True)
class Experiment:
    """One run of the paper and where it is printed.

    - `speed_rpm`: of the driving gear. - `reversal_deg`: driving angle of the turn.
    - `figure`: its number. - `printed`: "experiment" and "simulation" as Table 3 has them.
    """

    speed_rpm: int
    reversal_deg: int
    figure: int
    printed: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.speed_rpm} rpm to {self.reversal_deg}°"


def experiments() -> list[Experiment]:
    """The runs of Table 3, one for each speed and turn."""
    found: dict[tuple[int, int, int], tuple[str, ...]] = {}
    for run in PRINTED["table_3"]:
        for source, reversal in run["reversal_deg"].items():
            place = (run["speed_rpm"], reversal, run["figure"][source])
            found[place] = (*found.get(place, ()), source)
    return [Experiment(*place, sources) for place, sources in found.items()]


@cache
def simulated(
    run: Experiment, controller: str, drag_Nm: float = SCENARIO.friction.coulomb_Nm
) -> Simulation:
    """One run with one controller, every period kept."""
    values = {
        "motion.speed_rpm": float(run.speed_rpm),
        "motion.reversal_deg": float(run.reversal_deg),
        "controller": controller,
        "friction.coulomb_Nm": drag_Nm,
    }
    return vttig_jax.simulate(with_values(SCENARIO, values), PAIR, trace_every=1)


def number(run: Experiment, controller: str, name: str) -> float:
    """A metric that is there."""
    value = simulated(run, controller).metrics[name]
    assert isinstance(value, float)
    return value


def backlash(driving_deg: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """j at driving angles by the exact kinematics; nothing of a simulation is in it."""
    rig = SCENARIO.eccentricities
    assert rig is not None
    table = vttig_jax.Eccentricities(
        rig.driving_mm,
        rig.driving_phase_deg,
        rig.driven_mm,
        rig.driven_phase_deg,
        rig.constant_backlash_deg,
    )
    radians = np.asarray(driving_deg) * DEG
    return chunked(lambda piece: vttig_jax.exact_backlash(piece, PAIR, table), radians) / DEG


def degrees_per_mm() -> float:
    """Backlash that a mm of axial displacement closes, (16)."""
    return float(PAIR.taper.sum() / PAIR.reference_radii[1]) / DEG


@dataclass(frozen=True)
class Missed:
    """What a controller misses that closes by another backlash than that of the turn.

    With j(judged) less the margin m closed, j(turn) − j(judged) + m is left where that is positive,
    and the actuator wants further than the gap allows where it is negative. All arrays (n,).

    - `left_deg`: at the turn. - `over_mm`: beyond the closed gap at the turn, as a way of the
      actuator. - `over_on_the_way_mm`: the most from the judgement to the turn.
    """

    left_deg: Float[np.ndarray, " n"]
    over_mm: Float[np.ndarray, " n"]
    over_on_the_way_mm: Float[np.ndarray, " n"]


def missed(turn_deg: Float[np.ndarray, " n"], ahead_deg: float, places: int = 49) -> Missed:
    """Of turns at driving angles, judged by the backlash `ahead_deg` before each of them.

    The way from there to the turn is looked at in so many `places`.
    """
    turn = np.asarray(turn_deg, float)
    way = turn[:, None] - ahead_deg * np.linspace(1.0, 0.0, places)
    gap = backlash(way.ravel()).reshape(way.shape)
    closed = np.maximum(gap[:, 0] - SCENARIO.judgement.margin_mm * degrees_per_mm(), 0.0)
    beyond = np.maximum(closed[:, None] - gap, 0.0) / degrees_per_mm()
    return Missed(np.maximum(gap[:, -1] - closed, 0.0), beyond[:, -1], beyond.max(axis=1))


def judged_ahead(run: Experiment, controller: str) -> float:
    """Driving angle from where a controller closes to the turn."""
    return run.reversal_deg - number(run, controller, "detection_deg")

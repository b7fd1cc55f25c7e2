"""Plants, controllers and the scenario file that names them: one simulated reversal, or many."""

from typing import TYPE_CHECKING

from ..base.facade import lazy_names

if TYPE_CHECKING:
    from .compensation.c_header import c_header as c_header
    from .compensation.compensation import Compensation as Compensation
    from .compensation.map_harmonics import compensation_of as compensation_of
    from .controllers.controller import Command as Command
    from .controllers.controller import Controller as Controller
    from .controllers.controller import Measurement as Measurement
    from .motion.profiles import trapezoid as trapezoid
    from .motion.recorded import recorded as recorded
    from .motion.sine import sine as sine
    from .plants.elastic import mesh_stiffness as mesh_stiffness
    from .plants.plant import Plant as Plant
    from .scenario.spec import load_scenario_spec as load_scenario_spec
    from .scenario.spec import parse_scenario_spec as parse_scenario_spec
    from .scenario.spec import with_values as with_values
    from .simulation.case import Case as Case
    from .simulation.metrics import OUTCOMES as OUTCOMES
    from .simulation.pure_run import CaseRun as CaseRun
    from .simulation.pure_run import build_case as build_case
    from .simulation.pure_run import run as run
    from .simulation.result import Simulation as Simulation
    from .simulation.settings import with_settings as with_settings
    from .simulation.simulate import simulate as simulate
    from .sweeps.sweep import sweep as sweep
    from .sweeps.table import SweepTable as SweepTable
    from .tuning.result import Tuned as Tuned
    from .tuning.tune import tune as tune

_HOMES = {
    "Case": "simulation.case",
    "CaseRun": "simulation.pure_run",
    "Command": "controllers.controller",
    "Compensation": "compensation.compensation",
    "Controller": "controllers.controller",
    "Measurement": "controllers.controller",
    "OUTCOMES": "simulation.metrics",
    "Plant": "plants.plant",
    "Simulation": "simulation.result",
    "SweepTable": "sweeps.table",
    "Tuned": "tuning.result",
    "build_case": "simulation.pure_run",
    "c_header": "compensation.c_header",
    "compensation_of": "compensation.map_harmonics",
    "load_scenario_spec": "scenario.spec",
    "mesh_stiffness": "plants.elastic",
    "parse_scenario_spec": "scenario.spec",
    "recorded": "motion.recorded",
    "run": "simulation.pure_run",
    "simulate": "simulation.simulate",
    "sine": "motion.sine",
    "sweep": "sweeps.sweep",
    "trapezoid": "motion.profiles",
    "tune": "tuning.tune",
    "with_settings": "simulation.settings",
    "with_values": "scenario.spec",
}
"""Public name → submodule."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]

"""Transmission error and backlash of gear pairs, identified from encoder logs, in JAX.

The names below are the stable ones. Each is imported when first used, so `import vttig_jax` itself
imports neither jax nor numpy and configures nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .base.facade import lazy_names

if TYPE_CHECKING:
    from .base.errors import InputError as InputError
    from .base.errors import LogError as LogError
    from .base.errors import NoAnswerError as NoAnswerError
    from .base.errors import NotConvergedError as NotConvergedError
    from .base.errors import PairError as PairError
    from .base.errors import ScenarioError as ScenarioError
    from .base.errors import UsageError as UsageError
    from .base.errors import VttigError as VttigError
    from .base.runtime import enable_x64 as enable_x64
    from .base.runtime import prepare_cpu as prepare_cpu
    from .control.controllers.controller import Controller as Controller
    from .control.plants.plant import Plant as Plant
    from .control.simulation.result import Simulation as Simulation
    from .control.simulation.simulate import simulate as simulate
    from .control.sweeps.sweep import sweep as sweep
    from .control.sweeps.table import SweepTable as SweepTable
    from .control.tuning.tune import tune as tune
    from .geometry.measures.gear_measures import measure_gear as measure_gear
    from .geometry.tooth.surface import tooth_surface as tooth_surface
    from .identify.backlash import backlash_map as backlash_map
    from .identify.fit_result import Fit as Fit
    from .identify.fitting import fit as fit
    from .identify.many.fit_many import fit_many as fit_many
    from .identify.many.table import FitTable as FitTable
    from .identify.settings import FitSettings as FitSettings
    from .identify.store import read_fit as read_fit
    from .kinematics.backlash_map import BacklashMap as BacklashMap
    from .kinematics.flank_model import FlankModel as FlankModel
    from .kinematics.functions import axial_displacement as axial_displacement
    from .kinematics.functions import backlash as backlash
    from .kinematics.functions import exact_backlash as exact_backlash
    from .kinematics.functions import exact_transmission_error as exact_transmission_error
    from .kinematics.functions import transmission_error as transmission_error
    from .kinematics.turn_location import locate as locate
    from .logs.encoder_log import EncoderLog as EncoderLog
    from .logs.inspection import inspect_log as inspect_log
    from .logs.read import read_log as read_log
    from .pair.eccentricities import Eccentricities as Eccentricities
    from .pair.gear_pair import Drive as Drive
    from .pair.gear_pair import Gear as Gear
    from .pair.gear_pair import GearPair as GearPair
    from .pair.load import load_pair as load_pair
    from .plotting.dispatch import plot as plot
    from .posterior.density.prior import Prior as Prior
    from .posterior.planning.noise import PlannedNoise as PlannedNoise
    from .posterior.planning.plan import plan as plan
    from .posterior.planning.shortest_run import shortest_run as shortest_run
    from .posterior.sampler import read_posterior as read_posterior
    from .posterior.sampler import sample as sample
    from .posterior.sampling.stop_rule import Until as Until
    from .posterior.summary.bands import band_map as band_map
    from .posterior.summary.posterior import Posterior as Posterior
    from .posterior.summary.predictive import predictive as predictive
    from .posterior.summary.rig_draws import rig_draws as rig_draws
    from .posterior.summary.route_agreement import agreement as agreement
    from .rig.paper import paper_rig as paper_rig
    from .rig.synthetic import SyntheticRig as SyntheticRig
    from .runs.fit_run import save_fit as save_fit
    from .runs.posterior_run import save_posterior as save_posterior
    from .runs.run import Run as Run
    from .runs.run import open_run as open_run

    __version__: str

_HOMES = {
    "BacklashMap": "kinematics.backlash_map",
    "Controller": "control.controllers.controller",
    "Drive": "pair.gear_pair",
    "Eccentricities": "pair.eccentricities",
    "EncoderLog": "logs.encoder_log",
    "Fit": "identify.fit_result",
    "FitSettings": "identify.settings",
    "FitTable": "identify.many.table",
    "FlankModel": "kinematics.flank_model",
    "Gear": "pair.gear_pair",
    "GearPair": "pair.gear_pair",
    "InputError": "base.errors",
    "LogError": "base.errors",
    "NoAnswerError": "base.errors",
    "NotConvergedError": "base.errors",
    "PairError": "base.errors",
    "PlannedNoise": "posterior.planning.noise",
    "Plant": "control.plants.plant",
    "Posterior": "posterior.summary.posterior",
    "Prior": "posterior.density.prior",
    "Run": "runs.run",
    "ScenarioError": "base.errors",
    "Simulation": "control.simulation.result",
    "SweepTable": "control.sweeps.table",
    "SyntheticRig": "rig.synthetic",
    "Until": "posterior.sampling.stop_rule",
    "UsageError": "base.errors",
    "VttigError": "base.errors",
    "agreement": "posterior.summary.route_agreement",
    "axial_displacement": "kinematics.functions",
    "backlash": "kinematics.functions",
    "backlash_map": "identify.backlash",
    "band_map": "posterior.summary.bands",
    "enable_x64": "base.runtime",
    "exact_backlash": "kinematics.functions",
    "exact_transmission_error": "kinematics.functions",
    "fit": "identify.fitting",
    "fit_many": "identify.many.fit_many",
    "inspect_log": "logs.inspection",
    "load_pair": "pair.load",
    "locate": "kinematics.turn_location",
    "measure_gear": "geometry.measures.gear_measures",
    "open_run": "runs.run",
    "paper_rig": "rig.paper",
    "plan": "posterior.planning.plan",
    "plot": "plotting.dispatch",
    "predictive": "posterior.summary.predictive",
    "prepare_cpu": "base.runtime",
    "read_fit": "identify.store",
    "read_log": "logs.read",
    "read_posterior": "posterior.sampler",
    "rig_draws": "posterior.summary.rig_draws",
    "sample": "posterior.sampler",
    "save_fit": "runs.fit_run",
    "save_posterior": "runs.posterior_run",
    "shortest_run": "posterior.planning.shortest_run",
    "simulate": "control.simulation.simulate",
    "sweep": "control.sweeps.sweep",
    "tooth_surface": "geometry.tooth.surface",
    "transmission_error": "kinematics.functions",
    "tune": "control.tuning.tune",
}
"""The module of each public name, below the package."""


_ROOMS = (
    *("base", "pair", "kinematics", "geometry", "logs", "rig"),
    *("identify", "posterior", "control", "plotting", "runs"),
)

_find, _ = lazy_names(__name__, _HOMES)
__all__ = ["__version__", *_HOMES]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return import_module(f"{__name__}.{name}")
    if name != "__version__":
        return _find(name)
    from importlib.metadata import version

    globals()[name] = version("vttig-jax")
    return globals()[name]


def __dir__() -> list[str]:
    return sorted(__all__)

"""Transmission error and backlash of gear pairs, identified from encoder logs, in JAX.

The names below are the stable ones. Each is imported when first used, so `import vttig_jax` itself
imports neither jax nor numpy and configures nothing.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .base.cpu import prepare_cpu as prepare_cpu
    from .base.precision import enable_x64 as enable_x64
    from .control.simulate import simulate as simulate
    from .control.sweep import sweep as sweep
    from .control.tune import tune as tune
    from .geometry.surface import tooth_surface as tooth_surface
    from .identify.fit import fit as fit
    from .identify.mapping import backlash_map as backlash_map
    from .kinematics.functions import axial_displacement as axial_displacement
    from .kinematics.functions import backlash as backlash
    from .kinematics.functions import exact_backlash as exact_backlash
    from .kinematics.functions import exact_transmission_error as exact_transmission_error
    from .kinematics.functions import transmission_error as transmission_error
    from .logs.encoder_log import EncoderLog as EncoderLog
    from .logs.read import read_log as read_log
    from .pair.eccentricities import Eccentricities as Eccentricities
    from .pair.gears import Drive as Drive
    from .pair.gears import Gear as Gear
    from .pair.gears import GearPair as GearPair
    from .pair.load import load_pair as load_pair
    from .posterior.agreement import agreement as agreement
    from .posterior.bands import band_map as band_map
    from .posterior.plan import plan as plan
    from .posterior.planned_noise import PlannedNoise as PlannedNoise
    from .posterior.posterior import Posterior as Posterior
    from .posterior.predictive import predictive as predictive
    from .posterior.prior import Prior as Prior
    from .posterior.rig_draws import rig_draws as rig_draws
    from .posterior.sample import read_posterior as read_posterior
    from .posterior.sample import sample as sample
    from .posterior.shortest import shortest_run as shortest_run
    from .posterior.stopping import Until as Until

    __version__: str

_HOMES = {
    "Drive": "pair.gears",
    "Eccentricities": "pair.eccentricities",
    "EncoderLog": "logs.encoder_log",
    "Gear": "pair.gears",
    "GearPair": "pair.gears",
    "PlannedNoise": "posterior.planned_noise",
    "Posterior": "posterior.posterior",
    "Prior": "posterior.prior",
    "Until": "posterior.stopping",
    "agreement": "posterior.agreement",
    "axial_displacement": "kinematics.functions",
    "backlash": "kinematics.functions",
    "backlash_map": "identify.mapping",
    "band_map": "posterior.bands",
    "enable_x64": "base.precision",
    "exact_backlash": "kinematics.functions",
    "exact_transmission_error": "kinematics.functions",
    "fit": "identify.fit",
    "load_pair": "pair.load",
    "plan": "posterior.plan",
    "predictive": "posterior.predictive",
    "prepare_cpu": "base.cpu",
    "read_log": "logs.read",
    "read_posterior": "posterior.sample",
    "rig_draws": "posterior.rig_draws",
    "sample": "posterior.sample",
    "shortest_run": "posterior.shortest",
    "simulate": "control.simulate",
    "sweep": "control.sweep",
    "tune": "control.tune",
    "tooth_surface": "geometry.surface",
    "transmission_error": "kinematics.functions",
}
"""The module of each public name, below the package."""


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("vttig-jax")
    elif name in _HOMES:
        from importlib import import_module

        value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*_HOMES, "__version__"])

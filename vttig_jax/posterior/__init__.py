"""Posterior of a fit: sampling, bands, calibration, and the plan of a run."""

from typing import TYPE_CHECKING

from ..base.facade import lazy_names

if TYPE_CHECKING:
    from .calibration.calibrate import calibrate as calibrate
    from .calibration.coverage import coverage as coverage
    from .calibration.scenarios import SCENARIOS as SCENARIOS
    from .density.prior import Prior as Prior
    from .density.profile_likelihood import profile as profile
    from .density.profile_likelihood import profiles as profiles
    from .nuts import sample_nuts as sample_nuts
    from .planning.noise import PlannedNoise as PlannedNoise
    from .planning.plan import plan as plan
    from .planning.shortest_run import shortest_run as shortest_run
    from .sampler import read_posterior as read_posterior
    from .sampler import sample as sample
    from .sampling.convergence import autocorrelation_time as autocorrelation_time
    from .sampling.convergence import r_hat as r_hat
    from .sampling.ensembles import run_ensembles as run_ensembles
    from .sampling.stop_rule import Until as Until
    from .summary.bands import band as band
    from .summary.bands import band_map as band_map
    from .summary.posterior import Posterior as Posterior
    from .summary.predictive import predictive as predictive
    from .summary.rig_draws import rig_draws as rig_draws
    from .summary.route_agreement import agreement as agreement

_HOMES = {
    "PlannedNoise": "planning.noise",
    "Posterior": "summary.posterior",
    "Prior": "density.prior",
    "SCENARIOS": "calibration.scenarios",
    "Until": "sampling.stop_rule",
    "agreement": "summary.route_agreement",
    "autocorrelation_time": "sampling.convergence",
    "band": "summary.bands",
    "band_map": "summary.bands",
    "calibrate": "calibration.calibrate",
    "coverage": "calibration.coverage",
    "plan": "planning.plan",
    "predictive": "summary.predictive",
    "profile": "density.profile_likelihood",
    "profiles": "density.profile_likelihood",
    "r_hat": "sampling.convergence",
    "read_posterior": "sampler",
    "rig_draws": "summary.rig_draws",
    "run_ensembles": "sampling.ensembles",
    "sample": "sampler",
    "sample_nuts": "nuts",
    "shortest_run": "planning.shortest_run",
}
"""Public name → submodule."""

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]

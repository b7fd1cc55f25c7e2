"""Rigs (eccentricities and constant backlash) for the simulator, read from a run folder.

They are read here, so that the simulator does not import the modules of fits and posteriors.
"""

import logging
from pathlib import Path
from typing import TYPE_CHECKING

from ..base.errors import InputError
from .run import Run
from .run_file import CHECKPOINT

logger = logging.getLogger("vttig_jax")

if TYPE_CHECKING:
    from ..identify.fit_result import Fit
    from ..pair.eccentricities import Eccentricities
    from ..posterior.summary.posterior import Posterior


def drawn_rigs(scenario: Path) -> "tuple[tuple[Eccentricities, ...], Eccentricities | None]":
    """Return rigs drawn from a posterior, and the rig at the posterior mean.

    The table [rig] of the sweep file `scenario` names the run folder of the posterior. Without this
    table, return `(), None`.
    """
    from ..control.scenario.spec import load_sweep_spec
    from ..posterior.summary.rig_draws import rig_draws

    table = load_sweep_spec(scenario).rig
    if table is None:
        return (), None
    folder = scenario.parent / table.run
    fit = _fit(folder, scenario.parent / load_sweep_spec(scenario).pair)
    if not (folder / CHECKPOINT).exists():
        raise InputError(
            f"there is no {CHECKPOINT} in {folder}; make it with `vttig sample {folder}`.",
            where=f"{scenario}: rig.from",
        )
    posterior = _posterior(folder, fit)
    return rig_draws(posterior, *table.chosen), posterior.centred_fit.eccentricities()


def fitted_rig(folder: Path, pair: Path) -> "Eccentricities":
    """Return the rig of a run folder: the mean of its posterior, or the fit without a posterior.

    **Raises** `InputError` if the gears of the run differ from those in the pair file.
    """
    from ..identify.fit_result import require_rig

    fit = _fit(folder, pair)
    if (folder / CHECKPOINT).exists():
        fit = _posterior(folder, fit).centred_fit
    require_rig(fit)
    return fit.eccentricities()


def _fit(folder: Path, pair: Path) -> "Fit":
    fit = Run(folder).fit
    if pair.exists():  # the code that uses the pair file reports its errors
        _require_same_gears(fit, pair, folder)
    return fit


def _require_same_gears(fit: "Fit", path: Path, folder: Path) -> None:
    """Raise `InputError` if the pair file at `path` describes other gears than the fit."""
    import numpy as np

    from ..pair.gear_pair import GearPair
    from ..pair.load import load_pair

    pair = load_pair(path)
    if not (isinstance(pair, GearPair) and isinstance(fit.pair, GearPair)):
        return
    for what, unit, of in (
        ("teeth", "", lambda one: (one.driving.teeth, one.driven.teeth)),
        ("module", " mm", lambda one: one.module_mm),
        ("pressure angles", "°", lambda one: one.pressure_angles_deg),
        ("centre distance", " mm", lambda one: one.centre_distance_mm),
    ):
        here, there = (np.ravel(np.asarray(of(one), float)) for one in (pair, fit.pair))
        if not np.allclose(here, there, rtol=1e-9):
            seen, fitted = ("/".join(f"{x:g}" for x in dict.fromkeys(v)) for v in (here, there))
            raise InputError(
                f"not the gears of the run in {folder}: {what} {seen}{unit} here, {fitted}{unit}"
                " there; name the pair file of that run, or give eccentricities of these gears.",
                where=str(path),
            )


def _posterior(folder: Path, fit: "Fit") -> "Posterior":
    from ..posterior.sampler import read_posterior

    posterior = read_posterior(folder / CHECKPOINT, fit, model_draws=0)
    if not posterior.diagnosis.converged:
        logger.warning("the draws have not converged: %s", posterior.diagnosis)
    return posterior

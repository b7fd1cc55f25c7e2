"""Rigs of a run folder, for the simulator, which knows nothing of fits."""

from pathlib import Path
from typing import TYPE_CHECKING

from ..base.errors import InputError
from .fit_verb import CHECKPOINT
from .output import LOGGER
from .run_file import read_run

if TYPE_CHECKING:
    from ..identify.result import Fit
    from ..pair.eccentricities import Eccentricities
    from ..posterior.posterior import Posterior


def drawn_rigs(scenario: Path) -> tuple[tuple["Eccentricities", ...], "Eccentricities | None"]:
    """Draws of the posterior that a sweep file names, and the rig in their middle."""
    from ..control.spec import load_sweep_spec
    from ..posterior.rig_draws import rig_draws

    table = load_sweep_spec(scenario).rig
    if table is None:
        return (), None
    folder = scenario.parent / table.run
    if not (folder / CHECKPOINT).exists():
        raise InputError(
            f"there is no {CHECKPOINT} in {folder}; make it with `vttig sample --out {folder}`.",
            where=f"{scenario}: rig.from",
        )
    posterior = _posterior(folder, _fit(folder))
    return rig_draws(posterior, *table.chosen), posterior.centred_fit.eccentricities()


def fitted_rig(folder: Path) -> "Eccentricities":
    """The rig of a run folder: the mean of its posterior, without one its fit."""
    from ..identify.result import require_rig

    fit = _fit(folder)
    if (folder / CHECKPOINT).exists():
        fit = _posterior(folder, fit).centred_fit
    require_rig(fit)
    return fit.eccentricities()


def _fit(folder: Path) -> "Fit":
    from ..identify.store import read_fit
    from ..pair.load import pair_from_spec

    return read_fit(folder, pair_from_spec(read_run(folder).spec))


def _posterior(folder: Path, fit: "Fit") -> "Posterior":
    from ..posterior.sample import read_posterior

    posterior = read_posterior(folder / CHECKPOINT, fit)
    if not posterior.diagnosis.converged:
        LOGGER.warning("the draws have not converged: %s", posterior.diagnosis)
    return posterior

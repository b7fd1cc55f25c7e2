"""Sampling of a fit's posterior, with draws of the rig that follow from those of emcee."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import InputError
from ..base.runtime import require_x64
from ..base.threads import one_blas_thread
from ..identify.result import Fit
from .chains import FEWEST_ENSEMBLES, Chains, read_chains, run_ensembles
from .checkpoint import read
from .rig_draws import rig_draws, target_of, unit_of
from .summary.posterior import Posterior
from .target import FitTarget
from .until import Progress, Until

_DRAWS = 4000
"""Most draws of the rig; with more the ends of an interval hardly become more certain."""


@one_blas_thread
def sample(
    fit: Fit,
    *,
    seed: int = 0,
    steps: int | None = None,
    until: Until | None = None,
    ensembles: int = FEWEST_ENSEMBLES,
    walkers: int | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: Callable[[Progress], None] | None = None,
) -> Posterior:
    """Sample the posterior of a fit with several independent ensembles of emcee.

    emcee samples the density that `fit` has maximised, `vttig_jax.model.density.log_density`: the
    noise and the widths of the priors, θ, with all coefficients integrated out. Given each θ the
    coefficients are then drawn from their exact normal, and the eccentricities follow from each
    draw by the least squares of the fit. Where the encoders are taken to be perfect, the
    eccentricities are sampled too. The fit's largest density with its Hessian is the start.

    **Arguments**
    - `fit`: result of `fit`, or a fit read back from a run folder.
    - `seed`: seed of the random numbers; equal seeds give equal draws.
    - `steps`: exact number of steps; not together with `until`.
    - `until`: stop rule; by default 1000 effective draws and R-hat ≤ 1.01.
    - `ensembles`, `walkers`: number of independent ensembles (4 or more) and of walkers in each.
    - `checkpoint`: HDF5 file, updated every 5 s.
    - `resume`: continue the checkpoint if there is one, otherwise start a new run; the draws equal
      those of an uninterrupted run.
    - `overwrite`: replace an existing checkpoint.
    - `progress`: function called after every block of steps.

    **Returns** a `Posterior`; check `diagnosis.converged`.

    **Raises** `NoAnswerError` if the density has no finite value near the fit, `UsageError` if an
    overwrite is refused, `InputError` for a checkpoint that is damaged or of another run,
    `ValueError` for wrong arguments and without 64-bit floats.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.rig import paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig()
    >>> result = vttig_jax.fit(rig.log(), rig.pair)
    >>> post = vttig_jax.sample(result, seed=0, steps=100)
    >>> round(post.parameters["driving_eccentricity_mm"].value, 3)
    0.023

    ```
    """
    require_x64("sample")
    target = target_of(fit)
    chains = run_ensembles(
        target,
        ensembles=ensembles,
        walkers=walkers,
        steps=steps,
        until=until,
        seed=seed,
        checkpoint=None if checkpoint is None else Path(checkpoint),
        resume=resume,
        overwrite=overwrite,
        progress=progress,
    )
    return posterior_of(fit, target, chains)


def settings_of(path: str | Path) -> dict[str, Any]:
    """Return `seed`, `ensembles` and `walkers` with which `sample` continues a checkpoint.

    **Raises** `InputError` for a file that is damaged or no checkpoint.
    """
    header = read(Path(path))[0]
    return {name: getattr(header, name) for name in ("seed", "ensembles", "walkers")}


def read_posterior(path: str | Path, fit: Fit) -> Posterior:
    """Return the posterior of a checkpoint file that belongs to this fit.

    **Raises** `InputError` for a file that is damaged or belongs to another fit.
    """
    require_x64("read_posterior")
    chains, target = read_chains(Path(path)), target_of(fit)
    stored = chains.header.identity
    different = [key for key, value in target.identity.items() if stored.get(key) != value]
    if different or chains.header.names != target.names:
        raise InputError(
            f"these draws belong to another fit ({', '.join(different or ['names'])} differ);"
            " sample again with --overwrite.",
            where=str(path),
        )
    return posterior_of(fit, target, chains)


def posterior_of(fit: Fit, target: FitTarget, chains: Chains) -> Posterior:
    """Return the posterior of these chains: one draw of the rig for each of evenly spaced steps."""
    ensembles, steps, walkers, _ = chains.draws.shape
    stride = -(-ensembles * steps * walkers // _DRAWS)
    kept = chains.draws[:, ::stride]
    random = np.random.RandomState(np.random.MT19937(chains.header.seed))
    values, offset, cosine, sine = rig_draws(fit, target, kept.reshape(-1, kept.shape[-1]), random)
    # A sampled parameter is a quantity of the rig already.
    noise, told = len(target.free), target.told.names
    return Posterior(
        fit=fit,
        names=(*told, *target.names[:noise]),
        units=(*(unit_of(fit, name) for name in told), *target.units[:noise]),
        draws=np.concatenate([values.reshape(*kept.shape[:3], -1), kept[..., :noise]], axis=3),
        offset=offset,
        cosine=cosine,
        sine=sine,
        chains=chains,
    )

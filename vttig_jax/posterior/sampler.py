"""From a fit to its posterior: sample the density, and draw the flank model the draws imply."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Key

from ..base.errors import InputError
from ..base.runtime import require_x64
from ..base.threads import one_blas_thread
from ..identify.evidence import Evidence
from ..identify.fit_result import Fit
from ..identify.model.column_layout import OFFSET
from .density.density import FitTarget, fit_target
from .density.likelihood import Likelihood
from .density.prior import Prior
from .sampling.checkpoint import read
from .sampling.ensembles import FEWEST_ENSEMBLES, Chains, Progress, read_chains, run_ensembles
from .sampling.stop_rule import Until
from .summary.posterior import Posterior

MODEL_DRAWS = 2000
"""Draws of the order-complete flank model, spread evenly over the draws of the parameters."""

_CHUNK = 250


@one_blas_thread
def sample(
    fit: Fit,
    *,
    prior: Prior = Prior(),
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

    The density is the restricted likelihood of the compressed logs times the prior: free orders,
    offsets, drift and wind-up are integrated out, eccentricities and encoder errors are Cartesian,
    and the noise (log std of its innovations, partial autocorrelations) is sampled with them. What
    the fit calls undetermined is not sampled.

    **Arguments**
    - `fit`: the result of `fit`, or read back from a run folder.
    - `prior`: see `Prior`; stated in `Posterior.prior`.
    - `seed`: equal seeds give equal draws.
    - `steps`: make exactly so many steps; not with `until`.
    - `until`: the stop rule: chains of 50 autocorrelation times, R-hat between ensembles ≤ 1.01.
    - `ensembles`, `walkers`: independent ensembles (4 or more) and walkers of each.
    - `checkpoint`: HDF5 file brought up to date every 5 s.
    - `resume`: continue it: the draws are those of an uninterrupted run.
    - `overwrite`: replace an existing checkpoint.
    - `progress`: called after every block of steps.

    **Returns** a `Posterior`; ask `diagnosis.converged`.

    **Raises** `NoAnswerError` where nothing is determined or there is no noise, `UsageError` for a
    prior that excludes the fit and a refused overwrite, `InputError` for a checkpoint that is
    damaged or of another run, `ValueError` for wrong arguments and without 64-bit floats.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.rig import paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig()
    >>> result = vttig_jax.fit(rig.log(), rig.pair)
    >>> post = vttig_jax.sample(result, seed=0, steps=1000)
    >>> round(post.parameters["driving_eccentricity_mm"].value, 3)
    0.023

    ```
    """
    require_x64("sample")
    target = fit_target(fit, prior)
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
    """Keywords of `sample` that continue a checkpoint: seed, ensembles, walkers and prior.

    **Raises** `InputError` for a file that is damaged or no checkpoint.
    """
    header = read(Path(path))[0]
    return {
        "seed": header.seed,
        "ensembles": header.ensembles,
        "walkers": header.walkers,
        "prior": _prior_of(header.identity, path),
    }


def read_posterior(path: str | Path, fit: Fit) -> Posterior:
    """The posterior of a checkpoint file that belongs to this fit.

    **Raises** `InputError` for a file that is damaged or belongs to another fit.
    """
    require_x64("read_posterior")
    chains = read_chains(Path(path))
    target = fit_target(fit, _prior_of(chains.identity, path))
    different = [key for key, value in target.identity.items() if chains.identity.get(key) != value]
    if different or chains.names != target.names:
        what = ", ".join(different or ["names"]).replace("_", " ")
        raise InputError(
            f"these draws belong to another fit ({what} differ); sample again with --overwrite.",
            where=str(path),
        )
    return posterior_of(fit, target, chains)


def _prior_of(identity: dict[str, Any], path: str | Path) -> Prior:
    try:
        return Prior(**identity["prior"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"holds no prior of ours ({error}).", where=str(path)) from None


def posterior_of(fit: Fit, target: FitTarget, chains: Chains) -> Posterior:
    """The draws with the flank model they imply."""
    assert fit.evidence is not None  # held by `fit_target`
    flat = chains.flat()
    chosen = np.linspace(0, len(flat) - 1, min(MODEL_DRAWS, len(flat))).round().astype(np.int64)
    coefficients = coefficient_draws(target.density.likelihood, flat[chosen], chains.seed)
    offset, cosine, sine = _flank_models(fit.evidence, coefficients)
    kept = chains.discarded // chains.thin
    return Posterior(
        fit=fit,
        names=chains.names,
        units=chains.units,
        draws=chains.kept,
        log_density=chains.log_density[:, kept:],
        offset=offset,
        cosine=cosine,
        sine=sine,
        chosen=chosen,
        diagnosis=chains.diagnosis,
        prior=target.prior.sentences,
        seed=chains.seed,
        delay_offset_s=fit.evidence.delay_s,
    )


def coefficient_draws(
    likelihood: Likelihood, points: Float[np.ndarray, "m d"], seed: int
) -> Float[np.ndarray, "m flanks columns"]:
    """Coefficients of every column, drawn once for each point of the sampled density."""
    keys = jax.random.split(jax.random.key(seed), len(points))
    drawn = [
        np.asarray(_drawn(likelihood, points[start : start + _CHUNK], keys[start : start + _CHUNK]))
        for start in range(0, len(points), _CHUNK)
    ]
    return np.concatenate(drawn)


@eqx.filter_jit
def _drawn(likelihood: Likelihood, points: Float[ArrayLike, "m d"], keys: Key[Array, " m"]):
    asked = len(likelihood.asked)

    def one(point, key):
        return likelihood.drawn(point[:asked], point[asked + 1 :], point[asked], key)

    return jax.vmap(one)(jnp.asarray(points), keys)


def _flank_models(
    evidence: Evidence, coefficients: Float[np.ndarray, "m flanks columns"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offset, cosines and sines of both flanks; NaN for one that was not measured."""
    columns = evidence.summary.columns
    places = np.array([columns.cosine(k) for k in range(len(columns.free + columns.tied))])
    offset = np.full((len(coefficients), 2), np.nan)
    cosine, sine = np.full((2, len(coefficients), 2, len(places)), np.nan)
    for place, flank in enumerate(evidence.summary.flanks):
        side = "AB".index(flank.flank)
        offset[:, side] = coefficients[:, place, columns.index(OFFSET)]
        cosine[:, side] = coefficients[:, place, places]
        sine[:, side] = coefficients[:, place, places + 1]
    return offset, cosine, sine

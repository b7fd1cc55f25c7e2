"""Sampling of a fit's posterior, with draws of the flank model that the parameter draws imply."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from ..base.errors import InputError, UsageError
from ..base.runtime import require_x64
from ..base.threads import one_blas_thread
from ..identify.evidence import Evidence
from ..identify.fit_result import Fit
from ..identify.model.column_layout import OFFSET
from .density.coefficients import coefficient_draws
from .density.density import FitTarget, fit_target, target_of
from .density.prior import Prior
from .sampling.checkpoint import read
from .sampling.ensembles import FEWEST_ENSEMBLES, Chains, read_chains, run_ensembles
from .sampling.importance import POOL, PosteriorStarts, weighted_draws
from .sampling.importance_run import run_importance
from .sampling.laplace_move import share_around_fit
from .sampling.progress import Progress
from .sampling.stop_rule import BURN_IN, Until
from .summary.posterior import Posterior

MODEL_DRAWS = 2000
"""Number of flank-model draws (chosen), spread evenly over the draws of the parameters."""


@one_blas_thread
def sample(
    fit: Fit,
    *,
    method: Literal["emcee", "importance"] = "emcee",
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

    The density is the restricted likelihood of the compressed logs times the prior. Free orders,
    offsets, drift and wind-up are integrated out. Eccentricities and encoder errors are sampled as
    x and y components. The noise parameters (log std of the innovations, partial autocorrelations)
    are sampled too. Parameters that the fit marks as undetermined are not sampled.

    The walkers start from weighted draws of a Student t distribution around the fit, so that no
    burn-in is needed, and half of their proposals are made from this distribution. If the weights
    cannot be trusted (Pareto k̂ > 0.7), the walkers start from the normal approximation of the fit,
    the first quarter of the chains is discarded, and all proposals come from the other walkers.

    **Arguments**
    - `fit`: result of `fit`, or a fit read back from a run folder.
    - `method`: "emcee", or "importance" for the weighted draws alone, without a Markov chain.
    - `prior`: prior of the parameters, see `Prior`; stated in `Posterior.prior`.
    - `seed`: seed of the random numbers; equal seeds give equal draws.
    - `steps`: exact number of steps, or of draws of each ensemble by importance sampling; not
      together with `until`.
    - `until`: stop rule; by default chains of 50 autocorrelation times and R-hat ≤ 1.01.
    - `ensembles`, `walkers`: number of independent ensembles (4 or more) and of walkers in each.
    - `checkpoint`: HDF5 file, updated every 5 s.
    - `resume`: continue the checkpoint if there is one, otherwise start a new run; the draws equal
      those of an uninterrupted run.
    - `overwrite`: replace an existing checkpoint.
    - `progress`: function called after every block of steps.

    **Returns** a `Posterior`; check `diagnosis.converged`.

    **Raises** `NoAnswerError` if no parameter is determined or there is no noise, `UsageError` if
    the prior excludes the fit or an overwrite is refused, `InputError` for a checkpoint that is
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
    if method not in ("emcee", "importance"):
        raise ValueError(f'Argument `method` must be "emcee" or "importance", but is {method!r}.')
    target = fit_target(fit, prior)
    place = None if checkpoint is None else Path(checkpoint)
    if method == "importance":
        _require_no_chains(until=until, walkers=walkers, resume=resume or None)
        chains = run_importance(
            target,
            ensembles=ensembles,
            draws=POOL if steps is None else steps,
            seed=seed,
            checkpoint=place,
            overwrite=overwrite,
        )
        return posterior_of(fit, target, chains)
    pool = weighted_draws(target, POOL, np.random.default_rng(seed))
    chains = run_ensembles(
        PosteriorStarts(target) if pool.reliable else target,
        burn_in=0.0 if pool.reliable else BURN_IN,
        laplace_share=share_around_fit(pool),
        ensembles=ensembles,
        walkers=walkers,
        steps=steps,
        until=until,
        seed=seed,
        checkpoint=place,
        resume=resume,
        overwrite=overwrite,
        progress=progress,
    )
    return posterior_of(fit, target, chains)


def _require_no_chains(**arguments: object) -> None:
    """Raise `ValueError` if one of the `arguments`, which only Markov chains use, is not None."""
    for name, value in arguments.items():
        if value is not None:
            raise ValueError(
                f"Argument `{name}` must be left out for importance sampling, which has no chains,"
                f" but is {value!r}."
            )


def settings_of(path: str | Path) -> dict[str, Any]:
    """Return the arguments with which `sample` continues a checkpoint, by name.

    They are `seed`, `ensembles`, `walkers` and `prior`.

    **Raises** `InputError` for a file that is damaged or no checkpoint, `UsageError` for draws of
    importance sampling, which have no chains.
    """
    header = read(Path(path))[0]
    if header.method == "importance":
        raise UsageError(
            "these draws are those of importance sampling, which has no chains to continue; replace"
            " them with --overwrite, or choose another folder.",
            where=str(path),
        )
    return {
        "seed": header.seed,
        "ensembles": header.ensembles,
        "walkers": header.walkers,
        "prior": _prior_of(header.identity, path),
    }


def read_posterior(path: str | Path, fit: Fit, *, model_draws: int = MODEL_DRAWS) -> Posterior:
    """Return the posterior of a checkpoint file that belongs to this fit.

    **Arguments**
    - `model_draws`: largest number of draws of the flank model. With 0, no JAX program is compiled,
      and the posterior has no backlash map.

    **Raises** `InputError` for a file that is damaged or belongs to another fit.
    """
    require_x64("read_posterior")
    chains = read_chains(Path(path))
    target = target_of(fit, _prior_of(chains.identity, path))
    different = [key for key, value in target.identity.items() if chains.identity.get(key) != value]
    if different or chains.names != target.names:
        fields = ", ".join(different or ["names"]).replace("_", " ")
        raise InputError(
            f"these draws belong to another fit ({fields} differ); sample again with --overwrite.",
            where=str(path),
        )
    return posterior_of(fit, target, chains, model_draws)


def _prior_of(identity: dict[str, Any], path: str | Path) -> Prior:
    try:
        return Prior(**identity["prior"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"the checkpoint holds no valid prior ({error}); sample again with --overwrite.",
            where=str(path),
        ) from None


def posterior_of(
    fit: Fit, target: FitTarget, chains: Chains, model_draws: int = MODEL_DRAWS
) -> Posterior:
    """Return the posterior of these chains, with draws of the flank model.

    Each of at most `model_draws` draws of the parameters gives one draw of the flank model.
    """
    assert fit.evidence is not None  # `fit_target` has checked this
    flat = chains.flat()
    chosen = np.linspace(0, len(flat) - 1, min(model_draws, len(flat))).round().astype(np.int64)
    density = target.density
    widest = float(np.max(density.widening))
    coefficients = coefficient_draws(density.likelihood, flat[chosen], chains.seed, widest)
    offset, cosine, sine = _flank_models(fit.evidence, coefficients)
    discarded = chains.discarded // chains.thin
    return Posterior(
        fit=fit,
        names=chains.names,
        units=chains.units,
        draws=chains.kept,
        log_density=chains.log_density[:, discarded:],
        offset=offset,
        cosine=cosine,
        sine=sine,
        chosen=chosen,
        diagnosis=chains.diagnosis,
        prior=target.prior.sentences,
        seed=chains.seed,
        delay_offset_s=fit.evidence.delay_s,
        chains=chains,
    )


def _flank_models(
    evidence: Evidence, coefficients: Float[np.ndarray, "m flanks columns"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return draws of the offset, cosines and sines of both flanks, rad, from `coefficients`.

    The shapes are (m, 2), (m, 2, terms) and (m, 2, terms). An unmeasured flank has NaN.
    """
    columns = evidence.summary.columns
    cosines = np.array([columns.cosine(k) for k in evidence.summary.terms.locked[0]], np.intp)
    offset = np.full((len(coefficients), 2), np.nan)
    cosine, sine = np.full((2, len(coefficients), 2, len(cosines)), np.nan)
    for index, flank in enumerate(evidence.summary.flanks):
        side = "AB".index(flank.flank)
        offset[:, side] = coefficients[:, index, columns.index(OFFSET)]
        cosine[:, side] = coefficients[:, index, cosines]
        sine[:, side] = coefficients[:, index, cosines + 1]
    return offset, cosine, sine

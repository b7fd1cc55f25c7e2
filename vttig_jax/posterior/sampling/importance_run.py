"""Sampling of a log density by importance sampling alone, in the form of chains."""

from pathlib import Path

from .ensembles import FEWEST_ENSEMBLES, Chains, chains_of, diagnosis_of
from .importance import POOL, LaplaceTarget, importance_record
from .stop_rule import Until

FEWEST_DRAWS = 40  # fewest draws of an ensemble; the tail of their weights can be fitted (chosen)


def run_importance(
    target: LaplaceTarget,
    *,
    ensembles: int = FEWEST_ENSEMBLES,
    draws: int = POOL,
    seed: int = 0,
    checkpoint: Path | None = None,
    overwrite: bool = False,
) -> Chains:
    """Draw independent samples from the density by importance sampling.

    **Arguments**
    - `target`: density to sample, with its Laplace approximation.
    - `ensembles`: number of independent sets of draws, at least 4; `draws`: draws in each set.
    - `seed`, `checkpoint`, `overwrite`: as in `run_ensembles`.

    **Returns** chains of one walker each, whose steps are the draws; check `diagnosis.converged`.

    **Raises** `UsageError` or `InputError` for a checkpoint that cannot be written, `ValueError`
    for wrong arguments.
    """
    least = {"ensembles": (ensembles, FEWEST_ENSEMBLES), "draws": (draws, FEWEST_DRAWS)}
    for name, (value, fewest) in (least | {"seed": (seed, 0)}).items():
        if value < fewest:
            raise ValueError(f"Argument `{name}` must be at least {fewest}, but is {value!r}.")
    header, record = importance_record(target, ensembles, draws, seed)
    chains = chains_of(header, record, Until(), diagnosis_of(header, record, Until()))
    if checkpoint is not None:
        chains.save(checkpoint, overwrite=overwrite)
    return chains

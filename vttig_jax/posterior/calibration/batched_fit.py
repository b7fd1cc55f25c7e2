"""Fit of one compressed log as a function for `jax.vmap`, with noise and covariance."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from ...base.arrays import Numbers
from ...base.numerics.partial_autocorrelation import filter_of
from ...identify.compress.harmonic_summary import ROUNDING
from ...identify.compress.row_products import inner
from ...identify.many.optimum import estimate
from ...identify.model.forward_model import ForwardModel
from ...identify.noise.batched_reml import Partial, estimated_noise
from .compressed import Compressed


class BatchEstimate(NamedTuple):
    """Parameters of a forward model, their covariance, and standard deviation of the innovations.

    Units are mm and rad.
    """

    values: Float[Numbers, "*logs p"]
    covariance: Float[Numbers, "*logs p p"]
    innovation_std: Float[Numbers, "*logs"]


class Fitted(NamedTuple):
    """Three fits of one log, with different noise models.

    **Arguments**
    - `modelled`: fit with the estimated autoregressive noise of the rows.
    - `partial`, `order`: partial autocorrelations of this noise, and its order.
    - `white_rows`: fit with white noise of the rows.
    - `white_samples`: fit with white noise of the samples, that is, ordinary least squares with
      standard errors from the scatter of single samples.
    """

    modelled: BatchEstimate
    partial: Partial
    order: Int[Array, ""]
    white_rows: BatchEstimate
    white_samples: BatchEstimate


def fit_compressed(
    log: Compressed,
    relation: ForwardModel,
    free: int,
    rows: Int[ArrayLike, ""],
    size: Int[ArrayLike, ""],
) -> Fitted:
    """Return the fits of one log that has `rows` rows of `size` samples on each flank.

    `relation` is the forward model. The first `free` columns, the free harmonics, are eliminated.
    """
    rounding = ROUNDING * log.square
    noise = estimated_noise(log.products, log.needed, rounding)

    def under(partial: Partial) -> BatchEstimate:
        upper = inner(log.products, filter_of(partial))
        found = estimate(log.products, upper, relation, free=free, rounding=rounding)
        return BatchEstimate(found.values, found.covariance, found.innovation_std)

    both = jnp.stack([noise.partial, jnp.zeros_like(noise.partial)])
    estimates = jax.vmap(under)(both)
    modelled, white_rows = (jax.tree.map(lambda x, k=k: x[k], estimates) for k in range(2))
    flanks, width = len(log.scatter), log.products.triangle.shape[-1]
    misfit = white_rows.innovation_std**2 * (flanks * (rows - width + 1))
    counted = flanks * (rows * size - width + 1)
    sample = (size * misfit + jnp.sum(log.scatter)) / counted
    ratio = sample / size / white_rows.innovation_std**2
    ordinary = BatchEstimate(white_rows.values, ratio * white_rows.covariance, jnp.sqrt(sample))
    return Fitted(modelled, noise.partial, noise.order, white_rows, ordinary)

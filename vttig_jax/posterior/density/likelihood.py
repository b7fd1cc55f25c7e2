"""Likelihood of parameters and noise, computed from lag products instead of samples.

The rows of a flank are Z = U F, where U has orthonormal columns with the lag products Γ. With f the
whitening filter of the noise, Uᵀ Σ⁻¹ U = Σ_{jk} f_j f_k (Γ_{k−j} − end terms) = CᵀC, and R = C F is
the triangular factor of the whitened rows. The leading block of R integrates out the free
harmonics; the normal matrix K integrates out the nuisance parameters (offsets, drift, wind-up). For
n rows in r runs, with innovations of variance σ² and partial autocorrelations π_k,

    −2 log p = (n − coefficients) log σ² + Σ_flanks log|R_freeᵀ R_free| + log|K|
               − r Σ_k k log(1 − π_k²) + misfit / σ².
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.arrays import Numbers, float64
from ...identify.compress.flank_summary import FlankSummary
from ...identify.compress.harmonic_summary import HarmonicSummary
from ...identify.model.forward_model import ForwardModel

_RIDGE = 1e-13
"""Ridge relative to the squared norm of every column (chosen). With it, the normal matrix has a
Cholesky factor even if two nuisance parameters have equal columns, and so has Uᵀ Σ⁻¹ U for the most
extreme noise that is tried."""


class ReducedRows(eqx.Module):
    """Triangular factors of the whitened rows after elimination of the free harmonics.

    The rows are whitened for innovations of variance one.

    **Arguments**
    - `determinant`: log-determinant of the factors of the free columns, summed over the flanks.
    - `factor`: upper triangular factor of the tied columns and y of every flank.
    """

    determinant: Float[Array, ""]
    factor: Float[Array, "flanks t t"]


class Likelihood(eqx.Module):
    """Log-likelihood of the parameters of a forward model under autoregressive noise.

    **Arguments**
    - `relation`: forward model, from parameters to tied coefficients.
    - `kind`: class of the flank summaries, which gives the weights of `products`.
    - `products`: matrices of every flank whose weighted sum is Uᵀ Σ⁻¹ U.
    - `triangles`: triangular factor F of every flank.
    - `spread`: derivatives of the tied coefficients with respect to every nuisance parameter.
    - `determinants`: numbers from which `kind.determinant_of` computes the log-determinant of the
      noise, summed over the flanks.
    - `rows`: number of rows, or the sum of their weights for a robust loss.
    - `sampled_indices`: indices of the sampled parameters in the parameters of `relation`.
    - `fixed`: values of all parameters; the sampled values replace some of them, and nuisance
      parameters are integrated out as differences from them.
    - `variance_factor`: factor on the residual variance for a robust loss, 1 for least squares.
    - `free`: number of free columns of each flank.
    """

    relation: ForwardModel
    products: Float[Numbers, "products flanks q q"] = eqx.field(converter=float64)
    triangles: Float[Numbers, "flanks q q"] = eqx.field(converter=float64)
    determinants: Float[Numbers, "*terms"] = eqx.field(converter=float64)
    spread: Float[Numbers, "nuisance flanks tied"] = eqx.field(converter=float64)
    fixed: Float[Numbers, " p"] = eqx.field(converter=float64)
    rows: Float[Numbers, ""] = eqx.field(converter=float64)
    variance_factor: Float[Numbers, ""] = eqx.field(converter=float64)
    kind: type[FlankSummary] = eqx.field(static=True)
    sampled_indices: tuple[int, ...] = eqx.field(static=True)
    free: int = eqx.field(static=True)

    @property
    def coefficients(self) -> int:
        """Number of coefficients integrated out: nuisance parameters and all free harmonics."""
        return self.spread.shape[0] + self.products.shape[1] * self.free

    def factors(self, partial: Float[Array, " order"]) -> Float[Array, "flanks q q"]:
        """Return Cᵀ of every flank, lower triangular, for innovations of variance one."""
        weights = self.kind.product_weights(partial)
        gram = jnp.tensordot(weights, jnp.asarray(self.products), 1)
        return jax.lax.linalg.cholesky(gram, symmetrize_input=False)

    def reduced(self, partial: Float[Array, " order"]) -> ReducedRows:
        """Return the triangular factors that remain after elimination of the free harmonics."""
        return self._reduced(self.factors(partial))

    def _reduced(self, factors: Float[Array, "flanks q q"]) -> ReducedRows:
        free, triangles = self.free, jnp.asarray(self.triangles)
        diagonal = jnp.diagonal(factors * triangles, axis1=1, axis2=2)[:, :free]
        inner = jnp.swapaxes(factors[:, free:, free:], 1, 2)
        return ReducedRows(jnp.sum(jnp.log(diagonal)), inner @ triangles[:, free:, free:])

    def log_determinant(self, partial: Float[Array, " order"]) -> Float[Array, ""]:
        """Return the log-determinant of the noise covariance for innovations of variance one."""
        return jnp.asarray(self.kind.determinant_of(jnp.asarray(self.determinants), partial))

    def whitened_residual(
        self, sampled: Float[Array, " d"], factor: Float[Array, "flanks t t"]
    ) -> tuple[Float[Array, " r"], Float[Array, "r nuisance"]]:
        """Return the whitened residual of the tied rows, and the whitened nuisance columns.

        The residual is the prediction from the `sampled` parameters minus the measurement. `factor`
        is `ReducedRows.factor`.
        """
        parameters = jnp.asarray(self.fixed).at[jnp.asarray(self.sampled_indices)].set(sampled)
        tied, target = factor[:, :-1, :-1], factor[:, :-1, -1]
        predicted = self.relation.coefficients(parameters)
        residual = jnp.einsum("fij,fj->fi", tied, predicted) - target
        nuisance = jnp.einsum("fij,nfj->fin", tied, jnp.asarray(self.spread))
        return residual.ravel(), nuisance.reshape(residual.size, -1)

    def __call__(
        self,
        sampled: Float[Array, " d"],
        partial: Float[Array, " order"],
        log_innovation_std: Float[Array, ""],
    ) -> Float[Array, ""]:
        """Return the log-likelihood; free and nuisance coefficients are integrated out."""
        rows = self.reduced(partial)
        residual, nuisance = self.whitened_residual(sampled, rows.factor)
        misfit = jnp.asarray(self.variance_factor) * jnp.sum(rows.factor[:, -1, -1] ** 2)
        misfit += residual @ residual
        determinant = rows.determinant
        if nuisance.shape[1]:
            factor = jnp.linalg.cholesky(ridged(nuisance.T @ nuisance))
            explained = jax.scipy.linalg.solve_triangular(factor, nuisance.T @ residual, lower=True)
            misfit -= explained @ explained
            determinant += jnp.sum(jnp.log(jnp.diagonal(factor)))
        freedom = jnp.asarray(self.rows) - self.coefficients
        return -(
            freedom * log_innovation_std
            + determinant
            + 0.5 * self.log_determinant(partial)
            + 0.5 * misfit * jnp.exp(-2 * log_innovation_std)
        )


def likelihood_of(
    summary: HarmonicSummary,
    relation: ForwardModel,
    jacobian: Float[np.ndarray, "flanks tied p"],
    values: Float[np.ndarray, " p"],
    sampled: Sequence[str],
    order: int,
    variance_factor: float = 1.0,
) -> Likelihood:
    """Return the likelihood of the `sampled` parameters under autoregressive noise of this order.

    Every other parameter is integrated out with its column of `jacobian`. This is exact for all
    parameters except eccentricities, in which the forward model is not linear. `values` are the
    parameters of the fit.
    """
    names = list(relation.names)
    nuisance = [k for k, name in enumerate(names) if name not in sampled]
    curved = [k for k in nuisance if k >= relation.linear.shape[0]]
    fixed = np.where(np.isin(np.arange(len(names)), curved), 0.0, values)
    return Likelihood(
        relation=relation,
        products=np.stack([_product_matrices(flank, order) for flank in summary.flanks], axis=1),
        triangles=np.stack([flank.triangle for flank in summary.flanks]),
        determinants=sum(flank.determinant_terms(order) for flank in summary.flanks),
        spread=np.moveaxis(jacobian[:, :, nuisance], 2, 0),
        fixed=fixed,
        rows=np.asarray(summary.counted_rows),
        variance_factor=np.asarray(variance_factor),
        kind=summary.kind.summary,
        sampled_indices=tuple(names.index(name) for name in sampled),
        free=summary.columns.free_width,
    )


def _product_matrices(flank: FlankSummary, order: int) -> Float[np.ndarray, "products q q"]:
    """Return the matrices of `flank.weighted_products`, with a ridge added to the first one."""
    products = flank.weighted_products(order).copy()
    products[0] += _RIDGE * np.eye(len(flank.triangle))
    return products


def ridged(gram: Float[Numbers, "*stack n n"]) -> Float[Numbers, "*stack n n"]:
    """Return the normal matrices `gram` with their diagonals multiplied by 1 + `_RIDGE`."""
    return gram + _RIDGE * gram * np.eye(gram.shape[-1])

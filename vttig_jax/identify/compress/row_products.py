"""Products of the block rows of one log inside a compiled program, and their whitening.

The rows Z = U F of a flank are conditioned as in `flank_summary`, and the products are those of
`LaggedFlank`: the lag products of the rows of U, and the rows next to both ends of every run. The
shapes do not depend on the log: a run that is shorter than the others ends in rows of zeros. All
functions handle one log; `jax.vmap` makes them functions of many.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import sequential_vmap
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float, Int

from .lagged_forms import whitened_products

RIDGE = 1e-13
"""Ridge on the diagonal of a matrix of products, relative to the square of every column. It is as
large as the rounding error of a product."""

_SHIFT = 1e-12
"""Share of every squared column that is added before rows are conditioned, as in `orthogonal`."""

Filter = Float[Array, " taps"]


class RowProducts(NamedTuple):
    """Products of the rows of one log, flank by flank.

    Z = U F are the rows of a flank: the columns of the fit and, as the last of the q columns, the
    transmission error y. U are the conditioned rows, whose columns are nearly orthonormal.

    **Arguments**
    - `triangle`: upper triangular matrix F of every flank.
    - `lag_products`: Γ_0 … Γ_L of the rows of U.
    - `ends`: the L rows of U next to both ends of every run, the outermost first.
    - `rows`: number of rows. - `runs`: number of runs that have rows.
    """

    triangle: Float[Array, "flanks q q"]
    lag_products: Float[Array, "flanks lags q q"]
    ends: Float[Array, "flanks ends lag q"]
    rows: Float[Array, " flanks"]
    runs: Float[Array, " flanks"]

    @property
    def lags(self) -> int:
        """Number of lags L."""
        return self.ends.shape[2]


class Upper(NamedTuple):
    """Upper triangular matrices whose diagonals are not negative, and their inverses."""

    triangle: Float[Array, "*batch q q"]
    inverse: Float[Array, "*batch q q"]


def conditioned(
    rows: Float[Array, "flanks runs n q"],
) -> tuple[Float[Array, "flanks runs n q"], Float[Array, "flanks q q"]]:
    """Return the conditioned rows U and the triangle F of the rows Z = U F of every flank.

    The columns of U are nearly orthonormal.
    """
    flanks, runs, count, width = rows.shape
    table = rows.reshape(flanks, runs * count, width)
    square = jnp.sum(table**2, axis=1)
    size = jnp.sqrt(jnp.where(square > 0, square, 1.0))
    scaled = table / size[:, None, :]
    gram = jnp.swapaxes(scaled, 1, 2) @ scaled
    upper = upper_and_inverse(gram + _SHIFT * jnp.eye(width)[None])
    white = scaled @ upper.inverse
    return white.reshape(rows.shape), upper.triangle * size[:, None, :]


def row_products(
    white: Float[Array, "flanks runs n q"],
    triangle: Float[Array, "flanks q q"],
    counts: Int[Array, "flanks runs"],
    lags: int,
) -> RowProducts:
    """Return the lag products of conditioned rows; `counts` is the number of rows of each run.

    Rows beyond the count of a run must be zero.
    """
    flanks, runs, count, width = white.shape
    apart = jnp.pad(white, ((0, 0), (0, 0), (0, lags), (0, 0)))
    line = apart.reshape(flanks, runs * (count + lags), width)
    length = line.shape[1]
    products = [
        jnp.swapaxes(line[:, lag:], 1, 2) @ line[:, : length - lag] for lag in range(lags + 1)
    ]
    used = counts > 0
    # The first row of a tail is the last one of the run.
    places = counts[:, :, None] - 1 - np.arange(lags)[None, None]
    tails = jnp.take_along_axis(white, jnp.maximum(places, 0)[..., None], axis=2)
    tails = jnp.where((places >= 0)[..., None], tails, 0.0)
    ends = jnp.concatenate([white[:, :, :lags], tails], axis=1)
    return RowProducts(
        triangle=triangle,
        lag_products=jnp.stack(products, axis=1),
        ends=ends,
        rows=jnp.sum(counts, axis=1).astype(float),
        runs=jnp.sum(used, axis=1).astype(float),
    )


def residual_autocovariance(
    white: Float[Array, "flanks runs n q"], rows: Float[Array, " flanks"], lags: int
) -> Float[Array, "flanks taps"]:
    """Return the autocovariance of the residual of ordinary least squares for lags 0 … `lags`."""
    flanks, runs, count, width = white.shape
    table = white.reshape(flanks, runs * count, width)
    gram = jnp.swapaxes(table, 1, 2) @ table + RIDGE * jnp.eye(width)[None]
    weights = residual_weights(upper_and_inverse(gram))
    left = jnp.pad(
        (table @ weights[:, :, None]).reshape(flanks, runs, count), ((0, 0), (0, 0), (0, lags))
    )
    products = [
        jnp.sum(left[:, :, lag : lag + count] * left[:, :, :count], axis=(1, 2))
        for lag in range(lags + 1)
    ]
    return jnp.stack(products, axis=1) / jnp.maximum(rows, 1.0)[:, None]


def inner(products: RowProducts, filter_: Filter) -> Upper:
    """Return the upper triangle C with CᵀC = Uᵀ Σ⁻¹ U, and its inverse, for every flank.

    Σ is the covariance of the noise with the whitening filter `filter_` and innovations of variance
    one; taps beyond the order of the noise are zero. With F, which is `products.triangle`, the
    product C F is the upper triangle of the whitened rows Z: (C F)ᵀ(C F) = Zᵀ Σ⁻¹ Z.
    """
    total = jax.vmap(whitened_products, in_axes=(0, 0, None))(
        products.lag_products, products.ends, filter_
    )
    return upper_and_inverse(total + RIDGE * jnp.eye(total.shape[-1])[None])


@jax.custom_jvp
def upper_and_inverse(gram: Float[Array, "*batch q q"]) -> Upper:
    """Return the upper Cholesky factor C of symmetric matrices G = CᵀC, and its inverse C⁻¹.

    The derivative is computed from C and C⁻¹ by products of matrices, without another
    factorisation.
    """
    single = _one_matrix
    for _ in gram.shape[:-2]:
        single = jax.vmap(single)
    return Upper(*single(gram))


@sequential_vmap
def _one_matrix(
    gram: Float[Array, "q q"],
) -> tuple[Float[Array, "q q"], Float[Array, "q q"]]:
    """Return the upper Cholesky factor C of one matrix G = CᵀC, and the inverse C⁻¹ of the factor.

    `sequential_vmap` handles the matrices of a batch one after the other in a loop. A LAPACK call
    for a whole batch would distribute its matrices over the threads of XLA and wait for them. On
    two cores, two such calls at the same time can wait for each other forever (jaxlib 0.10).
    """
    lower = jnp.linalg.cholesky(gram)
    inverse = solve_triangular(lower, jnp.eye(gram.shape[0]), lower=True)
    return lower.T, inverse.T


@upper_and_inverse.defjvp
def _derivative(primals: tuple, tangents: tuple) -> tuple[Upper, Upper]:
    upper = upper_and_inverse(*primals)
    moved = _transposed(upper.inverse) @ tangents[0] @ upper.inverse
    share = np.triu(np.ones(moved.shape[-2:]), 1) + 0.5 * np.eye(moved.shape[-1])
    half = moved * share.reshape((1,) * (moved.ndim - 2) + share.shape)
    return upper, Upper(half @ upper.triangle, -upper.inverse @ half)


def residual_weights(upper: Upper) -> Float[Array, "flanks q"]:
    """Return the weights (−β, 1) of every flank; their product with a row is its residual.

    β are the least-squares coefficients of y, the last column, on the other columns.
    """
    return upper.triangle[:, -1:, -1] * upper.inverse[:, :, -1]


def _transposed(matrix: Float[Array, "*batch p q"]) -> Float[Array, "*batch q p"]:
    return jnp.swapaxes(matrix, -1, -2)

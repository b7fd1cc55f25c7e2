"""Products of whitened rows from lag products, as a function of the filter and of the columns.

The noise Σ of the rows U of one flank is an autoregression with the whitening filter f. Uᵀ Σ⁻¹ U is
a quadratic form of f, and its coefficients are the lag products of the rows and the products of the
rows next to both ends of every run (I. Gohberg, A. Semencul 1972). Both functions take NumPy arrays
or, inside a compiled program, JAX arrays.

In their arguments Γ_l = Σ_t u_t u_{t−l}ᵀ are the lag products of the rows, and `ends` holds the
rows next to both ends of every run, the outermost row first.
"""

import numpy as np
from jaxtyping import Float

from ...base.arrays import Numbers, namespace


def whitened_products(
    lag_products: Float[Numbers, "taps q q"],
    ends: Float[Numbers, "ends lag q"],
    filter_: Float[Numbers, " taps"],
) -> Float[Numbers, "q q"]:
    """Return Uᵀ Σ⁻¹ U for the whitening filter `filter_`.

    The filter is applied to every run with zeros before and after it, which gives Σ_{jk}
    f_j f_k Γ_{k−j}. The response after the end of the run is subtracted, and, with time reversed,
    the response before its start. The result is exact, initial rows included.
    """
    xp = namespace(filter_)
    taps = filter_.shape[0]
    place = np.add.outer(np.arange(taps), np.arange(taps))
    shifted = xp.where(place < taps, filter_[np.minimum(place, taps - 1)], 0.0)
    lagged = shifted @ filter_
    total = xp.tensordot(lagged, lag_products, 1)
    total = total + total.T - lagged[0] * lag_products[0]
    responses = (shifted[1:, :-1] @ ends).reshape(-1, total.shape[0])
    return total - responses.T @ responses


def filter_form(
    lag_products: Float[Numbers, "taps q q"],
    ends: Float[Numbers, "ends lag q"],
    weights: Float[Numbers, "q d"],
) -> Float[Numbers, "taps taps"]:
    """Return the matrix T with fᵀ T f = tr(Wᵀ Uᵀ Σ⁻¹ U W) for every filter f.

    `weights` is W: each column of W holds the factors of one linear combination of the q columns
    of U.
    """
    xp = namespace(weights)
    taps = lag_products.shape[0]
    lagged = xp.tensordot(lag_products, weights @ weights.T, 2)
    distance = np.abs(np.subtract.outer(np.arange(taps), np.arange(taps)))
    combined = ends @ weights
    products = xp.einsum("rad,rbd->ab", combined, combined)
    return lagged[distance] - xp.pad(_summed_diagonals(products), ((1, 0), (1, 0)))


def _summed_diagonals(square: Float[Numbers, "n n"]) -> Float[Numbers, "n n"]:
    """Return the matrix with the elements Σ_s square[a − s, b − s] for s = 0 … min(a, b).

    A result is the sum of the element (a, b) and of all elements before it on its diagonal. The
    program reverses the order of the columns and appends n zeros to every row. The same numbers in
    rows of 2n − 1 instead of 2n have each diagonal in one column, where a cumulative sum is taken.
    """
    xp = namespace(square)
    n = square.shape[0]
    if n == 0:
        return square
    wide = xp.concatenate([square[:, ::-1], xp.zeros((n, n))], axis=1)
    columns = xp.cumsum(wide.reshape(-1)[:-n].reshape(n, 2 * n - 1), axis=0)
    flat = xp.concatenate([columns.reshape(-1), xp.zeros(n)])
    return flat.reshape(n, 2 * n)[:, n - 1 :: -1]

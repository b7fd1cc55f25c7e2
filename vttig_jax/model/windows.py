"""Lag products of the rows of many runs, in which the restricted likelihood is linear."""

import numpy as np
from jaxtyping import Float, Int

from .density import FIRST, LAGS, SECOND


def windows(
    table: Float[np.ndarray, "n q"],
    first: Int[np.ndarray, " runs"],
    last: Int[np.ndarray, " runs"],
    away: Float[np.ndarray, " q"],
) -> Float[np.ndarray, "pairs q q"]:
    """Return D_ij = Σ_runs Σ_k z_{k+i} z_{k+j}ᵀ, where k leaves out the first and last i rows.

    For i < j the transpose is added. The runs are the rows `first` to `last`, both included; each
    has more than `LAGS` rows. In z the last column is `table` @ `away`. D_{i+1,j+1} follows from
    D_ij by the rows at the ends of the runs.
    """
    end = np.cumsum(last - first + 1 + LAGS) - LAGS
    begin = end - (last - first + 1)
    apart = np.zeros((end[-1] + LAGS, table.shape[1]))  # zeros between runs: no product joins two
    for a, b, to in zip(first, last, begin, strict=True):
        apart[to : to + b - a + 1] = table[a : b + 1]
    apart[:, -1] = apart @ away
    ends = [apart[np.concatenate([begin + lag, end - 1 - lag])] for lag in range(LAGS)]
    pairs = zip(FIRST.tolist(), SECOND.tolist(), strict=True)
    where = {pair: place for place, pair in enumerate(pairs)}
    found = np.empty((len(FIRST), len(away), len(away)))
    for lag in range(LAGS + 1):
        product = apart[: len(apart) - lag].T @ apart[lag:]
        if lag:
            product = product + product.T
        found[where[0, lag]] = product
        for step in range(LAGS - lag):
            outer = ends[step].T @ ends[step + lag]
            product = product - (outer + outer.T if lag else outer)
            found[where[step + 1, step + 1 + lag]] = product
    return found

"""Lag products of the rows of many runs, in which the restricted likelihood is linear."""

import numpy as np
from jaxtyping import Float, Int

from .density import FIRST, LAGS, SECOND


def windows(
    rows: Float[np.ndarray, "n q"], first: Int[np.ndarray, " runs"], last: Int[np.ndarray, " runs"]
) -> Float[np.ndarray, "pairs q q"]:
    """Return D_ij = Σ_runs Σ_k z_{k+i} z_{k+j}ᵀ, where k leaves out the first and last i rows.

    For i < j the transpose is added. The runs are the rows `first` to `last`, both included; each
    has more than `LAGS` rows. D_{i+1,j+1} follows from D_ij by the rows at the ends of the runs.
    """
    q = rows.shape[1]
    total = int(np.sum(last - first + 1 + LAGS))
    apart = np.zeros((total, q))  # runs with zeros between them, so that no product joins two
    place = 0
    for a, b in zip(first, last, strict=True):
        apart[place : place + b - a + 1] = rows[a : b + 1]
        place += b - a + 1 + LAGS
    ends = [np.concatenate([rows[first + lag], rows[last - lag]]) for lag in range(LAGS)]
    pairs = zip(FIRST.tolist(), SECOND.tolist(), strict=True)
    where = {pair: place for place, pair in enumerate(pairs)}
    found = np.empty((len(FIRST), q, q))
    for lag in range(LAGS + 1):
        product = apart[: total - lag].T @ apart[lag:]
        if lag:
            product = product + product.T
        found[where[0, lag]] = product
        for step in range(LAGS - lag):
            end = ends[step].T @ ends[step + lag]
            product = product - (end + end.T if lag else end)
            found[where[step + 1, step + 1 + lag]] = product
    return found

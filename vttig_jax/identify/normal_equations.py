"""Normal equations of rows [regressors, y], safe where regressors coincide."""

from contextlib import suppress

import numpy as np
from jaxtyping import Float

from ..base.errors import NoAnswerError

_RIDGES = (1e-13, 1e-11, 1e-9)
"""Relative to every column's own square, the first that keeps the Gram factorable: rounding leaves
more of a log without noise than of any other. Even the last moves no coefficient visibly."""


def cholesky(gram: Float[np.ndarray, "q q"]) -> Float[np.ndarray, "q q"]:
    """Upper factor R with RᵀR = gram, after scaling every column to one.

    **Raises** `NoAnswerError` where rounding has left nothing positive to factor.
    """
    size = np.sqrt(np.maximum(np.diag(gram), 0.0))
    size[size == 0] = 1.0
    scaled = gram / np.outer(size, size)
    for ridge in _RIDGES:
        with suppress(np.linalg.LinAlgError):
            return np.linalg.cholesky(scaled + ridge * np.eye(len(gram))).T * size
    raise NoAnswerError(
        "the samples do not tell the fitted orders apart; record more turns, or list fewer orders"
        " in [fit]."
    )


def residual_weights(gram: Float[np.ndarray, "q q"]) -> Float[np.ndarray, " q"]:
    """(−β, 1) with β the least-squares coefficients of y: rows @ weights are the residuals."""
    factor = cholesky(gram)
    return np.append(-np.linalg.solve(factor[:-1, :-1], factor[:-1, -1]), 1.0)

"""Normal equations of rows [regressors, y], safe where regressors coincide."""

import numpy as np
from jaxtyping import Float

from ..base.errors import NoAnswerError

_RIDGE = 1e-13
"""Relative to every column's own square: keeps a singular Gram factorable, moves nothing else."""


def cholesky(gram: Float[np.ndarray, "q q"]) -> Float[np.ndarray, "q q"]:
    """Upper factor R with RᵀR = gram, after scaling every column to one.

    **Raises** `NoAnswerError` where rounding has left nothing positive to factor.
    """
    size = np.sqrt(np.maximum(np.diag(gram), 0.0))
    size[size == 0] = 1.0
    scaled = gram / np.outer(size, size) + _RIDGE * np.eye(len(gram))
    try:
        return np.linalg.cholesky(scaled).T * size
    except np.linalg.LinAlgError:
        raise NoAnswerError(
            "the samples do not tell the fitted orders apart; record more turns, or list fewer"
            " orders in [fit]."
        ) from None


def residual_weights(gram: Float[np.ndarray, "q q"]) -> Float[np.ndarray, " q"]:
    """(−β, 1) with β the least-squares coefficients of y: rows @ weights are the residuals."""
    factor = cholesky(gram)
    return np.append(-np.linalg.solve(factor[:-1, :-1], factor[:-1, -1]), 1.0)

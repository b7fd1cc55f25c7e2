"""Least squares in lines: amplitudes, phases and refined frequencies."""

import numpy as np
from jaxtyping import Float

from ..base.units import REV
from .line_noise import Whitening, misfit, orthonormal
from .line_rows import Rows

APART = 1.0
"""Resolutions (one over the revolutions spanned) that two lines must be apart."""

LEAST_CYCLES = 1.5
"""Cycles over the whole log from which on a line is told from drift."""

_STEPS = 16
_CONVERGED = 0.01
"""Standard errors that a step of a frequency must come below."""


def refined(
    rows: Rows, found: Float[np.ndarray, " k"], noise: Whitening
) -> Float[np.ndarray, " k"]:
    """Frequencies of least misfit nearby, by Gauss-Newton with the step halved where it fails.

    Lines do not come closer than they can be told apart: two at one place would have any amplitude.
    """
    size, lowest = 1.0, misfit(rows, columns(rows, found), noise)
    for _ in range(_STEPS):
        coefficients, covariance = solved(rows, found, noise)
        step = np.clip(coefficients[-len(found) :], -0.25 / rows.span, 0.25 / rows.span)
        scatter = np.sqrt(np.diag(covariance)[-len(found) :] * lowest / noise.rows)
        if np.all(np.abs(size * step) <= _CONVERGED * scatter):
            break
        trial = found + size * step
        reached = misfit(rows, columns(rows, trial), noise)
        if (
            reached < lowest
            and np.min(trial) >= LEAST_CYCLES / rows.span
            and np.min(np.diff(np.sort(trial)), initial=np.inf) >= APART / rows.span
        ):
            found, lowest = trial, reached
        else:
            size *= 0.5
    return found


def columns(rows: Rows, found: Float[np.ndarray, " k"]) -> Float[np.ndarray, "n q"]:
    """Regressors, and cosine and sine of every line as block means show them."""
    angle = REV * rows.turns[:, None] * found
    seen = np.sinc(rows.width[:, None] * found)
    pairs = np.stack([np.cos(angle) * seen, np.sin(angle) * seen], axis=2)
    return np.concatenate([rows.nuisance, pairs.reshape(len(angle), -1)], axis=1)


def solved(
    rows: Rows, found: Float[np.ndarray, " k"], noise: Whitening
) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, "c c"]]:
    """Least squares in regressors, cosines and sines, and changes of the frequencies.

    **Returns** the coefficients and the covariance they have for innovations of size 1.
    """
    design = columns(rows, found)
    whitened, value = orthonormal(design, noise), noise(rows.value)
    pairs = (whitened[1] @ (whitened[0].T @ value))[rows.nuisance.shape[1] :]
    cosine, sine = (
        design[:, rows.nuisance.shape[1] :: 2],
        design[:, rows.nuisance.shape[1] + 1 :: 2],
    )
    slopes = REV * rows.turns[:, None] * (pairs[1::2] * cosine - pairs[::2] * sine)
    basis, mixing = orthonormal(np.concatenate([design, slopes], axis=1), noise)
    return mixing @ (basis.T @ value), mixing @ mixing.T

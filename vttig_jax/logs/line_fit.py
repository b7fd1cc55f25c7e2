"""Least squares in lines: amplitudes, phases and refined frequencies."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..base.units import REV
from .line_noise import Whitening, factored, orthonormal, scaled
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
    beside = Regressed.of(rows, noise)
    size, lowest = 1.0, beside.misfit(found)
    for _ in range(_STEPS):
        coefficients, covariance = beside.solved(found)
        step = np.clip(coefficients[-len(found) :], -0.25 / rows.span, 0.25 / rows.span)
        scatter = np.sqrt(np.diag(covariance)[-len(found) :] * lowest / noise.rows)
        if np.all(np.abs(size * step) <= _CONVERGED * scatter):
            break
        trial = found + size * step
        reached = beside.misfit(trial)
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
    return np.concatenate([rows.nuisance, _waves(rows, found)], axis=1)


def _waves(rows: Rows, found: Float[np.ndarray, " k"]) -> Float[np.ndarray, "n 2*k"]:
    angle = REV * rows.turns[:, None] * found
    seen = np.sinc(rows.width[:, None] * found)
    return np.stack([np.cos(angle) * seen, np.sin(angle) * seen], axis=2).reshape(len(angle), -1)


@dataclass(frozen=True, eq=False)
class Regressed:
    """Least squares in lines, from whose columns the whitened regressors are taken off.

    By the theorem of Frisch, Waugh and Lovell the lines get the coefficients and the covariance
    that they have beside the regressors, and the regressors are decomposed only once.

    **Arguments**
    - `basis`: orthonormal, of the whitened regressors. - `rest`: the whitened value beside them.
    """

    rows: Rows
    noise: Whitening
    basis: Float[np.ndarray, "n r"]
    rest: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, rows: Rows, noise: Whitening) -> "Regressed":
        """The regressors of some rows under a noise."""
        basis, _ = orthonormal(rows.nuisance, noise)
        value = noise(rows.value)
        return cls(rows, noise, basis, value - basis @ (basis.T @ value))

    def misfit(self, found: Float[np.ndarray, " k"]) -> float:
        """Sum of squared innovations beside regressors and lines."""
        own, _ = self._orthonormal(_waves(self.rows, found))
        rest = self.rest - own @ (own.T @ self.rest)
        return float(rest @ rest)

    def solved(
        self, found: Float[np.ndarray, " k"]
    ) -> tuple[Float[np.ndarray, " 3*k"], Float[np.ndarray, "3*k 3*k"]]:
        """Cosines and sines of the lines in turn, and then changes of their frequencies.

        **Returns** the coefficients and the covariance they have for innovations of size 1.
        """
        waves = _waves(self.rows, found)
        own, mixing = self._orthonormal(waves)
        pairs = mixing @ (own.T @ self.rest)
        cosine, sine = waves[:, ::2], waves[:, 1::2]
        slopes = REV * self.rows.turns[:, None] * (pairs[1::2] * cosine - pairs[::2] * sine)
        own, mixing = self._orthonormal(np.concatenate([waves, slopes], axis=1))
        return mixing @ (own.T @ self.rest), mixing @ mixing.T

    def _orthonormal(
        self, columns: Float[np.ndarray, "n c"]
    ) -> tuple[Float[np.ndarray, "n r"], Float[np.ndarray, "c r"]]:
        """Basis of what the regressors leave of whitened columns, and what makes it of them."""
        whitened, size = scaled(columns, self.noise)
        beside = whitened - self.basis @ (self.basis.T @ whitened)
        basis, mixing = factored(beside)
        return basis, mixing / size[:, None]

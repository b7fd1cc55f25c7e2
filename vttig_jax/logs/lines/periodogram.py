"""Periodogram of whitened rows, its false-alarm probability, and least-squares fit of lines."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Complex, Float
from scipy.special import gammaln

from ...base.units import REV
from .noise import Whitening, factored, orthonormal, scaled
from .rows import Rows

_CHUNK = 16
_LEAST_POWER = 0.01
"""Least fraction of the power of a trial after projection on the columns (chosen)."""


@dataclass(frozen=True)
class Scan:
    """Least-squares periodogram.

    **Arguments**
    - `cycles`: trial frequencies in cycles per revolution, shape (f,), equally spaced.
    - `height`: z = ½ n ln(RSS without the line / RSS with it), shape (f,); for noise alone it has
      an exponential distribution at every frequency.
    """

    cycles: Float[np.ndarray, " f"]
    height: Float[np.ndarray, " f"]


def scan(
    rows: Rows,
    columns: Float[np.ndarray, "n q"],
    whitening: Whitening,
    cycles: Float[np.ndarray, " f"],
) -> Scan:
    """Return the height of a line beside `columns` at every frequency of an equidistant grid."""
    basis, _ = orthonormal(columns, whitening)
    value = whitening(rows.value)
    residual = value - basis @ (basis.T @ value)
    misfit = float(residual @ residual)
    freedom = degrees_of_freedom(whitening, basis.shape[1])
    drops = np.concatenate(
        [_drop(whitening(trial), basis, residual) for trial in _trials(rows.turns, cycles)]
    )[: len(cycles)]
    relative = np.clip(drops / misfit, 0.0, 1 - 1e-15) if misfit > 0 else np.zeros(len(cycles))
    return Scan(cycles, -0.5 * freedom * np.log1p(-relative))


def degrees_of_freedom(whitening: Whitening, columns: int) -> int:
    """Return rows − columns − 2 (one line) − order of the autoregression, at least 1."""
    return max(whitening.rows - columns - 2 - (len(whitening.filter) - 1), 1)


def false_alarm_probability(height: float, rows: Rows, freedom: int, bandwidth: float) -> float:
    """Return the probability that noise alone reaches a height anywhere in a scan.

    Baluev, MNRAS 385, 1279 (2008), for the periodogram with unknown noise variance (z₃ there):
    1 − (1 − e⁻ᶻ) e⁻ᵗ with τ = W γ e^{−z (1 − 1/2n)} √(n sinh(z/n)), W = bandwidth √(4π var turns).
    It is an upper bound that is sharp for small probabilities.

    **Arguments**
    - `height`: z of `Scan`. `freedom`: n. `bandwidth`: range of the scan in cycles per revolution.
    """
    width = bandwidth * np.sqrt(4 * np.pi * np.var(rows.turns))
    n = float(freedom)
    gamma = gammaln((n + 2) / 2) - gammaln((n + 1) / 2) - 0.5 * np.log((n + 2) / 2)
    ratio = height / n
    # ln √(n sinh z/n), without overflow for a line with all the power.
    root = 0.5 * (np.log(n / 2) + ratio + np.log(-np.expm1(-2 * max(ratio, 1e-300))))
    tau = width * np.exp(gamma - height * (1 - 0.5 / n) + root)
    single = np.exp(-height)
    return float(np.clip(single - (1 - single) * np.expm1(-tau), 0.0, 1.0))


def _trials(
    turns: Float[np.ndarray, " n"], cycles: Float[np.ndarray, " f"]
) -> Iterator[Complex[np.ndarray, "k n"]]:
    """Yield exp(2πi f turns) for `_CHUNK` frequencies at a time, each by rotation of the last."""
    step = cycles[1] - cycles[0] if len(cycles) > 1 else 0.0
    trial = np.exp(2j * np.pi * (cycles[0] + step * np.arange(_CHUNK))[:, None] * turns)
    rotation = np.exp(2j * np.pi * step * _CHUNK * turns)
    for _ in range(0, len(cycles), _CHUNK):
        yield trial
        trial *= rotation


def _drop(
    trial: Complex[np.ndarray, "k n"],
    basis: Float[np.ndarray, "n r"],
    residual: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " k"]:
    """Return the decrease of the sum of squares by cosine and sine of every whitened trial.

    The basis is projected out of both first. With c + i s = trial, the 2×2 Gram matrix follows from
    Σ|trial|², Σ trial² and their products with the basis.
    """
    products = trial @ np.column_stack([basis, residual]).astype(complex)
    onto: Any = products[:, :-1]
    right: Any = products[:, -1]
    power = np.einsum("kn,kn->k", trial, trial.conj()).real
    square = np.einsum("kn,kn->k", trial, trial)
    remaining = power - np.sum(np.abs(onto) ** 2, axis=1)
    skew: Any = square - np.sum(onto**2, axis=1)
    cc, ss, cs = 0.5 * (remaining + skew.real), 0.5 * (remaining - skew.real), 0.5 * skew.imag
    determinant = cc * ss - cs**2
    drop = ss * right.real**2 + cc * right.imag**2 - 2 * cs * right.real * right.imag
    # This tests the smaller eigenvalue: both cosine and sine must remain.
    usable = determinant > _LEAST_POWER * power * np.maximum(remaining, 1e-300)
    return np.where(usable, drop / np.where(usable, determinant, 1.0), 0.0)


APART = 1.0
"""Least distance of two lines in resolutions, 1 / (revolutions of the log) (chosen)."""

LEAST_CYCLES = 1.5
"""Least number of cycles of a line over the whole log, to separate it from drift (chosen)."""

_STEPS = 16
_CONVERGED = 0.01
"""Largest number of steps, and last step of a frequency in standard errors (chosen)."""


def refine(
    rows: Rows, frequencies: Float[np.ndarray, " k"], noise: Whitening
) -> Float[np.ndarray, " k"]:
    """Refine frequencies to the least misfit by Gauss-Newton; a failed step is halved.

    Two lines keep a distance of at least the resolution; otherwise their amplitudes are undefined.
    """
    regression = LineRegression.from_rows(rows, noise)
    size, lowest = 1.0, regression.misfit(frequencies)
    for _ in range(_STEPS):
        coefficients, covariance = regression.solve(frequencies)
        step = np.clip(coefficients[-len(frequencies) :], -0.25 / rows.span, 0.25 / rows.span)
        scatter = np.sqrt(np.diag(covariance)[-len(frequencies) :] * lowest / noise.rows)
        if np.all(np.abs(size * step) <= _CONVERGED * scatter):
            break
        trial = frequencies + size * step
        misfit = regression.misfit(trial)
        if (
            misfit < lowest
            and np.min(trial) >= LEAST_CYCLES / rows.span
            and np.min(np.diff(np.sort(trial)), initial=np.inf) >= APART / rows.span
        ):
            frequencies, lowest = trial, misfit
        else:
            size *= 0.5
    return frequencies


def design_matrix(rows: Rows, frequencies: Float[np.ndarray, " k"]) -> Float[np.ndarray, "n q"]:
    """Return the regressors, and cosine and sine of every line averaged over each row."""
    return np.concatenate([rows.nuisance, _waves(rows, frequencies)], axis=1)


def _waves(rows: Rows, frequencies: Float[np.ndarray, " k"]) -> Float[np.ndarray, "n 2*k"]:
    angle = REV * rows.turns[:, None] * frequencies
    mean = np.sinc(rows.width[:, None] * frequencies)
    return np.stack([np.cos(angle) * mean, np.sin(angle) * mean], axis=2).reshape(len(angle), -1)


@dataclass(frozen=True, eq=False)
class LineRegression:
    """Least-squares fit of lines after projection of the whitened regressors.

    By the theorem of Frisch, Waugh and Lovell the lines have the same coefficients and covariance
    as in a common fit with the regressors, and the regressors are decomposed only once.

    **Arguments**
    - `basis`: orthonormal basis of the whitened regressors. - `residual`: of the whitened value.
    """

    rows: Rows
    noise: Whitening
    basis: Float[np.ndarray, "n r"]
    residual: Float[np.ndarray, " n"]

    @classmethod
    def from_rows(cls, rows: Rows, noise: Whitening) -> "LineRegression":
        """Project the whitened value of rows on their regressors."""
        basis, _ = orthonormal(rows.nuisance, noise)
        value = noise(rows.value)
        return cls(rows, noise, basis, value - basis @ (basis.T @ value))

    def misfit(self, frequencies: Float[np.ndarray, " k"]) -> float:
        """Return the sum of squared innovations after a fit of regressors and lines."""
        basis, _ = self._orthonormal(_waves(self.rows, frequencies))
        innovations = self.residual - basis @ (basis.T @ self.residual)
        return float(innovations @ innovations)

    def solve(
        self, frequencies: Float[np.ndarray, " k"]
    ) -> tuple[Float[np.ndarray, " 3*k"], Float[np.ndarray, "3*k 3*k"]]:
        """Fit cosine and sine of each line, and then corrections of the frequencies.

        **Returns** the coefficients and their covariance for innovations of size 1.
        """
        waves = _waves(self.rows, frequencies)
        basis, mixing = self._orthonormal(waves)
        pairs = mixing @ (basis.T @ self.residual)
        cosine, sine = waves[:, ::2], waves[:, 1::2]
        slopes = REV * self.rows.turns[:, None] * (pairs[1::2] * cosine - pairs[::2] * sine)
        basis, mixing = self._orthonormal(np.concatenate([waves, slopes], axis=1))
        return mixing @ (basis.T @ self.residual), mixing @ mixing.T

    def _orthonormal(
        self, columns: Float[np.ndarray, "n c"]
    ) -> tuple[Float[np.ndarray, "n r"], Float[np.ndarray, "c r"]]:
        """Return basis and mixing of whitened columns after projection of the regressors."""
        whitened, size = scaled(columns, self.noise)
        basis, mixing = factored(whitened - self.basis @ (self.basis.T @ whitened))
        return basis, mixing / size[:, None]

"""The periodogram of whitened rows, its false-alarm probability, and least squares in lines."""

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
_SHARE = 0.01
"""Least share of a trial's power that the columns taken off must leave of it."""


@dataclass(frozen=True)
class Scan:
    """Least-squares periodogram.

    **Arguments**
    - `cycles`: trial frequencies in cycles per revolution, shape (f,), equally spaced.
    - `height`: z = ½ n ln(RSS without the line / RSS with it), shape (f,); of noise alone it
      follows the exponential distribution at every frequency.
    """

    cycles: Float[np.ndarray, " f"]
    height: Float[np.ndarray, " f"]


def scan(
    rows: Rows,
    columns: Float[np.ndarray, "n q"],
    whitening: Whitening,
    cycles: Float[np.ndarray, " f"],
) -> Scan:
    """Height of a line at every frequency of an equally spaced grid beside `columns`."""
    basis, _ = orthonormal(columns, whitening)
    value = whitening(rows.value)
    rest = value - basis @ (basis.T @ value)
    misfit = float(rest @ rest)
    freedom = degrees_of_freedom(whitening, basis.shape[1])
    drops = np.concatenate(
        [_drop(whitening(trial), basis, rest) for trial in _trials(rows.turns, cycles)]
    )[: len(cycles)]
    share = np.clip(drops / misfit, 0.0, 1 - 1e-15) if misfit > 0 else np.zeros(len(cycles))
    return Scan(cycles, -0.5 * freedom * np.log1p(-share))


def degrees_of_freedom(whitening: Whitening, columns: int) -> int:
    """Rows less the columns, a line and the orders of the autoregression; at least 1."""
    return max(whitening.rows - columns - 2 - (len(whitening.filter) - 1), 1)


def chance(height: float, rows: Rows, freedom: int, bandwidth: float) -> float:
    """Probability that noise alone reaches a height anywhere in a scan.

    Baluev, MNRAS 385, 1279 (2008), for the periodogram of unknown noise variance (his z₃):
    1 − (1 − e⁻ᶻ) e⁻ᵗ with τ = W γ e^{−z (1 − 1/2n)} √(n sinh(z/n)), W = bandwidth √(4π var turns).
    It is an upper bound that is sharp for small probabilities.

    **Arguments**
    - `height`: z of `Scan`. `freedom`: n. `bandwidth`: cycles per revolution scanned.
    """
    width = bandwidth * np.sqrt(4 * np.pi * np.var(rows.turns))
    n = float(freedom)
    gamma = gammaln((n + 2) / 2) - gammaln((n + 1) / 2) - 0.5 * np.log((n + 2) / 2)
    ratio = height / n
    # ln √(n sinh z/n), without overflow for a line of all the power.
    root = 0.5 * (np.log(n / 2) + ratio + np.log(-np.expm1(-2 * max(ratio, 1e-300))))
    tau = width * np.exp(gamma - height * (1 - 0.5 / n) + root)
    single = np.exp(-height)
    return float(np.clip(single - (1 - single) * np.expm1(-tau), 0.0, 1.0))


def _trials(
    turns: Float[np.ndarray, " n"], cycles: Float[np.ndarray, " f"]
) -> Iterator[Complex[np.ndarray, "k n"]]:
    """exp(2πi f turns), `_CHUNK` frequencies at a time, each chunk turned on from the last."""
    step = cycles[1] - cycles[0] if len(cycles) > 1 else 0.0
    trial = np.exp(2j * np.pi * (cycles[0] + step * np.arange(_CHUNK))[:, None] * turns)
    onwards = np.exp(2j * np.pi * step * _CHUNK * turns)
    for _ in range(0, len(cycles), _CHUNK):
        yield trial
        trial *= onwards


def _drop(
    trial: Complex[np.ndarray, "k n"],
    basis: Float[np.ndarray, "n r"],
    rest: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " k"]:
    """What cosine and sine of every whitened trial take off the sum of squares.

    Both are first cleared of the basis: with c + i s = trial, the 2×2 Gram matrix follows from
    Σ|trial|², Σ trial² and their products with the basis.
    """
    products = trial @ np.column_stack([basis, rest]).astype(complex)
    onto: Any = products[:, :-1]
    right: Any = products[:, -1]
    power = np.einsum("kn,kn->k", trial, trial.conj()).real
    square = np.einsum("kn,kn->k", trial, trial)
    left = power - np.sum(np.abs(onto) ** 2, axis=1)
    skew: Any = square - np.sum(onto**2, axis=1)
    cc, ss, cs = 0.5 * (left + skew.real), 0.5 * (left - skew.real), 0.5 * skew.imag
    determinant = cc * ss - cs**2
    drop = ss * right.real**2 + cc * right.imag**2 - 2 * cs * right.real * right.imag
    # The smaller eigenvalue: both cosine and sine must be left.
    seen = determinant > _SHARE * power * np.maximum(left, 1e-300)
    return np.where(seen, drop / np.where(seen, determinant, 1.0), 0.0)


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

"""Least-squares fit of lines (cosine and sine of unknown frequency) together with regressors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.linalg import qr

from ...base.units import REV
from .noise import whitened
from .rows import KnownWaves, Rows, Wave

APART = 1.0
"""Least distance of two lines, in resolutions; a resolution is 1 / (revolutions of the log)
(chosen)."""

_STEPS = 16
_CONVERGED = 0.01
"""Largest number of Gauss–Newton steps. The iteration ends earlier if the step of every frequency
is at most `_CONVERGED` standard errors of this frequency (chosen)."""

_UNCHANGED = np.ones(1)
_RANK = 1e-10
"""A column is independent if the part orthogonal to the other columns has at least this norm,
relative to the column (chosen)."""

_INDEPENDENT = 1e-6
"""The normal equations are used if the least eigenvalue of the Gram matrix of normalised columns
reaches this value; the coefficients are then correct to ten digits (chosen)."""


@dataclass(frozen=True, eq=False)
class Regressors:
    """Pairs of the rows of a group and an orthonormal basis of its regressors, in row order."""

    blocks: tuple[tuple[slice, Float[np.ndarray, "_ _"]], ...]

    @classmethod
    def of(cls, rows: Rows) -> "Regressors":
        """Orthonormalise the regressors of `rows`; linearly dependent columns are omitted."""
        return cls(tuple((where, orthonormal(columns)[0]) for where, columns in rows.nuisance))

    @property
    def rank(self) -> int:
        """Number of independent regressors of all groups."""
        return sum(basis.shape[1] for _, basis in self.blocks)

    def residual(self, columns: Float[np.ndarray, " n *k"]) -> Float[np.ndarray, " n *k"]:
        """Return the part of `columns` orthogonal to the regressors, column-major in memory."""
        left = np.array(columns.T, order="C")
        for where, basis in self.blocks:
            part = left[..., where]
            part -= (part @ basis) @ basis.T
        return left.T


def orthonormal(
    columns: Float[np.ndarray, "n q"],
) -> tuple[Float[np.ndarray, "n r"], Float[np.ndarray, "q r"]]:
    """Return an orthonormal basis of `columns`, and the matrix `mixing`: basis = columns @ mixing.

    Linearly dependent columns are omitted, so that r ≤ q.
    """
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    factors: Any = qr(columns / size, mode="economic", pivoting=True, check_finite=False)
    basis, upper, order = factors
    rank = int(np.count_nonzero(np.abs(np.diag(upper)) > _RANK))
    mixing = np.zeros((columns.shape[1], rank))
    mixing[order[:rank]] = np.linalg.inv(upper[:rank, :rank])
    return basis[:, :rank], mixing / size[:, None]


def waves(rows: Rows, frequencies: Sequence[float] | np.ndarray) -> Float[np.ndarray, "n k"]:
    """Return cosine and sine of every line at every row, two columns for each frequency.

    Both are averaged over the angle `rows.width` over which the row itself was averaged.
    """
    return _columns(lambda one: rows.waves.of(one, partial(_wave, rows)), frequencies, rows)


def _wave(rows: Rows, cycles: float) -> Wave:
    angle = REV * cycles * rows.turns
    table = np.stack([np.cos(angle), np.sin(angle)])
    if rows.width.any():
        table *= np.sinc(cycles * rows.width)
    return table.T


def _columns(
    wave: Callable[[float], Wave], frequencies: Sequence[float] | np.ndarray, rows: Rows
) -> Float[np.ndarray, "n k"]:
    """Return cosine and sine of all lines, in column-major memory order.

    `wave` computes the two columns of one frequency.
    """
    table = np.empty((2 * len(frequencies), len(rows.turns)))
    for place, cycles in enumerate(frequencies):
        table[2 * place : 2 * place + 2] = wave(float(cycles)).T
    return table.T


def fitted(
    columns: Float[np.ndarray, "n q"], value: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q q"]]:
    """Return the least-squares coefficients of `columns` and their covariance for noise variance 1.

    The normal equations are solved if the columns are far from dependent; otherwise QR is used.
    """
    products, right = columns.T @ columns, columns.T @ value
    size = np.sqrt(np.diag(products))
    size[size == 0] = 1.0
    values, vectors = np.linalg.eigh(products / np.outer(size, size))
    if len(values) and values[0] < _INDEPENDENT:
        basis, mixing = orthonormal(columns)
        return mixing @ (basis.T @ value), mixing @ mixing.T
    root = vectors / np.sqrt(values) / size[:, None]
    return root @ (root.T @ right), root @ root.T


@dataclass(frozen=True, eq=False)
class LineRegression:
    """Least-squares fit of lines to the whitened residual after a fit of the regressors.

    The regressors are projected out of the value and the lines before both are whitened.

    **Arguments**
    - `taps`: whitening filter along every run; (1,) without whitening.
    - `residual`: value minus its fit by the regressors, then whitened, rad, shape (n,).
    - `waves`: cache of the whitened columns of lines.
    """

    rows: Rows
    regressors: Regressors
    taps: Float[np.ndarray, " taps"]
    residual: Float[np.ndarray, " n"]
    waves: KnownWaves = field(default_factory=KnownWaves)

    @classmethod
    def of(
        cls, rows: Rows, regressors: Regressors, taps: Float[np.ndarray, " taps"] = _UNCHANGED
    ) -> "LineRegression":
        """Remove the regressors from the value of `rows`, and whiten the rest with `taps`."""
        return cls(rows, regressors, taps, whitened(rows, regressors.residual(rows.value), taps))

    def columns(self, frequencies: Sequence[float] | np.ndarray) -> Float[np.ndarray, "n k"]:
        """Return cosine and sine of every line, made orthogonal to the regressors and whitened."""
        return _columns(lambda one: self.waves.of(one, self._white), frequencies, self.rows)

    def _white(self, cycles: float) -> Wave:
        return whitened(self.rows, self.regressors.residual(waves(self.rows, [cycles])), self.taps)

    def after(self, frequencies: Sequence[float] | np.ndarray) -> Float[np.ndarray, " n"]:
        """Return the whitened residual of a fit of regressors and lines."""
        columns = self.columns(frequencies)
        return self.residual - columns @ fitted(columns, self.residual)[0]

    def misfit(self, frequencies: Sequence[float] | np.ndarray) -> float:
        """Return the sum of squares of the whitened residual of a fit of regressors and lines."""
        residual = self.after(frequencies)
        return float(residual @ residual)

    def drops(self, frequencies: Float[np.ndarray, " k"]) -> tuple[Float[np.ndarray, " k"], float]:
        """Return the decrease of the sum of squares by each line, and the remaining sum of squares.

        The decrease by a line is relative to a fit of all other lines. The remaining sum of squares
        is that of a fit of all lines.
        """
        columns = self.columns(frequencies)
        pairs, covariance = fitted(columns, self.residual)
        rest = self.residual - columns @ pairs
        drops = [
            pairs[wave] @ np.linalg.pinv(covariance[wave, wave]) @ pairs[wave]
            for wave in (slice(k, k + 2) for k in range(0, len(pairs), 2))
        ]
        return np.array(drops), float(rest @ rest)

    def solve(
        self, frequencies: Float[np.ndarray, " k"]
    ) -> tuple[Float[np.ndarray, " 3*k"], Float[np.ndarray, "3*k 3*k"]]:
        """Fit cosine and sine of each line together with a linear correction of each frequency.

        **Returns** the coefficients (2 k of cosines and sines, then k corrections of frequencies in
        cycles per revolution) and their covariance for innovations of variance 1.
        """
        columns = self.columns(frequencies)
        pairs, _ = fitted(columns, self.residual)
        wave = waves(self.rows, frequencies)
        change = pairs[1::2] * wave[:, ::2] - pairs[::2] * wave[:, 1::2]
        slopes = self.regressors.residual(REV * self.rows.turns[:, None] * change)
        slopes = whitened(self.rows, slopes, self.taps)
        return fitted(np.concatenate([columns.T, slopes.T]).T, self.residual)

    def refine(
        self, frequencies: Float[np.ndarray, " k"], lowest_cycles: float
    ) -> Float[np.ndarray, " k"]:
        """Return the frequencies of least misfit near `frequencies`, by Gauss–Newton iteration.

        A step that fails is halved. Two lines keep a distance of at least the resolution; otherwise
        their amplitudes are undefined. No frequency falls below `lowest_cycles`.
        """
        count, resolution = len(frequencies), 1 / self.rows.span
        size, lowest = 1.0, self.misfit(frequencies)
        coefficients, covariance = self.solve(frequencies)
        for _ in range(_STEPS):
            step = np.clip(coefficients[-count:], -0.25 * resolution, 0.25 * resolution)
            scatter = np.sqrt(np.diag(covariance)[-count:] * lowest / len(self.residual))
            if np.all(np.abs(size * step) <= _CONVERGED * scatter):
                break
            trial = frequencies + size * step
            misfit = self.misfit(trial)
            apart = np.min(np.diff(np.sort(trial)), initial=np.inf)
            if misfit < lowest and trial.min() >= lowest_cycles and apart >= APART * resolution:
                frequencies, lowest = trial, misfit
                coefficients, covariance = self.solve(frequencies)
            else:
                size *= 0.5
        return frequencies

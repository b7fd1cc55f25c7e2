"""Least-squares fit of lines (cosine and sine of unknown frequency) together with regressors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

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
    return _columns(partial(_known_wave, rows), frequencies, rows)


def _known_wave(rows: Rows, cycles: float) -> Wave:
    return rows.waves.of(cycles, partial(_wave, rows))


def _wave(rows: Rows, cycles: float) -> Wave:
    angle = cycles * rows.turns
    angle -= np.rint(angle)  # NumPy is faster for small angles
    angle *= REV
    table = np.empty((2, len(angle)))
    np.cos(angle, out=table[0])
    np.sin(angle, out=table[1])
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
    found = _of_products(columns.T @ columns, columns.T @ value)
    return _by_factors(columns, value) if found is None else found


def _of_products(
    products: Float[np.ndarray, "q q"], right: Float[np.ndarray, " q"]
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q q"]] | None:
    """Return the solution of the normal equations, or None if the columns are nearly dependent."""
    size = np.sqrt(np.diag(products))
    size[size == 0] = 1.0
    values, vectors = np.linalg.eigh(products / np.outer(size, size))
    if len(values) and values[0] < _INDEPENDENT:
        return None
    root = vectors / np.sqrt(values) / size[:, None]
    return root @ (root.T @ right), root @ root.T


def _by_factors(
    columns: Float[np.ndarray, "n q"], value: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q q"]]:
    basis, mixing = orthonormal(columns)
    return mixing @ (basis.T @ value), mixing @ mixing.T


@dataclass(frozen=True, eq=False)
class LineRegression:
    """Least-squares fit of lines to the whitened residual after a fit of the regressors.

    The regressors are projected out of the value and the lines before both are whitened.

    **Arguments**
    - `taps`: whitening filter along every run; (1,) without whitening.
    - `residual`: value minus its fit by the regressors, then whitened, rad, shape (n,).
    - `plain`: the same regression without whitening, which keeps the projected columns; None if
      this one is not whitened.
    - `waves`, `slopes`: caches of the whitened columns of lines and of their derivatives.
    """

    rows: Rows
    regressors: Regressors
    taps: Float[np.ndarray, " taps"]
    residual: Float[np.ndarray, " n"]
    plain: "LineRegression | None" = None
    waves: KnownWaves = field(default_factory=KnownWaves)
    slopes: KnownWaves = field(default_factory=KnownWaves)

    @classmethod
    def of(
        cls, rows: Rows, regressors: Regressors, taps: Float[np.ndarray, " taps"] = _UNCHANGED
    ) -> "LineRegression":
        """Remove the regressors from the value of `rows`, and whiten the rest with `taps`."""
        plain = cls(rows, regressors, _UNCHANGED, regressors.residual(rows.value))
        return plain.whitened(taps)

    def whitened(self, taps: Float[np.ndarray, " taps"]) -> "LineRegression":
        """Return the same regression, whitened with `taps`; `self` must not be whitened."""
        if len(taps) == 1:
            return self
        residual = whitened(self.rows, self.residual, taps)
        return LineRegression(self.rows, self.regressors, taps, residual, self)

    def columns(self, frequencies: Sequence[float] | np.ndarray) -> Float[np.ndarray, "n k"]:
        """Return cosine and sine of every line, made orthogonal to the regressors and whitened."""
        return _columns(self._wave, frequencies, self.rows)

    def _wave(self, cycles: float) -> Wave:
        return self.waves.of(cycles, self._projected if self.plain is None else self._white)

    def _projected(self, cycles: float) -> Wave:
        return self.regressors.residual(_known_wave(self.rows, cycles))

    def _white(self, cycles: float) -> Wave:
        assert self.plain is not None
        return whitened(self.rows, self.plain._wave(cycles), self.taps)

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
        return self._solved(self._fit(frequencies))

    def refine(
        self, frequencies: Float[np.ndarray, " k"], lowest_cycles: float
    ) -> Float[np.ndarray, " k"]:
        """Return the frequencies of least misfit near `frequencies`, by Gauss–Newton iteration.

        A step that fails is halved, and a step moves only the lines that are not yet at their best
        frequency. Two lines keep a distance of at least the resolution; otherwise their amplitudes
        are undefined. No frequency falls below `lowest_cycles`.
        """
        count, resolution = len(frequencies), 1 / self.rows.span
        size, best = 1.0, self._fit(frequencies)
        coefficients, covariance = self._solved(best)
        for _ in range(_STEPS):
            step = np.clip(coefficients[-count:], -0.25 * resolution, 0.25 * resolution)
            scatter = np.sqrt(np.diag(covariance)[-count:] * best.misfit / len(self.residual))
            moves = np.abs(size * step) > _CONVERGED * scatter
            if not moves.any():
                break
            trial = best.frequencies + np.where(moves, size * step, 0.0)
            apart = np.min(np.diff(np.sort(trial)), initial=np.inf)
            allowed = trial.min() >= lowest_cycles and apart >= APART * resolution
            found = self._fit(trial) if allowed else best
            if found.misfit < best.misfit:
                best = found
                coefficients, covariance = self._solved(best)
            else:
                size *= 0.5
        return best.frequencies

    def _fit(self, frequencies: Float[np.ndarray, " k"]) -> "_Fitted":
        columns = self.columns(frequencies)
        products, right = columns.T @ columns, columns.T @ self.residual
        found = _of_products(products, right)
        pairs = (_by_factors(columns, self.residual) if found is None else found)[0]
        rest = self.residual - columns @ pairs
        left = float(rest @ rest)
        return _Fitted(frequencies, pairs, left, columns=columns, products=products, right=right)

    def _solved(self, found: "_Fitted") -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, "c c"]]:
        """Fit the lines of `found` and a linear correction of their frequencies; see `solve`."""
        moved = np.empty((len(found.frequencies), len(self.residual)))
        for place, cycles in enumerate(found.frequencies):
            wave = slice(2 * place, 2 * place + 2)
            np.matmul(found.pairs[wave], self._slopes(float(cycles)).T, out=moved[place])
        crossed = moved @ found.columns
        products = np.block([[found.products, crossed.T], [crossed, moved @ moved.T]])
        right = np.concatenate([found.right, moved @ self.residual])
        solved = _of_products(products, right)
        return solved or _by_factors(np.hstack([found.columns, moved.T]), self.residual)

    def _slopes(self, cycles: float) -> Wave:
        """Return the derivatives of the columns of a line with respect to its frequency."""
        return self.slopes.of(cycles, self._slopes_now)

    def _slopes_now(self, cycles: float) -> Wave:
        if self.plain is not None:
            return whitened(self.rows, self.plain._slopes(cycles), self.taps)
        cosine, sine = _known_wave(self.rows, cycles).T
        turns = REV * self.rows.turns
        return self.regressors.residual(np.stack([-turns * sine, turns * cosine]).T)


class _Fitted(NamedTuple):
    """Frequencies of lines, coefficients of their columns, and the sum of squares that remains.

    `products` and `right` are the products of the `columns` with each other and with the value.
    """

    frequencies: Float[np.ndarray, " k"]
    pairs: Float[np.ndarray, " 2*k"]
    misfit: float
    columns: Float[np.ndarray, "n 2*k"]
    products: Float[np.ndarray, "2*k 2*k"]
    right: Float[np.ndarray, " 2*k"]

"""Comparison of several sets of periodic terms, each of which may explain a residual."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from .noise import noise_filter, whitened
from .regression import APART, orthonormal, waves
from .rows import Rows, Stretch, stack

_TRIALS = 9  # trial frequencies before the refinement; chosen value
_STEP = 0.05  # step for the curvature of ln L, in units of `Comparison.resolution`; chosen value


@dataclass(frozen=True, eq=False)
class Comparison:
    """Generalised least squares of terms a cos(cφ) + b sin(cφ) together with regressors.

    An explanation is a set of frequencies c; every side (flank) has separate coefficients a, b. All
    explanations use one noise model, from the residual of the explanation with most frequencies.

    **Arguments**
    - `taps`: whitening filter along every run.
    - `sides`: indices of the rows of every side.
    - `bases`: rows of every group of runs and an orthonormal basis of its whitened regressors.
    - `value`: whitened value minus its fit by the regressors, rad, shape (n,).
    """

    rows: Rows
    taps: Float[np.ndarray, " taps"]
    sides: tuple[Int[np.ndarray, " _"], ...]
    bases: tuple[tuple[slice, Float[np.ndarray, "_ _"]], ...]
    value: Float[np.ndarray, " n"]

    @classmethod
    def of(
        cls,
        runs: Sequence[Stretch],
        sides: Sequence[str],
        frequencies: Sequence[float],
        highest: float,
    ) -> "Comparison":
        """Prepare a comparison for `runs`.

        **Arguments**
        - `sides`: name of the side of every run. Runs of one group have one side.
        - `frequencies`: all frequencies of the largest explanation, which defines the noise model.
        - `highest`: highest frequency in cycles per revolution.
        """
        rows = stack(runs, highest)
        side_of = {run.group: side for run, side in zip(runs, sides, strict=True)}
        places: dict[str, list[np.ndarray]] = {}
        for group, (where, _) in zip(side_of, rows.nuisance, strict=True):
            places.setdefault(side_of[group], []).append(np.arange(where.start, where.stop))
        joined = tuple(np.concatenate(parts) for parts in places.values())
        white = cls._under(rows, joined, np.ones(1))
        return cls._under(rows, joined, noise_filter(rows, white._left(frequencies)))

    @classmethod
    def _under(
        cls,
        rows: Rows,
        sides: tuple[Int[np.ndarray, " _"], ...],
        taps: Float[np.ndarray, " taps"],
    ) -> "Comparison":
        bases = []
        for where, columns in rows.nuisance:
            padded = np.zeros((len(rows.value), columns.shape[1]))
            padded[where] = columns
            bases.append((where, orthonormal(whitened(rows, padded, taps)[where])[0]))
        one = cls(rows, taps, sides, tuple(bases), whitened(rows, rows.value, taps))
        return cls(rows, taps, sides, tuple(bases), one._outside(one.value))

    @property
    def resolution(self) -> float:
        """Frequency of one cycle over the whole log, in cycles per revolution."""
        return 1 / self.rows.span

    @property
    def freedom(self) -> int:
        """Number of whitened rows minus the number of regressors, at least one."""
        lost = (len(self.taps) - 1) * len(self.rows.runs)
        return max(len(self.value) - lost - sum(basis.shape[1] for _, basis in self.bases), 1)

    @property
    def penalty(self) -> float:
        """Increase of BIC by one coefficient, log of `freedom`."""
        return float(np.log(self.freedom))

    @property
    def coefficients(self) -> int:
        """Number of coefficients that one frequency adds: two for every side."""
        return 2 * len(self.sides)

    def height(self, frequencies: Sequence[float]) -> float:
        """Return −2 ln L of a fit of lines at `frequencies`, up to a constant of the comparison."""
        left = self._left(frequencies)
        return self.freedom * float(np.log(max(float(left @ left), 1e-300)))

    def refined(
        self, cycles: float, beside: Sequence[float], lines: Sequence[float] = ()
    ) -> tuple[float, float]:
        """Return the best frequency within one resolution of `cycles`, and −2 ln L there.

        Lines at the fixed frequencies `beside` and `lines` are fitted too. If `cycles` is at least
        one resolution from each of `lines`, so is the result, because the amplitudes of closer
        lines are undefined.
        """

        from scipy.optimize import minimize_scalar  # slow to import, and `inspect` compares nothing

        def height(frequency: float) -> float:
            return self.height([*beside, *lines, frequency])

        apart = APART * self.resolution
        low = max([apart / 2, cycles - self.resolution, *(c + apart for c in lines if c < cycles)])
        high = min([cycles + self.resolution, *(c - apart for c in lines if c > cycles)])
        trials = np.linspace(min(low, cycles), max(high, cycles), _TRIALS)
        best = int(np.argmin([height(trial) for trial in trials]))
        bounds = (trials[max(best - 1, 0)], trials[min(best + 1, _TRIALS - 1)])
        options = {"xatol": 1e-3 * self.resolution}
        found: Any = minimize_scalar(height, bounds=bounds, method="bounded", options=options)
        return float(found.x), float(found.fun)

    def frequency_std(self, cycles: float, beside: Sequence[float]) -> float:
        """Return the standard error of the frequency `cycles`, from the curvature of ln L.

        Lines at the fixed frequencies `beside` are fitted too.
        """
        step = _STEP * self.resolution
        low, middle, high = (
            self.height([*beside, cycles + sign * step]) for sign in (-1.0, 0.0, 1.0)
        )
        return step * float(np.sqrt(2 / max(low + high - 2 * middle, 1e-300)))

    def _outside(self, columns: Float[np.ndarray, " n *k"]) -> Float[np.ndarray, " n *k"]:
        parts = [columns[where] - basis @ (basis.T @ columns[where]) for where, basis in self.bases]
        return np.concatenate(parts)

    def _left(self, frequencies: Sequence[float]) -> Float[np.ndarray, " n"]:
        """Return the whitened residual of a fit of the regressors and of lines at `frequencies`."""
        if not len(frequencies):
            return self.value
        columns = self._outside(whitened(self.rows, waves(self.rows, frequencies), self.taps))
        left = self.value.copy()
        for side in self.sides:
            basis, _ = orthonormal(columns[side])
            left[side] -= basis @ (basis.T @ left[side])
        return left

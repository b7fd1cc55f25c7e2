"""Noise model for few turns: white noise, and noise that is correlated also from run to run.

The rows have residuals of covariance

    K = e^s [(1 − w) exp(−|t − t'| / τ) + w 1].

A few turns determine s, τ and w only roughly, and a fit of many columns hides slow noise. All
values are therefore weighted by their restricted likelihood L, with a uniform prior of s, ln τ and
logit w (D. A. Harville, Biometrika 61 (1974) 383). With s integrated out, a linear function of the
rows with the weights u has the error

    Σ p(τ, w) √v(τ, w) t_ν,    v = uᵀ K u,    p ∝ L,

a mixture of Student's distributions with ν degrees of freedom, the number of rows minus the number
of columns. An autoregression of the rows, in contrast, treats the runs of a log as independent.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.optimize import brentq
from scipy.special import stdtr, stdtrit

from ..compress.orthogonal import triangle_of

_MOST_ROWS = 300
"""Rows of the likelihood; more are averaged, because its cost grows with their third power."""

_LONGEST = 1.0
"""Largest correlation time, relative to the duration of the log; slower noise is drift (chosen)."""

_LEAST_WHITE, _MOST_WHITE = -8.0, 4.0  # bounds of logit w; chosen values
_MEMORIES, _WHITES = 14, 9
"""Numbers of values of ln τ and logit w, in the middle of equal cells; a finer grid changes a
half-width by less than 5 %."""

_EMPTY = 1e-9  # least singular value of the columns, relative to the largest; chosen value
_OUTSIDE = 0.05  # probability of an error beyond the half-width


@dataclass(frozen=True, eq=False)
class Run:
    """Rows of one run; `design` and `value` are multiplied by `share`.

    **Arguments**
    - `time`: times, s; those of different logs are far apart.
    - `share`: root of the weight that a robust loss gives to each row, 0 … 1.
    - `design`: columns whose coefficients are fitted; each flank has columns of its own.
    - `value`: transmission error, rad.
    """

    time: Float[np.ndarray, " n"]
    share: Float[np.ndarray, " n"]
    design: Float[np.ndarray, "n q"]
    value: Float[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class RememberedNoise:
    """Probability of each correlation time τ and share w of white noise, for the rows of all runs.

    Neighbouring rows are averaged if there are many.

    **Arguments**
    - `rows`: averaged rows. - `size`: number of rows that are averaged to one.
    - `runs`: rows of every run before the averages.
    - `memory_s`: correlation times τ, s. - `white`: shares w of white noise in the variance.
    - `scale`: for each τ and w, the variance e^s with the largest likelihood, rad².
    - `probability`: probability of each τ and w; the sum is 1.
    """

    rows: "_Rows"
    size: int
    runs: Sequence[Run]
    memory_s: Float[np.ndarray, " t"]
    white: Float[np.ndarray, " w"]
    scale: Float[np.ndarray, "t w"]
    probability: Float[np.ndarray, "t w"]

    @classmethod
    def of(cls, runs: Sequence[Run]) -> "RememberedNoise":
        """Return the probabilities of all τ and w on a grid, from their restricted likelihood."""
        size = max(1, -(-sum(len(run.time) for run in runs) // _MOST_ROWS))
        found = []
        for run in runs:
            rows = np.column_stack([run.share, run.time, run.design, run.value])
            total = _sums(rows * run.share[:, None], size)
            found.append(total / np.maximum(total[:, :1], 1e-300))
            found[-1][:, 1] = _sums(run.time, size) / _sums(np.ones(len(run.time)), size)
            found[-1] = found[-1][total[:, 0] > 0]
        averaged = np.concatenate(found)
        rows = _Rows.of(averaged[:, 1], averaged[:, 2:-1], averaged[:, -1])
        longest = np.log(_LONGEST * len(rows.value))
        memory_s = rows.step * np.exp(_middles(0.0, longest, _MEMORIES))
        white = 1 / (1 + np.exp(-_middles(_LEAST_WHITE, _MOST_WHITE, _WHITES)))
        parts = np.array([[rows.parts(memory, share) for share in white] for memory in memory_s])
        misfit = np.maximum(parts[..., 0], 1e-300)
        height = rows.freedom * np.log(misfit) + parts[..., 1]
        likelihood = np.exp((height.min() - height) / 2)
        return cls(
            rows=rows,
            size=size,
            runs=runs,
            memory_s=memory_s,
            white=white,
            scale=misfit / rows.freedom,
            probability=likelihood / likelihood.sum(),
        )

    def half_widths(self, weights: Sequence[Float[np.ndarray, "_ k"]]) -> Float[np.ndarray, " k"]:
        """Return the half widths of the 95 % intervals of k functions of the rows.

        The error of a function is a weighted sum of the errors of the rows. The distribution of
        this error is averaged over τ and w with their probabilities. The unit is that of the
        functions.

        **Arguments**
        - `weights`: for every run, the derivatives of the k functions with respect to its rows.
        """
        summed = np.concatenate(
            [
                _sums(own * run.share[:, None], self.size)[_sums(run.share**2, self.size) > 0]
                for own, run in zip(weights, self.runs, strict=True)
            ]
        )
        slow = np.array(
            [
                np.sum(summed * (self.rows.correlation(one) @ summed), axis=0)
                for one in self.memory_s
            ]
        )
        mixed = np.multiply.outer(1 - self.white, slow).swapaxes(0, 1)
        mixed += np.multiply.outer(self.white, np.sum(summed**2, axis=0))
        std = np.sqrt(np.maximum(self.scale[..., None] * mixed, 0.0))
        probability, freedom = self.probability.ravel(), float(self.rows.freedom)
        return np.array(
            [_half_width(own, probability, freedom) for own in std.reshape(-1, std.shape[-1]).T]
        )


def _half_width(
    std: Float[np.ndarray, " n"], probability: Float[np.ndarray, " n"], freedom: float
) -> float:
    """Return the half-width of the 95 % interval of a mixture of Student's distributions.

    Component k of the mixture has the scale `std[k]`, the weight `probability[k]` and `freedom`
    degrees of freedom.
    """
    quantile = float(stdtrit(freedom, 1 - _OUTSIDE / 2))
    counted = probability > 0
    std, probability = std[counted], probability[counted]
    low, high = quantile * float(std.min()), quantile * float(std.max())
    if not low < high or low == 0:
        return high

    def excess(width: float) -> float:
        return 2 * float(probability @ stdtr(freedom, -width / std)) - _OUTSIDE

    found: Any = brentq(excess, 0.99 * low, 1.01 * high)
    return found


def _middles(low: float, high: float, count: int) -> Float[np.ndarray, " count"]:
    """Return the middles of `count` equal cells between `low` and `high`."""
    return low + (high - low) * (np.arange(count) + 0.5) / count


def _sums(rows: Float[np.ndarray, "n ..."], size: int) -> Float[np.ndarray, "m ..."]:
    """Return the sums of every `size` neighbouring rows; the last sum may have fewer rows."""
    return np.add.reduceat(rows, np.arange(0, len(rows), size), axis=0)


@dataclass(frozen=True, eq=False)
class _Rows:
    """Averaged rows: distances in time, design matrix and values.

    `distance` holds |t_j − t_k| and `step` is the median distance of neighbours, s. `basis` is an
    orthonormal basis of the columns of the design matrix, and `value` is the TE, rad.
    """

    distance: Float[np.ndarray, "n n"]
    basis: Float[np.ndarray, "n q"]
    value: Float[np.ndarray, " n"]
    step: float

    @classmethod
    def of(
        cls,
        time: Float[np.ndarray, " n"],
        design: Float[np.ndarray, "n q"],
        value: Float[np.ndarray, " n"],
    ) -> "_Rows":
        size = np.linalg.norm(design, axis=0)
        scaled = design / np.where(size > 0, size, 1.0)
        left, singular, _ = np.linalg.svd(scaled, full_matrices=False)
        return cls(
            distance=np.abs(np.subtract.outer(time, time)),
            basis=left[:, singular > _EMPTY * singular[0]],
            value=value,
            step=float(np.median(np.diff(time))),
        )

    @property
    def freedom(self) -> int:
        """Number of rows minus number of independent columns, at least 1."""
        return max(len(self.value) - self.basis.shape[1], 1)

    def correlation(self, memory_s: float) -> Float[np.ndarray, "n n"]:
        """Return the correlations exp(−|t_j − t_k|/τ) of all pairs of rows; τ is `memory_s`."""
        return np.exp(-self.distance / memory_s)

    def parts(self, memory_s: float, white: float) -> tuple[float, float]:
        """Return the whitened misfit, and the sum of two log-determinants.

        These are ln|K e^−s| and ln|Xᵀ K⁻¹ X e^s| for the τ `memory_s` and the w `white`.
        """
        matrix = (1 - white) * self.correlation(memory_s)
        matrix[np.diag_indices_from(matrix)] = 1.0
        lower = np.linalg.cholesky(matrix)
        columns = np.column_stack([self.basis, self.value])
        triangle = triangle_of(solve_triangular(lower, columns, lower=True))
        diagonal = np.append(np.diag(lower), np.diag(triangle)[:-1])
        return float(triangle[-1, -1] ** 2), 2 * float(np.sum(np.log(np.abs(diagonal))))

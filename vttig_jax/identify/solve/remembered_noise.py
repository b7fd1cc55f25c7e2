"""Noise of few turns: white noise and noise that remembers, also from one run to the next.

The rows have residuals of covariance

    K = e^s [(1 − w) exp(−|t − t'| / τ) + w 1].

Restricted likelihood estimates s, ln τ and logit w. A linear function with the weights u of the
rows then has the variance v = uᵀ K u with Satterthwaite's degrees of freedom

    ν = 2 v² / (∇vᵀ A ∇v),    A = 2 H⁻¹,

where H is the Hessian of −2 ln of the likelihood (F. E. Satterthwaite, Biometrics Bull. 2 (1946)
110). An autoregression of the rows knows less: it takes the runs of a log as independent.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from ..compress.orthogonal import triangle_of
from ..noise.freedom import satterthwaite

_MOST_ROWS = 300
"""Rows of the likelihood; more are averaged, because its cost grows with their third power."""

_LONGEST = 10.0  # largest correlation time in durations of the log; chosen value
_LEAST_WHITE, _MOST_WHITE = -9.0, 6.0  # bounds of logit w; chosen values
_STEP = 0.02  # step of the differences of ln τ and logit w; chosen value
_SEARCH = {"xatol": 0.02, "fatol": 1e-3, "maxfev": 80}
"""Tolerances of the search, small beside the standard errors, 0.3 and more (chosen)."""

_EMPTY = 1e-9  # least singular value of a column that counts, relative; chosen value

Shape = Float[np.ndarray, "2"]
"""ln τ and logit w."""


@dataclass(frozen=True, eq=False)
class Run:
    """Rows of one run, multiplied by their shares.

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
    """Estimated noise of the rows of all runs; neighbouring rows are averaged if there are many.

    **Arguments**
    - `likelihood`: likelihood of the averaged rows. - `shape`: its largest value.
    - `size`: rows per averaged row. - `runs`: rows of every run.
    """

    likelihood: "_Likelihood"
    shape: Shape
    size: int
    runs: Sequence[Run]

    @classmethod
    def of(cls, runs: Sequence[Run]) -> "RememberedNoise":
        """Estimate the noise."""
        size = max(1, -(-sum(len(run.time) for run in runs) // _MOST_ROWS))
        found = []
        for run in runs:
            rows = np.column_stack([run.share, run.time, run.design, run.value])
            total = _sums(rows * run.share[:, None], size)
            found.append(total / np.maximum(total[:, :1], 1e-300))
            found[-1][:, 1] = _sums(run.time, size) / _sums(np.ones(len(run.time)), size)
            found[-1] = found[-1][total[:, 0] > 0]
        rows = np.concatenate(found)
        likelihood = _Likelihood.of(rows[:, 1], rows[:, 2:-1], rows[:, -1])
        return cls(likelihood, likelihood.best(), size, runs)

    def variances(
        self, weights: Sequence[Float[np.ndarray, "_ k"]]
    ) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
        """Return the variances of functions with these weights of the rows of every run, and ν."""
        summed = np.concatenate(
            [
                _sums(own * run.share[:, None], self.size)[_sums(run.share**2, self.size) > 0]
                for own, run in zip(weights, self.runs, strict=True)
            ]
        )
        left = self.likelihood.freedom

        def at(first: float = 0.0, second: float = 0.0):
            """Return the misfit, the log-determinants and uᵀ K u e^−s at a shifted shape."""
            shape = self.shape + _STEP * np.array([first, second])
            variance = np.einsum("nk,nk->k", summed, self.likelihood.covariance(shape) @ summed)
            return (*self.likelihood.parts(shape), variance)

        middle = at()
        scale = middle[0] / left
        height = lambda part: part[0] / scale + part[1] - left - middle[1]  # noqa: E731
        ends = [[at(step, 0.0) for step in (1.0, -1.0)], [at(0.0, step) for step in (1.0, -1.0)]]
        mixed = height(at(1.0, 1.0)) + height(at(-1.0, -1.0))
        mixed -= sum(height(end) for pair in ends for end in pair)
        hessian = np.diag([left, 0.0, 0.0])
        hessian[1, 2] = hessian[2, 1] = mixed / (2 * _STEP**2)
        for place, (up, down) in enumerate(ends, 1):
            hessian[place, place] = (height(up) + height(down)) / _STEP**2
            hessian[0, place] = hessian[place, 0] = (down[0] - up[0]) / (2 * _STEP * scale)
        slope = np.array([middle[2], *((up[2] - down[2]) / (2 * _STEP) for up, down in ends)])
        return scale * middle[2], satterthwaite(middle[2], slope, hessian)


def _sums(rows: Float[np.ndarray, "n ..."], size: int) -> Float[np.ndarray, "m ..."]:
    """Return the sums over so many neighbouring rows."""
    return np.add.reduceat(rows, np.arange(0, len(rows), size), axis=0)


@dataclass(frozen=True, eq=False)
class _Likelihood:
    """Restricted likelihood of rows; `basis` is an orthonormal basis of their columns."""

    distance: Float[np.ndarray, "n n"]
    basis: Float[np.ndarray, "n q"]
    value: Float[np.ndarray, " n"]
    shortest: float
    longest: float

    @classmethod
    def of(
        cls,
        time: Float[np.ndarray, " n"],
        design: Float[np.ndarray, "n q"],
        value: Float[np.ndarray, " n"],
    ) -> "_Likelihood":
        size = np.linalg.norm(design, axis=0)
        scaled = design / np.where(size > 0, size, 1.0)
        left, singular, _ = np.linalg.svd(scaled, full_matrices=False)
        step = float(np.median(np.diff(time)))
        return cls(
            distance=np.abs(np.subtract.outer(time, time)),
            basis=left[:, singular > _EMPTY * singular[0]],
            value=value,
            shortest=step,
            longest=_LONGEST * step * len(time),
        )

    @property
    def freedom(self) -> int:
        """Rows less columns."""
        return max(len(self.value) - self.basis.shape[1], 1)

    def covariance(self, shape: Shape) -> Float[np.ndarray, "n n"]:
        """Return K e^−s."""
        white = 1 / (1 + np.exp(-shape[1]))
        matrix = (1 - white) * np.exp(-self.distance / np.exp(shape[0]))
        matrix[np.diag_indices_from(matrix)] = 1.0
        return matrix

    def parts(self, shape: Shape) -> tuple[float, float]:
        """Return the misfit, and the sum of the log-determinants of K e^−s and of Xᵀ K⁻¹ X e^s."""
        lower = np.linalg.cholesky(self.covariance(shape))
        columns = np.column_stack([self.basis, self.value])
        triangle = triangle_of(solve_triangular(lower, columns, lower=True))
        diagonal = np.append(np.diag(lower), np.diag(triangle)[:-1])
        return float(triangle[-1, -1] ** 2), 2 * float(np.sum(np.log(np.abs(diagonal))))

    def best(self) -> Shape:
        """Return the shape of the largest likelihood, which may have several maxima."""
        low = np.array([np.log(self.shortest), _LEAST_WHITE])
        high = np.array([np.log(self.longest), _MOST_WHITE])

        def height(shape: Shape) -> float:
            inside = np.clip(shape, low, high)
            misfit, penalty = self.parts(inside)
            outside = float(np.sum((inside - shape) ** 2))
            return self.freedom * np.log(max(misfit, 1e-300)) + penalty + outside

        starts = [
            np.array([low[0] + share * (high[0] - low[0]), white])
            for share in np.arange(1, 8) / 8
            for white in (-5.0, -3.0, -1.5, 0.0)
        ]
        found: Any = minimize(
            height, min(starts, key=height), method="Nelder-Mead", options=_SEARCH
        )
        return np.clip(np.asarray(found.x), low, high)

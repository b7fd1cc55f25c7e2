"""Numbers of a fit: linear functionals of the coefficients, with the uncertainty of everything.

Given θ the coefficients are normal. The uncertainty of θ is added to first order (Kass and
Steffey), cov(C β) = C M⁻¹ Cᵀ + J A Jᵀ with A = cov θ and J = ∂(C β̂)/∂θ; the quantiles are those of
Student's t with ν = 2/(gᵀ A g) degrees of freedom, g = ∂ ln var(C β)/∂θ (Satterthwaite).
"""

from dataclasses import dataclass
from functools import cached_property

import jax
import numpy as np
from jaxtyping import Array, Float
from scipy.special import stdtrit

from .density import FIRST, LAGS, Solved, weights
from .problem import Problem

_LEAST_FREEDOM, _MOST_FREEDOM = 4.0, 1e4
_FLOOR = 0.05


@dataclass(frozen=True)
class Estimate:
    """A number with its standard deviation and Student degrees of freedom."""

    value: float
    std: float
    freedom: float

    @property
    def half(self) -> float:
        """Half width of the 95 % interval."""
        return float(stdtrit(self.freedom, 0.975)) * self.std


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of θ and of the coefficients at the largest density."""

    problem: Problem
    theta: Float[np.ndarray, " p"]
    at: Solved

    @property
    def theta_spread(self) -> Float[np.ndarray, "p p"]:
        """Covariance of θ: the inverse Hessian, whose curvatures are at least a small one."""
        values, axes = np.linalg.eigh(np.asarray(self.at.hessian))
        return (axes / np.maximum(values, _FLOOR)) @ axes.T

    @property
    def coefficients(self) -> Float[np.ndarray, " columns"]:
        """Coefficients of the columns."""
        problem = self.problem
        beta = np.asarray(self.at.beta)[: len(problem.columns)]
        return problem.natural @ (problem.unit * beta + problem.start)

    @property
    def moved(self) -> Float[np.ndarray, " columns"]:
        """Coefficients of the columns that are orthogonal to their fixed part."""
        problem = self.problem
        beta = np.asarray(self.at.beta)[: len(problem.columns)]
        return np.diag(problem.natural) * (problem.unit * beta + problem.start)

    def told(
        self, rows: Float[np.ndarray, "f columns"], *, moved: bool = False
    ) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, "f f"], Float[np.ndarray, " f"]]:
        """Return means, covariance and degrees of freedom of `rows` @ coefficients.

        With `moved` the rows act on the coefficients that are orthogonal to their fixed part.
        """
        problem, size = self.problem, len(self.problem.columns)
        to = np.diag(np.diag(problem.natural)) if moved else problem.natural
        functionals = np.zeros((len(rows), len(self.at.beta)))
        functionals[:, :size] = rows @ to
        mean = rows @ (to @ (problem.unit * np.asarray(self.at.beta)[:size] + problem.start))
        spread, slopes = np.asarray(self.at.spread), np.asarray(self.at.slopes)
        held = spread @ functionals.T
        by_theta = -held.T @ slopes
        variance = np.einsum("fq,qf->f", functionals, held)
        bend = self._slopes_of_variance(held) / (variance + 1e-300)
        cov_theta = self.theta_spread
        covariance = functionals @ held + by_theta @ cov_theta @ by_theta.T
        freedom = 2 / np.maximum(np.einsum("pf,pq,qf->f", bend, cov_theta, bend), 1e-6)
        return (
            mean,
            covariance * problem.unit**2,
            np.clip(freedom, _LEAST_FREEDOM, _MOST_FREEDOM),
        )

    @cached_property
    def _by_theta(self) -> tuple[Float[np.ndarray, "noise q q"], Float[np.ndarray, "columns g"]]:
        """∂M/∂θ: matrices for the noise, diagonals for the groups."""
        logs = self.problem.compressed
        slope = np.asarray(_weight_slopes(self.theta, logs.on))
        pairs, noise = len(FIRST), LAGS + 1
        windows = np.asarray(logs.windows)
        size = windows.shape[-1]
        bends = (slope[:pairs, :noise].T @ windows.reshape(pairs, -1)).reshape(noise, size, size)
        return bends[:, :-1, :-1], np.asarray(logs.member) * np.diag(slope[pairs:, noise:])

    def _slopes_of_variance(self, held: Float[np.ndarray, "columns f"]) -> Float[np.ndarray, "p f"]:
        """Return ∂ var/∂θ of functionals c, with `held` = M⁻¹ c: −cᵀ M⁻¹ (∂M/∂θ) M⁻¹ c."""
        bends, member = self._by_theta
        by_noise = np.sum(held * (bends @ held), axis=1)
        return -np.concatenate([by_noise, member.T @ held**2])

    def one(self, row: Float[np.ndarray, " columns"], *, moved: bool = False) -> Estimate:
        """Return the estimate of one functional; see `told`."""
        mean, covariance, freedom = self.told(row[None], moved=moved)
        return Estimate(float(mean[0]), float(np.sqrt(covariance[0, 0])), float(freedom[0]))

    def row(self, name: tuple, value: float = 1.0) -> Float[np.ndarray, " columns"]:
        """Return the functional of one column."""
        row = np.zeros(len(self.problem.columns))
        row[self.problem.index[name]] = value
        return row


@jax.jit
def _weight_slopes(theta: Float[Array, " p"], on: Float[Array, " groups"]) -> Float[Array, "w p"]:
    return jax.jacfwd(weights)(theta, on)

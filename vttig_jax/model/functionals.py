"""Numbers of a fit: linear functionals of the coefficients, with the uncertainty of everything.

Given θ the coefficients are normal, with mean β̂(θ) and covariance M(θ)⁻¹. Their posterior is the
mixture of these normals over the posterior of θ, which is far from normal on short logs: noise that
remembers longer than it seems to is likelier than one that forgets sooner. It is integrated along
each principal axis of the Hessian at the largest density, at the five Gauss–Hermite nodes, whose
weights are multiplied by the density there over that of the normal approximation. What the axes
add to a variance is multiplied, what they add to a mean is independent. The mixture has the
quantiles of Student's t with the same variance and kurtosis, ν = 4 + 2 (E v)²/var v.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.arrays import Numbers
from .columns import ColumnName
from .density import LAGS, Compressed, Solved, log_density, normal, partial_of
from .problem import Problem

_MOST_FREEDOM = 1e4
_FLOOR = 0.05
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
_CENTRE = 2
"""The node at the largest density."""


@dataclass(frozen=True)
class Estimate:
    """A number with its standard deviation and Student degrees of freedom."""

    value: float
    std: float
    freedom: float


class Readings(NamedTuple):
    """Further readings: the `rows` that act on β, their values, and the variance of their noise."""

    rows: Float[np.ndarray, "r all"]
    values: Float[np.ndarray, " r"]
    variance: float


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of θ and of the coefficients at the largest density."""

    problem: Problem
    theta: Float[np.ndarray, " p"]
    at: Solved
    readings: Readings | None = None

    def with_readings(self, readings: Readings) -> "Posterior":
        """Return the posterior after further readings, whose noise does not depend on θ."""
        beta, spread = _after(np.asarray(self.at.beta), np.asarray(self.at.spread), readings)
        at = replace(self.at, beta=jnp.asarray(beta), spread=jnp.asarray(spread))
        return replace(self, at=at, readings=readings)

    @property
    def partial(self) -> Float[Array, " lags"]:
        """Partial autocorrelations of the noise of the rows."""
        return partial_of(self.theta)

    @property
    def innovation_std(self) -> float:
        """Standard deviation of the innovations of the noise of the rows, rad."""
        return self.problem.unit * float(np.exp(self.theta[LAGS]))

    @property
    def theta_spread(self) -> Float[np.ndarray, "p p"]:
        """Covariance of θ: the inverse Hessian, whose curvatures are at least a small one."""
        values, axes = np.linalg.eigh(np.asarray(self.at.hessian))
        return (axes / np.maximum(values, _FLOOR)) @ axes.T

    @property
    def coefficients(self) -> Float[np.ndarray, " columns"]:
        """Coefficients of the columns."""
        return self.problem.natural @ self._scaled

    @property
    def moved(self) -> Float[np.ndarray, " columns"]:
        """Coefficients of the columns that are orthogonal to their fixed part."""
        return np.diag(self.problem.natural) * self._scaled

    @property
    def _scaled(self) -> Float[np.ndarray, " columns"]:
        problem = self.problem
        return problem.unit * np.asarray(self.at.beta)[: len(problem.columns)] + problem.start

    @cached_property
    def _nodes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Weight, β̂ and M⁻¹ at every node of every axis; the weights of an axis add up to one."""
        on = np.concatenate([np.ones(LAGS + 1), np.asarray(self.problem.compressed.on)]) > 0
        values, axes = np.linalg.eigh(np.where(np.outer(on, on), self.theta_spread, 0.0))
        axes = axes * np.sqrt(np.maximum(values, 0.0))
        density, beta, spread = map(
            np.asarray, _at_nodes(self.theta, axes.T, self.problem.compressed)
        )
        # At the expected θ of a planned log the density has a slope, which is left out.
        slope = (np.asarray(self.at.gradient) @ axes)[:, None] * _NODES
        lower = np.minimum(density - density[:, [_CENTRE]] + slope, 0.0)
        weight = _WEIGHTS * np.exp(np.nan_to_num(lower, nan=-np.inf) + 0.5 * _NODES**2)
        dead = (weight == 0)[:, :, None]
        beta = np.where(dead, 0.0, beta)
        spread = np.where(dead[..., None], 0.0, spread)
        if self.readings is not None:
            beta, spread = _after(beta, spread, self.readings)
        return weight / weight.sum(axis=1, keepdims=True), beta, spread

    def _functionals(
        self, rows: Float[np.ndarray, "f columns"], moved: bool
    ) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, "f all"]]:
        """Return means at the largest density, and the rows that act on all β."""
        natural = self.problem.natural
        to = np.diag(np.diag(natural)) if moved else natural
        functionals = np.zeros((len(rows), len(self.at.beta)))
        functionals[:, : len(natural)] = rows @ to
        return rows @ (to @ self._scaled), functionals

    def given_noise(
        self, rows: Float[np.ndarray, "f columns"], *, moved: bool = False
    ) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, "f f"]]:
        """Return means and covariance of `rows` @ coefficients as if θ were known; see `told`."""
        mean, functionals = self._functionals(rows, moved)
        return mean, self.problem.unit**2 * functionals @ np.asarray(self.at.spread) @ functionals.T

    def told(
        self, rows: Float[np.ndarray, "f columns"], *, moved: bool = False
    ) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, "f f"], Float[np.ndarray, " f"]]:
        """Return means, covariance and degrees of freedom of `rows` @ coefficients.

        With `moved` the rows act on the coefficients that are orthogonal to their fixed part. The
        covariance is that of Student's t before its quantile: variance times (ν − 2)/ν.
        """
        mean, functionals = self._functionals(rows, moved)
        weight, beta, spread = self._nodes
        given = functionals @ np.asarray(self.at.spread) @ functionals.T
        usual = np.diag(given) + 1e-300
        width = np.einsum("knfq,fq->knf", functionals @ spread, functionals) / usual
        far = (beta - np.asarray(self.at.beta)) @ functionals.T * (weight > 0)[..., None]
        wider = np.einsum("kn,knf->kf", weight, width)
        square = np.einsum("kn,knf->kf", weight, width**2)
        factor = np.sqrt(np.prod(wider, axis=0))
        covariance = given * np.outer(factor, factor) + np.einsum(
            "kn,knf,kng->fg", weight, far, far
        )
        spread_of_variance = np.prod(square / wider**2, axis=0) - 1
        share = usual * factor**2 / (np.diag(covariance) + 1e-300)
        freedom = 4 + 2 / np.maximum(spread_of_variance * share**2, 2 / _MOST_FREEDOM)
        scale = self.problem.unit * np.sqrt((freedom - 2) / freedom)
        return mean, covariance * np.outer(scale, scale), freedom

    def one(self, row: Float[np.ndarray, " columns"], *, moved: bool = False) -> Estimate:
        """Return the estimate of one functional; see `told`."""
        mean, covariance, freedom = self.told(row[None], moved=moved)
        return Estimate(float(mean[0]), float(np.sqrt(covariance[0, 0])), float(freedom[0]))

    def row(self, name: ColumnName) -> Float[np.ndarray, " columns"]:
        """Return the functional of one column."""
        row = np.zeros(len(self.problem.columns))
        row[self.problem.index[name]] = 1.0
        return row


def _after(
    beta: Float[np.ndarray, "... all"], spread: Float[np.ndarray, "... all all"], readings: Readings
) -> tuple[Float[np.ndarray, "... all"], Float[np.ndarray, "... all all"]]:
    """Return mean and covariance of normal coefficients after readings of `rows` @ β."""
    rows, values, variance = readings
    held = spread @ rows.T
    noise = rows @ held + variance * np.eye(len(rows))
    gain = np.swapaxes(np.linalg.solve(noise, np.swapaxes(held, -1, -2)), -1, -2)
    moved = beta + np.einsum("...qr,...r->...q", gain, values - beta @ rows.T)
    return moved, spread - gain @ np.swapaxes(held, -1, -2)


@eqx.filter_jit
def _at_nodes(
    theta: Float[Numbers, " p"], axes: Float[Numbers, "p p"], logs: Compressed
) -> tuple[Float[Array, "p nodes"], Float[Array, "p nodes all"], Float[Array, "p nodes all all"]]:
    """Return log density, β̂ and M⁻¹ at the nodes of the axes, the rows of `axes`."""

    def at(theta: Float[Array, " p"]) -> tuple[Array, Array, Array]:
        one = normal(theta, logs)
        return log_density(theta, logs, one), one.solved(one.half), one.spread

    nodes = jnp.asarray(_NODES)[None, :, None] * jnp.asarray(axes)[:, None]
    return jax.vmap(jax.vmap(at))(jnp.asarray(theta)[None, None] + nodes)

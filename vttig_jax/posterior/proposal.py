"""Draws around the fit: they start the walkers, and are proposals of a move of emcee.

A scale that the log does not tell has an exponential tail in ln τ, where a normal proposal would
hardly ever go. In the whitened coordinates z = L⁻¹ (x − m), whose first ones are these scales, a
proposal has therefore Student's t with few degrees of freedom for them and with many for others.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import gammaln

from ..base.errors import NoAnswerError

_HEAVY, _LIGHT = 5.0, 30.0
"""Degrees of freedom of scales and of other coordinates; 3 and 8 were worse on five rigs."""

_POOL, _ROUNDS = 2048, 2
"""Weighted draws that improve the proposal, and how often; a third round changed nothing."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """Distribution of x = m + P L z, where z has independent Student components.

    `order`: heavy coordinates first. `pool`, `weights`: draws of the density that it is sampled
    for, with their weights; empty before `improved`.
    """

    mean: Float[np.ndarray, " d"]
    factor: Float[np.ndarray, "d d"]
    order: Int[np.ndarray, " d"]
    freedom: Float[np.ndarray, " d"]
    pool: Float[np.ndarray, "n d"]
    weights: Float[np.ndarray, " n"]

    @classmethod
    def of(
        cls,
        mean: Float[np.ndarray, " d"],
        spread: Float[np.ndarray, "d d"],
        heavy: Bool[np.ndarray, " d"],
    ) -> "Proposal":
        """Return the proposal with this mean and covariance of its normal core."""
        order = np.argsort(~heavy, kind="stable")
        freedom = np.where(heavy[order], _HEAVY, _LIGHT)
        factor = np.linalg.cholesky(spread[np.ix_(order, order)])
        return cls(mean, factor, order, freedom, np.empty((0, len(mean))), np.empty(0))

    @property
    def table(self) -> Float[np.ndarray, "d columns"]:
        """Mean, order, freedom and factor as columns, for a file."""
        return np.column_stack([self.mean, self.order, self.freedom, self.factor])

    @classmethod
    def read(cls, table: Float[np.ndarray, "d columns"]) -> "Proposal":
        """Return the proposal of a `table`, without its pool."""
        mean, order, freedom = table[:, :3].T
        empty = np.empty((0, len(mean)))
        return cls(mean, table[:, 3:], order.astype(int), freedom, empty, np.empty(0))

    def draw(self, count: int, random: np.random.RandomState) -> Float[np.ndarray, "n d"]:
        """Return draws."""
        z = random.standard_t(np.broadcast_to(self.freedom, (count, len(self.freedom))))
        found = np.empty_like(z)
        found[:, self.order] = self.mean[self.order] + z @ self.factor.T
        return found

    def log_density(self, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """Return the log density of points."""
        z = np.linalg.solve(self.factor, (points - self.mean)[:, self.order].T).T
        v = self.freedom
        norm = gammaln((v + 1) / 2) - gammaln(v / 2) - 0.5 * np.log(np.pi * v)
        each = norm - 0.5 * (v + 1) * np.log1p(z**2 / v)
        return each.sum(axis=1) - np.log(np.diag(self.factor)).sum()

    def improved(self, log_density: Callable) -> "Proposal":
        """Return the proposal with the moments of a density, from weighted draws.

        **Raises** `NoAnswerError` for a density that is nowhere finite.
        """
        found, random = self, np.random.RandomState(0)
        for _ in range(_ROUNDS):
            pool = found.draw(_POOL, random)
            logs = log_density(pool) - found.log_density(pool)
            if not np.isfinite(logs.max()):
                raise NoAnswerError(
                    "the posterior has no finite density near the fit, so that nothing can be"
                    " sampled; fit fewer orders, or record more turns."
                )
            weights = np.exp(logs - logs.max())
            most = np.sort(weights)[-_POOL // 50]  # a few draws must not decide the moments
            cut = np.minimum(weights, most) / np.minimum(weights, most).sum()
            mean = cut @ pool
            spread = (cut[:, None] * (pool - mean)).T @ (pool - mean)
            heavy = np.empty(len(mean), bool)
            heavy[self.order] = self.freedom == _HEAVY
            found = replace(self.of(mean, spread, heavy), pool=pool, weights=weights)
        return found

    @property
    def efficiency(self) -> float:
        """Share of the pool that is effective by its weights, (Σw)²/(n Σw²)."""
        return float(self.weights.sum() ** 2 / np.sum(self.weights**2) / len(self.weights))

    def starts(self, count: int, random: np.random.RandomState) -> Float[np.ndarray, "n d"]:
        """Return different points of the pool, drawn by their weights."""
        share = self.weights / self.weights.sum()
        lottery = np.log(random.uniform(size=len(share))) / np.maximum(share, 1e-300)
        return self.pool[np.argsort(-lottery)[:count]]

    def __call__(
        self, points: Float[np.ndarray, "n d"], random: np.random.RandomState
    ) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, " n"]]:
        """Return proposals and ln q(x) − ln q(x′), as `emcee.moves.MHMove` asks for."""
        proposed = self.draw(len(points), random)
        return proposed, self.log_density(points) - self.log_density(proposed)

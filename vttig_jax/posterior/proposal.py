"""Draws around the fit: they start the walkers, and are proposals of a move of emcee.

A scale that the log does not tell has an exponential tail in ln τ, where a normal proposal would
hardly ever go. In the whitened coordinates z = L⁻¹ (x − m), whose first ones are these scales, a
proposal has therefore Student's t with few degrees of freedom for them and with many for others.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import t

from ..base.errors import NoAnswerError

_HEAVY, _LIGHT = 5.0, 30.0
"""Degrees of freedom of scales and of other coordinates; 3 and 8 were worse on five rigs."""

_POOL, _ENOUGH = 2048, 0.05
"""Weighted draws that improve the proposal, and the share of them that must be effective."""

_ROUNDS, _MOST_ROUNDS = 2, 12
"""Improvements by true weights (a third one changed nothing), and all improvements."""


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
        """Return the proposal with this mean and covariance of its normal core.

        Both are rounded to 2⁻¹⁶ of a standard deviation, so that equal logs give equal draws where
        the linear algebra of two processes differs in its last bits.
        """
        order = np.argsort(~heavy, kind="stable")
        freedom = np.where(heavy[order], _HEAVY, _LIGHT)
        factor = np.linalg.cholesky(spread[np.ix_(order, order)])
        grid = 2.0 ** (np.floor(0.5 * np.log2(np.diag(spread))) - 16)
        mean, steps = grid * np.round(mean / grid), grid[order, None]
        factor = steps * np.round(factor / steps)
        return cls(mean, factor, order, freedom, np.empty((0, len(mean))), np.empty(0))

    def draw(self, count: int, random: np.random.RandomState) -> Float[np.ndarray, "n d"]:
        """Return draws."""
        z = random.standard_t(np.broadcast_to(self.freedom, (count, len(self.freedom))))
        found = np.empty_like(z)
        found[:, self.order] = self.mean[self.order] + z @ self.factor.T
        return found

    def log_density(self, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """Return the log density of points."""
        z = np.linalg.solve(self.factor, (points - self.mean)[:, self.order].T).T
        return t.logpdf(z, self.freedom).sum(axis=1) - np.log(np.diag(self.factor)).sum()

    def improved(self, log_density: Callable) -> "Proposal":
        """Return the proposal with the moments of a density, from weighted draws.

        Where few weights are large, since the density is elsewhere, their powers are taken that
        leave enough effective draws, until the weights themselves do. The random numbers are fixed,
        so that a run that goes on has the same proposal.

        **Raises** `NoAnswerError` for a density that is nowhere finite.
        """
        found, random, left = self, np.random.RandomState(0), _ROUNDS
        for _ in range(_MOST_ROUNDS):
            pool = found.draw(_POOL, random)
            logs = log_density(pool) - found.log_density(pool)
            if not np.isfinite(logs.max()):
                raise NoAnswerError(
                    "the posterior has no finite density near the fit, so that nothing can be"
                    " sampled; fit fewer orders, or record more turns."
                )
            power, logs = 1.0, logs - logs.max()
            while _effective(np.exp(power * logs)) < _ENOUGH * _POOL:
                power /= 2
            share = np.exp(power * logs) / np.exp(power * logs).sum()
            mean = share @ pool
            spread = (share[:, None] * (pool - mean)).T @ (pool - mean)
            heavy = np.empty(len(mean), bool)
            heavy[self.order] = self.freedom == _HEAVY
            found = replace(self.of(mean, spread, heavy), pool=pool, weights=np.exp(logs))
            left -= power == 1
            if left == 0:
                break
        return found

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


def _effective(weights: Float[np.ndarray, " n"]) -> float:
    """Return the effective number of draws with these weights."""
    return float(weights.sum() ** 2 / np.sum(weights**2))

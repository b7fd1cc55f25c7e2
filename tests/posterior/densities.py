"""Log densities with known answers, for the tests of the sampler."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vttig_jax.posterior.proposal import Proposal


@dataclass
class Gaussian:
    """Normal of given mean and covariance; keeps the batch shapes it was asked for.

    Its start, `around`, is `spread` times as wide and `off` away.
    """

    mean: np.ndarray
    covariance: np.ndarray
    identity: dict[str, Any] = field(default_factory=lambda: {"data": "ab12", "priors": [1.5]})
    spread: float = 1.0
    off: float = 0.0
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    sizes: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        d = len(self.mean)
        self.names = self.names or tuple(f"x{index}" for index in range(d))
        self.units = self.units or ("mm",) * d
        self._whiten = np.linalg.inv(np.linalg.cholesky(self.covariance))

    def log_density(self, points: np.ndarray) -> np.ndarray:
        self.sizes.append(len(points))
        return -0.5 * (((points - self.mean) @ self._whiten.T) ** 2).sum(axis=1)

    def around(self) -> Proposal:
        wide = self.spread**2 * self.covariance
        start = Proposal.of(self.mean + self.off, wide, np.zeros(len(self.mean), bool))
        return start.improved(lambda x: -0.5 * (((x - self.mean) @ self._whiten.T) ** 2).sum(1))


def plain(d: int = 2, **options: Any) -> Gaussian:
    return Gaussian(np.zeros(d), np.eye(d), **options)


def ar1(rho: float, shape: tuple[int, ...], seed: int) -> np.ndarray:
    """Stationary AR(1) of unit variance along the first axis, otherwise independent."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    noise[1:] *= np.sqrt(1 - rho**2)
    for step in range(1, shape[0]):
        noise[step] += rho * noise[step - 1]
    return noise

"""Log densities with known answers, for the tests of the sampler."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass
class Gaussian:
    """Normal of given mean and covariance; keeps the batch shapes it was asked for."""

    mean: np.ndarray
    covariance: np.ndarray
    identity: dict[str, Any] = field(default_factory=lambda: {"data": "ab12", "prior": {"a": 1.5}})
    spread: float = 1.0
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    sizes: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        d = len(self.mean)
        self.names = self.names or tuple(f"x{index}" for index in range(d))
        self.units = self.units or ("mm",) * d
        self._factor = np.linalg.cholesky(self.covariance)
        self._whiten = np.linalg.inv(self._factor)

    def whitened(self, points: np.ndarray) -> np.ndarray:
        return (points - self.mean) @ self._whiten.T

    def log_density(self, points: np.ndarray) -> np.ndarray:
        self.sizes.append(len(points))
        return -0.5 * (self.whitened(points) ** 2).sum(axis=1)

    def starts(self, count: int, generator: np.random.Generator) -> np.ndarray:
        normal = generator.standard_normal((count, len(self.mean)))
        return self.mean + self.spread * normal @ self._factor.T


def plain(d: int = 2, **options: Any) -> Gaussian:
    return Gaussian(np.zeros(d), np.eye(d), **options)


def ar1(rho: float, shape: tuple[int, ...], seed: int) -> np.ndarray:
    """Stationary AR(1) of unit variance along the first axis, otherwise independent."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    noise[1:] *= np.sqrt(1 - rho**2)
    for step in range(1, shape[0]):
        noise[step] += rho * noise[step - 1]
    return noise

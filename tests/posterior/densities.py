"""Log densities with known answers, and short runs of the sampler on them."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from vttig_jax.posterior import run_ensembles
from vttig_jax.posterior.chains import Chains
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


def sample(path: Path | None, target: Gaussian | None = None, **options: Any) -> Chains:
    settings: dict[str, Any] = {"steps": 100, "walkers": 16} | options
    return run_ensembles(target or plain(), checkpoint=path, **settings)


def same(one: Chains, other: Chains) -> bool:
    return one.header == other.header and all(
        np.array_equal(getattr(one.record, name), getattr(other.record, name))
        for name in ("draws", "log_density", "accepted")
    )


def sentence(error: BaseException) -> str:
    text = str(error)
    assert "\n" not in text and text.endswith(".")
    return text


def only(path: Path) -> bool:
    """No lock and no temporary file is left."""
    return [item.name for item in path.parent.iterdir()] == [path.name]

"""Numbers that say whether stated uncertainties hold: coverage with bounds, rank histograms."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import stats

LEVELS = (0.50, 0.68, 0.90, 0.95)
BINS = 20

_BOUNDS = 0.95


@dataclass(frozen=True)
class Coverage:
    """How many of `rigs` intervals of a nominal level hold the truth.

    **Arguments**
    - `low`, `high`: Clopper–Pearson bounds of the share, 95 %.
    """

    level: float
    hits: int
    rigs: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """Of the intervals that hold the truth."""
        return self.hits / self.rigs

    def to_json(self) -> dict:
        """Level, share and its bounds."""
        return {"level": self.level, "share": self.share, "low95": self.low, "high95": self.high}


def coverage(ranks: Float[np.ndarray, " rigs"], level: float) -> Coverage:
    """Coverage of equal-tailed intervals, from the rank of every truth in its distribution.

    **Arguments**
    - `ranks`: share of the distribution below the truth, 0 … 1; NaN, a fit that failed, counts as
      a miss.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.posterior.calibration.coverage import coverage
    >>> found = coverage(np.linspace(0.0, 1.0, 1001), 0.95)
    >>> round(found.share, 3), round(found.low, 3), round(found.high, 3)
    (0.95, 0.935, 0.963)

    ```
    """
    hits = int(np.sum(np.abs(ranks - 0.5) <= level / 2))
    rigs, left = len(ranks), (1 - _BOUNDS) / 2
    low = stats.beta.ppf(left, hits, rigs - hits + 1) if hits else 0.0
    high = stats.beta.ppf(1 - left, hits + 1, rigs - hits) if hits < rigs else 1.0
    return Coverage(level, hits, rigs, float(low), float(high))


def normal_ranks(
    truth: Float[np.ndarray, "rigs p"],
    values: Float[np.ndarray, "rigs p"],
    std: Float[np.ndarray, "rigs p"],
) -> Float[np.ndarray, "rigs p"]:
    """Rank of the truth in a normal distribution (Laplace)."""
    return stats.norm.cdf((truth - values) / std)


def histogram(ranks: Float[np.ndarray, " rigs"], bins: int = BINS) -> list[int]:
    """Ranks counted in equal bins."""
    return np.histogram(ranks[np.isfinite(ranks)], bins, (0.0, 1.0))[0].tolist()


def uniformity(ranks: Float[np.ndarray, " rigs"], bins: int = BINS) -> float:
    """Probability of a histogram at least this uneven if the ranks are uniform (χ²)."""
    return float(stats.chisquare(histogram(ranks, bins)).pvalue)


@dataclass(frozen=True)
class Disc:
    """Places of x and y of one vector, and the radius of the disc it was drawn from."""

    name: str
    x: int
    y: int
    radius: float


def amplitude_ranks(
    truth: Float[np.ndarray, "rigs p"],
    values: Float[np.ndarray, "rigs p"],
    covariance: Float[np.ndarray, "rigs p p"],
    discs: Sequence[Disc],
    seed: int = 0,
    draws: int = 400,
) -> dict[str, Float[np.ndarray, " rigs"]]:
    """Rank of every true amplitude among draws from the Laplace approximation.

    Rigs are drawn flat in discs, so draws outside of any of the discs are left out: what is left
    is the posterior under the prior the rigs come from, and its ranks are uniform.
    """
    generator = np.random.default_rng(seed)
    found = {disc.name: np.full(len(truth), np.nan) for disc in discs}
    for rig, (true, value, spread) in enumerate(zip(truth, values, covariance, strict=True)):
        if not np.isfinite(spread).all():
            continue
        points = (
            value + generator.standard_normal((draws, len(value))) @ np.linalg.cholesky(spread).T
        )
        sizes = np.stack([np.hypot(points[:, d.x], points[:, d.y]) for d in discs])
        inside = np.all(sizes <= np.array([[d.radius] for d in discs]), axis=0)
        for disc, own in zip(discs, sizes[:, inside], strict=True):
            below = np.sum(own < np.hypot(true[disc.x], true[disc.y]))
            found[disc.name][rig] = (below + generator.random()) / (len(own) + 1)
    return found

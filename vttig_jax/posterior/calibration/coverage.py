"""Coverage of intervals with bounds, rank histograms, and binomial tests of all cells (Holm)."""

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
    >>> from vttig_jax.posterior import coverage
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
class CoverageDisc:
    """Places of x and y of one vector, and the radius of the disc it was drawn from."""

    name: str
    x: int
    y: int
    radius: float


def amplitude_ranks(
    truth: Float[np.ndarray, "rigs p"],
    values: Float[np.ndarray, "rigs p"],
    covariance: Float[np.ndarray, "rigs p p"],
    discs: Sequence[CoverageDisc],
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


BANDS = {0.68: (0.64, 0.72), 0.95: (0.925, 0.975)}
"""Nominal level → what counts as calibrated."""

SAMPLED_BANDS = {0.68: (0.61, 0.75), 0.95: (0.91, 0.98)}
"""The same for a subset that is sampled, of some hundred rigs."""

FAMILY_WISE = 0.01


@dataclass(frozen=True)
class Cell:
    """One tested number: probability of it if it is calibrated."""

    case: str
    name: str
    what: str
    probability: float


def outside(found: Coverage, band: tuple[float, float]) -> float:
    """Probability of a coverage so far out if the true one lies within `band`."""
    low, high = band
    below = stats.binom.cdf(found.hits, found.rigs, low)
    above = stats.binom.sf(found.hits - 1, found.rigs, high)
    return float(min(below, above))


def uneven(ranks: Float[np.ndarray, " rigs"], band: tuple[float, float] = BANDS[0.95]) -> float:
    """Probability of so uneven a rank histogram if standard errors are off no more than tolerated.

    χ² of n ranks in K bins of true shares p_i has the noncentrality n K Σ (p_i − 1/K)²; tolerated
    is that of standard errors so small that 95 % intervals hold at the lower end of the `band`.
    """
    counted = np.array(histogram(ranks))
    stated = stats.norm.ppf((1 + band[0]) / 2) / stats.norm.ppf(0.975)
    shares = np.diff(stats.norm.cdf(stated * stats.norm.ppf(np.linspace(0, 1, BINS + 1))))
    tolerated = counted.sum() * BINS * np.sum((shares - 1 / BINS) ** 2)
    statistic = np.sum((counted - counted.mean()) ** 2) / counted.mean()
    return float(stats.ncx2.sf(statistic, BINS - 1, tolerated))


def rejected(cells: Sequence[Cell], family_wise: float = FAMILY_WISE) -> list[Cell]:
    """Cells that fail at this family-wise error (S. Holm, Scand. J. Statist. 6 (1979) 65)."""
    order = np.argsort([cell.probability for cell in cells], kind="stable")
    found = []
    for left, place in zip(range(len(cells), 0, -1), order, strict=True):
        if not cells[place].probability <= family_wise / left:
            break
        found.append(cells[place])
    return found

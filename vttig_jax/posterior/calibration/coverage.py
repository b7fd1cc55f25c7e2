"""Coverage of intervals with its bounds, rank histograms, and tests of many of these numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import stats

LEVELS = (0.50, 0.68, 0.90, 0.95)  # nominal probabilities of the intervals
BINS = 20  # number of bins of a rank histogram (chosen)

_BOUNDS = 0.95  # confidence level of the Clopper–Pearson bounds


@dataclass(frozen=True)
class Coverage:
    """Number `hits` of intervals that contain the true value, out of `rigs` intervals.

    `level` is the nominal probability of the intervals. `low` and `high` are the 95 %
    Clopper–Pearson bounds of the true fraction of hits.
    """

    level: float
    hits: int
    rigs: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """Fraction of the intervals that contain the truth."""
        return self.hits / self.rigs

    def to_json(self) -> dict:
        """Return the level, the fraction and its bounds."""
        return {"level": self.level, "share": self.share, "low95": self.low, "high95": self.high}


def coverage(ranks: Float[np.ndarray, " rigs"], level: float) -> Coverage:
    """Return the coverage of equal-tailed intervals, from the ranks of the true values.

    **Arguments**
    - `ranks`: estimated probability of values below the true value, 0 … 1; NaN (a failed fit)
      counts as an interval that does not contain the true value.
    - `level`: nominal probability of the intervals.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.posterior import coverage
    >>> result = coverage(np.linspace(0.0, 1.0, 1001), 0.95)
    >>> round(result.share, 3), round(result.low, 3), round(result.high, 3)
    (0.95, 0.935, 0.963)

    ```
    """
    hits = int(np.sum(np.abs(ranks - 0.5) <= level / 2))
    rigs, tail = len(ranks), (1 - _BOUNDS) / 2
    low = stats.beta.ppf(tail, hits, rigs - hits + 1) if hits else 0.0
    high = stats.beta.ppf(1 - tail, hits + 1, rigs - hits) if hits < rigs else 1.0
    return Coverage(level, hits, rigs, float(low), float(high))


def normal_ranks(
    truth: Float[np.ndarray, "rigs p"],
    values: Float[np.ndarray, "rigs p"],
    std: Float[np.ndarray, "rigs p"],
) -> Float[np.ndarray, "rigs p"]:
    """Return the ranks of the true values in normal distributions: Φ((truth − values) / std)."""
    return stats.norm.cdf((truth - values) / std)


def histogram(ranks: Float[np.ndarray, " rigs"], bins: int = BINS) -> list[int]:
    """Return the number of ranks in each of `bins` equal bins of 0 … 1; NaN is left out."""
    return np.histogram(ranks[np.isfinite(ranks)], bins, (0.0, 1.0))[0].tolist()


def uniformity(ranks: Float[np.ndarray, " rigs"], bins: int = BINS) -> float:
    """Return the p-value of a χ² test that the ranks are uniformly distributed."""
    return float(stats.chisquare(histogram(ranks, bins)).pvalue)


@dataclass(frozen=True)
class CoverageDisc:
    """Prior of one vector (x, y) of parameters: uniform density in a disc around (0, 0).

    `x` and `y` are the indices of both coordinates among the parameters, and `radius` is the radius
    of the disc in the unit of these parameters.
    """

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
    """Return for each disc the rank of every true amplitude among draws from the fitted normal.

    The vectors of the rigs are drawn with uniform density in discs. Draws with a vector outside its
    disc are therefore discarded; the remaining draws follow the posterior under this prior. The
    ranks of the true amplitudes are uniform if the fit is calibrated.
    """
    generator = np.random.default_rng(seed)
    ranks = {disc.name: np.full(len(truth), np.nan) for disc in discs}
    for rig, (true, value, spread) in enumerate(zip(truth, values, covariance, strict=True)):
        if not np.isfinite(spread).all():
            continue
        points = (
            value + generator.standard_normal((draws, len(value))) @ np.linalg.cholesky(spread).T
        )
        sizes = np.stack([np.hypot(points[:, d.x], points[:, d.y]) for d in discs])
        inside = np.all(sizes <= np.array([[d.radius] for d in discs]), axis=0)
        for disc, accepted in zip(discs, sizes[:, inside], strict=True):
            below = np.sum(accepted < np.hypot(true[disc.x], true[disc.y]))
            ranks[disc.name][rig] = (below + generator.random()) / (len(accepted) + 1)
    return ranks


BANDS = {0.68: (0.64, 0.72), 0.95: (0.925, 0.975)}
"""Nominal level → lowest and highest true coverage that count as calibrated (chosen)."""

SAMPLED_BANDS = {0.68: (0.61, 0.75), 0.95: (0.91, 0.98)}
"""Nominal level → the same for the sampled rigs, of which there are some hundred (chosen)."""

FAMILY_WISE = 0.01  # probability of at least one false rejection in a family of tests (chosen)


@dataclass(frozen=True)
class Cell:
    """Result of one statistical test: the p-value for one parameter in one case of calibration.

    `case` and `name` are the names of the case and of the parameter, and `what` is the tested
    statistic in words. `probability` is the p-value: the probability of a result at least as
    extreme if the intervals are calibrated.
    """

    case: str
    name: str
    what: str
    probability: float


def coverage_p_value(result: Coverage, band: tuple[float, float]) -> float:
    """Return the binomial p-value of a coverage if the true coverage lies within `band`."""
    low, high = band
    below = stats.binom.cdf(result.hits, result.rigs, low)
    above = stats.binom.sf(result.hits - 1, result.rigs, high)
    return float(min(below, above))


def histogram_p_value(
    ranks: Float[np.ndarray, " rigs"], band: tuple[float, float] = BANDS[0.95]
) -> float:
    """Return the p-value of a χ² test of a rank histogram that tolerates slightly uneven ranks.

    With n ranks in K bins of true probabilities p_i, χ² has the noncentrality n K Σ (p_i − 1/K)².
    The tolerated p_i are those of standard errors so small that the coverage of the 95 % intervals
    is only the lower end of `band`.
    """
    counted = np.array(histogram(ranks))
    scale = stats.norm.ppf((1 + band[0]) / 2) / stats.norm.ppf(0.975)
    shares = np.diff(stats.norm.cdf(scale * stats.norm.ppf(np.linspace(0, 1, BINS + 1))))
    tolerated = counted.sum() * BINS * np.sum((shares - 1 / BINS) ** 2)
    statistic = np.sum((counted - counted.mean()) ** 2) / counted.mean()
    return float(stats.ncx2.sf(statistic, BINS - 1, tolerated))


def rejected(cells: Sequence[Cell], family_wise: float = FAMILY_WISE) -> list[Cell]:
    """Return the cells that fail by the method of S. Holm, Scand. J. Statist. 6 (1979) 65."""
    order = np.argsort([cell.probability for cell in cells], kind="stable")
    failed = []
    for remaining, index in zip(range(len(cells), 0, -1), order, strict=True):
        if not cells[index].probability <= family_wise / remaining:
            break
        failed.append(cells[index])
    return failed

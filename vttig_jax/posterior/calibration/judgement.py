"""Is a coverage outside of what is allowed? Binomial tests, all cells together (Holm)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import stats

from .coverage import BINS, Coverage, histogram

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

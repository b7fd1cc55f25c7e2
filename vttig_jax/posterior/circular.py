"""Angles that close on themselves: mean, spread and intervals of draws of a phase."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..base.angles import difference_deg, wrap_deg


@dataclass(frozen=True)
class CircularSummary:
    """Draws of one angle, in degrees.

    **Arguments**
    - `mean`: circular mean, in [0, 360).
    - `std`: circular standard deviation √(−2 ln R), R the length of the mean unit vector.
    - `median`, `low`, `high`: mean plus quantiles of the signed way from it; they stand around the
      mean and may leave [0, 360).
    """

    mean: float
    std: float
    median: float
    low: float
    high: float


def circular_summary(
    angles_deg: Float[np.ndarray, " m"], probability: float = 0.95
) -> CircularSummary:
    """Summarise draws of an angle with an equal-tailed interval.

    **Arguments**
    - `angles_deg`: any multiples of a turn, shape (m,).
    - `probability`: inside the interval.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.posterior.circular import circular_summary
    >>> found = circular_summary(np.array([350.0, 358.0, 2.0, 6.0, 374.0]))
    >>> round(found.mean, 2), round(found.low, 2), round(found.high, 2)
    (2.0, -9.2, 13.2)

    ```
    """
    from scipy.stats import circmean, circstd  # slow to import

    # Rounding can make it 360 itself.
    mean = float(wrap_deg(circmean(angles_deg, high=360, low=0)))
    way = difference_deg(angles_deg, mean)
    tail = (1.0 - probability) / 2.0
    low, median, high = mean + np.quantile(way, [tail, 0.5, 1.0 - tail])
    std = float(circstd(angles_deg, high=360, low=0))
    return CircularSummary(mean, std, float(median), float(low), float(high))

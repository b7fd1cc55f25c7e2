"""Slope of driven over driving angle, and its standard error.

A periodic transmission error is not white noise. Therefore the standard error is the largest of
three: from the residual, with one independent value per driven turn; from a block jackknife; and
the change of the slope when first orders of both shafts are fitted as well, which is the effect of
an eccentricity over less than a turn.
"""

import itertools
import math

import numpy as np
from jaxtyping import Float

from ..base.numerics.well_conditioned import least_squares
from ..base.units import REV

BLOCKS = 10  # number of blocks of the jackknife (chosen)

MOST_ROWS = 20_000
"""Largest number of rows of the regression with first orders; longer logs are thinned (chosen)."""

LARGEST_ORDER = 0.02
"""Largest plausible amplitude of a first order in rad (chosen: 1.5 mm at 80 mm)."""

_COMPUTED = 1e-8
"""Largest deviation of a computed angle from its line, as a share of its travel: what rounding to
nine digits leaves, and less than any encoder (chosen)."""

_EPSILON = float(np.finfo(np.float64).eps)


def slope(driving: Float[np.ndarray, " n"], driven: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the slope of `driven` over `driving` (rad) and its standard error.

    The module docstring says how the standard error is estimated.
    """
    blocks = _blocks(len(driving))
    level, lift = driving.mean(), driven.mean()
    sums = []
    travel = 0.0
    for block in blocks:
        x, y = driving[block] - level, driven[block] - lift
        sums.append((len(x), x.sum(), y.sum(), x @ x, x @ y))
        travel += float(np.abs(np.diff(driven[block.start : block.stop + 1])).sum())
    size, sx, sy, sxx, sxy = np.array(sums).T
    value = float(sxy.sum() / sxx.sum())
    square = 0.0
    for block in blocks:
        residual = driven[block] - lift - value * (driving[block] - level)
        square += float(residual @ residual)
    independent = min(float(len(driving)), max(1.0, travel / REV))
    by_residual = math.sqrt(square / float(sxx.sum()) / independent)
    by_orders = _change_by_orders(driving, driven, value)
    return value, max(by_residual, _jackknife(size, sx, sy, sxx, sxy), by_orders)


def exact_slope(driving: Float[np.ndarray, " n"], driven: Float[np.ndarray, " n"]) -> float | None:
    """Return the slope of a driven angle that was computed from the driving one, or None.

    It follows a line to the last digit, as no measured angle does.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.slope import exact_slope
    >>> angle = np.linspace(0.0, 50.0, 1000)
    >>> [exact_slope(angle, 0.5 * angle + error) for error in (0.1, 1e-4 * np.sin(angle))]
    [0.5, None]

    ```
    """
    part = slice(None, None, max(1, len(driving) // 10_000))
    x, y = driving[part] - driving.mean(), driven[part] - driven.mean()
    value = float(x @ y / (x @ x))
    left = y - value * x
    return float(f"{value:.12g}") if np.ptp(left) <= _COMPUTED * np.ptp(y) else None


def computed_text(slope: float) -> str:
    """Return what is wrong with a driven angle that follows the driving one exactly."""
    return (
        f"the driven angle is {slope:.9g} times the driving angle to the last digit: one of both"
        " columns was computed from the other and not measured"
    )


def _blocks(count: int) -> list[slice]:
    """Divide `count` samples into the blocks of the jackknife."""
    edges = np.linspace(0, count, min(BLOCKS, count // 2) + 1).astype(np.int64).tolist()
    return [slice(start, stop) for start, stop in itertools.pairwise(edges)]


def _change_by_orders(
    driving: Float[np.ndarray, " n"], driven: Float[np.ndarray, " n"], value: float
) -> float:
    """Return the change of the slope `value` when first orders of both shafts are fitted as well.

    If their amplitude exceeds `LARGEST_ORDER`, the change is reduced in proportion.
    """
    thin = slice(None, None, max(1, len(driving) // MOST_ROWS))
    x, y = driving[thin], driven[thin]
    middle = x - x.mean()
    columns = np.stack([np.ones_like(x), middle, np.cos(x), np.sin(x), np.cos(y), np.sin(y)])
    # The residual of `value` instead of y, because the change is as small as its last digits.
    solution = least_squares(columns.T, y - y.mean() - value * middle, len(x) * _EPSILON)
    amplitude = max(math.hypot(*solution[2:4]), math.hypot(*solution[4:6]))
    return abs(float(solution[1])) * min(1.0, LARGEST_ORDER / max(amplitude, 1e-300))


def _jackknife(
    size: Float[np.ndarray, " blocks"],
    sx: Float[np.ndarray, " blocks"],
    sy: Float[np.ndarray, " blocks"],
    sxx: Float[np.ndarray, " blocks"],
    sxy: Float[np.ndarray, " blocks"],
) -> float:
    """Return the delete-one-block jackknife standard error of the slope from sums of blocks."""
    n, mx, my, mxx, mxy = (part.sum() - part for part in (size, sx, sy, sxx, sxy))
    spread = n * mxx - mx * mx
    usable = spread > 0
    slopes = (n * mxy - mx * my)[usable] / spread[usable]
    if len(slopes) < 2:
        return 0.0
    scatter = np.sum((slopes - slopes.mean()) ** 2)
    return float(np.sqrt((len(slopes) - 1) / len(slopes) * scatter))

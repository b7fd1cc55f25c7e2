"""Slope of driven over driving angle, and the fraction of whole numbers that is likely behind it.

A periodic transmission error is not white noise. Therefore the standard error is the largest of
three: from the residual, with one independent value per driven turn; from a block jackknife; and
the change of the slope when first orders of both shafts are fitted as well, which is the effect of
an eccentricity over less than a turn. Ratios of whole numbers of teeth are compared by likelihood.
"""

import itertools
import math
from fractions import Fraction

import numpy as np
from jaxtyping import Float

from ..base.numerics.well_conditioned import least_squares
from ..base.units import REV

BLOCKS = 10  # number of blocks of the jackknife (chosen)

MOST_ROWS = 20_000
"""Largest number of rows of the regression with first orders; longer logs are thinned (chosen)."""

TOLERANCE = 0.005
"""Largest relative deviation of the slope of two shafts from their ratio over many turns
(chosen)."""

APART = 0.05
"""Largest rms deviation of the driven angle from a straight line over the driving one, as a
fraction of its travel (chosen)."""

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
    edges = np.linspace(0, len(driving), min(BLOCKS, len(driving) // 2) + 1).astype(np.int64)
    blocks = [slice(start, stop) for start, stop in itertools.pairwise(edges.tolist())]
    level, lift = driving.mean(), driven.mean()
    sums = []
    travel = 0.0
    for block in blocks:
        x, y = driving[block] - level, driven[block] - lift
        sums.append((len(x), x.sum(), y.sum(), x @ x, x @ y))
        travel += float(np.abs(np.diff(driven[block.start : block.stop + 1])).sum())
    _, _, _, sxx, sxy = columns = np.array(sums).T
    value = float(sxy.sum() / sxx.sum())
    square = 0.0
    for block in blocks:
        residual = driven[block] - lift - value * (driving[block] - level)
        square += float(residual @ residual)
    independent = min(float(len(driving)), max(1.0, travel / REV))
    by_residual = math.sqrt(square / float(sxx.sum()) / independent)
    # The slopes without one block each, whose scatter is the standard error of the jackknife.
    n, mx, my, mxx, mxy = (part.sum() - part for part in columns)
    spread = n * mxx - mx * mx
    usable = spread > 0
    slopes, by_blocks = (n * mxy - mx * my)[usable] / spread[usable], 0.0
    if len(slopes) > 1:
        scatter = np.sum((slopes - slopes.mean()) ** 2)
        by_blocks = float(np.sqrt((len(slopes) - 1) / len(slopes) * scatter))
    # The change of the slope when first orders of both shafts are fitted as well; if they are
    # larger than `LARGEST_ORDER`, it is reduced in proportion.
    thin = slice(None, None, max(1, len(driving) // MOST_ROWS))
    x, y = driving[thin], driven[thin]
    middle = x - x.mean()
    orders = np.stack([np.ones_like(x), middle, np.cos(x), np.sin(x), np.cos(y), np.sin(y)])
    # The residual of `value` instead of y, because the change is as small as its last digits.
    solution = least_squares(orders.T, y - y.mean() - value * middle, len(x) * _EPSILON)
    amplitude = max(math.hypot(*solution[2:4]), math.hypot(*solution[4:6]))
    by_orders = abs(float(solution[1])) * min(1.0, LARGEST_ORDER / max(amplitude, 1e-300))
    return value, max(by_residual, by_blocks, by_orders)


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


MOST_TEETH = 200
"""Largest denominator of a fraction that is proposed as the ratio of a drive (chosen)."""

DENOMINATORS = (1, 2, 3, 5, 7, 10, 14, 20, 30, 50, 70, 100, 140, MOST_TEETH)
"""Limits of the denominator for which the nearest fraction is compared (chosen)."""

CHANCE = 0.02
"""Largest probability that some fraction with small numbers lies so near a ratio by chance
(chosen)."""

DEVIATIONS = 5.0
"""Largest deviation of a correct ratio in standard errors (chosen)."""

_ROUNDING = 1e-6
"""Least relative standard error of a ratio in a comparison (chosen). A smaller one would compare
rounding errors."""


def likely_fraction(value: float, std: float) -> Fraction | None:
    """Return the fraction that explains the ratio `value` better than any other number, or None.

    A ratio q of whole numbers has the likelihood of `value` under a normal distribution around q,
    divided by the number of fractions from 0 to 1 whose denominators are not larger. Another number
    may lie anywhere, and the likelihood of `value` is then 1 per unit.

    **Example**
    ```python
    >>> from vttig_jax.logs.slope import likely_fraction
    >>> print(likely_fraction(0.99984, 8e-5), likely_fraction(0.7331, 2e-6))
    1 None

    ```
    """
    std = max(std, _ROUNDING * abs(value))
    found, best = None, math.log(math.sqrt(2 * math.pi) * std)  # the weight of any other number
    for limit in DENOMINATORS:
        fraction = Fraction(value).limit_denominator(limit)
        if not fraction:
            continue
        size = fraction.denominator
        weight = -0.5 * ((float(fraction) - value) / std) ** 2 - math.log(max(0.3 * size**2, 1.0))
        if weight > best:
            best, found = weight, fraction
    return found


def ratio_option(value: float, std: float) -> str:
    """Return a ratio of driven to driving speed as the option `--ratio`, from turns to turns.

    It is a likely fraction, such as "64:23", or a decimal with two digits of the standard error.

    **Example**
    ```python
    >>> from vttig_jax.logs.slope import ratio_option
    >>> ratio_option(1 / 6, 1e-5), ratio_option(0.733123, 2e-5), ratio_option(0.0073312, 2e-7)
    ('6:1', '1:0.733123', '136.4033:1')

    ```
    """
    found = likely_fraction(value, std) if value < 1 else likely_fraction(1 / value, std / value**2)
    if found is not None:
        found = found if value < 1 else 1 / found
        return f"{found.denominator}:{found.numerator}"
    return decimal_option(value, std)


def decimal_option(value: float, std: float) -> str:
    """Return a ratio of driven to driving speed as the option `--ratio`, with a decimal number.

    **Example**
    ```python
    >>> from vttig_jax.logs.slope import decimal_option
    >>> decimal_option(1 / 6, 1e-5), decimal_option(0.99984, 8e-5)
    ('6.00000:1', '1:0.999840')

    ```
    """
    if value < 0.5:
        return f"{_decimal(1 / value, std / value**2)}:1"
    return f"1:{_decimal(value, std)}"


def _decimal(value: float, std: float) -> str:
    """Return a number with two digits of its standard error."""
    places = 1 - math.floor(math.log10(max(std, 1e-9 * abs(value))))
    return f"{value:.{max(places, 0)}f}"


def better_fraction(given: Fraction, seen: float, std: float) -> Fraction | None:
    """Return a simple fraction that fits the log if the given ratio does not, else None.

    The given ratio must deviate from `seen` by more than five standard errors `std`, and the
    fraction by at most three.
    """
    if not 0 < DEVIATIONS * std < abs(seen - float(given)):
        return None
    for limit in DENOMINATORS:
        fraction = Fraction(seen).limit_denominator(limit)
        # 3/π² q² fractions in [0, 1] have a denominator up to q
        if max(0.3 * fraction.denominator**2, 1.0) * 6 * std > CHANCE:
            return None
        if fraction and abs(float(fraction) - seen) <= 3 * std:
            return fraction
    return None

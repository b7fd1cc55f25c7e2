"""Ratios of whole numbers of teeth that explain the ratio in a log, compared by likelihood."""

import math
from fractions import Fraction

MOST_TEETH = 200
"""Largest denominator of a fraction that is proposed as the ratio of a drive (chosen)."""

_DENOMINATORS = (1, 2, 3, 5, 7, 10, 14, 20, 30, 50, 70, 100, 140, MOST_TEETH)
"""Limits of the denominator for which the nearest fraction is compared (chosen)."""

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
    >>> from vttig_jax.logs.checks.fractions import likely_fraction
    >>> print(likely_fraction(0.99984, 8e-5), likely_fraction(0.7331, 2e-6))
    1 None

    ```
    """
    std = max(std, _ROUNDING * abs(value))
    found, best = None, math.log(math.sqrt(2 * math.pi) * std)  # the weight of any other number
    for limit in _DENOMINATORS:
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
    >>> from vttig_jax.logs.checks.fractions import ratio_option
    >>> ratio_option(1 / 6, 1e-5), ratio_option(0.733123, 2e-5), ratio_option(0.0073312, 2e-7)
    ('6:1', '1:0.733123', '136.4033:1')

    ```
    """
    found = likely_fraction(value, std) if value < 1 else likely_fraction(1 / value, std / value**2)
    if found is not None:
        found = found if value < 1 else 1 / found
        return f"{found.denominator}:{found.numerator}"
    if value < 0.5:
        return f"{_decimal(1 / value, std / value**2)}:1"
    return f"1:{_decimal(value, std)}"


def _decimal(value: float, std: float) -> str:
    """Return a number with two digits of its standard error."""
    places = 1 - math.floor(math.log10(max(std, 1e-9 * abs(value))))
    return f"{value:.{max(places, 0)}f}"

"""Ratios of whole numbers of teeth that explain the ratio in a log, compared by likelihood."""

import math
from fractions import Fraction

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
    >>> from vttig_jax.logs.fractions import likely_fraction
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
    >>> from vttig_jax.logs.fractions import ratio_option
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
    >>> from vttig_jax.logs.fractions import decimal_option
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

"""Whole numbers of quotients: rounding never decides between two of them.

A quotient such as 0.05 s / 0.004 s is a whole number or a half in exact arithmetic. In floating
point it lies beside that, on either side. Within 1e-6 it counts as what it is meant to be.
"""

import math

_BESIDE = 1e-6


def whole_below(quotient: float) -> int:
    """The largest whole number that is not above.

    **Example**
    ```python
    >>> from vttig_jax.base.numerics.counting import whole_below
    >>> whole_below(0.3 / 0.1), whole_below(2.9)
    (3, 2)

    ```
    """
    return math.floor(quotient + _BESIDE)


def whole_above(quotient: float) -> int:
    """The smallest whole number that is not below.

    **Example**
    ```python
    >>> from vttig_jax.base.numerics.counting import whole_above
    >>> whole_above(0.3 / 0.1), whole_above(3 * 0.1 / 0.1), whole_above(2.1)
    (3, 3, 3)

    ```
    """
    return math.ceil(quotient - _BESIDE)


def nearest_whole(quotient: float) -> int:
    """The nearest whole number; a half goes down.

    **Example**
    ```python
    >>> from vttig_jax.base.numerics.counting import nearest_whole
    >>> nearest_whole(0.05 / 0.004), nearest_whole(12.50001), nearest_whole(12.6)
    (12, 13, 13)

    ```
    """
    return math.ceil(quotient - 0.5 - _BESIDE)

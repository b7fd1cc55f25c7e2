"""Rounding of quotients to whole numbers, independent of floating-point errors, and slices.

A quotient such as 0.05 s / 0.004 s is a whole number or a half in exact arithmetic. In floating
point it can lie slightly above or below. A deviation of up to 1e-6 is treated as zero.
"""

import math
from collections.abc import Iterator

_TOLERANCE = 1e-6  # chosen; far above the rounding error of a quotient


def whole_below(quotient: float) -> int:
    """Return the largest whole number that is not greater than `quotient`.

    **Example**
    ```python
    >>> from vttig_jax.base.numerics.counting import whole_below
    >>> whole_below(0.3 / 0.1), whole_below(2.9)
    (3, 2)

    ```
    """
    return math.floor(quotient + _TOLERANCE)


def pieces(count: int, most: int = 65_536) -> Iterator[slice]:
    """Yield slices of at most `most` of `count` values, in order.

    An expression that is computed piece by piece needs no memory for intermediate arrays of the
    length of a log.

    **Example**
    ```python
    >>> from vttig_jax.base.numerics.counting import pieces
    >>> list(pieces(5, 2))
    [slice(0, 2, None), slice(2, 4, None), slice(4, 5, None)]

    ```
    """
    for start in range(0, count, most):
        yield slice(start, min(start + most, count))

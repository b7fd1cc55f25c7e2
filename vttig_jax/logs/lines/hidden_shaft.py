"""Hidden shafts: more lines at multiples of one frequency than a coincidence can explain."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

HIGHEST_ORDER = 6
"""Highest order of a hidden shaft; lines of a shaft have low orders (chosen)."""

_CLEARER = 0.1
"""A shaft with orders up to 2 × `HIGHEST_ORDER` counts only if its coincidence is smaller than that
of the shaft with low orders by this factor; chosen value."""

COINCIDENCE = 1e-3  # largest likelihood ratio of a coincidence to a shaft; chosen value


@dataclass(frozen=True)
class Multiples:
    """Hidden shaft: lines at multiples of one frequency.

    **Arguments**
    - `turns`: the frequency, turns of the shaft per driving turn. - `std`: its standard error.
    - `orders`: order of every line of the shaft, ascending.
    - `coincidence`: ratio of the likelihood of lines at random frequencies to that of the shaft, or
      an upper bound of the probability that random lines imitate the shaft.
    """

    turns: float
    std: float
    orders: tuple[int, ...]
    coincidence: float


def hidden_shaft(cycles: Sequence[float], stds: Sequence[float]) -> Multiples | None:
    """Return the shaft whose orders explain several of the lines, or None.

    Of several possible shafts, the one that is least probable as a coincidence is returned.
    If a line c₀ ± s₀ has order k₀, its shaft turns f = c₀/k₀ times. If another line c ± s has order
    m of this shaft, the density of c is normal about m f with the variance s² + (m s₀/k₀)². If not,
    c lies anywhere between two multiples with the density 1/f. The product of the ratios of these
    densities over all lines of the shaft, divided by the number of ways to choose k₀ and the lines,
    is the likelihood ratio of a shaft to a coincidence. It must exceed 1000.

    **Arguments**
    - `cycles`, `stds`: frequencies of lines with standard errors, cycles per driving revolution.

    **Example**
    ```python
    >>> from vttig_jax.logs.lines.hidden_shaft import hidden_shaft
    >>> shaft = hidden_shaft([3.0874, 1.5441, 4.6307], [0.0004, 0.003, 0.003])
    >>> round(shaft.turns, 4), shaft.orders
    (1.5437, (1, 2, 3))

    ```
    """
    lines = sorted(zip(stds, cycles, strict=True))
    best = _best(lines, HIGHEST_ORDER)
    if best is None or best.coincidence >= COINCIDENCE:
        return None
    slower = _best(lines, 2 * HIGHEST_ORDER)  # its even orders alone are a shaft of twice the speed
    return slower if slower and slower.coincidence < _CLEARER * best.coincidence else best


def _best(lines: Sequence[tuple[float, float]], highest: int) -> Multiples | None:
    """Return the shaft with orders up to `highest` that is least probable as a coincidence."""
    found = [
        one
        for start in range(len(lines) - 1)
        for order in range(1, highest + 1)
        if (one := _of_order(lines[start:], order, len(lines), highest)) is not None
    ]
    return min(found, key=lambda one: one.coincidence, default=None)


def _of_order(
    lines: Sequence[tuple[float, float]], first: int, total: int, highest: int
) -> Multiples | None:
    """Return the shaft for which the first of `lines` has the order `first`, or None.

    `lines` are pairs (standard error, frequency) in cycles per revolution, the most precise first.
    `total` is the number of all lines, and `highest` is the highest order.
    """
    base_std, base = (part / first for part in lines[0])
    members, chance = {first: lines[0]}, 1.0
    for std, cycles in lines[1:]:
        order = round(cycles / base)
        spread = math.hypot(std, order * base_std)
        off = (cycles - order * base) / spread
        coincidence = math.sqrt(2 * math.pi) * spread * math.exp(min(off**2, 100) / 2) / base
        if 1 <= order <= highest and order not in members and coincidence < 1:
            members[order] = (std, cycles)
            chance *= coincidence
    if len(members) < 2 or math.gcd(*members) > 1:
        return None
    weights = {order: order / std for order, (std, _) in members.items()}
    std = 1 / math.hypot(*weights.values())
    turns = std**2 * sum(weights[order] * c / s for order, (s, c) in members.items())
    chance *= highest * math.comb(total, len(members))
    return Multiples(turns, std, tuple(sorted(members)), min(chance, 1.0))

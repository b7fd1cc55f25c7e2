"""Numbers behind pictures: long lines thinned to what a picture shows, and a fast spectrum."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

MOST_POINTS = 20_000
"""Largest number of points of a line (chosen), about ten times the pixels across a page."""


def thinned(
    x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], most: int = MOST_POINTS
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Return fewer points of a line, which look the same in a picture.

    The line is divided into pieces of equally many points. The points of minimum and maximum y of
    each piece and the two end points are kept, in their order.

    **Arguments**
    - `x`, `y`: the line; NaN in y is ignored if its piece also has numbers.
    - `most`: largest number of points, at least 4; shorter lines are returned unchanged.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.plotting.curves import thinned
    >>> x, y = thinned(np.arange(100.0), np.sin(np.arange(100.0)), 10)
    >>> len(x) <= 10, bool(y.max() == np.sin(np.arange(100.0)).max())
    (True, True)

    ```
    """
    if most < 4:
        raise ValueError(f"Argument `most` must be at least 4, but is {most}.")
    if len(y) <= most:
        return x, y
    width = -(-len(y) // ((most - 2) // 2))
    pieces = np.pad(y, (0, -len(y) % width), constant_values=np.nan).reshape(-1, width)
    missing = np.isnan(pieces)
    starts = np.arange(len(pieces)) * width
    lowest = starts + np.where(missing, np.inf, pieces).argmin(axis=1)
    highest = starts + np.where(missing, -np.inf, pieces).argmax(axis=1)
    kept = np.unique(np.concatenate([lowest, highest, [0, len(y) - 1]]))
    return x[kept], y[kept]


def mean_spectrum(
    runs: Sequence[tuple[Float[np.ndarray, " _"], Float[np.ndarray, " _"]]],
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Return frequencies and amplitudes of the mean spectrum of runs, up to half of their rows.

    Each run is interpolated to equal steps and windowed (Hann). The amplitudes are those of sines,
    the root of the mean power of the runs.

    **Arguments**
    - `runs`: places (rising or falling, for example in turns) and values of each run.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.plotting.curves import mean_spectrum
    >>> turns = np.linspace(0.0, 20.0, 2001)
    >>> cycles, size = mean_spectrum([(turns, 3.0 * np.sin(2 * np.pi * 5.0 * turns))])
    >>> round(float(cycles[size.argmax()]), 6), round(float(size.max()), 1)
    (5.0, 3.0)

    ```
    """
    longest = max((place for place, _ in runs), key=len)
    cycles, power = np.arange(len(longest) // 2) / np.ptp(longest), 0.0
    for place, values in runs:
        order, even = np.argsort(place), np.linspace(place.min(), place.max(), len(place))
        window = np.hanning(len(place))
        spectrum = np.fft.rfft(np.interp(even, place[order], values[order]) * window)
        own = np.arange(len(spectrum)) / np.ptp(place)
        size = np.abs(spectrum) * 2 / window.sum()
        power += np.interp(cycles, own, size**2, right=0.0) / len(runs)
    return cycles, np.sqrt(power)

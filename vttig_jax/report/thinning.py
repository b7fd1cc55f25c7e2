"""Long lines for a picture: fewer points, the same outline."""

import numpy as np
from jaxtyping import Float

MOST_POINTS = 20_000
"""Points a line keeps: an order of magnitude more than a page has pixels."""


def thinned(
    x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], most: int = MOST_POINTS
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Keep the ends, and the minimum and maximum of y in equal pieces, in the order they came.

    **Arguments**
    - `x`, `y`: a line; NaN in y is passed over where its piece has numbers.
    - `most`: points that may remain, at least 4; shorter lines come back as they are.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.report.thinning import thinned
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
    hole = np.isnan(pieces)
    starts = np.arange(len(pieces)) * width
    lowest = starts + np.where(hole, np.inf, pieces).argmin(axis=1)
    highest = starts + np.where(hole, -np.inf, pieces).argmax(axis=1)
    kept = np.unique(np.concatenate([lowest, highest, [0, len(y) - 1]]))
    return x[kept], y[kept]

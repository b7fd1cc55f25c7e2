"""Evaluate a jitted function over a grid of any length with one compiled chunk."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

_CHUNK = 8192


def chunked(
    function: Callable[[np.ndarray], object], grid: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return `function(grid)` computed in chunks of one fixed size, the last one padded.

    Memory stays that of one chunk and grids of different length share one compilation.
    """
    pieces = []
    for start in range(0, len(grid), _CHUNK):
        piece = grid[start : start + _CHUNK]
        padded = np.pad(piece, (0, _CHUNK - len(piece)), mode="edge")
        pieces.append(np.asarray(function(padded))[: len(piece)])
    return np.concatenate(pieces) if pieces else np.empty(0)

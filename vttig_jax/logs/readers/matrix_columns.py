"""Channels in a matrix: the rows of a wide matrix or the columns of a tall one, from number 1."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Shaped

MOST_COLUMNS = 256
"""Largest number of channels in one matrix, its shorter side (chosen)."""


def matrix_columns(name: str, array: np.ndarray) -> Iterator[tuple[str, Shaped[np.ndarray, " _"]]]:
    """Yield name and values of a vector, the rows of a wide matrix or the columns of a tall one."""
    array = array.squeeze()
    if array.ndim == 1 and array.size > 1:
        yield name, array
    if array.ndim != 2 or min(array.shape) > MOST_COLUMNS:
        return
    rows, columns = array.shape
    if rows < columns:
        yield from ((f"{name}({k + 1},:)", array[k]) for k in range(rows))
    elif columns < rows:
        yield from ((f"{name}(:,{k + 1})", array[:, k]) for k in range(columns))

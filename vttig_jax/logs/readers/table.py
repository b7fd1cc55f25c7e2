"""Table: named columns of one file, each of which is read once, when it is used."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Int64, Real, Shaped

MOST_COLUMNS = 256
"""Largest number of channels in one matrix, its shorter side, and of columns of a text that has
fewer rows than columns (chosen)."""


@dataclass(eq=False)
class Table:
    """Columns of a file that are arrays; `TextTable` parses them from a text.

    - `names`: names of the columns; a text without a header has the names #1, #2, ….
    - `arrays`: values of the columns, which may differ in length.
    - `source`, `digest`: name of the file, and the SHA-256 of its bytes.
    - `clocks`: index of a column → index of the column with its time stamps in s, for channels with
      separate time stamps. - `held`: indices of columns of which only changes are logged.
    - `sample_numbers`: numbers of the rows in the full record if samples are missing.
    - `notes`: sentences on assumptions and on what is left out.
    - `units`: name of a computed column → unit of the columns from which it is computed.
    """

    names: tuple[str, ...]
    arrays: tuple[Shaped[np.ndarray, " _"], ...]
    source: str
    clocks: Mapping[int, int] = field(default_factory=dict)
    held: frozenset[int] = frozenset()
    sample_numbers: Int64[np.ndarray, " _"] | None = None
    digest: str = ""
    notes: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)

    def columns(self, indices: Sequence[int]) -> list[Real[np.ndarray, " _"]]:
        """Return the columns with these indices, without an incomplete last row.

        A column of integers that fit into int64 is int64, any other column is float64.

        **Raises** `LogError` naming the line and column of a field that is not a number.
        """
        found = []
        for values in (self.arrays[k] for k in indices):
            floats = values.dtype.kind == "f" or values.max() > np.iinfo(np.int64).max
            found.append(values.astype(np.float64 if floats else np.int64, copy=False))
        return found

    def numeric(self) -> dict[int, Real[np.ndarray, " _"]]:
        """Return index → values of all columns that hold only numbers."""
        return dict(enumerate(self.columns(range(len(self.names)))))

    def left_out(self, indices: Sequence[int]) -> tuple[str, ...]:
        """Return a note if the last row is incomplete in `indices`, and is not read."""
        return ()

    def texts(self, index: int) -> list[str]:
        """Return the fields of a column of a text as they are written.

        **Raises** `LogError` naming the line of a row without this field.
        """
        raise NotImplementedError(f"column {index} is no text")

    def starts_with_a_number(self, index: int) -> bool:
        """Return whether the first field of a column is a number."""
        return True

    def is_dated(self, index: int) -> bool:
        """Return whether the first field of a column is a date with time, or a time of day."""
        return False

    @property
    def line_of(self) -> Callable[[int], int] | None:
        """Function from row to its line number in the file, from 1; None without lines."""
        return None

    def close(self) -> None:
        """Free the memory of the columns, which cannot be read any more."""
        self.arrays = ()


def matrix_columns(name: str, array: np.ndarray) -> Iterator[tuple[str, Shaped[np.ndarray, " _"]]]:
    """Yield name and values of a vector, the rows of a wide matrix or the columns of a tall one.

    Names are in the notation of MATLAB: `x(1,:)` for the first row, `x(:,1)` for the first column.
    """
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

"""Nested arrays (MATLAB .mat, HDF5) as a table: every vector, row or column of a matrix by name.

Names are paths as the maker of the file writes them: `rec.t`, `rec.pos(1,:)` for the first row of a
wide matrix, `rec.pos(:,1)` for the first column of a tall one, in plain HDF5 files `rec/t`.
"""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Real, Shaped

from ...base.errors import LogError, UsageError
from .hdf5 import HDF5_SIGNATURE, hdf5_leaves
from .matlab import matlab_leaves
from .text import NESTED, read_bytes

MOST_COLUMNS = 256
"""The shorter side of a matrix that is taken for a set of channels, at most."""


@dataclass(frozen=True)
class NestedTable:
    """Columns of a nested file, which may differ in length; `arrays` are their values."""

    names: tuple[str, ...]
    arrays: tuple[Shaped[np.ndarray, " _"], ...]
    source: str
    line_of: ClassVar[None] = None

    def columns(self, indices: Sequence[int]) -> list[Real[np.ndarray, " _"]]:
        """Columns as int64 where the file holds whole numbers, else float64."""
        return [_as_number(self.arrays[k]) for k in indices]

    def without_cut_line(self, indices: Sequence[int]) -> "tuple[NestedTable, tuple[str, ...]]":
        """The table itself: there are no lines. As `Table.without_cut_line`."""
        return self, ()


def read_nested(path: str | Path) -> tuple[NestedTable, str]:
    """Return the columns of a .mat, .h5 or .hdf5 file and the SHA-256 of its bytes.

    MATLAB's v7.3 is HDF5. Nothing of the file is executed, and nothing outside it is read.

    **Raises** `LogError` for a missing, damaged or unreadable file or one without numeric arrays,
    `UsageError` for HDF5 without the package h5py.
    """
    data = read_bytes(path, NESTED)
    source = str(path)
    hdf5 = HDF5_SIGNATURE in (data[:8], data[512:520])
    leaves = hdf5_leaves if hdf5 else matlab_leaves
    columns: dict[str, np.ndarray] = {}
    try:
        for name, array in leaves(data):
            columns.update(_columns(name, array))
    except UsageError:
        raise
    except Exception:  # damaged bytes raise whatever the parser stumbles over
        raise LogError(
            "damaged, or no MATLAB or HDF5 file; save it again, or export the log as CSV.",
            where=source,
        ) from None
    if not columns:
        raise LogError(
            "no numeric array; save plain arrays or structs (in MATLAB `table2struct(T,"
            ' "ToScalar", true)` makes one of a table), or export the log as CSV.',
            where=source,
        )
    table = NestedTable(tuple(columns), tuple(columns.values()), source)
    return table, hashlib.sha256(data).hexdigest()


def _columns(name: str, array: np.ndarray) -> Iterator[tuple[str, Shaped[np.ndarray, " _"]]]:
    """A vector under its name; the rows of a wide matrix, the columns of a tall one, from 1."""
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


def _as_number(values: Shaped[np.ndarray, " _"]) -> Real[np.ndarray, " _"]:
    if values.dtype.kind == "f" or values.max() > np.iinfo(np.int64).max:
        return values.astype(np.float64)
    return values.astype(np.int64)

"""Table of the nested arrays of a MATLAB or HDF5 file; rows or columns of matrices are its columns.

Names are paths in the notation of the file format: `rec.t`, `rec.pos(1,:)` for the first row of a
wide matrix, `rec.pos(:,1)` for the first column of a tall one, and `rec/t` in plain HDF5 files.
"""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Real, Shaped

from ...base.errors import InputError, LogError, UsageError
from ...base.files.limits import MemoryBudget
from .hdf5 import HDF5_SIGNATURE, hdf5_leaves
from .matlab import matlab_leaves
from .text import NESTED, read_bytes

MOST_COLUMNS = 256
"""Largest number of channels in one matrix, its shorter side (chosen)."""


@dataclass(frozen=True)
class NestedTable:
    """Columns of a nested file, which may differ in length, and their values `arrays`."""

    names: tuple[str, ...]
    arrays: tuple[Shaped[np.ndarray, " _"], ...]
    source: str
    line_of: ClassVar[None] = None

    def columns(self, indices: Sequence[int]) -> list[Real[np.ndarray, " _"]]:
        """Return the columns with these indices.

        A column of integers that fit into int64 is int64, any other column is float64.
        """
        return [_as_number(self.arrays[k]) for k in indices]

    def without_cut_line(self, indices: Sequence[int]) -> "tuple[NestedTable, tuple[str, ...]]":
        """Return the table itself, because it has no lines; see `TextTable.without_cut_line`."""
        return self, ()


def read_nested(path: str | Path) -> tuple[NestedTable, str]:
    """Return the columns of a .mat, .h5 or .hdf5 file and the SHA-256 of its bytes.

    MATLAB v7.3 files are HDF5. No code in the file is executed, and no other file is read.

    **Raises** `LogError` for a missing, damaged or unreadable file or one without numeric arrays,
    `UsageError` for HDF5 without the package h5py.
    """
    data = read_bytes(path, NESTED)
    source = str(path)
    hdf5 = HDF5_SIGNATURE in (data[:8], data[512:520])
    leaves = hdf5_leaves if hdf5 else matlab_leaves
    columns: dict[str, np.ndarray] = {}
    try:
        for name, array in leaves(data, MemoryBudget(source, len(data))):
            columns.update(_columns(name, array))
    except (UsageError, InputError):
        raise
    except Exception:  # damaged bytes raise various exceptions
        raise LogError(
            "the file is damaged or not a MATLAB or HDF5 file; save it again, or export the log as"
            " CSV.",
            where=source,
        ) from None
    if not columns:
        raise LogError(
            "the file has no numeric array; save plain arrays or structs (in MATLAB"
            ' `table2struct(T, "ToScalar", true)` converts a table), or export the log as CSV.',
            where=source,
        )
    table = NestedTable(tuple(columns), tuple(columns.values()), source)
    return table, hashlib.sha256(data).hexdigest()


def _columns(name: str, array: np.ndarray) -> Iterator[tuple[str, Shaped[np.ndarray, " _"]]]:
    """Yield a vector, the rows of a wide matrix or the columns of a tall one, numbered from 1."""
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

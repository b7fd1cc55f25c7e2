"""Table of the nested arrays of a MATLAB or HDF5 file.

Its columns are vectors, and rows or columns of matrices.

Names are paths in the notation of the file format: `rec.t`, `rec.pos(1,:)` for the first row of a
wide matrix, `rec.pos(:,1)` for the first column of a tall one, and `rec/t` in plain HDF5 files.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Int64, Real, Shaped

from ...base.errors import InputError, LogError, UsageError
from ...base.files.limits import MemoryBudget
from ...base.logger import LOGGER
from .binary.hdf5 import HDF5_SIGNATURE, hdf5_leaves
from .binary.matlab import matlab_leaves
from .binary.matlab_objects import check_objects, object_leaves
from .matrix_columns import matrix_columns
from .text import NESTED, printable, read_bytes


@dataclass(frozen=True)
class NestedTable:
    """Columns of a file, which may differ in length, and their values `arrays`.

    `clocks` is index of a column → index of the column with its time stamps in s, for channels with
    separate time stamps. `held` are the indices of columns of which only changes are logged.
    `sample_numbers` are the numbers of the rows in the full record if samples are missing.
    """

    names: tuple[str, ...]
    arrays: tuple[Shaped[np.ndarray, " _"], ...]
    source: str
    clocks: Mapping[int, int] = field(default_factory=dict)
    held: frozenset[int] = frozenset()
    sample_numbers: Int64[np.ndarray, " _"] | None = None
    line_of: ClassVar[None] = None

    def columns(self, indices: Sequence[int]) -> list[Real[np.ndarray, " _"]]:
        """Return the columns with these indices.

        A column of integers that fit into int64 is int64, any other column is float64.
        """
        return [_as_number(self.arrays[k]) for k in indices]

    def is_dated(self, index: int) -> bool:
        """Return False, because the columns hold numbers; see `TextTable.is_dated`."""
        return False

    def complete_rows(self, indices: Sequence[int]) -> "tuple[NestedTable, tuple[str, ...]]":
        """Return the table itself and no notes; only `TextTable` has text lines."""
        return self, ()


def has_clocks(table: object) -> bool:
    """Return whether channels of a table have separate time stamps."""
    return isinstance(table, NestedTable) and bool(table.clocks)


def read_nested(path: str | Path) -> tuple[NestedTable, str]:
    """Return the columns of a .mat, .h5 or .hdf5 file and the SHA-256 of its bytes.

    MATLAB v7.3 files are HDF5. No code in the file is executed, and no other file is read.

    **Raises** `LogError` for a missing, damaged or unreadable file or one without numeric arrays,
    `UsageError` for MATLAB tables without the package mat-io, unless the file has plain arrays.
    """
    data = read_bytes(path, NESTED)
    source = str(path)
    hdf5 = HDF5_SIGNATURE in (data[:8], data[512:520])
    leaves = hdf5_leaves if hdf5 else matlab_leaves
    columns: dict[str, np.ndarray] = {}
    budget = MemoryBudget(source, len(data))
    try:
        for name, array in leaves(data, budget):
            columns.update(matrix_columns(name, array))
        if check_objects(data, hdf5=hdf5, budget=budget):
            columns.update(_columns_of_objects(Path(path), needed=not columns))
    except (UsageError, InputError, MemoryError):
        raise
    except Exception:  # damaged bytes raise various exceptions
        raise LogError(
            "the file is damaged or not a MATLAB or HDF5 file; save it again, or export the log as"
            " CSV.",
            where=source,
        ) from None
    if not columns:
        raise LogError(
            "the file has no numeric array; save arrays, structs or tables of numbers, or export"
            " the log as CSV.",
            where=source,
        )
    names = tuple(map(printable, columns))
    table = NestedTable(names, tuple(columns.values()), source)
    return table, hashlib.sha256(data).hexdigest()


def _columns_of_objects(path: Path, *, needed: bool) -> dict[str, np.ndarray]:
    """Return name → values of the columns of MATLAB tables.

    Without the package mat-io they are omitted with a warning.
    **Raises** `UsageError` without the package if the columns are `needed`, because the file has no
    other columns.
    """
    columns: dict[str, np.ndarray] = {}
    try:
        for name, array in object_leaves(path):
            columns.update(matrix_columns(name, array))
    except UsageError as error:
        if needed:
            raise
        LOGGER.warning("%s: they are left out: %s", path, error.message)
    return columns


def _as_number(values: Shaped[np.ndarray, " _"]) -> Real[np.ndarray, " _"]:
    if values.dtype.kind == "f" or values.max() > np.iinfo(np.int64).max:
        return values.astype(np.float64)
    return values.astype(np.int64)

"""Tables, timetables, dates and durations of MATLAB, which the library mat-io reads.

MATLAB stores them as objects in a separate part of the file. The bytes of this part are checked
before the library reads them, like those of the other variables.
"""

import io
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ....base.errors import UsageError
from ....base.files.limits import MemoryBudget
from ..times.seconds import since_first
from .hdf5 import take_dataset
from .matlab import HEADER, Leaves, check_tags, leaves

WORKSPACE = "__function_workspace__"
"""Name under which SciPy returns the bytes of all objects of a file in format v6 or v7."""

SUBSYSTEM = "#subsystem#"
"""Name of the group with the objects of a file in format v7.3."""

UNIT_KEYS = ("varUnits", "VariableUnits")
"""Names of the attributes with the units of the columns, for a timetable and for a table."""


def check_objects(data: bytes, *, hdf5: bool, budget: MemoryBudget) -> bool:
    """Check the bytes of the objects in a file, and return whether the file has objects.

    Damaged bytes raise various exceptions. **Raises** `InputError` for declared sizes beyond the
    budget.
    """
    if hdf5:
        return _check_hdf5(data, budget)
    from scipy.io import loadmat
    from scipy.io.matlab import matfile_version

    if matfile_version(io.BytesIO(data))[0] != 1:  # v4 has no objects
        return False
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        stored = loadmat(io.BytesIO(data), variable_names=[WORKSPACE]).get(WORKSPACE)
    if stored is None:
        return False
    inner = np.asarray(stored, np.uint8).tobytes()
    # The inner stream has two bytes of version and two of byte order in place of a header.
    check_tags(bytes(HEADER - 2) + inner[2:4] + inner[8:], budget)
    return True


def _check_hdf5(data: bytes, budget: MemoryBudget) -> bool:
    import h5py

    with h5py.File(io.BytesIO(data), "r") as file:
        if SUBSYSTEM not in file:
            return False

        def count(_: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset):
                if item.is_virtual or item.external:
                    raise ValueError("data in another file")
                take_dataset(item, budget)

        file.visititems(count)
    return True


def object_leaves(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Yield name and values of table columns, dates and durations.

    Dates and durations are converted to seconds since the first value.

    Columns are named `T.column`, and `T.column [unit]` if the table states units. Damaged bytes
    raise various exceptions. **Raises** `UsageError` without the library.
    """
    try:
        from matio import load_from_mat
    except ImportError:
        raise UsageError(
            "tables and other objects of MATLAB need the package mat-io; install it with"
            ' `pip install "vttig-jax[matlab]"`, or convert the table in MATLAB with'
            ' `table2struct(T, "ToScalar", true)`.',
            where=str(path),
        ) from None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        variables = load_from_mat(str(path), add_table_attrs=True)
        for name, value in variables.items():
            if not name.startswith("__"):
                yield from leaves(name, value, _objects, lone_cells=False)


def _objects(path: str, value: Any) -> Leaves:
    if hasattr(value, "columns") and hasattr(value, "index"):  # a DataFrame of pandas
        return _table(path, value)
    if not isinstance(value, np.ndarray):
        return ()
    return [(f"{path} [s]", since_first(value))] if value.dtype.kind in "mM" else None


def _table(path: str, table: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Yield name and values of the row times of a timetable and of numeric and time columns.

    `table` is a DataFrame.
    """
    if table.index.dtype.kind in "mM":
        yield f"{path}.{table.index.name or 'Time'} [s]", since_first(table.index.to_numpy())
    stated = max((np.ravel(table.attrs.get(key, ())) for key in UNIT_KEYS), key=len)
    for k, column in enumerate(table.columns):
        values = table[column].to_numpy()
        unit = str(stated[k]) if len(stated) == len(table.columns) else ""
        if values.dtype.kind in "mM":
            yield f"{path}.{column} [s]", since_first(values)
        elif values.dtype.kind in "biuf":
            yield f"{path}.{column} [{unit}]" if unit else f"{path}.{column}", values

"""Rows of a column without a number: empty cells, and readings that are NaN or infinite."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Real

from ..readers.delimited import TextTable
from ..readers.table import Table

_CURE = "a fit refuses such a column, unless --missing skip leaves out these rows"


def missing_notes(table: Table, arrays: Mapping[int, Real[np.ndarray, " _"]]) -> list[str]:
    """Return notes on the columns of a table in which rows hold no number.

    `arrays` is index → values of the columns that are read. Of other columns of a text the empty
    cells are counted.
    """
    notes = [missing_numbers(table.names[k], values) for k, values in arrays.items()]
    if isinstance(table, TextTable):
        notes += _empty_cells(table, [k for k in range(len(table.names)) if k not in arrays])
    return [note for note in notes if note is not None]


def missing_numbers(name: str, values: Real[np.ndarray, " n"]) -> str | None:
    """Return a note that counts the readings of a column that are no finite number, or None.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs.checks.missing_cells import missing_numbers
    >>> missing_numbers("pos", np.array([1.0, np.nan])).partition(";")[0]
    'column `pos`: 1 of 2 rows holds no number (NaN or infinite), row 2 first'

    ```
    """
    rows = np.flatnonzero(~np.isfinite(values)).tolist()
    return _counted(name, rows, len(values), "NaN or infinite")


def _empty_cells(table: TextTable, columns: Sequence[int]) -> list[str | None]:
    empty: dict[int, list[int]] = {k: [] for k in columns}
    count = 0
    for _, row in table.rows() if columns else ():
        for k, rows in empty.items():
            if not (k < len(row) and row[k].strip()):
                rows.append(count)
        count += 1
    return [_counted(table.names[k], rows, count, "empty cells") for k, rows in empty.items()]


def _counted(name: str, rows: Sequence[int], size: int, what: str) -> str | None:
    if not rows:
        return None
    holds = "holds" if len(rows) == 1 else "hold"
    return (
        f"column `{name}`: {len(rows)} of {size} rows {holds} no number ({what}), row"
        f" {rows[0] + 1} first; {_CURE}"
    )

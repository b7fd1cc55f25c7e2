"""Reading of a table from a text, MATLAB or HDF5 file."""

from collections.abc import Iterable
from pathlib import Path

from ...base.errors import LogError
from .column_names import number_of
from .delimited import TextTable
from .layouts.recognised import read_layout
from .nested import NestedTable, read_nested
from .table import find_table
from .text import NESTED, read_text


def open_table(
    path: str | Path,
    *,
    encoding: str | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    requested: Iterable[str | None] = (),
    headerless: bool = False,
) -> tuple[TextTable | NestedTable, str, tuple[str, ...]]:
    """Return the table of a text, MATLAB or HDF5 file, its SHA-256, and notes on assumptions.

    If `headerless` or if the `requested` column names contain a number such as `#1`, a text needs
    no header.

    **Raises** `LogError` for a file without table, `UsageError` for HDF5 without h5py.
    """
    numbered = [name for name in requested if number_of(name)]
    if Path(path).suffix.lower() in NESTED:
        nested, digest = read_nested(path)
        if numbered:
            raise LogError(
                f"there is no column {numbered[0]}; give an array name such as {nested.names[0]}.",
                where=nested.source,
            )
        return nested, digest, ()
    text, digest, notes = read_text(path, encoding)
    if delimiter is None and not numbered:
        found = read_layout(text, str(path))
        if found is not None:
            return found[0], digest, (*notes, *found[1])
    highest = max(map(number_of, numbered), default=int(headerless))
    table = find_table(text, str(path), delimiter=delimiter, decimal=decimal, highest=highest)
    return table, digest, notes

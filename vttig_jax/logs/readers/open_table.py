"""From a path to a table, whatever kind of file it is."""

from collections.abc import Iterable
from pathlib import Path

from ...base.errors import LogError
from .column_names import number_of
from .delimited import TextTable
from .nested import NestedTable, read_nested
from .table import find_table
from .text import NESTED, read_text


def open_table(
    path: str | Path,
    *,
    encoding: str | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    asked: Iterable[str | None] = (),
) -> tuple[TextTable | NestedTable, str, tuple[str, ...]]:
    """Return the table in a text, MATLAB or HDF5 file, its SHA-256, and notes on what was assumed.

    `asked`: the names of the columns wanted; with numbers (`#1`) among them a text needs no header.

    **Raises** `LogError` where there is no table, `UsageError` for HDF5 without h5py.
    """
    numbered = [name for name in asked if number_of(name)]
    if Path(path).suffix.lower() in NESTED:
        nested, digest = read_nested(path)
        if numbered:
            raise LogError(
                f"no column {numbered[0]}; arrays are asked for by name, such as"
                f" {nested.names[0]}.",
                where=nested.source,
            )
        return nested, digest, ()
    text, digest, notes = read_text(path, encoding)
    highest = max(map(number_of, numbered), default=0)
    table = find_table(text, str(path), delimiter=delimiter, decimal=decimal, highest=highest)
    return table, digest, notes

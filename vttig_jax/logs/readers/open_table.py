"""Reading of a table from a file of any format."""

from collections.abc import Iterable
from pathlib import Path

from ...base.errors import LogError
from .binary.formats import format_of, read_binary
from .column_names import number_of
from .delimited import TextTable
from .layouts.recognised import read_layout
from .nested import NestedTable, read_nested
from .quadrature import with_counts
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
    """Return the table of a file, its SHA-256, and notes on assumptions.

    A text needs no header if `headerless` is true or if one of the `requested` column names is a
    number such as `#1`. A requested `quadrature(A,B)` is counted from the levels of A and B.

    **Raises** `LogError` for a file without table, `UsageError` for a format whose package is
    missing.
    """
    requested = tuple(requested)
    table, digest, notes = _opened(
        path, (encoding, delimiter, decimal), requested, headerless=headerless
    )
    table, counted = with_counts(table, requested)
    return table, digest, (*notes, *counted)


def _opened(
    path: str | Path,
    form: tuple[str | None, str | None, str | None],
    requested: Iterable[str | None],
    *,
    headerless: bool,
) -> tuple[TextTable | NestedTable, str, tuple[str, ...]]:
    encoding, delimiter, decimal = form
    numbered = [name for name in requested if number_of(name)]
    binary = format_of(Path(path))
    if binary is not None or Path(path).suffix.lower() in NESTED:
        if binary is None:
            nested, digest, notes = (*read_nested(path), ())
        else:
            nested, digest, notes = read_binary(Path(path), binary)
        if numbered:
            raise LogError(
                f"there is no column {numbered[0]}; give an array name such as {nested.names[0]}.",
                where=nested.source,
            )
        return nested, digest, notes
    text, digest, notes = read_text(path, encoding)
    if delimiter is None:
        found = read_layout(text, str(path))
        if found is not None:
            return found[0], digest, (*notes, *found[1])
    highest = max(map(number_of, numbered), default=int(headerless))
    table = find_table(text, str(path), delimiter=delimiter, decimal=decimal, highest=highest)
    return table, digest, notes

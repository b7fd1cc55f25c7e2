"""Texts in other files, recognised by their first bytes: packed texts, and workbooks as text.

A workbook of Excel or OpenDocument becomes a text with tabs, a line for each row of a sheet. The
largest sheet comes first, so that its line numbers are the numbers of its rows; other sheets with
more than one row follow under their names.
"""

import bz2
import gzip
import io
import lzma
import re
import zipfile
from collections.abc import Callable
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

from ...base.errors import InputError, LogError, UsageError
from ...base.files.limits import PART, MemoryBudget

_CELL = 64  # bytes of a cell of a sheet as a Python object; chosen value

_REPEATED = re.compile(rb"number-(?:rows|columns)-repeated\s*=\s*[\"'](\d+)")
_ROW_OR_CELL = re.compile(rb"[\s:]r\s*=\s*[\"']\s*([A-Za-z]*)(\d+)")
"""Number of a row, or letters and number of a cell, in the XML of a sheet of Excel."""

_TABLE = re.compile(rb"<(?:\w+:)?table-(row|cell)\b([^>]*)>")
"""Start of a row or a cell in the XML of OpenDocument; `_REPEATED` is how often it stands there."""


def _zstd(file: io.BytesIO) -> Any:
    import pyarrow as pa

    return pa.CompressedInputStream(file, "zstd")


_WORKBOOK = b"PK\x03\x04"
_OPENERS: dict[bytes, Callable[[io.BytesIO], Any]] = {
    b"\x1f\x8b": lambda file: gzip.GzipFile(fileobj=file),
    b"BZh": bz2.BZ2File,
    b"\xfd7zXZ\0": lzma.LZMAFile,
    b"\x28\xb5\x2f\xfd": _zstd,
}

ENDINGS = (".gz", ".bz2", ".xz", ".zst")
"""File endings that follow the ending of the packed text, as in `log.csv.gz`."""


def ending_of(path: Path) -> str:
    """Return the file ending in lower case, without that of a packed file: .csv for log.csv.gz."""
    packed = path.suffix.lower() in ENDINGS
    return Path(path.stem).suffix.lower() if packed else path.suffix.lower()


def unpacked(data: bytes, where: str) -> bytes:
    """Return the text of a packed file or of a workbook; other bytes are returned unchanged.

    **Raises** `LogError` for a damaged file, `InputError` beyond the memory limit, `UsageError` for
    a workbook without the package python-calamine.
    """
    budget, parts = MemoryBudget(where, len(data)), []
    try:
        if data.startswith(_WORKBOOK):
            return _text_of_workbook(data, budget).encode()
        opener = next((one for start, one in _OPENERS.items() if data.startswith(start)), None)
        if opener is None:
            return data
        file = opener(io.BytesIO(data))
        while part := file.read(PART):
            budget.take(len(part))
            parts.append(part)
    except (InputError, UsageError, MemoryError):
        raise
    except Exception:  # damaged bytes raise various exceptions
        raise LogError(
            "the file is damaged, cut off or packed in another way; write it again.", where=where
        ) from None
    return b"".join(parts)


def _text_of_workbook(data: bytes, budget: MemoryBudget) -> str:
    try:
        from python_calamine import load_workbook
    except ImportError:
        raise UsageError(
            "workbooks need the package python-calamine; install it with"
            ' `pip install "vttig-jax[sheets]"`, or export the log as CSV.',
            where=budget.where,
        ) from None
    _take_sheets(data, budget)
    book = load_workbook(io.BytesIO(data))
    sheets = {
        name: ["\t".join(map(_field, row)) for row in sheet.to_python(skip_empty_area=False)]
        for name in book.sheet_names
        if (sheet := book.get_sheet_by_name(name)) is not None
    }
    first, *others = sorted(sheets, key=lambda name: -len(sheets[name]))
    lines = sheets[first]
    for name in others:
        if len(sheets[name]) > 1:
            lines += ["", name, *sheets[name]]
    return "\n".join([*lines, ""])


def _take_sheets(data: bytes, budget: MemoryBudget) -> None:
    """Take the memory of all cells up to the last one of each sheet from the budget.

    The library makes a cell for each place up to the last one, however empty the sheet is, and ends
    the process if their memory is lacking.

    **Raises** `ValueError` for a member that is damaged or unpacks to more than it declares.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for member in archive.infolist():
            budget.take(member.file_size)
            content = archive.read(member)  # checks its size and its sum
            if member.filename.endswith(".xml"):
                rows, columns = _size(content)
                budget.take(_CELL * rows * columns)


def _size(content: bytes) -> tuple[int, int]:
    """Return the last row and the last column of a sheet with content; 0 in other XML."""
    rows = columns = seen = place = 0
    for letters, number in _ROW_OR_CELL.findall(content):
        rows, columns = max(rows, int(number)), max(columns, _column(letters))
    for kind, attributes in _TABLE.findall(content):
        match = _REPEATED.search(attributes)
        repeated = int(match[1]) if match else 1
        if kind == b"row":
            seen, place = seen + repeated, 0
        else:
            place += repeated
            if not attributes.endswith(b"/"):
                rows, columns = seen, max(columns, place)
    return rows, columns


def _column(letters: bytes) -> int:
    """Return the number of a column, 28 for AB."""
    number = 0
    for letter in letters.upper():
        number = 26 * number + letter - 64
    return number


def _field(value: Any) -> str:
    if isinstance(value, bool | int):
        return str(int(value))
    if isinstance(value, float):
        return str(int(value)) if value.is_integer() and abs(value) < 2**53 else repr(value)
    if isinstance(value, date) and not isinstance(value, datetime):  # also midnight
        return f"{value.isoformat()}T00:00:00"
    if isinstance(value, datetime | time):
        return value.isoformat()
    if isinstance(value, timedelta):
        return repr(value.total_seconds())
    return " ".join(str(value).split())

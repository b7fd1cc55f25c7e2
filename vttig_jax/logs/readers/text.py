"""Bytes and text of a file, packed or not, with its encoding, its digest and its lines.

Packed texts and workbooks are recognised by their first bytes. A workbook of Excel or OpenDocument
becomes a text with tabs, a line for each row of a sheet. The largest sheet comes first, so that its
line numbers are the numbers of its rows; other sheets with more than one row follow under their
names.
"""

import bz2
import codecs
import gzip
import hashlib
import io
import lzma
import re
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from datetime import date, datetime, time, timedelta
from importlib import import_module
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any, overload

import numpy as np

from ...base.errors import InputError, LogError, UsageError
from ...base.files.limits import PART, MemoryBudget, kept_bytes, read_regular
from ...base.numerics.counting import pieces
from .column_names import known_words

_CELL = 64  # bytes of a cell of a sheet as a Python object; chosen value

_REPEATED = re.compile(rb"number-(?:rows|columns)-repeated\s*=\s*[\"'](\d+)")
_ROW_OR_CELL = re.compile(rb"[\s:]r\s*=\s*[\"']\s*([A-Za-z]*)(\d+)")
"""Number of a row, or letters and number of a cell, in the XML of a sheet of Excel."""

_TABLE = re.compile(rb"<(?:\w+:)?table-(row|cell)\b([^>]*)>")
"""Start of a row or a cell in the XML of OpenDocument; `_REPEATED` is how often it stands there."""


def _zstd(file: io.BytesIO) -> Any:
    import pyarrow as pa

    return pa.CompressedInputStream(file, "zstd")


_PACKAGES = {"python_calamine": "python-calamine", "matio": "mat-io"}
"""Import name → name of the package, where they differ."""

_WORKBOOK = b"PK\x03\x04"
_OPENERS: dict[bytes, Callable[[io.BytesIO], Any]] = {
    b"\x1f\x8b": lambda file: gzip.GzipFile(fileobj=file),
    b"BZh": bz2.BZ2File,
    b"\xfd7zXZ\0": lzma.LZMAFile,
    b"\x28\xb5\x2f\xfd": _zstd,
}

PACKED_ENDINGS = (".gz", ".bz2", ".xz", ".zst")
"""File endings that follow the ending of the packed text, as in `log.csv.gz`."""


def library(name: str, what: str, extra: str, where: str = "", cure: str = "") -> Any:
    """Return an optional package; raise `UsageError` if it is missing.

    `what` are the files that need it, in the plural, `extra` is the extra of vttig-jax that
    installs it, and `cure` is a way without it.
    """
    try:
        return import_module(name)
    except ImportError:
        package = _PACKAGES.get(name, name)
        raise UsageError(
            f'{what} need the package {package}; install it with `pip install "vttig-jax[{extra}]"`'
            f"{cure and ', or '}{cure}.",
            where=where,
        ) from None


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
    calamine = library(
        "python_calamine", "workbooks", "sheets", budget.where, "export the log as CSV"
    )
    _take_sheets(data, budget)
    book = calamine.load_workbook(io.BytesIO(data))
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


ENDINGS = (
    *("", ".csv", ".tsv", ".txt", ".dat", ".asc", ".log", ".lvm", ".prn", ".out"),
    *(".json", ".jsonl", ".ndjson", ".xlsx", ".xlsm", ".ods"),
)
"""File endings of delimited text, of JSON, and of workbooks, which are read as such a text."""


def unpacked_parts(unpacker: Any, packed: bytes) -> Iterator[bytes]:
    """Yield what `packed` unpacks to in parts of at most 1 MiB, so that none of it must be kept.

    `unpacker` is a decompressor object of zlib, bz2, lz4 or Zstandard.
    """
    while not unpacker.eof:
        part = unpacker.decompress(packed, PART)
        yield part
        packed = getattr(unpacker, "unconsumed_tail", b"")  # only zlib returns what it did not read
        if not part and getattr(unpacker, "needs_input", True):
            return


def refuse_larger(unpacker: Any, packed: bytes, most: int, what: str) -> None:
    """Raise `ValueError` if `packed` unpacks to more than `most` bytes; `what` names it there."""
    size = 0
    for part in unpacked_parts(unpacker, packed):
        size += len(part)
        if size > most:
            raise ValueError(f"{what} unpacks to more than {size}")


BOMS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")
"""Control codes other than tab, line feed and carriage return."""

_PLAIN = b"\t\n\r" + bytes(range(0x20, 0x7F))
"""Bytes of an ASCII text without control codes; a test with them is faster than the pattern."""


def read_text(path: str | Path, encoding: str | None) -> tuple["Lines", str, tuple[str, ...]]:
    """Return the lines, the SHA-256 of the bytes, and notes on an assumed encoding.

    A byte-order mark defines the encoding. Without one it is UTF-16 if every second byte is zero,
    else UTF-8. If UTF-8 fails it is the one in which most words are known, or Windows-1252.

    **Raises** `LogError` for a missing, empty, binary or unreadable file, a folder, an unknown
    ending, or bytes that are invalid in the encoding.
    """
    data = read_bytes(path, ENDINGS)
    digest = hashlib.sha256(data).hexdigest()
    where = str(path)
    raw = unpacked(data, where)
    data = raw if encoding else _without_garbage(raw)
    serial = data is not raw or _SERIAL.search(data, 0, _TOP)
    codec = encoding or next((name for bom, name in BOMS if data.startswith(bom)), None)
    if codec is None and not serial and data.isascii() and is_plain(data):
        return Lines(data), digest, ()
    notes: tuple[str, ...] = ()
    if codec is None and b"\0" in data[:65536]:
        codec = _utf16_without_mark(data)
        if codec is None:
            raise LogError(
                "the file is binary; logs are text (CSV, TSV, TXT), MATLAB (.mat) or HDF5 (.h5).",
                where=where,
            )
        notes = (f"UTF-16 without a byte-order mark, read as {codec}",)
    try:
        if codec is not None and codecs.lookup(codec).name.startswith("utf-16"):
            data = data[: len(data) // 2 * 2]  # removes half a character at the end
        text = data.decode(codec or "utf-8")
    except UnicodeDecodeError as error:
        if codec is not None:
            raise LogError(
                f"byte {error.start} is not {codec}; write the `encoding` of the file in [log].",
                where=where,
            ) from None
        known, codec = max(((_known(data, one), one) for one in _OTHERS), key=itemgetter(0))
        try:
            text = data.decode(codec)
        except UnicodeDecodeError:
            raise LogError(
                "the file is binary or has an unknown encoding; logs are text (CSV, TSV, TXT),"
                " MATLAB (.mat) or HDF5 (.h5); save a text of another encoding as UTF-8.",
                where=where,
            ) from None
        said = "Windows-1252 (cp1252)" if codec == _OTHERS[0] else codec
        notes = (f"not UTF-8, read as {said}" + ", in which its words are known" * bool(known),)
    except (LookupError, ValueError):  # a null character in the name, a codec that always fails
        cure = f"unknown encoding {encoding!r}; write utf-8, utf-16 or cp1252."
        raise LogError(cure, where="log.encoding") from None
    del data, raw  # before a changed copy of the text takes memory too
    text = printable(text.removeprefix("\ufeff"))
    if serial:
        text, told = _without_boot_text(text)
        notes = (*notes, *told)
    return Lines(text), digest, notes


_TOP = 8192  # bytes of the beginning, in which boot text is searched (chosen)
_OTHERS = ("cp1252", "cp1250", "cp1251", "gb18030", "cp932", "cp949", "big5")
"""Encodings of texts that are not UTF-8; the first one is taken if no word decides."""

_JUNK = re.compile(rb"[^\t\n\r -~]")
_SERIAL = re.compile(rb"^[\d:.,]+ -> |^rst:0x|^ets \w+ +\d|^ESP-ROM:", re.MULTILINE)
"""A stamp of the Arduino IDE, and lines that an ESP writes as it starts."""

_ARROW = re.compile(r"^(\d\d:\d\d:\d\d[.,]\d+) -> ?", re.MULTILINE)
_AMOUNT = re.compile(r"[-+]?(?:\d[\d.]*|\.\d+)(?:[eE][-+]?\d+)?")


def _known(data: bytes, codec: str) -> int:
    """Return how many words with other letters than those of ASCII are known in an encoding."""
    try:
        return known_words(codecs.getincrementaldecoder(codec)().decode(data[:_TOP]))
    except UnicodeDecodeError:
        return 0


def _without_garbage(data: bytes) -> bytes:
    """Return a text in which bytes of garbage before plain text are question marks.

    A serial line receives them before both ends have one rate.
    """
    found = list(_JUNK.finditer(data, 0, _TOP))
    end = found[-1].end() if found else 0
    texts = (data[:end].decode(codec, "replace") for codec in ("utf-8", "cp1252"))
    known = any("\ufffd" not in printable(text) for text in texts) or _utf16_without_mark(data)
    if known or len(data) < 2 * end or data[end:].translate(None, _PLAIN):
        return data
    return _JUNK.sub(b"?", data[:end]) + data[end:]


def _without_boot_text(text: str) -> tuple[str, tuple[str, ...]]:
    """Return the text of a serial line without the lines above its table, and a note.

    The rows of the table are alike up to their numbers. Its header is kept: the line above with as
    many delimiters. A stamp before `->` becomes the first column.
    """
    shapes = [_AMOUNT.sub("0", _ARROW.sub("", line)) for line in text[: 16 * _TOP].split("\n")]
    usual = (Counter(filter(None, shapes)).most_common(1) or [("", 0)])[0][0]
    first = shapes.index(usual)
    mark = next((mark for mark in ";\t," if mark in usual), " ")
    header = next((k for k in range(first - 1, -1, -1) if shapes[k].strip()), 0)
    named = first and ":" not in usual and shapes[header].count(mark) == usual.count(mark)
    *above, rows = text.split("\n", first)
    names = _ARROW.sub(f"time{mark}", above[header]).lstrip("?") if named else ""
    above = [names if k == header else "" for k in range(first)]
    note = f"lines of a controller that starts, above the table, left out: {first - bool(named)}"
    rows = _ARROW.sub("\\1 " if ":" in usual else f"\\1{mark}", rows)
    return "\n".join([*above, rows]), (note,) * (first > bool(named))


def is_plain(data: bytes) -> bool:
    """Return whether bytes are ASCII without control codes, and each CR is part of a CR LF."""
    plain = all(not data[part].translate(None, _PLAIN) for part in pieces(len(data), _BLOCK))
    return plain and data.count(b"\r") == data.count(b"\r\n")


def printable(text: str) -> str:
    """Return a text with control codes replaced, because they could control the user's terminal."""
    return _CONTROL.sub("\ufffd", text)


def _utf16_without_mark(data: bytes) -> str | None:
    """Return the UTF-16 byte order that explains the positions of the zero bytes, or None."""
    head = np.frombuffer(data[:65536], np.uint8)
    if len(head) < 2:
        return None
    low, high = np.mean(head[::2] == 0), np.mean(head[1::2] == 0)
    if low == 0 and high > 0.9:
        return "utf-16-le"
    return "utf-16-be" if high == 0 and low > 0.9 else None


_UNREADABLE: dict[type[OSError], str] = {
    FileNotFoundError: "no such file; check its path.",
    PermissionError: "there is no permission to read this file; change its access rights.",
}


def read_bytes(path: str | Path, endings: Sequence[str]) -> bytes:
    """Return the bytes of a file with one of `endings`.

    **Raises** `LogError` for a missing, empty or unreadable file, a folder and other endings.
    """
    path = Path(path)
    where = str(path)
    try:
        if path.is_dir():
            raise LogError("this is a folder; name the log file in it.", where=where)
        packed = path.suffix.lower() in PACKED_ENDINGS
        ending = Path(path.stem).suffix if packed else path.suffix  # .csv for log.csv.gz
        if ending.lower() not in endings and path.exists():
            raise LogError(
                f"`{path.suffix}` files are not read, only text logs (CSV, TSV, TXT, JSON, also"
                " packed), workbooks (.xlsx, .ods), MATLAB (.mat), HDF5 (.h5, .hdf5), NumPy,"
                " Parquet, Feather, Arrow, TDMS, MDF and ROS files; export the log as CSV.",
                where=where,
            )
        kept = kept_bytes(path)
        data = read_regular(path) if kept is None else kept
    except OSError as error:
        said = f"cannot be read ({error.strerror or error}); check the path and the disk."
        raise LogError(_UNREADABLE.get(type(error), said), where=where) from None
    if not data or data.isspace():
        raise LogError("the file is empty; export the log again.", where=where)
    return data


_HEAD = 1024
"""Number of first lines that are stored as a list, because the search for headers and layouts reads
them often (chosen)."""

_BLOCK = 1 << 18
"""Number of bytes that are split into lines at a time (chosen)."""

_IN_NUMBERS = b" \t\r\n0123456789.,;+-"


class Lines(Sequence[str]):
    """The lines of a text, as `text.split("\\n")` returns them; a line may end in CR LF.

    `data` is the text, or its bytes in UTF-8, which are not copied, from `start` to `stop`. They
    stay one object, because a list of lines would take three times the memory.
    """

    def __init__(self, data: str | bytes, start: int = 0, stop: int | None = None):
        if isinstance(data, str):
            data = data.replace("\r\n", "\n").replace("\r", "\n").encode("utf-8", "surrogatepass")
        self.data, self.start, self.stop = data, start, len(data) if stop is None else stop
        self._length = data.count(b"\n", start, self.stop) + 1
        self._head = list(islice(self, _HEAD))

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[str]:
        for block in self.blocks(0):
            lines = block.split("\n")
            yield from lines[:-1]
            if not block.endswith("\n"):
                yield lines[-1]
        if self.stop == self.start or self.data[self.stop - 1] == 10:
            yield ""

    @overload
    def __getitem__(self, index: int) -> str: ...

    @overload
    def __getitem__(self, index: slice) -> list[str]: ...

    def __getitem__(self, index: int | slice) -> str | list[str]:
        if isinstance(index, slice):
            start, stop, step = index.indices(len(self))
            kept = self._head if max(start, stop) <= len(self._head) else list(self)
            return kept[start:stop:step]
        if 0 <= index < len(self._head):
            return self._head[index]
        if index >= len(self) or index < -len(self):
            raise IndexError("this text has no such line")
        return next(self.starting_at(index % len(self)))

    def _decoded(self, start: int, stop: int) -> str:
        """Return the text of whole lines, whose line ends are LF."""
        text = self.data[start:stop].decode("utf-8", "surrogatepass")
        return text.replace("\r\n", "\n") if "\r" in text else text

    def starting_at(self, index: int) -> Iterator[str]:
        """Yield the lines from the line with index `index` (from 0) to the end."""
        return islice(self, index, None)

    def backwards(self) -> Iterator[str]:
        """Yield the lines from the last one to the first one."""
        stop = self.stop
        while stop >= self.start:
            start = self.data.rfind(b"\n", self.start, stop) + 1 or self.start
            yield self._decoded(start, stop).removesuffix("\r")
            stop = start - 1

    def before(self, index: int) -> "Lines":
        """Return the lines before the line with index `index` ≥ 1."""
        stop = self.stop
        for _ in range(len(self) - index):
            stop = self.data.rfind(b"\n", self.start, stop)
        return Lines(self.data, self.start, stop - (self.data[stop - 1 : stop] == b"\r"))

    def trimmed(self, empty: bytes) -> "Lines":
        """Return the lines without those at the end that hold only bytes of `empty`."""
        places = range(self.stop, self.start, -1)
        end = next((k for k in places if self.data[k - 1] not in empty), self.stop)
        stop = self.data.find(b"\n", end, self.stop) + 1 or self.stop
        return self if stop == self.stop else Lines(self.data, self.start, stop)

    def start_of(self, index: int) -> int:
        """Return the position in the bytes at which the line with index `index` starts."""
        place = self.start
        for _ in range(index):
            place = self.data.index(b"\n", place, self.stop) + 1
        return place

    def have(self, mark: str, first: int = 0) -> bool:
        """Return whether `mark` occurs in the line with index `first` or a later line."""
        if len(self) <= first:
            return False
        return self.data.find(mark.encode(), self.start_of(first), self.stop) >= 0

    def match(self, pattern: re.Pattern[str], first: int) -> bool:
        """Return whether a pattern matches at or in a line from the line with index `first` on.

        The pattern has the flag MULTILINE, and matches only what is no number in ASCII.
        """
        return any(
            block.encode().translate(None, _IN_NUMBERS) and pattern.search(block)
            for block in self.blocks(first)
        )

    def blocks(self, first: int, size: int = _BLOCK) -> Iterator[str]:
        """Yield blocks of whole lines from the line with index `first` on.

        A block has about `size` bytes.
        """
        place = self.start_of(first) if len(self) > first else self.stop
        while place < self.stop:
            end = self.data.rfind(b"\n", place, min(place + size, self.stop)) + 1
            if not end:
                end = self.data.find(b"\n", place, self.stop) + 1
            if not end or self.stop - place <= size:
                end = self.stop
            yield self._decoded(place, end)
            place = end

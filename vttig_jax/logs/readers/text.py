"""Bytes and text of a file, with its encoding, its digest and its lines."""

import codecs
import hashlib
import re
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import overload

import numpy as np

from ...base.errors import LogError
from ...base.files.limits import read_regular
from ...base.files.standard_input import kept_bytes
from .packed import ending_of, unpacked

ENDINGS = (
    *("", ".csv", ".tsv", ".txt", ".dat", ".asc", ".log", ".lvm", ".prn", ".out"),
    *(".json", ".jsonl", ".ndjson", ".xlsx", ".xlsm", ".ods"),
)
"""File endings of delimited text, of JSON, and of workbooks, which are read as such a text."""

NESTED = (".mat", ".h5", ".hdf5")
"""File endings of nested arrays."""

BOMS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")
"""Control codes other than tab, line feed and carriage return."""

_PLAIN = b"\t\n\r" + bytes(range(0x20, 0x7F))
"""Bytes of an ASCII text without control codes; a test with them is faster than the pattern."""


def read_text(path: str | Path, encoding: str | None) -> tuple[str, str, tuple[str, ...]]:
    """Return the text, the SHA-256 of its bytes, and notes on an assumed encoding.

    A byte-order mark defines the encoding. Without one it is UTF-16 if every second byte is zero,
    else UTF-8, or Windows-1252 if UTF-8 fails.

    **Raises** `LogError` for a missing, empty, binary or unreadable file, a folder, an unknown
    ending, or bytes that are invalid in the encoding.
    """
    data = read_bytes(path, ENDINGS)
    digest = hashlib.sha256(data).hexdigest()
    where = str(path)
    data = unpacked(data, where)
    codec = encoding or next((name for bom, name in BOMS if data.startswith(bom)), None)
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
        try:
            text = data.decode("cp1252")
        except UnicodeDecodeError:
            raise LogError(
                "the file is binary or has an unknown encoding; logs are text (CSV, TSV, TXT),"
                " MATLAB (.mat) or HDF5 (.h5); save a text of another encoding, such as Shift"
                " JIS, as UTF-8.",
                where=where,
            ) from None
        notes = ("not UTF-8, read as Windows-1252 (cp1252)",)
    except (LookupError, ValueError):  # a null character in the name, a codec that always fails
        raise _unusable(encoding) from None
    is_plain = text.isascii() and not data.translate(None, _PLAIN)
    del data  # before a changed copy of the text takes memory too
    text = text.removeprefix("\ufeff")  # some codecs keep the byte-order mark
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    return text if is_plain else printable(text), digest, notes


def printable(text: str) -> str:
    """Return a text with control codes replaced, because they could control the user's terminal."""
    return _CONTROL.sub("\ufffd", text)


def _unusable(encoding: str | None) -> LogError:
    return LogError(
        f"unknown encoding {encoding!r}; write utf-8, utf-16 or cp1252.",
        where="log.encoding",
    )


def _utf16_without_mark(data: bytes) -> str | None:
    """Return the UTF-16 byte order that explains the positions of the zero bytes, or None."""
    head = np.frombuffer(data[:65536], np.uint8)
    if len(head) < 2:
        return None
    low, high = np.mean(head[::2] == 0), np.mean(head[1::2] == 0)
    if low == 0 and high > 0.9:
        return "utf-16-le"
    return "utf-16-be" if high == 0 and low > 0.9 else None


def read_bytes(path: str | Path, endings: Sequence[str]) -> bytes:
    """Return the bytes of a file with one of `endings`.

    **Raises** `LogError` for a missing, empty or unreadable file, a folder and other endings.
    """
    path = Path(path)
    where = str(path)
    try:
        if path.is_dir():
            raise LogError("this is a folder; name the log file in it.", where=where)
        if ending_of(path) not in endings and path.exists():
            raise _unknown_ending(path)
        kept = kept_bytes(path)
        data = read_regular(path) if kept is None else kept
    except FileNotFoundError:
        raise LogError("no such file; check its path.", where=where) from None
    except PermissionError:
        raise LogError(
            "there is no permission to read this file; change its access rights.", where=where
        ) from None
    except OSError as error:
        raise LogError(
            f"cannot be read ({error.strerror or error}); check the path and the disk.", where=where
        ) from None
    if not data or data.isspace():
        raise LogError("the file is empty; export the log again.", where=where)
    return data


def _unknown_ending(path: Path) -> LogError:
    return LogError(
        f"`{path.suffix}` files are not read, only text logs (CSV, TSV, TXT, JSON, also packed),"
        " workbooks (.xlsx, .ods), MATLAB (.mat), HDF5 (.h5, .hdf5), NumPy, Parquet, Feather,"
        " Arrow, TDMS, MDF and ROS files; export the log as CSV.",
        where=str(path),
    )


_HEAD = 1024
"""Number of first lines that are stored as a list, because the search for headers and layouts reads
them often (chosen)."""

_BLOCK = 1 << 20
"""Number of characters that are split into lines at a time (chosen)."""


class Lines(Sequence[str]):
    """The lines of `text[:stop]`, as `text[:stop].split("\\n")` returns them.

    They stay one string, because a list of lines would take three times the memory.
    """

    def __init__(self, text: str, stop: int | None = None):
        self.text, self.stop = text, len(text) if stop is None else stop
        self._length = text.count("\n", 0, self.stop) + 1
        self._head = list(islice(self, _HEAD))

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[str]:
        for block in self.blocks(0, _BLOCK):
            lines = block.split("\n")
            yield from lines[:-1]
            if not block.endswith("\n"):
                yield lines[-1]
        if not self.stop or self.text[self.stop - 1] == "\n":
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

    def starting_at(self, index: int) -> Iterator[str]:
        """Yield the lines from the line with index `index` (from 0) to the end."""
        return islice(self, index, None)

    def backwards(self) -> Iterator[str]:
        """Yield the lines from the last one to the first one."""
        stop = self.stop
        while stop >= 0:
            start = self.text.rfind("\n", 0, stop) + 1
            yield self.text[start:stop]
            stop = start - 1

    def before(self, index: int) -> "Lines":
        """Return the lines before the line with index `index` ≥ 1."""
        stop = self.stop
        for _ in range(len(self) - index):
            stop = self.text.rfind("\n", 0, stop)
        return Lines(self.text, stop)

    def start_of(self, index: int) -> int:
        """Return the character position in the text at which the line with index `index` starts."""
        place = 0
        for _ in range(index):
            place = self.text.index("\n", place, self.stop) + 1
        return place

    def have(self, mark: str, first: int = 0) -> bool:
        """Return whether `mark` occurs in the line with index `first` or a later line."""
        return len(self) > first and self.text.find(mark, self.start_of(first), self.stop) >= 0

    def match(self, pattern: re.Pattern[str], first: int) -> bool:
        """Return whether a pattern (flag MULTILINE) matches from the line with index `first` on."""
        if len(self) <= first:
            return False
        return pattern.search(self.text, self.start_of(first), self.stop) is not None

    def blocks(self, first: int, size: int) -> Iterator[str]:
        """Yield blocks of whole lines from the line with index `first` on.

        A block has about `size` characters.
        """
        place = self.start_of(first) if len(self) > first else self.stop
        while place < self.stop:
            end = self.text.rfind("\n", place, min(place + size, self.stop)) + 1
            if not end:
                end = self.text.find("\n", place, self.stop) + 1
            if not end or self.stop - place <= size:
                end = self.stop
            yield self.text[place:end]
            place = end

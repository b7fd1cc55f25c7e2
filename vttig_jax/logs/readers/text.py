"""Reading of the bytes and text of a file, with its encoding and digest."""

import codecs
import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

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

"""From a path to text: what kind of file it is, its encoding and its digest."""

import codecs
import hashlib
from pathlib import Path

from ..base.errors import LogError

ENDINGS = ("", ".csv", ".tsv", ".txt", ".dat", ".asc", ".log")
"""File endings read as delimited text."""

BOMS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


def read_text(path: str | Path, encoding: str | None) -> tuple[str, str, tuple[str, ...]]:
    """Return the text, the SHA-256 of its bytes, and notes on an encoding that was assumed.

    A byte-order mark decides; without one it is UTF-8 or, failing that, Windows-1252.

    **Raises** `LogError` for a missing, empty, binary or unreadable file, a folder, an unknown
    ending, or bytes the encoding does not have.
    """
    path = Path(path)
    data = _read_bytes(path)
    digest = hashlib.sha256(data).hexdigest()
    where = str(path)
    if not data.strip():
        raise LogError("the file is empty; export the log again.", where=where)
    found = encoding or next((name for bom, name in BOMS if data.startswith(bom)), None)
    if found != "utf-16" and encoding is None and b"\0" in data[:65536]:
        raise LogError("a binary file; only text logs (CSV, TSV, TXT) are read.", where=where)
    notes: tuple[str, ...] = ()
    try:
        text = data.decode(found or "utf-8")
    except LookupError:
        raise LogError(
            f"unknown encoding {encoding!r}; write utf-8, utf-16 or cp1252.",
            where="log.encoding",
        ) from None
    except UnicodeDecodeError as error:
        if found is not None:
            raise LogError(
                f"byte {error.start} is not {found}; give the file's `encoding` in [log].",
                where=where,
            ) from None
        try:
            text = data.decode("cp1252")
        except UnicodeDecodeError:
            raise LogError(
                "a binary file, or text in an unknown encoding; only text logs (CSV, TSV, TXT) are"
                " read.",
                where=where,
            ) from None
        notes = ("not UTF-8, read as Windows-1252 (cp1252)",)
    return text.replace("\r\n", "\n").replace("\r", "\n"), digest, notes


def _read_bytes(path: Path) -> bytes:
    where = str(path)
    try:
        if path.is_dir():
            raise LogError("this is a folder; name the log file in it.", where=where)
        if path.suffix.lower() not in ENDINGS and path.exists():
            raise LogError(
                f"`{path.suffix}` files are not read, only text logs (CSV, TSV, TXT); export the"
                " log as CSV.",
                where=where,
            )
        return path.read_bytes()
    except FileNotFoundError:
        raise LogError("no such file; check the path of the log.", where=where) from None
    except PermissionError:
        raise LogError(
            "no permission to read this file; change its access rights.", where=where
        ) from None
    except OSError as error:
        raise LogError(
            f"cannot be read ({error.strerror or error}); check the path and the disk.", where=where
        ) from None

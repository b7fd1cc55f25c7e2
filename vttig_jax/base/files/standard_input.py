"""Standard input as a file: its bytes are read once and kept in memory under a file name.

A log is opened several times (to recognise its columns, to read them, to take its digest), but a
pipe can be read only once.
"""

import os
import sys
from pathlib import Path

from ..errors import InputError, UsageError
from .limits import asked_bytes, free_bytes, read_at_most

STDIN = Path("-")
"""Path by which a user selects standard input."""

MOST_BYTES = 1 << 30  # limit of a stream, whose length is not known in advance; chosen value

KEPT_STEM = "stdin"
"""Name of a kept log in a run folder, without its ending."""

_PREFIX = "<stdin>"
_KEPT: dict[str, bytes] = {}


def read_standard_input() -> bytes:
    """Return all bytes of standard input.

    **Raises** `UsageError` for a terminal, `InputError` for an empty input, one that cannot be
    read, and one longer than 1 GiB, half of the free memory, or `--most-memory`.
    """
    stream = sys.stdin
    if stream is None or stream.closed:
        raise UsageError("nothing is connected to stdin; give the path of the log.", where="stdin")
    if stream.isatty():
        raise UsageError("stdin is a terminal; pipe a log into it, or give a path.", where="stdin")
    asked = asked_bytes()
    limit = min(MOST_BYTES, free_bytes() // 2) if asked is None else asked
    try:
        data = read_at_most(stream.buffer, limit)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}.", where="stdin") from None
    if len(data) > limit:
        raise InputError(
            f"it is longer than the limit of {limit / 2**30:.3g} GiB; give --most-memory GIB if you"
            " trust it.",
            where="stdin",
        )
    return data


def keep(data: bytes, ending: str) -> Path:
    """Keep `data` in memory under a name with the file ending `ending`; return the name."""
    name = _PREFIX + ending
    _KEPT[name] = data
    return Path(name)


def kept_bytes(path: str | Path) -> bytes | None:
    """Return the bytes that are kept under a name, or None for a file."""
    return _KEPT.get(os.fspath(path))


def kept_name(path: Path) -> str:
    """Return the name of a kept log in a run folder: `stdin.csv` for `<stdin>.csv`."""
    return f"{KEPT_STEM}{path.suffix}"

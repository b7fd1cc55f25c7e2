"""Memory that files may take when they are read, and bytes from standard input.

A small file can declare arrays of any size or unpack to any length, and a device has no end. So
only regular files are read, and sizes are compared with a limit before memory is allocated. The
limit is 64 times the size of the file and at least 256 MiB, but not more than half of the free
memory of the machine. The option `--most-memory` of the command line replaces it.

Standard input is read once and kept under a file name, because a log is opened several times (to
recognise its columns, to read them, to take its digest) and a pipe can be read only once.
"""

import errno
import io
import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import BinaryIO

from ..errors import InputError, UsageError

MULTIPLE, LEAST_BYTES = 64, 1 << 28
"""Memory per byte of the file, and memory that any file may take; chosen values. Logs of encoders
compress by 2 to 20."""

PART = 1 << 20  # bytes that are read or unpacked at a time, where the length is unknown; chosen
_FALLBACK_BYTES = 4 << 30  # free memory of a system that does not report it; chosen value
_ASKED: ContextVar[int | None] = ContextVar("asked", default=None)


@contextmanager
def most_memory(size_bytes: int | None) -> Iterator[None]:
    """Replace the memory limit by `size_bytes` inside the block; None keeps the limit."""
    token = _ASKED.set(_ASKED.get() if size_bytes is None else size_bytes)
    try:
        yield
    finally:
        _ASKED.reset(token)


def asked_bytes() -> int | None:
    """Return the memory limit in bytes that the user asked for, or None."""
    return _ASKED.get()


def free_bytes() -> int:
    """Return the free memory in bytes, or an assumed value if the system does not report it."""
    with suppress(OSError):  # MemAvailable includes pages that only cache files, unlike sysconf
        for line in Path("/proc/meminfo").read_text("ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    with suppress(AttributeError, ValueError, OSError):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    return _FALLBACK_BYTES


class MemoryBudget:
    """Memory that the content of one file may take.

    **Arguments**
    - `where`: name of the file, for the error. - `file_bytes`: its size.
    """

    def __init__(self, where: str, file_bytes: int) -> None:
        self.where = where
        asked = _ASKED.get()
        allowed = max(LEAST_BYTES, MULTIPLE * file_bytes)
        self.limit = min(allowed, free_bytes() // 2) if asked is None else asked
        self.taken = 0

    def take(self, size_bytes: int) -> None:
        """Add `size_bytes`, which are about to be allocated, to the memory of this file.

        **Raises** `InputError` beyond the limit.
        """
        self.taken += size_bytes
        if self.taken > self.limit:
            raise InputError(
                f"its content takes more than {self.limit / 2**30:.3g} GiB of memory, which is the"
                " limit for a file of this size; give --most-memory GIB if you trust the file.",
                where=self.where,
            )


def read_at_most(file: BinaryIO | io.BufferedIOBase, limit: int, expected: int = 0) -> bytes:
    """Return all bytes of a stream, or more than `limit` of its first bytes if it is longer.

    Python allocates the memory for all requested bytes before it reads them. A request of `limit`
    bytes could fail for a small file, where the system limits the memory of a process. So the
    stream is read in parts. `expected` is the number of bytes that it probably has.
    """
    data = file.read(expected + 1)
    if len(data) <= expected:
        return data
    parts = [data]
    while len(parts[-1]) and sum(map(len, parts)) <= limit:
        parts.append(file.read(min(PART, limit + 1)))
    return b"".join(parts)


def read_regular(path: str | Path) -> bytes:
    """Return the bytes of a regular file.

    **Raises** `OSError` with a reason for a folder, a device, a pipe and a file that is larger than
    half of the free memory (or than `--most-memory`).
    """
    # Without O_NONBLOCK the system waits at a pipe until somebody writes to it.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    descriptor = os.open(path, flags)
    try:
        seen = os.fstat(descriptor)
        if stat.S_ISDIR(seen.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(seen.st_mode):
            raise OSError(errno.EINVAL, "it is a device or a pipe and no regular file", str(path))
        asked = _ASKED.get()
        limit = free_bytes() // 2 if asked is None else asked
        with open(descriptor, "rb", closefd=False) as file:
            data = read_at_most(file, limit, seen.st_size) if seen.st_size <= limit else b""
        if max(len(data), seen.st_size) > limit:
            size = f"it is larger than the limit of {limit / 2**30:.3g} GiB; see --most-memory"
            raise OSError(errno.EFBIG, size, str(path))
        return data
    finally:
        os.close(descriptor)


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

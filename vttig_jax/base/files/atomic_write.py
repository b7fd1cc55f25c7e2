"""Atomic write of one file: write a temporary file, sync it to disk, then rename it.

The temporary name is random and the file is created exclusively, so that an existing file or link
of the same name is never opened.
"""

import errno
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import InputError

_NAME_LENGTH = 100
"""Number of characters of the target name in the temporary name, which must stay below 255."""


def temporary_path(target: Path) -> Path:
    """Return a path with a new random name in the folder of `target`, on the same file system."""
    return target.with_name(f"{_prefix(target)}{secrets.token_hex(8)}.tmp")


def remove_abandoned(target: Path) -> None:
    """Remove the temporary files of `target` that killed processes have left.

    The caller holds the lock of `target`, so that no living process uses them.
    """
    name = re.compile(re.escape(_prefix(target)) + r"([0-9a-f]{16}\.)?tmp")
    with suppress(OSError):
        for path in target.parent.iterdir():
            if name.fullmatch(path.name):
                with suppress(OSError):
                    path.unlink()


def _prefix(target: Path) -> str:
    return f".{target.name[:_NAME_LENGTH]}."


def open_new(path: Path) -> int:
    """Create a file and return its descriptor; a file or a link of that name is never opened.

    **Raises** `FileExistsError` for an existing name.
    """
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL
    flags |= getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    return os.open(path, flags, 0o666)  # the mode of any new file; the umask removes its bits


def write_synced(path: Path, data: bytes) -> None:
    """Write a new file and wait until its bytes are on the disk."""
    with os.fdopen(open_new(path), "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def replace_file(target: Path, data: bytes) -> None:
    """Replace the content of a file atomically: a reader finds the old content or the new one."""
    temporary = temporary_path(target)
    try:
        write_synced(temporary, data)
        move(temporary, target)
    except BaseException:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise


def move(temporary: Path, target: Path) -> None:
    """Rename a written file to `target` atomically, and sync the new name to disk."""
    os.replace(temporary, target)
    sync_folder(target.parent)


def sync_folder(folder: Path) -> None:
    """Wait until the entries (file names) of a folder are on the disk."""
    if os.name != "posix":  # other systems cannot sync a folder
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def os_errors_as_input_errors(path: Path) -> Iterator[None]:
    """Convert an `OSError` inside the block into an `InputError` at `path`."""
    try:
        yield
    except OSError as error:
        raise InputError(os_error_message(error), where=str(path)) from error


def os_error_message(error: OSError) -> str:
    """Return the message for an `OSError` of a write, with advice to the user."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "there is no space left to write it; free some space or choose another disk."
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return "there is no permission to write here; choose another folder."
    if error.errno in (errno.ENOTDIR, errno.EEXIST):
        return "a file is in the way of this folder; choose another name."
    if error.errno == errno.EISDIR:
        return "a folder is in the way of this file; choose another name."
    if error.errno == errno.ENOENT:
        return "the folder of this file does not exist; create it first."
    if error.errno == errno.ELOOP:
        return "a link is in the way of a file that is created here; remove it."
    return f"this file cannot be written: {error.strerror}."

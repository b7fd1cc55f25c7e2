"""Atomic write of one file: write a temporary file, sync it to disk, then rename it."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError


def temporary_path(target: Path) -> Path:
    """Return a temporary name in the folder of `target`, so that both are on one file system."""
    return target.with_name(f".{target.name}.tmp")


def write_synced(path: Path, data: bytes) -> None:
    """Write a file and wait until its bytes are on the disk."""
    with open(path, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def move(temporary: Path, target: Path) -> None:
    """Rename a written file to `target` atomically, and sync the new name to disk."""
    os.replace(temporary, target)
    if os.name == "posix":  # other systems cannot sync a folder
        folder = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


@contextmanager
def os_errors_as_input_errors(path: Path) -> Iterator[None]:
    """Convert an `OSError` inside the block into an `InputError` at `path`."""
    try:
        yield
    except OSError as error:
        raise InputError(os_error_message(error), where=str(path)) from error


def os_error_message(error: OSError) -> str:
    """Return the message for an `OSError` of a write, with the cure."""
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
    return f"this file cannot be written: {error.strerror}."

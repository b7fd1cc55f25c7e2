"""One file that is there whole or not at all: written beside its place, synced, moved."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError


def beside(target: Path) -> Path:
    """Temporary name in the folder of `target`, so that the move stays on one file system."""
    return target.with_name(f".{target.name}.tmp")


def write_synced(path: Path, data: bytes) -> None:
    """Write a file and wait until the disk has it."""
    with open(path, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def move(temporary: Path, target: Path) -> None:
    """Give a written file its name, in one step that lasts."""
    os.replace(temporary, target)
    if os.name == "posix":  # only there can a folder be synced, which makes the new name last
        folder = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


@contextmanager
def in_a_sentence(path: Path) -> Iterator[None]:
    """Turn what the operating system refuses into an `InputError` at `path`."""
    try:
        yield
    except OSError as error:
        raise InputError(refusal(error), where=str(path)) from error


def refusal(error: OSError) -> str:
    """Sentence for what the operating system refused, with the cure."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "no space left to write it; free some or choose another disk."
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return "no permission to write here; choose another place."
    if error.errno in (errno.ENOTDIR, errno.EEXIST):
        return "a file is in the way of this folder; choose another name."
    if error.errno == errno.EISDIR:
        return "a folder is in the way of this file; choose another name."
    if error.errno == errno.ENOENT:
        return "the folder to write it to does not exist; make it first."
    return f"cannot be written: {error.strerror}."

"""Files that are written whole or not at all, one or several at once.

One file is written under a random name, synced to disk and renamed. It is created exclusively, so
that an existing file or link of the same name is never opened.

Several files are written into a stage, a folder with a random name inside the target folder. Its
record lists them, and the old files that go. The rename of the stage is the switch: a stage that
has its new name is always finished, its files are moved out of it one after the other, the result
last. After a kill `settle` does that, and removes a stage that still has its first name. So the
folder holds the old result or the new one and never a mixture of both.
"""

import errno
import json
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

from ..errors import InputError, UsageError

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


PREFIX, SWITCHED, RECORD, LOCK = ".new-", ".commit-", ".commit.json", ".lock"


def commit(
    folder: Path, files: Mapping[str, bytes], removed: Iterable[str], result: str | None
) -> None:
    """Write several files into a folder, and remove the old files `removed`, all at once.

    The lock of the folder must be held. Names use `/` for subfolders. `result` is the file that is
    moved last; by default it is the last one of `files`.

    **Raises** `InputError` for an operation that the system refuses. If it fails before the switch,
    the folder is unchanged. After the switch the stage stays for `settle` to finish.
    """
    names = sorted(files, key=lambda name: name == result)
    removed = [name for name in removed if name not in files]
    with os_errors_as_input_errors(folder):
        stage = Path(tempfile.mkdtemp(prefix=PREFIX, dir=folder))  # new, and closed to others
    switched = stage
    try:
        for name, data in files.items():
            with os_errors_as_input_errors(folder / name):
                (stage / name).parent.mkdir(parents=True, exist_ok=True)
                write_synced(stage / name, data)
        if len(names) > 1 or removed:  # otherwise the move is the switch
            with os_errors_as_input_errors(folder):
                record = {"files": names, "removed": removed}
                write_synced(stage / RECORD, json.dumps(record).encode())
                for one in {(stage / name).parent for name in names} | {stage}:
                    sync_folder(one)
            for target in (folder / name for name in names):
                with os_errors_as_input_errors(target):
                    if target.is_dir():
                        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            switched = folder / f"{SWITCHED}{secrets.token_hex(8)}"
            with os_errors_as_input_errors(folder):
                os.rename(stage, switched)
                sync_folder(folder)
        _finish(switched, names, removed)
    finally:
        shutil.rmtree(stage, ignore_errors=True)  # it has this name only if it is not switched


def settle(folder: Path) -> None:
    """Finish or remove the stages of killed processes. The lock of the folder must be held.

    **Raises** `InputError` for an operation that the system refuses.
    """
    for stage in list(_stages(folder)):
        record = _read_record(stage) if stage.name.startswith(SWITCHED) else None
        if record is None:
            shutil.rmtree(stage, ignore_errors=True)
        else:
            _finish(stage, **record)


def settle_if_free(folder: Path) -> None:
    """Call `settle` before a folder is read, if no other process writes to it.

    Nothing happens if this process has no permission to write to the folder.
    """
    if next(_stages(folder), None) is None:
        return
    from filelock import FileLock, Timeout

    with suppress(OSError, Timeout, InputError), FileLock(folder / LOCK).acquire(timeout=0):
        settle(folder)
        (folder / LOCK).unlink()  # removed while locked; a waiting `filelock` detects that


@contextmanager
def locked(lock: Path, what: str) -> Iterator[None]:
    """Hold the file `lock`, and create its folder; it goes again if it is empty at the end.

    **Raises** `UsageError` if another process holds the lock, with `what` it is writing;
    `InputError` for missing permission and a file in the way of the folder.
    """
    from filelock import FileLock, Timeout

    folder, held = lock.parent, FileLock(lock)
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        with os_errors_as_input_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            try:
                held.acquire(timeout=0)
            except Timeout:
                raise UsageError(
                    f"another vttig is writing to {what}; wait for it or choose another one.",
                    where=str(folder),
                ) from None
        yield
    finally:
        if held.is_locked:
            # The file is removed while locked; a waiting `filelock` detects that and retries.
            with suppress(OSError):
                lock.unlink()
            held.release()
        for path in made:
            with suppress(OSError):
                path.rmdir()  # fails, as wanted, for a folder that is not empty


def _stages(folder: Path) -> Iterator[Path]:
    with suppress(OSError):
        for path in folder.iterdir():
            if path.name.startswith((PREFIX, SWITCHED)) and path.is_dir() and not path.is_symlink():
                yield path


def _read_record(stage: Path) -> dict[str, list[str]] | None:
    """Return the record of a stage, or None if it is missing or names files outside the folder."""
    folder = stage.parent
    try:
        found = json.loads((stage / RECORD).read_bytes())
        record = {name: list(found[name]) for name in ("files", "removed")}
        names = [PurePosixPath(name) for named in record.values() for name in named]
        inside = (  # also if the folder contains links
            name.name not in ("", "..")
            and (folder / name).parent.resolve().is_relative_to(folder.resolve())
            for name in names
        )
        return record if all(inside) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _finish(stage: Path, files: Iterable[str], removed: Iterable[str]) -> None:
    """Move the files of a stage that are still in it to their places, and remove the old files."""
    folders = set()
    for name in files:
        staged, target = stage / name, stage.parent / name
        if staged.exists():
            with os_errors_as_input_errors(target):
                target.parent.mkdir(parents=True, exist_ok=True)
                os.replace(staged, target)
            folders.add(target.parent)
    for folder in folders:  # after all moves, so that they follow each other closely
        with os_errors_as_input_errors(folder):
            sync_folder(folder)
    for name in removed:
        target = stage.parent / name
        with os_errors_as_input_errors(target):
            target.unlink(missing_ok=True)
    shutil.rmtree(stage, ignore_errors=True)

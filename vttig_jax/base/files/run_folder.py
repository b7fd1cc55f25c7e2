"""Files that are there whole or not at all: run folders.

Everything is written to a temporary name beside its place, synced to disk and moved with
`os.replace`. Whatever the operating system refuses is an `InputError` of one sentence.
"""

import errno
import hashlib
import os
from collections.abc import Iterable
from contextlib import suppress
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import Any

from ..errors import InputError, UsageError
from .atomic_write import beside
from .atomic_write import in_a_sentence as _in_a_sentence
from .atomic_write import move as _move
from .atomic_write import write_synced as _write_synced

_LOCK = ".lock"
_REFUSED = "already exists; add --overwrite (in Python overwrite=True) or choose another name."


class RunFolder:
    """Writer of one run folder, used as a context manager.

    What is written inside the `with` block appears under its name when the block ends without an
    exception; until then, and after any exception (Ctrl-C too), the folder is as it was. A second
    writer of the same folder is refused.

    **Arguments**
    - `path`: the folder; made, with its parents, where it does not exist.
    - `overwrite`: replace files that exist. The old ones stay intact until all new ones are whole.
    - `results`: names whose presence means that the folder holds a result. They are refused on
      entry rather than at the end of a long run, and moved last.

    **Raises** `UsageError` for an existing file and for a second writer, `InputError` for no space,
    no permission and a path that is no folder.

    **Example**
    ```python
    >>> import tempfile, os
    >>> from vttig_jax.base.files.run_folder import RunFolder
    >>> with tempfile.TemporaryDirectory() as parent:
    ...     with RunFolder(f"{parent}/run", results=("fit.json",)) as run:
    ...         run.write_text("fit.json", "{}")
    ...     os.listdir(f"{parent}/run")
    ['fit.json']

    ```
    """

    def __init__(
        self, path: str | Path, *, overwrite: bool = False, results: tuple[str, ...] = ()
    ) -> None:
        self.path = Path(path)
        self.overwrite = overwrite
        self.results = results
        self._pending: dict[str, Path] = {}
        self._made: list[Path] = []
        self._discarded: list[str] = []
        self._lock: Any = None

    def __enter__(self) -> "RunFolder":
        try:
            with _in_a_sentence(self.path):
                self._make(self.path)
                self._acquire()
            for name in self.results:
                self._refuse_existing(name)
        except BaseException:
            self._leave()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self._commit()
        finally:
            self._leave()

    def write_bytes(self, name: str, data: bytes) -> None:
        """Write a file; `name` is relative to the folder, with `/` for subfolders."""
        parts = PurePosixPath(name)
        if parts.is_absolute() or ".." in parts.parts or not parts.name:
            raise ValueError(
                f"Argument `name` must be a file name inside the run folder, but it is {name!r}."
            )
        if self._lock is None:
            raise ValueError(
                "Argument `name` must be written inside the `with` block of the run folder,"
                f" but {name!r} is not."
            )
        self._refuse_existing(name)
        target = self.path / name
        temporary = beside(target)
        with _in_a_sentence(target):
            self._make(target.parent)
            self._pending[name] = temporary
            _write_synced(temporary, data)

    def discard(self, name: str) -> None:
        """Remove an older file when the block ends well, unless it was written anew."""
        self._discarded.append(name)

    def write_text(self, name: str, text: str) -> None:
        """Write a text file in UTF-8."""
        self.write_bytes(name, text.encode("utf-8"))

    def write_toml(self, name: str, table: dict[str, Any]) -> None:
        """Write a table as TOML, keys in the order given."""
        import tomli_w

        self.write_text(name, tomli_w.dumps(table))

    def write_npz(self, name: str, **arrays: Any) -> None:
        """Write named arrays of numbers or text; arrays of Python objects are a `ValueError`."""
        import numpy as np

        for key, array in arrays.items():
            if np.asarray(array).dtype.hasobject:
                raise ValueError(
                    f"Argument `{key}` must be an array of numbers or text,"
                    " but it holds Python objects."
                )
        buffer = BytesIO()
        np.savez(buffer, allow_pickle=False, **arrays)
        self.write_bytes(name, buffer.getvalue())

    def _make(self, folder: Path) -> None:
        """Make a folder with its parents, and remember which ones were not there."""
        missing = []
        while not folder.exists():
            missing.append(folder)
            folder = folder.parent
        if not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder))
        for new in reversed(missing):
            new.mkdir(exist_ok=True)
            self._made.append(new)

    def _acquire(self) -> None:
        from filelock import FileLock, Timeout

        lock = FileLock(self.path / _LOCK)
        try:
            lock.acquire(timeout=0)
        except Timeout:
            raise UsageError(
                "another vttig is writing to this folder; wait for it or choose another folder.",
                where=str(self.path),
            ) from None
        self._lock = lock

    def _refuse_existing(self, name: str) -> None:
        if not self.overwrite and (self.path / name).exists():
            raise UsageError(_REFUSED, where=str(self.path / name))

    def _commit(self) -> None:
        moved = []
        try:
            for name in sorted(self._pending, key=lambda name: name in self.results):
                target = self.path / name
                moved.append(target)
                with _in_a_sentence(target):
                    _move(self._pending[name], target)
        except BaseException:
            if not self.overwrite:
                # A run that could not finish leaves nothing; nothing of an older one was there.
                for target in moved:
                    target.unlink(missing_ok=True)
            raise
        for name in self._discarded:
            if name not in self._pending:
                with _in_a_sentence(self.path / name):
                    (self.path / name).unlink(missing_ok=True)

    def _leave(self) -> None:
        """Remove what is left of an unfinished run, then let the next writer in."""
        for temporary in self._pending.values():
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
        if self._lock is not None:
            # Unlinked while held: `filelock` sees that a lock it just got guards no name.
            with suppress(OSError):
                (self.path / _LOCK).unlink()
            self._lock.release()
            self._lock = None
        for folder in reversed(self._made):
            with suppress(OSError):
                folder.rmdir()  # succeeds only where nothing was written
        self._pending.clear()
        self._made.clear()


def data_sha256(paths: Iterable[str | Path]) -> list[str]:
    """SHA-256 of each file in hexadecimal, in the order given."""
    digests = []
    for path in paths:
        try:
            with open(path, "rb") as file:
                digests.append(hashlib.file_digest(file, "sha256").hexdigest())
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror}.", where=str(path)) from None
    return digests

"""Run folders: all files of a run appear together or not at all.

Every file is written under a temporary name, synced to disk and renamed with `os.replace`; several
files are committed as one, see `atomic_write`. An `OSError` becomes an `InputError` with a message
of one sentence.
"""

import hashlib
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

from ..errors import InputError, UsageError
from .atomic_write import LOCK, commit, locked, os_errors_as_input_errors, settle
from .limits import kept_bytes, read_regular

_EXISTS = "already exists; add --overwrite (in Python overwrite=True) or choose another name."


class RunFolder:
    """Writer of one run folder, used as a context manager.

    Files written inside the `with` block appear under their names when the block ends without an
    exception. Until then, and after any exception (also Ctrl-C), the folder is unchanged. Only one
    writer at a time can open a folder.

    **Arguments**
    - `path`: the folder; it is created, with its parents, if it does not exist.
    - `overwrite`: replace existing files. The old files stay intact until all new ones are written.
    - `results`: names of the files that mark a finished result. If one exists, the error is raised
      on entry and not at the end of a long run. The rename of the last one switches from the old
      result to the new one.

    **Raises** `UsageError` for an existing file and for a second writer, `InputError` for no space,
    no permission and a path that is not a folder.

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
        self._files: dict[str, bytes] = {}
        self._discarded: list[str] = []
        self._opened = ExitStack()

    def __enter__(self) -> "RunFolder":
        with ExitStack() as stack:
            stack.enter_context(locked(self.path / LOCK, "this folder"))
            with os_errors_as_input_errors(self.path):
                settle(self.path)
            for name in self.results:
                self._refuse_existing(name)
            self._opened = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with self._opened:
            if kind is None and self._files:
                result = self.results[-1] if self.results else None
                commit(self.path, self._files, self._discarded, result)

    def write_bytes(self, name: str, data: bytes) -> None:
        """Write a file; `name` is relative to the folder and uses `/` for subfolders."""
        self._refuse_existing(name)
        self._files[name] = data

    def discard(self, name: str) -> None:
        """Mark an old file: the commit of the new result removes it unless it is written again."""
        self._discarded.append(name)

    def write_text(self, name: str, text: str) -> None:
        """Write a text file in UTF-8."""
        self.write_bytes(name, text.encode("utf-8"))

    def _refuse_existing(self, name: str) -> None:
        if not self.overwrite and (self.path / name).exists():
            raise UsageError(_EXISTS, where=str(self.path / name))


def write_files(files: Mapping[Path, str | bytes], *, overwrite: bool) -> None:
    """Write files of one folder together; the last one is the result that was asked for.

    **Raises** the errors of `RunFolder`.
    """
    *_, asked = files
    with RunFolder(asked.parent, overwrite=overwrite, results=(asked.name,)) as folder:
        for path, content in files.items():
            folder.write_bytes(path.name, content.encode() if isinstance(content, str) else content)


def data_sha256(path: str | Path) -> str:
    """Return the SHA-256 of a file, or that of the names and bytes of all files in a folder."""
    path = Path(path)
    try:
        if not path.is_dir():
            kept = kept_bytes(path)
            return hashlib.sha256(read_regular(path) if kept is None else kept).hexdigest()
        digest = hashlib.sha256()
        for file in sorted(one for one in path.rglob("*") if one.is_file()):
            digest.update(f"{file.relative_to(path).as_posix()}\0".encode())
            with open(file, "rb") as opened:
                digest.update(hashlib.file_digest(opened, "sha256").digest())
        return digest.hexdigest()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}.", where=str(path)) from None

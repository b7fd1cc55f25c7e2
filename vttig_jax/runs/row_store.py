"""Storage of a sweep on disk: one Parquet file per block while it runs, one for all at the end."""

import errno
import json
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ..base.errors import InputError, UsageError
from ..base.files import atomic_write
from ..base.files.atomic_write import os_errors_as_input_errors
from ..base.files.json_io import dumps, read_json
from ..base.logger import LOGGER
from ..control.sweeps.table import Rows

TABLE, PARTS, HEADER = "sweep.parquet", "parts", "sweep.json"
_ROW_GROUP = 1 << 20
_PART = re.compile(r"\d{8}\.parquet")  # name of the file of a block


class FolderNames(NamedTuple):
    """Names for a folder with blocks of rows: noun for messages, file of the table, header file."""

    noun: str = "sweep"
    table: str = TABLE
    header: str = HEADER


def is_complete(folder: Path, header: dict[str, Any], names: FolderNames = FolderNames()) -> bool:
    """Return whether a folder holds the whole table of a header.

    The versions of packages may differ, because a complete table is not continued.
    """
    stored = read_json(folder / names.header)
    asked = json.loads(dumps(header))
    return (
        (folder / names.table).exists()
        and isinstance(stored, dict)
        and all(stored.get(name) == asked[name] for name in asked if name != "versions")
    )


@dataclass(eq=False)
class SweepFolder:
    """Folder of a sweep, or of another table with blocks of rows, used as a context manager.

    Every block is written atomically to its own file, so that `resume` continues with the missing
    blocks after a kill. `header` identifies the sweep; a different sweep is not continued.

    **Raises** `UsageError` for a folder with a sweep without `resume` or `overwrite`, and while
    another process writes to it; `InputError` for a different sweep, a full disk, or missing
    permissions.
    """

    path: Path
    header: dict[str, Any]
    resume: bool = False
    overwrite: bool = False
    names: FolderNames = FolderNames()

    def __post_init__(self) -> None:
        self.header = json.loads(dumps(self.header))
        self._opened = ExitStack()
        self._began = False

    def __enter__(self) -> "SweepFolder":
        with ExitStack() as stack:
            stack.enter_context(atomic_write.locked(self.path / atomic_write.LOCK, "this folder"))
            for target in (self.table, self.path / self.names.header):
                stack.callback(atomic_write.remove_abandoned, target)
            self._begin()
            self._opened = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None and (count := len(self.done)):
            blocks = "1 block" if count == 1 else f"{count} blocks"
            LOGGER.warning("%s keeps %s; continue with --resume", self.path, blocks)
        elif kind is not None:
            if not issubclass(kind, Exception):  # such as Ctrl-C
                LOGGER.warning("%s keeps nothing: no block of rows was finished yet", self.path)
            if self._began:
                shutil.rmtree(self.path / PARTS, ignore_errors=True)
                with suppress(OSError):
                    (self.path / self.names.header).unlink()
        self._opened.close()

    @property
    def table(self) -> Path:
        """Path of the file with all rows."""
        return self.path / self.names.table

    @property
    def done(self) -> set[int]:
        """Numbers of the complete blocks."""
        files = (self.path / PARTS).glob("*.parquet")
        # Programs that synchronise folders add files with names of their own.
        return {int(file.stem) for file in files if _PART.fullmatch(file.name)}

    def write(self, number: int, rows: Rows) -> None:
        """Write a block."""
        target = self._part(number)
        with _os_and_arrow_errors(target):
            buffer = BytesIO()
            table = {name: pa.array(values, from_pandas=True) for name, values in rows.items()}
            pq.write_table(pa.table(table), buffer)  # NaN is null
            atomic_write.replace_file(target, buffer.getvalue())

    def finish(self, blocks: int) -> Rows:
        """Join all blocks in one file, remove the files of the blocks, and return the columns."""
        first = self._read(0)
        temporary = atomic_write.temporary_path(self.table)
        with _os_and_arrow_errors(self.table):
            with open(atomic_write.open_new(temporary), "wb") as file:
                with pq.ParquetWriter(file, first.schema) as writer:
                    for number in range(blocks):
                        writer.write_table(self._read(number), row_group_size=_ROW_GROUP)
                file.flush()
                os.fsync(file.fileno())
            atomic_write.move(temporary, self.table)
            shutil.rmtree(self.path / PARTS, ignore_errors=True)
        return read_table(self.table)

    def _begin(self) -> None:
        """Prepare the folder for writing, or raise an error if it holds a sweep to be kept."""
        header, noun = self.path / self.names.header, self.names.noun
        holds_sweep = self.table.exists() or header.exists()
        if holds_sweep and self.resume:
            self._compare(header)
        elif holds_sweep and not self.overwrite:
            raise UsageError(
                f"holds a {noun}; replace it with --overwrite (in Python overwrite=True) or choose"
                " another folder."
                if self.table.exists()
                else f"holds an unfinished {noun}; continue it with --resume, replace it with"
                " --overwrite (in Python resume=True, overwrite=True) or choose another folder.",
                where=str(self.path),
            )
        else:
            with os_errors_as_input_errors(self.path):
                shutil.rmtree(self.path / PARTS, ignore_errors=True)
                self.table.unlink(missing_ok=True)
                (self.path / PARTS).mkdir()
                atomic_write.replace_file(header, (dumps(self.header) + "\n").encode())
            self._began = True

    def _compare(self, header: Path) -> None:
        """Raise `InputError` if the header in the folder belongs to a different sweep."""
        stored = read_json(header)
        if not isinstance(stored, dict):
            raise InputError(
                f"the header of this {self.names.noun} is damaged; make it again with --overwrite.",
                where=str(header),
            )
        differing = [name for name in self.header if stored.get(name) != self.header[name]]
        if differing:
            raise InputError(
                f"this folder holds another {self.names.noun}: {', '.join(differing)} differ;"
                " repeat the command with its first inputs, or replace it with --overwrite.",
                where=str(header),
            )
        with os_errors_as_input_errors(self.path):
            (self.path / PARTS).mkdir(exist_ok=True)
            for file in (self.path / PARTS).glob(".*.tmp"):
                file.unlink(missing_ok=True)
        damaged = 0
        for number in self.done:
            try:
                self._read(number)
            except InputError:  # it has removed the part
                damaged += 1
        if damaged:
            parts = "1 damaged part is" if damaged == 1 else f"{damaged} damaged parts are"
            LOGGER.warning("%s: %s computed again", self.path, parts)

    def _part(self, number: int) -> Path:
        return self.path / PARTS / f"{number:08d}.parquet"

    def _read(self, number: int) -> Any:
        try:
            return pq.read_table(self._part(number))
        except (OSError, pa.ArrowException) as error:
            with suppress(OSError):
                self._part(number).unlink()
            raise InputError(
                f"this part of the {self.names.noun} is damaged ({type(error).__name__}) and was"
                " removed; run it again with --resume.",
                where=str(self._part(number)),
            ) from None


def read_table(path: Path) -> Rows:
    """Read the columns of a sweep; null becomes NaN."""
    with os_errors_as_input_errors(path):
        table = pq.read_table(path)
    rows: Rows = {}
    for name in table.column_names:
        column = table.column(name)
        text = str(column.type) in ("string", "large_string")
        rows[name] = np.array(column.to_pylist()) if text else column.to_numpy()
    return rows


@contextmanager
def _os_and_arrow_errors(path: Path) -> Iterator[None]:
    """Convert errors as `os_errors_as_input_errors`, and Arrow's full-disk error without errno."""
    with os_errors_as_input_errors(path):
        try:
            yield
        except OSError as error:
            if error.errno is None and "No space" in str(error):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from error
            raise

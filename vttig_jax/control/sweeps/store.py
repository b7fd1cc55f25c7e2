"""A sweep on disk: one Parquet file a block while it runs, one for all when it is done."""

import errno
import json
import logging
import os
import shutil
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import InputError, UsageError
from ...base.files.atomic_write import beside, in_a_sentence, move, write_synced
from ...base.files.json_io import dumps
from .blocks import Rows

_LOGGER = logging.getLogger("vttig_jax")

TABLE, PARTS, HEADER = "sweep.parquet", "parts", "sweep.json"
_LOCK = ".lock"
_ROW_GROUP = 1 << 20


class SweepFolder:
    """Where a sweep is written, used as a context manager.

    Every block is written whole to a file of its own, so that after a kill `resume` goes on with
    the blocks that are missing. `header` says what the sweep is; another one is not continued.

    **Raises** `UsageError` for a folder that holds a sweep, with neither `resume` nor `overwrite`,
    and for a second writer; `InputError` for another sweep, no space, no permission.
    """

    def __init__(
        self, path: Path, header: dict[str, Any], resume: bool = False, overwrite: bool = False
    ) -> None:
        self.path = path
        self.header = json.loads(dumps(header))
        self.resume = resume
        self.overwrite = overwrite
        self._lock: Any = None
        self._began = False
        self._made: list[Path] = []

    def __enter__(self) -> "SweepFolder":
        from filelock import FileLock, Timeout

        with in_a_sentence(self.path):
            self._made = [one for one in (self.path, *self.path.parents) if not one.exists()]
            self.path.mkdir(parents=True, exist_ok=True)
            lock = FileLock(self.path / _LOCK)
            try:
                lock.acquire(timeout=0)
            except Timeout:
                raise UsageError(
                    "another vttig is writing to this folder; wait for it or choose another one.",
                    where=str(self.path),
                ) from None
        self._lock = lock
        try:
            self._begin()
        except BaseException:
            self._leave()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None and self.done:
            _LOGGER.warning("%s keeps %d blocks; go on with --resume", self.path, len(self.done))
        elif kind is not None and self._began:
            if not issubclass(kind, Exception):  # Ctrl-C and its like
                _LOGGER.warning("%s keeps nothing: no block of cases was done yet", self.path)
            self._undo()
        self._leave()

    @property
    def table(self) -> Path:
        """The file of all rows."""
        return self.path / TABLE

    @property
    def done(self) -> set[int]:
        """Blocks that are there, whole."""
        return {int(file.stem) for file in (self.path / PARTS).glob("*.parquet")}

    def write(self, number: int, rows: Rows) -> None:
        """Write a block."""
        import pyarrow.parquet as pq

        target = self._part(number)
        with _in_a_sentence(target):
            buffer = BytesIO()
            pq.write_table(as_arrow(rows), buffer)
            write_synced(beside(target), buffer.getvalue())
            move(beside(target), target)

    def finish(self, blocks: int) -> Rows:
        """Join all blocks in one file, remove them, and return the columns."""
        import pyarrow.parquet as pq

        first = self._read(0)
        temporary = beside(self.table)
        with _in_a_sentence(self.table):
            with pq.ParquetWriter(temporary, first.schema) as writer:
                for number in range(blocks):
                    writer.write_table(self._read(number), row_group_size=_ROW_GROUP)
            with open(temporary, "rb+") as file:
                os.fsync(file.fileno())
            move(temporary, self.table)
            shutil.rmtree(self.path / PARTS, ignore_errors=True)
        return read_table(self.table)

    def _begin(self) -> None:
        """Make the folder ready, or refuse it."""
        header = self.path / HEADER
        there = self.table.exists() or header.exists()
        if there and self.resume:
            if self.table.exists():
                raise UsageError(
                    "this sweep is complete; there is nothing to resume.", where=str(self.table)
                )
            self._compare(header)
        elif there and not self.overwrite:
            raise UsageError(
                "holds a sweep; replace it with --overwrite (in Python overwrite=True) or choose"
                " another folder."
                if self.table.exists()
                else "holds an unfinished sweep; continue it with --resume, replace it with"
                " --overwrite (in Python resume=True, overwrite=True) or choose another folder.",
                where=str(self.path),
            )
        elif self.resume:
            raise UsageError("nothing to resume here; leave out --resume.", where=str(self.path))
        else:
            with in_a_sentence(self.path):
                shutil.rmtree(self.path / PARTS, ignore_errors=True)
                self.table.unlink(missing_ok=True)
                (self.path / PARTS).mkdir()
                write_synced(beside(header), (dumps(self.header) + "\n").encode())
                move(beside(header), header)
            self._began = True

    def _compare(self, header: Path) -> None:
        """Refuse another sweep."""
        try:
            seen = json.loads(header.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            seen = None
        if not isinstance(seen, dict):
            raise InputError(
                "the header of this sweep is damaged; make it anew with --overwrite.",
                where=str(header),
            )
        other = [name for name in self.header if seen.get(name) != self.header[name]]
        if other:
            raise InputError(
                f"this folder holds another sweep: {', '.join(other)} differ; run it as it was"
                " begun, or make it anew with --overwrite.",
                where=str(header),
            )
        with in_a_sentence(self.path):
            (self.path / PARTS).mkdir(exist_ok=True)
            for file in (self.path / PARTS).glob(".*.tmp"):
                file.unlink(missing_ok=True)

    def _part(self, number: int) -> Path:
        return self.path / PARTS / f"{number:08d}.parquet"

    def _read(self, number: int) -> Any:
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            return pq.read_table(self._part(number))
        except (OSError, pa.ArrowException) as error:
            with suppress(OSError):
                self._part(number).unlink()
            raise InputError(
                f"this part of the sweep is damaged ({type(error).__name__}) and was removed; make"
                " it again with --resume.",
                where=str(self._part(number)),
            ) from None

    def _undo(self) -> None:
        """Leave nothing of a sweep that ended before its first block."""
        shutil.rmtree(self.path / PARTS, ignore_errors=True)
        with suppress(OSError):
            (self.path / HEADER).unlink()

    def _leave(self) -> None:
        with suppress(OSError):
            beside(self.table).unlink(missing_ok=True)
        # Unlinked while held: `filelock` sees that a lock it just got guards no name.
        with suppress(OSError):
            (self.path / _LOCK).unlink()
        self._lock.release()
        for folder in self._made:
            with suppress(OSError):
                folder.rmdir()  # succeeds only where nothing was written


class Memory(AbstractContextManager["Memory"]):
    """Where a sweep without a folder keeps its blocks."""

    def __init__(self) -> None:
        self._blocks: dict[int, Rows] = {}

    def __exit__(self, *_: object) -> None:
        self._blocks.clear()

    @property
    def done(self) -> set[int]:
        """None before it begins."""
        return set(self._blocks)

    def write(self, number: int, rows: Rows) -> None:
        """Keep a block."""
        self._blocks[number] = rows

    def finish(self, blocks: int) -> Rows:
        """All blocks one after the other."""
        parts = [self._blocks[number] for number in range(blocks)]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def as_arrow(rows: Rows) -> Any:
    """Columns as a table of Arrow; NaN becomes null."""
    import pyarrow as pa

    return pa.table(
        {
            name: pa.array(
                values.tolist() if values.dtype.kind == "U" else values,
                mask=np.isnan(values) if values.dtype.kind == "f" else None,
            )
            for name, values in rows.items()
        }
    )


def read_table(path: Path) -> Rows:
    """Columns of a sweep; null becomes NaN."""
    import pyarrow.parquet as pq

    with in_a_sentence(path):
        table = pq.read_table(path)
    found: Rows = {}
    for name in table.column_names:
        column = table.column(name)
        text = str(column.type) in ("string", "large_string")
        found[name] = np.array(column.to_pylist()) if text else column.to_numpy()
    return found


@contextmanager
def _in_a_sentence(path: Path) -> Iterator[None]:
    """As `in_a_sentence`, for what Arrow raises without a number too."""
    with in_a_sentence(path):
        try:
            yield
        except OSError as error:
            if error.errno is None and "No space" in str(error):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from error
            raise

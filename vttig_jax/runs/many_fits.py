"""Fits of many log files in one table, written block by block so that it can be resumed."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec

from ..base.errors import UsageError, VttigError
from ..base.files.json_io import dumps
from ..base.files.run_folder import data_sha256
from ..control.sweeps.cluster import run_blocks
from ..control.sweeps.store import FolderNames, Memory, SweepFolder, read_table
from ..identify.many.batches import Shapes
from ..identify.many.fit_many import Unread, fit_columns, settings_table
from ..identify.many.table import Columns, FitTable
from ..identify.settings import FitSettings
from ..logs.encoder_log import EncoderLog
from ..logs.read import read_log
from ..pair.gear_pair import Drive, GearPair
from ..pair.load import load_pair, spec_of
from ..pair.pair_file import spec_table
from .options import ReadingOptions

NAMES = FolderNames("table of fits", "fits.parquet", "fits.json")
"""Files of the folder of `vttig fit-many`."""

_BLOCK = 64  # logs of a block, as many as a call of the compiled programs takes; chosen value

_PACKAGES = ("vttig-jax", "jax", "jaxlib", "numpy", "scipy")


@dataclass(frozen=True, eq=False)
class ManyFits:
    """Task of `vttig fit-many`: files, pair, settings of the fits and of the reading."""

    logs: tuple[Path, ...]
    pair: GearPair | Drive
    settings: FitSettings
    reading: ReadingOptions

    @classmethod
    def of(
        cls, logs: Sequence[Path], pair: Path, settings: FitSettings, reading: ReadingOptions
    ) -> "ManyFits":
        """Read the pair file and check that every log is given once.

        **Raises** `UsageError` for a log that is given twice, `PairError` for the pair file.
        """
        for number, log in enumerate(logs):
            if log in logs[:number]:
                raise UsageError("given twice; give every log once.", where=str(log))
        return cls(tuple(logs), load_pair(pair), settings, reading)

    @property
    def blocks(self) -> int:
        """Number of blocks of logs."""
        return -(-len(self.logs) // _BLOCK)

    def header(self) -> dict[str, Any]:
        """Return digests, settings and versions; a table with the same ones can be continued."""
        return {
            "logs": [str(log) for log in self.logs],
            "sha256": data_sha256(self.logs),
            "pair": spec_table(spec_of(self.pair)),
            "settings": settings_table(self.settings),
            "reading": msgspec.to_builtins(self.reading),
            "block": _BLOCK,
            "versions": {name: version(name) for name in _PACKAGES},
        }

    def columns(
        self, block: int, shapes: Shapes, progress: Callable[[int], None] = lambda logs: None
    ) -> Columns:
        """Read and fit the logs of a block."""
        return fit_columns(
            self._read(self.logs[block * _BLOCK : (block + 1) * _BLOCK]),
            self.pair,
            self.settings,
            orders=self.pair.fit,
            shapes=shapes,
            progress=progress,
        )

    def _read(self, paths: Sequence[Path]) -> Iterator[EncoderLog | Unread]:
        """Yield the logs, named by their paths because many folders hold the same file name."""
        for path in paths:
            try:
                log = read_log(path, self.pair, **self.reading.keywords())
            except VttigError as error:
                yield Unread(str(path), error)
                continue
            yield replace(log, source=str(path))


def fit_files(
    task: ManyFits,
    *,
    out: Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    dask: str | None = None,
    progress: Callable[[int], None] = lambda logs: None,
) -> FitTable:
    """Fit all logs of a task, and write the table to the folder `out` if it is given.

    **Arguments**
    - `resume`: continue with the blocks that are missing in `out`; start where it holds no table,
      and return a complete table as it is. - `overwrite`: start again.
    - `dask`: address of a dask.distributed scheduler whose workers fit the blocks; they must find
      the logs under the same paths.
    - `progress`: called with the number of further logs that are done.

    **Raises** `InputError` for a log that does not exist and for a folder that holds another table,
    `UsageError` for a folder that may not be written.
    """
    header = task.header()
    if resume and out is not None and (done := _finished(task, header, out)) is not None:
        progress(len(task.logs))
        return done
    store = Memory() if out is None else SweepFolder(out, header, resume, overwrite, NAMES)
    shapes = Shapes()
    with store:
        todo = [number for number in range(task.blocks) if number not in store.done]
        progress(len(task.logs) - sum(len(_logs_of(task, number)) for number in todo))
        if dask is None:
            for number in todo:
                store.write(number, task.columns(number, shapes, progress))
        else:
            run_blocks(dask, _on_worker, task, todo, done=store.write, progress=progress)
        columns = store.finish(task.blocks)
    return _table(task, columns, None if out is None else out / NAMES.table)


def _logs_of(task: ManyFits, block: int) -> tuple[Path, ...]:
    return task.logs[block * _BLOCK : (block + 1) * _BLOCK]


def _on_worker(number: int, shared: ManyFits) -> tuple[int, int, Columns]:
    """Fit a block on a worker and return its number, its number of logs and its columns."""
    from ..base.runtime import enable_x64

    enable_x64()
    return number, len(_logs_of(shared, number)), shared.columns(number, Shapes())


def _table(task: ManyFits, columns: Columns, path: Path | None) -> FitTable:
    return FitTable(columns, task.pair.name, settings_table(task.settings), path)


def _finished(task: ManyFits, header: dict[str, Any], out: Path) -> FitTable | None:
    """Return the complete table of this task, or None where there is none or another one."""
    try:
        stored = json.loads((out / NAMES.header).read_text("utf-8"))
    except (OSError, ValueError):
        return None
    asked = json.loads(dumps(header))
    # A complete table is not continued, so that other versions of packages do not matter.
    same = isinstance(stored, dict) and all(
        stored.get(name) == asked[name] for name in asked if name != "versions"
    )
    if not same or not (out / NAMES.table).exists():
        return None
    return _table(task, read_table(out / NAMES.table), out / NAMES.table)

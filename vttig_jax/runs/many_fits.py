"""Fits of many log files in one table.

The table is written block by block, so that an interrupted computation can be continued.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from ..base.errors import InputError, LogError, UsageError, VttigError
from ..base.files.limits import asked_bytes, free_bytes, kept_bytes, most_memory
from ..base.files.run_folder import data_sha256
from ..base.runtime import enable_x64
from ..base.shown_text import name_of_file
from ..base.threads import usable_cores
from ..control.sweeps.sweep import Memory
from ..identify.fit_settings import FitSettings
from ..identify.many.fit_many import Unread, fit_columns, settings_table
from ..identify.many.table import Columns, FitTable
from ..logs.encoder_log import EncoderLog
from ..logs.read import open_log, read_log
from ..logs.recognition.request import DriveRequest, ReadingOptions
from ..pair.gear_pair import Drive, GearPair, pair_from_spec, spec_of
from ..pair.pair_file import spec_table
from ..pair.schema import PairSpec
from .elsewhere import Blocks, run_in_processes, run_on_cluster
from .row_store import FolderNames, SweepFolder, is_complete, read_table
from .stated_drive import require_columns, spec_of_file

if TYPE_CHECKING:
    from ..logs.recognition.candidates import Guess

NAMES = FolderNames("table of fits", "fits.parquet", "fits.json")
"""Name of the result in messages, and names of the files that `vttig fit-many` writes."""

_BLOCK = 16  # logs per block; an interrupt loses at most so many for each process; chosen value

_PROCESS_BYTES = 3 << 29  # free memory for each process; chosen value

_PACKAGES = ("vttig-jax", "jax", "jaxlib", "numpy", "scipy")


@dataclass(frozen=True, eq=False)
class ManyFits:
    """Task of `vttig fit-many`: many logs, all fitted with one pair file and the same settings.

    **Arguments**
    - `logs`: files. - `spec`: content of their pair file. - `settings`: settings of the fits.
    - `reading`: options for reading the logs.
    - `drive`: statements of the user in place of a pair file; the columns of every log are then
      recognised, and a log whose columns differ from those of the first log gets no fit.
    - `guesses`: columns and units that were recognised in the first log without a pair file.
    - `block`: number of logs in a block.
    """

    logs: tuple[Path, ...]
    spec: PairSpec
    settings: FitSettings
    reading: ReadingOptions
    drive: DriveRequest = DriveRequest()
    guesses: "tuple[Guess, ...]" = ()
    block: int = _BLOCK

    @classmethod
    def of(
        cls,
        logs: Sequence[Path],
        pair: Path | None,
        settings: FitSettings,
        reading: ReadingOptions,
        drive: DriveRequest = DriveRequest(),
    ) -> "ManyFits":
        """Make a task from the pair file, or without one from the columns of the first log.

        If the columns of the first log are not recognised, the next log is tried.

        **Raises** `UsageError` for a log that is given twice or a missing ratio, `PairError` for a
        wrong pair file, `LogError` if the columns of no log are recognised.
        """
        for number, log in enumerate(logs):
            if log in logs[:number]:
                raise UsageError("given twice; give every log once.", where=str(log))
        spec = spec_of_file(pair, drive)  # says that the ratio is missing
        if pair is not None:
            return cls(tuple(logs), spec, settings, reading, block=_BLOCK)
        failed: LogError | None = None
        for log in logs:
            try:
                found = open_log(log, drive, reading)
            except LogError as error:
                failed = failed or error
                continue
            guesses = found.roles.guesses
            return cls(tuple(logs), found.spec, settings, reading, drive, guesses, _BLOCK)
        assert failed is not None  # click asks for at least one log
        raise failed

    @property
    def pair(self) -> GearPair | Drive:
        """Gear pair or drive of all logs."""
        return pair_from_spec(self.spec)

    @property
    def blocks(self) -> int:
        """Number of blocks of logs."""
        return -(-len(self.logs) // self.block)

    def logs_of(self, block: int) -> tuple[Path, ...]:
        """Return the logs of block number `block`."""
        return self.logs[block * self.block : (block + 1) * self.block]

    def header(self) -> dict[str, Any]:
        """Return the header of the table: digests of the logs, pair, settings and versions.

        An unfinished table can be continued only by a task with an equal header.
        """
        return {
            "logs": [str(log) for log in self.logs],
            "sha256": _digests(self.logs),
            "pair": spec_table(spec_of(self.pair)),
            "settings": settings_table(self.settings),
            "reading": msgspec.to_builtins(self.reading),
            "block": self.block,
            "versions": {name: version(name) for name in _PACKAGES},
        }

    def columns(self, block: int, **options: Any) -> Columns:
        """Read and fit the logs of block number `block`; return the columns with one row per log.

        `options` are those of `fit_columns`.
        """
        logs = self._read(self.logs_of(block))
        return fit_columns(logs, self.pair, self.settings, self.pair.fit, **options)

    def _read(self, paths: Sequence[Path]) -> Iterator[EncoderLog | Unread]:
        """Yield every log, or an `Unread` with the error for a log that cannot be used.

        The source of a log is its path, because files in different folders may have equal names.
        """
        pair = self.pair
        for path in paths:
            try:
                if self.drive.names_a_drive:
                    opened = open_log(path, self.drive, self.reading)
                    require_columns(opened, self.spec, "the first log")
                    log = opened.log
                else:
                    log = read_log(path, pair, **self.reading.keywords())
            except VttigError as error:
                yield Unread(str(path), error)
                continue
            yield replace(log, source=name_of_file(path))


def fit_files(
    task: ManyFits,
    *,
    out: Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    dask: str | None = None,
    jobs: int | None = None,
    progress: Callable[[int], None] = lambda logs: None,
) -> FitTable:
    """Fit all logs of a task, and write the table to the folder `out` if it is given.

    **Arguments**
    - `resume`: continue with the blocks that are missing in `out`. If `out` holds no table, start
      from the beginning; if it holds the complete table, return that table.
    - `overwrite`: replace the table in `out`.
    - `dask`: address of a dask.distributed scheduler whose workers fit the blocks; they must find
      the logs under the same paths.
    - `jobs`: number of processes of this machine that fit blocks at the same time; by default as
      many as it has cores and 1.5 GiB of free memory. Fewer blocks need fewer processes.
    - `progress`: called with the number of further logs that are done.

    **Raises** `InputError` for a log that does not exist and for a folder that holds another table,
    `UsageError` for a folder that may not be written.
    """
    if out is None and not any(log.exists() or kept_bytes(log) for log in task.logs):
        _digests(task.logs)  # says why none can be read
    header = {} if out is None else task.header()  # for it every log is read once more
    if resume and out is not None and is_complete(out, header, NAMES):
        progress(len(task.logs))
        return _table(task, read_table(out / NAMES.table), out / NAMES.table)
    store = Memory(header) if out is None else SweepFolder(out, header, resume, overwrite, NAMES)
    with store:
        todo = [number for number in range(task.blocks) if number not in store.done]
        progress(len(task.logs) - sum(len(task.logs_of(number)) for number in todo))
        # Not the number of blocks left, so that a table is continued in the way it was begun.
        usual = max(1, min(usable_cores(), free_bytes() // _PROCESS_BYTES))
        processes = min(jobs or usual, task.blocks)
        blocks = Blocks(_in_process, (task, asked_bytes()), todo, store.write, progress)
        if dask is not None:
            run_on_cluster(dask, blocks)
        elif processes > 1:
            run_in_processes(processes, blocks)
        else:
            for number in todo:
                store.write(number, task.columns(number, progress=progress))
        columns = store.finish(task.blocks)
    return _table(task, columns, None if out is None else out / NAMES.table)


def _digests(logs: Sequence[Path]) -> list[str]:
    """Return the SHA-256 of every log, or the reason for a log that cannot be read.

    **Raises** `InputError` if no log can be read.
    """
    digests: list[str] = []
    failed: InputError | None = None
    for log in logs:
        try:
            digests.append(data_sha256(log))
        except InputError as error:
            failed = failed or error
            digests.append(error.message)
    if failed is not None and all(" " in digest for digest in digests):
        raise failed
    return digests


def _in_process(number: int, shared: tuple[ManyFits, int | None]) -> tuple[int, int, Columns]:
    """Fit block `number` in another process; return its number, number of logs, and columns.

    `shared` holds the task and the memory limit that the user asked for.
    """
    enable_x64()
    task, most_memory_bytes = shared
    with most_memory(most_memory_bytes):
        return number, len(task.logs_of(number)), task.columns(number, threads=1)


def _table(task: ManyFits, columns: Columns, path: Path | None) -> FitTable:
    return FitTable(columns, task.pair.name, settings_table(task.settings), path)

"""HDF5 checkpoint files, replaced atomically: a process that is killed leaves a complete file."""

import io
import json
import os
import time
import zlib
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import h5py
import numpy as np

from ...base.errors import InputError, UsageError
from ...base.files.atomic_write import (
    move,
    open_new,
    os_error_message,
    os_errors_as_input_errors,
    remove_abandoned,
    temporary_path,
)
from ...base.files.json_io import dumps
from ...base.files.limits import MemoryBudget
from .ensemble_blocks import Record
from .stop_rule import BURN_IN, Until

FORMAT = "vttig.posterior/1"
SAVE_S = 5.0  # shortest time between two saves, s (chosen)
_WAIT_PER_WRITE = 20.0  # least time between two saves, in durations of one save (chosen)
_ARRAYS = tuple(
    field.name for field in fields(Record) if field.name not in ("steps", "thin")
)  # names of the HDF5 datasets


@dataclass(frozen=True)
class Header:
    """Settings of a run; only a run with equal settings may continue its checkpoint.

    `burn_in` is the fraction of the chains that is discarded, and `laplace_share` the share of the
    proposals that are made around the fit; a continued run uses those of its checkpoint. `pareto_k`
    (shape k̂ of the weights) and `effective` (effective number of draws) have one value per ensemble
    for importance sampling, and are empty for emcee.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    identity: dict[str, Any]
    seed: int
    ensembles: int
    walkers: int
    thin: int
    burn_in: float = BURN_IN
    laplace_share: float = 0.0
    method: Literal["emcee", "importance"] = "emcee"
    pareto_k: tuple[float, ...] = ()
    effective: tuple[float, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Return the header as it is after a round trip through JSON, for comparison."""
        return json.loads(dumps(self))


class Checkpoint:
    """Writer of a checkpoint file, used as a context manager.

    A new version is written to a temporary file, synced and moved over the old one: the file is
    complete at any moment. A second writer is refused.

    **Raises** `UsageError` for an existing file without `resume` or `overwrite` and for a second
    writer; `InputError` for a full disk or missing permission.
    """

    def __init__(self, path: Path, header: Header, *, resume: bool, overwrite: bool):
        self.path = path
        self.header = header
        self.resume = resume
        self.overwrite = overwrite
        self._lock: Any = None
        self._saved: tuple[int, Until] | None = None
        self._failed = False
        self._cost_s = 0.0
        self._last_s = time.monotonic()

    def __enter__(self) -> "Checkpoint":
        from filelock import FileLock, Timeout

        with os_errors_as_input_errors(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            lock = FileLock(self._lock_path)
            try:
                lock.acquire(timeout=0)
            except Timeout:
                raise UsageError(
                    "another vttig is writing this checkpoint; wait for it or choose another name.",
                    where=str(self.path),
                ) from None
        self._lock = lock
        remove_abandoned(self.path)
        if self.path.exists() and not (self.resume or self.overwrite):
            self._release()
            raise UsageError(
                "already exists; continue it with --resume, replace it with --overwrite (in Python"
                " resume=True, overwrite=True) or choose another name.",
                where=str(self.path),
            )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._release()

    @property
    def _lock_path(self) -> Path:
        return self.path.with_name(f".{self.path.name}.lock")

    def _release(self) -> None:
        remove_abandoned(self.path)
        # Delete the lock file before the release: another process that gets the lock at this moment
        # notices through `filelock` that its file is missing.
        with suppress(OSError):
            self._lock_path.unlink()
        self._lock.release()

    @property
    def is_begun(self) -> bool:
        """Whether this run continues an existing checkpoint file."""
        return self.resume and self.path.exists()

    def load(self) -> Record:
        """Return the record of the file, which must belong to this run.

        **Raises** `InputError` that says what differs, or that the file is damaged.
        """
        stored, record, until = read(self.path)
        self.header = replace(
            self.header, burn_in=stored.burn_in, laplace_share=stored.laplace_share
        )
        differences = list(_differences(stored.as_json(), self.header.as_json()))
        if differences:
            first = "; ".join(differences[:3])
            more = f"; and {len(differences) - 3} more" if len(differences) > 3 else ""
            raise InputError(
                f"this checkpoint belongs to another run: {first}{more}; repeat the settings of"
                " that run, or replace the file with --overwrite.",
                where=str(self.path),
            )
        self._saved = record.steps, until
        return record

    def due(self) -> bool:
        """Return whether a save is due: every 5 s, less often if writing is slow."""
        return time.monotonic() - self._last_s >= max(SAVE_S, _WAIT_PER_WRITE * self._cost_s)

    def save(self, record: Record, until: Until) -> None:
        """Write the record unless the file already holds it or an earlier attempt failed."""
        if self._failed or record.steps == 0 or self._saved == (record.steps, until):
            return
        began = time.monotonic()
        temporary = temporary_path(self.path)
        try:
            _write(temporary, self.header, record, until)
            move(temporary, self.path)
        except OSError as error:
            self._failed = True
            raise InputError(
                f"{os_error_message(error)[:-1]}; {self._recovery_hint()}.", where=str(self.path)
            ) from (error)
        self._saved = record.steps, until
        self._last_s = time.monotonic()
        self._cost_s = self._last_s - began

    def _recovery_hint(self) -> str:
        if self._saved is not None:
            return f"the checkpoint of step {self._saved[0]} is complete, continue with --resume"
        older = self.path.exists()
        return "the older file is unchanged" if older else "no checkpoint was written before"


def read(path: Path) -> tuple[Header, Record, Until]:
    """Return header, record and stop rule of a checkpoint, and check that it is complete.

    **Raises** `InputError` for a file that is damaged or no checkpoint.
    """
    try:
        # The file itself needs no lock: it is replaced, never changed.
        with h5py.File(path, "r", locking=False) as file:
            if file.attrs.get("format") != FORMAT:
                raise ValueError(f"its format is not {FORMAT}")
            text = file["header"][()].decode("utf-8")  # type: ignore[index, union-attr]
            budget = MemoryBudget(str(path), path.stat().st_size)
            for name in _ARRAYS:
                budget.take(int(np.asarray(file[name].nbytes)))  # type: ignore[union-attr]
            arrays = {name: np.asarray(file[name]) for name in _ARRAYS}
            if _checksum(text, arrays) != int(np.asarray(file.attrs["crc32"])):
                raise ValueError("its checksum does not match")
        content = json.loads(text)
        steps, until = content.pop("steps"), Until(**content.pop("until"))
        for name in ("names", "units", "pareto_k", "effective"):
            content[name] = tuple(content.get(name, ()))
        header = Header(**content)
        return header, Record(steps=steps, thin=header.thin, **arrays), until
    except InputError:
        raise
    except PermissionError:
        raise InputError("there is no permission to read it.", where=str(path)) from None
    except FileNotFoundError:
        raise InputError("this checkpoint does not exist.", where=str(path)) from None
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"this is no complete checkpoint of vttig ({reason}); replace it with `vttig sample"
            " --overwrite`.",
            where=str(path),
        ) from None


def _write(path: Path, header: Header, record: Record, until: Until) -> None:
    """Write a checkpoint to the new temporary file `path` and sync it to the disk."""
    text = dumps(header.as_json() | {"steps": record.steps, "until": until})
    arrays = {name: getattr(record, name) for name in _ARRAYS}
    with open(open_new(path), "wb+", buffering=0) as raw:
        disk = _ErrorRecordingFile(raw)
        with h5py.File(disk, "w") as file:
            file.attrs["format"] = FORMAT
            file.attrs["crc32"] = _checksum(text, arrays)
            file["header"] = np.bytes_(text.encode("utf-8"))
            for name, array in arrays.items():
                dataset = file.create_dataset(name, array.shape, array.dtype)
                for index, part in enumerate(array):  # one ensemble is contiguous, the whole is not
                    if part.size:
                        dataset[index] = part
        if disk.error is not None:
            raise disk.error
        os.fsync(raw.fileno())


class _ErrorRecordingFile(io.RawIOBase):
    """File for HDF5 that records the first write error instead of raising it.

    HDF5 cannot close a file whose last writes fail. With this class it continues as if they had
    succeeded, and the caller reads `error`.
    """

    def __init__(self, raw: io.FileIO):
        self._raw = raw
        self.error: OSError | None = None

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._raw.seek(offset, whence)

    def tell(self) -> int:
        return self._raw.tell()

    def readinto(self, buffer: Any) -> int:
        return self._raw.readinto(buffer) or 0

    def truncate(self, size: int | None = None) -> int:
        return self._try(lambda: self._raw.truncate(size), 0)

    def write(self, data: Any) -> int:
        return self._try(lambda: self._write_fully(memoryview(data).cast("B")), len(data))

    def flush(self) -> None:
        """Do nothing: the file is unbuffered."""

    def _write_fully(self, data: memoryview) -> int:
        done = 0
        while done < len(data):  # the system may write only a part
            done += self._raw.write(data[done:]) or 0
        return done

    def _try(self, action: Any, otherwise: int) -> int:
        if self.error is None:
            try:
                return action()
            except OSError as error:
                self.error = error
        return otherwise


def _checksum(text: str, arrays: dict[str, np.ndarray]) -> int:
    value = zlib.crc32(text.encode("utf-8"))
    for name in _ARRAYS:
        value = zlib.crc32(f"{name}{arrays[name].shape}{arrays[name].dtype}".encode(), value)
        for part in arrays[name]:
            value = zlib.crc32(np.ascontiguousarray(part).reshape(-1).data, value)
    return value


def _differences(stored: Any, expected: Any, place: str = "") -> Any:
    """Yield a clause on each difference between two JSON values, in the order of `stored`.

    `place` is the path of the values in the whole JSON object.
    """
    if isinstance(stored, dict) and isinstance(expected, dict):
        for key in [*stored, *(key for key in expected if key not in stored)]:
            inner = f"{place}.{key}" if place else key
            if key not in stored:
                yield f"`{inner}` is missing, {_shortened(expected[key])} expected"
            elif key not in expected:
                yield f"`{inner}` is {_shortened(stored[key])}, not expected"
            else:
                yield from _differences(stored[key], expected[key], inner)
    elif isinstance(stored, list) and isinstance(expected, list) and len(stored) == len(expected):
        for index, (item, expected_item) in enumerate(zip(stored, expected, strict=True)):
            yield from _differences(item, expected_item, f"{place}[{index}]")
    elif stored != expected:
        yield f"`{place}` is {_shortened(stored)}, {_shortened(expected)} expected"


def _shortened(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}…"

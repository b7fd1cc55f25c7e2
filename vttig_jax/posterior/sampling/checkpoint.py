"""Checkpoints that survive a kill at any moment: one HDF5 file, replaced whole. No pickles."""

import io
import json
import os
import time
import zlib
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from types import TracebackType
from typing import Any

import h5py
import numpy as np

from ...base.errors import InputError, UsageError
from ...base.files.atomic_write import beside, in_a_sentence, move, refusal
from ...base.files.json_io import dumps
from .ensemble_blocks import Record
from .stop_rule import Until

FORMAT = "vttig.posterior/1"
SAVE_S = 5.0
_SHARE = 20.0  # writing takes at most 1/20 of the time
_ARRAYS = tuple(
    field.name for field in fields(Record) if field.name not in ("steps", "thin")
)  # one dataset each


@dataclass(frozen=True)
class Header:
    """What a run is: a checkpoint is continued only by a run that agrees in all of this."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    identity: dict[str, Any]
    seed: int
    ensembles: int
    walkers: int
    thin: int

    def plain(self) -> dict[str, Any]:
        """The header as JSON gives it back, so that two can be compared."""
        return json.loads(dumps(self))


class Checkpoint:
    """The one writer of a checkpoint file, used as a context manager.

    A new generation is written beside the old one, synced and moved over it: at any moment the
    file is a whole generation. A second writer is refused.

    **Raises** `UsageError` for an existing file without `resume` or `overwrite`, for a missing one
    with `resume` and for a second writer; `InputError` for no space and no permission.
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

        if self.resume and not self.path.exists():
            raise UsageError("nothing to resume here; leave out --resume.", where=str(self.path))
        with in_a_sentence(self.path):
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
        if self.path.exists() and not (self.resume or self.overwrite):
            self._leave()
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
        self._leave()

    @property
    def _lock_path(self) -> Path:
        return self.path.with_name(f".{self.path.name}.lock")

    def _leave(self) -> None:
        with suppress(OSError):
            beside(self.path).unlink(missing_ok=True)
        # Unlinked while held: `filelock` sees that a lock it just got guards no name.
        with suppress(OSError):
            self._lock_path.unlink()
        self._lock.release()

    def load(self) -> Record:
        """What the file holds, where it is of this run.

        **Raises** `InputError` saying what differs, or that the file is damaged.
        """
        seen, record, until = read(self.path)
        differences = list(_differences(seen.plain(), self.header.plain()))
        if differences:
            shown = "; ".join(differences[:3])
            rest = f"; and {len(differences) - 3} more" if len(differences) > 3 else ""
            raise InputError(
                f"this checkpoint is of another run: {shown}{rest}; sample as it was made, or make"
                " it anew with --overwrite.",
                where=str(self.path),
            )
        self._saved = record.steps, until
        return record

    def due(self) -> bool:
        """Whether it is time for a new generation: 5 s, more where writing is slow."""
        return time.monotonic() - self._last_s >= max(SAVE_S, _SHARE * self._cost_s)

    def save(self, record: Record, until: Until) -> None:
        """Write a generation, unless the file holds it or an attempt has failed."""
        if self._failed or record.steps == 0 or self._saved == (record.steps, until):
            return
        began = time.monotonic()
        temporary = beside(self.path)
        try:
            _write(temporary, self.header, record, until)
            move(temporary, self.path)
        except OSError as error:
            self._failed = True
            raise InputError(
                f"{refusal(error)[:-1]}; {self._whole()}.", where=str(self.path)
            ) from (error)
        self._saved = record.steps, until
        self._last_s = time.monotonic()
        self._cost_s = self._last_s - began

    def _whole(self) -> str:
        if self._saved is not None:
            return f"the checkpoint of step {self._saved[0]} is whole, go on from it with --resume"
        older = self.path.exists()
        return "the older file is as it was" if older else "no checkpoint was written before"


def read(path: Path) -> tuple[Header, Record, Until]:
    """Read a checkpoint and check that it is whole.

    **Raises** `InputError` for a file that is damaged or no checkpoint.
    """
    try:
        # No locks on the file itself: it is never changed, only replaced.
        with h5py.File(path, "r", locking=False) as file:
            if file.attrs.get("format") != FORMAT:
                raise ValueError(f"its format is not {FORMAT}")
            text = file["header"][()].decode("utf-8")  # type: ignore[index, union-attr]
            arrays = {name: np.asarray(file[name]) for name in _ARRAYS}
            if _checksum(text, arrays) != int(np.asarray(file.attrs["crc32"])):
                raise ValueError("its checksum does not fit")
        content = json.loads(text)
        steps, until = content.pop("steps"), Until(**content.pop("until"))
        for name in ("names", "units"):
            content[name] = tuple(content[name])
        header = Header(**content)
        return header, Record(steps=steps, thin=header.thin, **arrays), until
    except PermissionError:
        raise InputError("no permission to read this checkpoint.", where=str(path)) from None
    except FileNotFoundError:
        raise InputError("no such checkpoint.", where=str(path)) from None
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"no whole checkpoint of vttig ({reason}); make it anew with `vttig sample"
            " --overwrite`.",
            where=str(path),
        ) from None


def _write(path: Path, header: Header, record: Record, until: Until) -> None:
    """Write a generation to a temporary name and wait until the disk has it."""
    text = dumps(header.plain() | {"steps": record.steps, "until": until})
    arrays = {name: getattr(record, name) for name in _ARRAYS}
    with open(path, "wb+", buffering=0) as raw:
        disk = _Disk(raw)
        with h5py.File(disk, "w") as file:
            file.attrs["format"] = FORMAT
            file.attrs["crc32"] = _checksum(text, arrays)
            file["header"] = np.bytes_(text.encode("utf-8"))
            for name, array in arrays.items():
                dataset = file.create_dataset(name, array.shape, array.dtype)
                for index, part in enumerate(array):  # an ensemble is contiguous, all are not
                    if part.size:
                        dataset[index] = part
        if disk.error is not None:
            raise disk.error
        os.fsync(raw.fileno())


class _Disk(io.RawIOBase):
    """A file for HDF5 that remembers the first refusal instead of raising it.

    HDF5 cannot close a file whose last writes fail; it goes on as if they had been done, and the
    caller looks at `error`.
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
        return self._try(lambda: self._all(memoryview(data).cast("B")), len(data))

    def flush(self) -> None:
        """Nothing is buffered."""

    def _all(self, data: memoryview) -> int:
        done = 0
        while done < len(data):  # the system may take a part only
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


def _differences(seen: Any, expected: Any, place: str = "") -> Any:
    """Sentences on where two JSON values differ, in the order of the first."""
    if isinstance(seen, dict) and isinstance(expected, dict):
        for key in [*seen, *(key for key in expected if key not in seen)]:
            inner = f"{place}.{key}" if place else key
            if key not in seen:
                yield f"`{inner}` is missing, {_short(expected[key])} expected"
            elif key not in expected:
                yield f"`{inner}` is {_short(seen[key])}, not expected"
            else:
                yield from _differences(seen[key], expected[key], inner)
    elif isinstance(seen, list) and isinstance(expected, list) and len(seen) == len(expected):
        for index, (one, other) in enumerate(zip(seen, expected, strict=True)):
            yield from _differences(one, other, f"{place}[{index}]")
    elif seen != expected:
        yield f"`{place}` is {_short(seen)}, {_short(expected)} expected"


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}…"

"""Checkpoint file of a sampler: HDF5, replaced atomically, so that a kill leaves a complete file.

emcee's own `HDFBackend` writes into the open file at every step: a process that is killed then may
leave a file that cannot be opened. Here the same content is written beside the old file and moved
over it.
"""

import io
import json
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from jaxtyping import Float, Int, UInt32

from ..base.errors import InputError, UsageError
from ..base.files.atomic_write import locked, os_error_message, remove_abandoned, replace_file
from ..base.files.json_io import dumps
from ..base.files.limits import MemoryBudget
from .until import Until

FORMAT = "vttig.posterior/2"
SAVE_S, SLOWER = 5.0, 20.0
"""Least time between two saves: in s, and in durations of a save."""


@dataclass(frozen=True)
class Header:
    """Settings of a run; only a run with equal settings may continue its checkpoint."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    identity: dict[str, Any]
    seed: int
    ensembles: int
    walkers: int

    def as_json(self) -> dict[str, Any]:
        """Return the header as it is after a round trip through JSON, for comparison."""
        return json.loads(dumps(asdict(self)))


@dataclass(frozen=True)
class StoredSteps:
    """State of several ensembles: every stored step, and their random generators at the last one.

    `accepted` counts proposals of every walker. `keys` and `rest` (position, has_gauss,
    cached_gaussian) are the states of Mersenne twisters.
    """

    draws: Float[np.ndarray, "ensembles stored walkers d"]
    log_density: Float[np.ndarray, "ensembles stored walkers"]
    accepted: Int[np.ndarray, "ensembles walkers"]
    keys: UInt32[np.ndarray, "ensembles 624"]
    rest: Float[np.ndarray, "ensembles 3"]


class Checkpoint:
    """Writer of a checkpoint file, used as a context manager; a second writer is refused.

    **Raises** `UsageError` for an existing file without `resume` or `overwrite` and for a second
    writer; `InputError` for a full disk or missing permission.
    """

    def __init__(self, path: Path, header: Header, *, resume: bool, overwrite: bool):
        self.path, self.header = path, header
        self.resume, self.overwrite = resume, overwrite
        self._stored: tuple[int, Until] | None = None
        self._failed = False
        self._due_s = time.monotonic() + SAVE_S

    def __enter__(self) -> "Checkpoint":
        with ExitStack() as stack:
            lock = self.path.with_name(f".{self.path.name}.lock")
            stack.enter_context(locked(lock, "this checkpoint"))
            stack.callback(remove_abandoned, self.path)
            if self.path.exists() and not (self.resume or self.overwrite):
                raise UsageError(
                    "already exists; continue it with --resume, replace it with --overwrite (in"
                    " Python resume=True, overwrite=True) or choose another name.",
                    where=str(self.path),
                )
            self._opened = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def begun(self) -> StoredSteps | None:
        """Return the record of the file that this run continues; None for a new run.

        **Raises** `InputError` that says what differs, or that the file is damaged.
        """
        if not (self.resume and self.path.exists()):
            return None
        header, record, until = read(self.path)
        differing = _differences(header.as_json(), self.header.as_json())
        if differing:
            raise InputError(
                f"this checkpoint belongs to another run ({'; '.join(differing)}); repeat the"
                " settings of that run, or replace the file with --overwrite.",
                where=str(self.path),
            )
        self._stored = record.draws.shape[1], until
        return record

    def save(self, record: StoredSteps, until: Until, *, if_due: bool = False) -> None:
        """Write the record unless the file holds it already or an earlier attempt failed."""
        now, stored = time.monotonic(), (record.draws.shape[1], until)
        waits = if_due and now < self._due_s
        if self._failed or waits or stored[0] == 0 or self._stored == stored:
            return
        try:
            replace_file(self.path, _bytes(self.header, record, until))
        except OSError as error:
            self._failed = True
            kept = "the older checkpoint is complete, continue it with --resume"
            none = "no checkpoint was written before"
            raise InputError(
                f"{os_error_message(error)[:-1]}; {kept if self.path.exists() else none}.",
                where=str(self.path),
            ) from error
        self._stored = stored
        self._due_s = time.monotonic() + max(SAVE_S, SLOWER * (time.monotonic() - now))


def _bytes(header: Header, record: StoredSteps, until: Until) -> bytes:
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file.attrs["format"] = FORMAT
        text = dumps(header.as_json() | {"until": asdict(until)}).encode()
        file["header"] = np.frombuffer(text, np.uint8)
        for field in fields(record):
            file.create_dataset(field.name, data=getattr(record, field.name), fletcher32=True)
    return buffer.getvalue()


def read(path: Path) -> tuple[Header, StoredSteps, Until]:
    """Return header, record and stop rule of a checkpoint, and check that it is complete.

    **Raises** `InputError` for a file that is damaged or no checkpoint.
    """
    try:
        # The file itself needs no lock: it is replaced, never changed.
        with h5py.File(path, "r", locking=False) as file:
            if file.attrs.get("format") != FORMAT:
                raise ValueError(f"its format is not {FORMAT}")
            budget = MemoryBudget(str(path), path.stat().st_size)
            sets: Any = {name: file[name] for name in ("header", *StoredSteps.__dataclass_fields__)}
            for one in sets.values():
                budget.take(int(one.nbytes))
            arrays = {name: np.asarray(one) for name, one in sets.items()}
        content = json.loads(arrays.pop("header").tobytes())
        until = Until(**content.pop("until"))
        names, units = tuple(content.pop("names")), tuple(content.pop("units"))
        header, record = Header(names, units, **content), StoredSteps(**arrays)
        shape = header.ensembles, record.draws.shape[1], header.walkers, len(names)
        if record.draws.shape != shape or record.log_density.shape != shape[:3]:
            raise ValueError("its draws have another shape than it says")
        return header, record, until
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


def _differences(stored: dict[str, Any], expected: dict[str, Any]) -> list[str]:
    """Return clauses on the values that differ; those of `identity` by their names."""
    found = []
    for key, value in stored.items():
        if key == "identity" and isinstance(value, dict):
            other = expected[key]
            names = sorted(k for k in value.keys() | other.keys() if value.get(k) != other.get(k))
            found += [f"its {name} differ" for name in names]
        elif value != expected[key]:
            found.append(f"{key} {_short(value)} in it, {_short(expected[key])} asked for")
    return found


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}…"

"""Size of a sweep before it starts: lane-steps, and whether memory and disk are sufficient."""

import os
import shutil
from pathlib import Path
from typing import NamedTuple

from ...base.errors import InputError
from ..simulation.case import Case
from ..simulation.metrics import METRICS
from ..simulation.simulate import periods_of
from .batching import LANES
from .blocks import SweepWork

_SAMPLED = 64
"""Number of cases whose run length is examined; a chosen value."""

_CELL = 8  # bytes of a number
_STATE = 3 * 100 * _CELL
"""Memory of a lane, bytes: about a hundred numbers of state, and intermediate results of a step."""

_SHARE = 0.8
"""Largest fraction of the memory and of the free disk space that a sweep may use; chosen."""


class SweepCost(NamedTuple):
    """Numbers of cases and of lane-steps of a sweep, as they are expected."""

    cases: int
    lane_steps: float

    def __str__(self) -> str:
        return f"{self.cases} cases, {self.lane_steps:.3g} lane-steps"


def estimate(work: SweepWork, folder: Path | None) -> SweepCost:
    """Return the size of a sweep, from the lengths of some of its runs.

    **Raises** `InputError` for a sweep that needs more memory or disk than allowed.
    """
    cases = work.cases
    count = len(cases)
    row = _CELL * (2 + len(METRICS) + len(cases.axes))
    rows = count * row
    memory = work.block_size * row + LANES * len(work.runner.devices) * _STATE
    memory += 2 * rows  # the table, and a copy while it is concatenated
    _refuse("memory", memory, _memory(), count, "split an axis into several sweeps")
    if folder is not None:
        _refuse("disk", 2 * rows, _disk(folder), count, "split an axis, or choose another disk")
    numbers = sorted({count * index // _SAMPLED for index in range(_SAMPLED)})
    sampled = [case for case in map(cases.case, numbers) if isinstance(case, Case)]
    steps = [periods_of(case.motion, case.period) * case.substeps for case in sampled]
    return SweepCost(count, count / len(numbers) * sum(steps))


def _refuse(resource: str, needed: int, available: int, count: int, cure: str) -> None:
    if needed > _SHARE * available:
        need, limit = _size(needed), _size(available)
        raise InputError(
            f"{count} cases need {need} of {resource}, but there are {limit}; {cure}.",
            where="sweep",
        )


def _memory() -> int:
    """Return the memory of this machine, bytes."""
    if not hasattr(os, "sysconf"):  # on Windows, where no sweep is refused
        return 1 << 62
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _disk(folder: Path) -> int:
    """Return the free disk space, bytes, at a folder that need not exist yet."""
    while not folder.exists():
        folder = folder.parent
    return shutil.disk_usage(folder).free


def _size(count: int) -> str:
    size = float(count)
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB"

"""Estimate of the cost of a sweep before it starts: lane-steps, time, memory, disk."""

import math
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from ...base.errors import InputError
from ..simulation.case import Case
from ..simulation.metrics import METRICS
from ..simulation.simulate import periods_of
from .batching import LANES, lanes_for
from .blocks import SweepWork

_SAMPLED = 64
"""Number of cases whose run length is examined; a chosen value."""

_CELL = 8  # bytes of a number
_STATE = 3 * 100 * _CELL
"""Memory of a lane, bytes: about a hundred numbers of state, and intermediate results of a step."""

_BUILD_S = 2e-4
"""Time to build a case, s."""

_SHARE = 0.8
"""Largest fraction of the memory and of the free disk space that a sweep may use; chosen."""


@dataclass(frozen=True)
class SweepCost:
    """Estimated cost of a sweep.

    - `cases`, `lane_steps`: numbers of cases and lane-steps. - `run_s`: time to run them, s.
    - `compile_s`: time to compile the missing programs, s.
    - `memory_bytes`, `disk_bytes`: upper limits, bytes.
    """

    cases: int
    lane_steps: float
    run_s: float
    compile_s: float
    memory_bytes: int
    disk_bytes: int

    def __str__(self) -> str:
        disk = f", {_size(self.disk_bytes)} on disk" if self.disk_bytes else ""
        time = _time(self.run_s + self.compile_s)
        return (
            f"{self.cases} cases, {self.lane_steps:.3g} lane-steps: about {time},"
            f" {_size(self.memory_bytes)} of memory{disk}"
        )


def estimate(work: SweepWork, folder: Path | None) -> SweepCost:
    """Estimate the cost from some cases and a few compiled calls.

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
    lengths = [periods_of(case) * case.substeps for case in sampled]
    steps = count / len(numbers) * sum(lengths)
    # Every lane of a batch, filled or not, runs as long as the longest case of the batch.
    group = min(count, work.block_size) / cases.text_combinations
    lanes = lanes_for(math.ceil(group), len(work.runner.devices))
    calls = cases.text_combinations * work.blocks * math.ceil(group / lanes)
    longest = max(lengths, default=0) if group <= lanes else sum(lengths) / max(len(lengths), 1)
    compiled = work.runner.compile_s
    rounds = math.ceil(calls / len(work.runner.devices))
    run_s = rounds * lanes * longest * work.seconds_per_lane_step(lanes) + count * _BUILD_S
    compile_s = (cases.text_combinations - 1) * (work.runner.compile_s - compiled)
    return SweepCost(
        cases=count,
        lane_steps=steps,
        run_s=run_s,
        compile_s=compile_s,
        memory_bytes=memory,
        disk_bytes=2 * rows if folder else 0,
    )


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


def _time(seconds: float) -> str:
    for unit, length in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.3g} {unit}"
    return f"{seconds:.2g} s"

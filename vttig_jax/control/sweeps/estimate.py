"""What a sweep will take, before it starts: lane-steps, time, memory, disk."""

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
"""Cases whose length is looked at."""

_CELL = 8
_STATE = 3 * 100 * _CELL
"""bytes of a lane's state: some hundred numbers, and what a step makes of them."""

_BUILD_S = 2e-4
"""To build a case."""

_SHARE = 0.8
"""Of the memory and the disk there are that a sweep may take."""


@dataclass(frozen=True)
class SweepCost:
    """What a sweep will take.

    - `cases`, `lane_steps`: how many. - `run_s`: time to run them.
    - `compile_s`: time to compile the programs that are not yet.
    - `memory_bytes`, `disk_bytes`: at most.
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
    """Look at some cases, and run one compiled call.

    **Raises** `InputError` for a sweep that is larger than memory or disk.
    """
    cases = work.cases
    count = len(cases)
    row = _CELL * (2 + len(METRICS) + len(cases.axes))
    rows = count * row
    memory = work.block * row + LANES * len(work.lanes.devices) * _STATE
    memory += 2 * rows  # the table, and a copy while it is put together
    _refuse("memory", memory, _memory(), count, "split an axis into several sweeps")
    if folder is not None:
        _refuse("disk", 2 * rows, _disk(folder), count, "split an axis, or choose another disk")
    places = sorted({count * place // _SAMPLED for place in range(_SAMPLED)})
    sampled = [case for case in map(cases.case, places) if isinstance(case, Case)]
    lengths = [periods_of(case) * case.substeps for case in sampled]
    steps = count / len(places) * sum(lengths)
    # Lanes wait for the longest run beside them, and are filled up; cases take time to build.
    wanted = min(count, work.block) / cases.kinds
    lanes = lanes_for(math.ceil(wanted), len(work.lanes.devices))
    calls = cases.kinds * work.blocks * math.ceil(wanted / lanes)
    longest = max(lengths, default=0) if wanted <= lanes else sum(lengths) / max(len(lengths), 1)
    compiled = work.lanes.compile_s
    run_s = calls * lanes * longest * work.trial(lanes) + count * _BUILD_S
    compile_s = (cases.kinds - 1) * (work.lanes.compile_s - compiled)
    return SweepCost(count, steps, run_s, compile_s, memory, 2 * rows if folder else 0)


def _refuse(what: str, needed: int, there: int, count: int, cure: str) -> None:
    if needed > _SHARE * there:
        raise InputError(
            f"{count} cases need {_size(needed)} of {what}, but there are {_size(there)}; {cure}.",
            where="sweep",
        )


def _memory() -> int:
    """bytes of memory of this machine."""
    if not hasattr(os, "sysconf"):  # Windows says it elsewhere; nothing is refused there
        return 1 << 62
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _disk(folder: Path) -> int:
    """bytes that are free where a folder is, or will be."""
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

"""Channels of an ASAM MDF file (.mf4, .mdf, .dat of MDF 3), with the time of their group."""

import gc
import io
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ....base.files.limits import MemoryBudget
from .clocked import ClockedColumn
from .declared_sizes import take_mdf
from .mdf_links import check_links
from .silence import each_silent

_SAMPLE = 16  # bytes of a sample and its time stamp


def mdf_columns(path: Path, data: bytes) -> Iterator[ClockedColumn]:
    """Yield every channel of a file under the name `Channel [unit]`.

    A repeated name is preceded by its group: `group 2/Channel [unit]`.
    Damaged bytes raise various exceptions of asammdf.
    """
    budget = MemoryBudget(str(path), len(data))
    check_links(data)
    take_mdf(data, budget)
    yield from each_silent(_columns(data, budget), "asammdf")


def _columns(data: bytes, budget: MemoryBudget) -> Generator[ClockedColumn, None, None]:
    from asammdf import MDF

    try:
        with MDF(io.BytesIO(data)) as file:
            yield from _channels(file, budget)
    finally:
        gc.collect()  # runs noisy destructors of half-open files where nobody sees their messages


def _channels(file: Any, budget: MemoryBudget) -> Iterator[ClockedColumn]:
    names: set[str] = set()
    for g, group in enumerate(file.groups):
        master = file.masters_db.get(g)
        for k, channel in enumerate(group.channels):
            if k == master:
                continue
            budget.take(_SAMPLE * group.channel_group.cycles_nr)
            signal = file.get(group=g, index=k)
            if signal.samples.dtype.kind not in "biuf" or signal.samples.ndim != 1:
                continue
            if len(signal.samples) < 2:
                continue
            name = channel.name if channel.name not in names else f"group {g}/{channel.name}"
            names.add(channel.name)
            full = f"{name} [{signal.unit}]" if signal.unit else name
            stamps = None if master is None else np.asarray(signal.timestamps, np.float64)
            yield ClockedColumn(full, signal.samples, stamps)

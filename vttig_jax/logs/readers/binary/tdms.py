"""Channels of a TDMS file of LabVIEW; the time of a waveform is computed from its increment."""

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ....base.errors import LogError
from ....base.files.limits import MemoryBudget
from ..times.seconds import since_first
from .clocked import ClockedColumn
from .silence import silent

_WIDEST = 16  # bytes of a value, for channels of unknown type

UNIT_KEYS = ("unit_string", "NI_UnitDescription", "unit", "units")
"""Properties of a channel that may contain its unit, in order of priority."""


def tdms_columns(path: Path, data: bytes) -> Iterator[ClockedColumn]:
    """Yield every channel of a file under the name `Group/Channel [unit]`.

    **Raises** `LogError` for a file that ends within its data, which nptdms would read without a
    warning. Damaged bytes raise various exceptions of nptdms.
    """
    from nptdms import TdmsFile

    budget = MemoryBudget(str(path), len(data))
    with silent("nptdms"):
        declared = TdmsFile.read_metadata(io.BytesIO(data))
        for channel in (channel for group in declared.groups() for channel in group.channels()):
            budget.take(len(channel) * getattr(channel.dtype, "itemsize", _WIDEST))
        file = TdmsFile.read(io.BytesIO(data))
    if file.file_status.incomplete_final_segment:
        lengths = [len(channel) for group in file.groups() for channel in group.channels()]
        raise LogError(
            f"the file is cut off: its last segment is incomplete, and its channels have"
            f" {min(lengths, default=0)} to {max(lengths, default=0)} samples; export it again.",
            where=str(path),
        )
    for group in file.groups():
        for channel in group.channels():
            values = channel[:]
            if len(values) < 2:
                continue
            name = f"{group.name}/{channel.name}"
            if values.dtype.kind == "M":
                yield ClockedColumn(f"{name} [s]", since_first(values))
                continue
            if values.dtype.kind not in "biuf":
                continue
            unit = next((channel.properties[k] for k in UNIT_KEYS if k in channel.properties), "")
            full = f"{name} [{unit}]" if unit else name
            yield ClockedColumn(full, values, _time(dict(channel.properties), len(values)))


def _time(properties: dict, size: int) -> np.ndarray | None:
    """Return the times of the samples of a waveform in s; None if the channel is no waveform."""
    step = properties.get("wf_increment")
    if not isinstance(step, int | float) or not step > 0:
        return None
    return float(properties.get("wf_start_offset", 0.0)) + step * np.arange(size)

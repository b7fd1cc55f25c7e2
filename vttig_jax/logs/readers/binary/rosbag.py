"""Numeric fields of the messages of a ROS bag: a ROS 2 folder (sqlite or MCAP), .mcap or .bag.

The joints of `sensor_msgs/JointState` are found by name in every message, because their order may
change. The stamp in the header of a message is preferred to the time of its recording.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ....base.files.limits import MemoryBudget
from .bag_sizes import take_bag
from .clocked import ClockedColumn
from .silence import silent

_SAMPLE = 80  # bytes of a stamp and a number as Python objects, with their places in lists

JOINTS = "JointState"
JOINT_FIELDS = {"position": "rad", "velocity": "rad/s", "effort": "Nm"}
"""Arrays of a JointState with one number for each joint, and their units (for a rotary joint)."""

DEEPEST = 4
"""Largest depth of messages within messages that are read (chosen)."""


def rosbag_columns(path: Path, data: bytes) -> Iterator[ClockedColumn]:
    """Yield one column for each numeric field of the messages, with its time stamps.

    The position of a joint is `topic/joint/position [rad]`, any other number `topic/field`.
    Damaged bytes raise various exceptions of rosbags.
    """
    del data  # rosbags reads the file or the folder
    budget = _budget(path)
    with silent("rosbags"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        series: dict[str, tuple[list[int], list[float]]] = {}
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            for connection, recorded_ns, raw in reader.messages():
                message = reader.deserialize(raw, connection.msgtype)
                stamp_ns = _header_ns(message) or recorded_ns
                for name, value in _numbers(connection.topic.strip("/"), message, 0):
                    stamps, values = series.setdefault(name, ([], []))
                    budget.take(_SAMPLE)
                    stamps.append(stamp_ns)
                    values.append(value)
    if not series:
        return
    first = min(stamps[0] for stamps, _ in series.values())
    for name, (stamps, values) in series.items():
        if len(values) > 1:
            seconds = (np.array(stamps, np.int64) - first) / 1e9
            yield ClockedColumn(name, np.array(values), seconds)


def _budget(path: Path) -> MemoryBudget:
    """Return the memory budget of a bag minus the unpacked sizes of its files."""
    files = [one for one in path.rglob("*") if one.is_file()] if path.is_dir() else [path]
    budget = MemoryBudget(str(path), sum(one.stat().st_size for one in files))
    for one in files:
        take_bag(one, budget)
    return budget


def _header_ns(message: Any) -> int:
    """Return the stamp in the header of a message in ns since 1970, or 0 without a stamp."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None:
        return 0
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _numbers(path: str, message: Any, depth: int) -> Iterator[tuple[str, float]]:
    """Yield path and value of every numeric field of a message and of the messages in it."""
    if type(message).__name__.endswith(JOINTS):
        yield from _joints(path, message)
        return
    if depth > DEEPEST:
        return
    for field in getattr(message, "__dataclass_fields__", {}):
        value = getattr(message, field)
        if field in ("header", "stamp") or field.startswith("__"):
            continue
        if isinstance(value, bool | str):
            continue
        if isinstance(value, int | float | np.number):
            yield f"{path}/{field}", value.item() if isinstance(value, np.number) else value
        elif hasattr(value, "__dataclass_fields__"):
            yield from _numbers(f"{path}/{field}", value, depth + 1)


def _joints(path: str, message: Any) -> Iterator[tuple[str, float]]:
    for field, unit in JOINT_FIELDS.items():
        values = getattr(message, field)
        for joint, value in zip(message.name, values, strict=False):
            yield f"{path}/{joint}/{field} [{unit}]", float(value)

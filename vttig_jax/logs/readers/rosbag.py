"""Numeric fields of the messages of a ROS bag: a ROS 2 folder (sqlite or MCAP), .mcap or .bag.

The unpacked sizes of its files are added up first, without unpacking them into memory: every
function adds bytes to a `MemoryBudget`, whose method `take` raises `InputError` beyond its limit.

The joints of `sensor_msgs/JointState` are found by name in every message, because their order may
change. The stamp in the header of a message is preferred to the time of its recording.
"""

import bz2
import sqlite3
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ...base.files.limits import MemoryBudget, read_regular
from .binary import silent
from .table import ClockedColumn
from .text import refuse_larger, unpacked_parts

_MCAP_START, _MCAP_CHUNK = 8, 6  # bytes of the signature, opcode of a chunk (MCAP specification)
_ROS1_MAGIC, _ROS1_CHUNK = b"#ROSBAG V2.0\n", 5  # first line, and opcode of a chunk (bag format 2)
_ZSTD = b"\x28\xb5\x2f\xfd"  # first bytes of a frame (RFC 8878); no plain message begins with them


def take_bag(path: Path, budget: MemoryBudget) -> None:
    """Add the unpacked size of one file of a bag to the budget; other kinds of file add nothing."""
    takes = {".mcap": take_mcap, ".bag": take_ros1, ".zstd": take_frame}
    if path.suffix.lower() == ".db3":
        take_messages(path, budget)
    elif (take := takes.get(path.suffix.lower())) is not None:
        take(read_regular(path), budget)


def take_mcap(data: bytes, budget: MemoryBudget) -> None:
    """Add the unpacked sizes that the chunks of an MCAP file declare to the budget.

    **Raises** `ValueError` for a chunk that unpacks to more than it declares.
    """
    place = _MCAP_START
    while place + 9 <= len(data):
        length = struct.unpack_from("<Q", data, place + 1)[0]
        if data[place] == _MCAP_CHUNK and place + 41 <= len(data):
            declared, _, size = struct.unpack_from("<QII", data, place + 25)
            budget.take(declared)
            begin = place + 41 + size
            kind = data[place + 41 : begin]
            (packed,) = struct.unpack_from("<Q", data, begin) if begin + 8 <= len(data) else (0,)
            _check_chunk(kind, data[begin + 8 : begin + 8 + packed], declared)
        place += 9 + length


def take_ros1(data: bytes, budget: MemoryBudget) -> None:
    """Add the unpacked sizes that the chunks of a bag of ROS 1 declare to the budget.

    A record consists of a header and data, and the length of each precedes it. A header consists of
    fields `name=value`, each preceded by its length. The field `op` is the kind of the record, and
    the field `size` is the unpacked size of a chunk.

    **Raises** `ValueError` for a chunk that unpacks to more than it declares.
    """
    place = len(_ROS1_MAGIC)
    with suppress(struct.error):  # the file ends inside a record; its reader reports the damage
        while place < len(data):
            head = struct.unpack_from("<I", data, place)[0]
            fields = _ros1_fields(data[place + 4 : place + 4 + head])
            place += 4 + head
            length = struct.unpack_from("<I", data, place)[0]
            if fields.get(b"op") == bytes([_ROS1_CHUNK]) and len(fields.get(b"size", b"")) == 4:
                (declared,) = struct.unpack("<I", fields[b"size"])
                budget.take(declared)
                packed = data[place + 4 : place + 4 + length]
                _check_chunk(fields.get(b"compression", b""), packed, declared)
            place += 4 + length


def _ros1_fields(header: bytes) -> dict[bytes, bytes]:
    fields, place = {}, 0
    while place + 4 <= len(header):
        length = struct.unpack_from("<I", header, place)[0]
        name, _, value = header[place + 4 : place + 4 + length].partition(b"=")
        fields[name] = value
        place += 4 + length
    return fields


def _check_chunk(kind: bytes, packed: bytes, declared: int) -> None:
    """Raise `ValueError` for a chunk that unpacks to more than it declares.

    This check is necessary because rosbags unpacks a chunk to its end and ignores the declared
    size.
    """
    unpackers: dict[bytes, Callable[[], Any]] = {
        b"bz2": bz2.BZ2Decompressor,
        b"lz4": lambda: import_module("lz4.frame").LZ4FrameDecompressor(),
        b"zstd": lambda: _zstd().ZstdDecompressor(),
    }
    if kind in unpackers:
        # The reader reports the damage of a chunk.
        with suppress(OSError, RuntimeError, EOFError, _zstd().ZstdError):
            refuse_larger(unpackers[kind](), packed, declared, f"a chunk of {declared} bytes")


def take_messages(path: Path, budget: MemoryBudget) -> None:
    """Add the unpacked sizes of all compressed messages in a bag of ROS 2 in SQLite to the budget.

    A message is compressed if it begins like a frame of Zstandard; other messages add nothing.

    **Raises** `InputError` beyond the limit of the budget, `ValueError` for a table whose rows are
    computed and not stored.
    """
    address = f"{path.resolve().as_uri()}?mode=ro&immutable=1"
    # The reader of the bag reports the damage of a file that is no table of messages.
    with suppress(sqlite3.Error), closing(sqlite3.connect(address, uri=True)) as base:
        with suppress(sqlite3.Error):  # the messages are counted also if a name is damaged
            _require_stored(base)
        for (data,) in base.execute("SELECT data FROM messages"):
            if isinstance(data, bytes) and data.startswith(_ZSTD):
                take_frame(data, budget)


def _require_stored(base: sqlite3.Connection) -> None:
    """Raise `ValueError` for a table that is computed while it is read, for example a view.

    A view can have infinitely many rows, and the values of a computed column can have any size.
    """
    for name, kind, root in base.execute("SELECT name, type, rootpage FROM sqlite_master"):
        if kind == "view" or (kind == "table" and not root):
            raise ValueError(f"`{name}` is no stored table")
    stored = base.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
    for (name,) in stored:
        columns = base.execute("SELECT hidden FROM pragma_table_xinfo(?)", (name,))
        if any(hidden for (hidden,) in columns):
            raise ValueError(f"`{name}` has a computed column")


def take_frame(data: bytes, budget: MemoryBudget) -> None:
    """Unpack a frame of Zstandard part by part and add the size of every part to the budget."""
    zstd = _zstd()
    with suppress(zstd.ZstdError):  # the reader of the bag reports the damage
        for part in unpacked_parts(zstd.ZstdDecompressor(), data):
            budget.take(len(part))


def _zstd() -> Any:
    """Return the Zstandard library that rosbags uses; it is part of Python from 3.14 on."""
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd


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
    files = [one for one in path.rglob("*") if one.is_file()] if path.is_dir() else [path]
    budget = MemoryBudget(str(path), sum(one.stat().st_size for one in files))
    for one in files:
        take_bag(one, budget)
    with silent():
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        series: dict[str, tuple[list[int], list[float]]] = {}
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            for connection, recorded_ns, raw in reader.messages():
                message = reader.deserialize(raw, connection.msgtype)
                stamp = getattr(getattr(message, "header", None), "stamp", None)
                stamp_ns = stamp and int(stamp.sec) * 10**9 + int(stamp.nanosec)
                for name, value in _numbers(connection.topic.strip("/"), message, 0):
                    stamps, values = series.setdefault(name, ([], []))
                    budget.take(_SAMPLE)
                    stamps.append(stamp_ns or recorded_ns)
                    values.append(value)
    if not series:
        return
    first = min(stamps[0] for stamps, _ in series.values())
    for name, (stamps, values) in series.items():
        if len(values) > 1:
            seconds = (np.array(stamps, np.int64) - first) / 1e9
            yield ClockedColumn(name, np.array(values), seconds)


def _numbers(path: str, message: Any, depth: int) -> Iterator[tuple[str, float]]:
    """Yield path and value of every numeric field of a message and of the messages in it."""
    if type(message).__name__.endswith(JOINTS):
        for field, unit in JOINT_FIELDS.items():
            for joint, value in zip(message.name, getattr(message, field), strict=False):
                yield f"{path}/{joint}/{field} [{unit}]", float(value)
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

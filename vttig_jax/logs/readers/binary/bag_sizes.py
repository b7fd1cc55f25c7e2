"""Unpacked sizes of the files of ROS bags, without unpacking them into memory.

Every function adds sizes in bytes to a `MemoryBudget`, whose method `take` raises `InputError`
beyond its limit.
"""

import bz2
import sqlite3
import struct
import sys
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from ....base.files.limits import PART, MemoryBudget, read_regular

_MCAP_START, _MCAP_CHUNK = 8, 6  # bytes of the signature, opcode of a chunk (MCAP specification)
_ROS1_MAGIC, _ROS1_CHUNK = b"#ROSBAG V2.0\n", 5  # first line, and opcode of a chunk (bag format 2)
_ZSTD = b"\x28\xb5\x2f\xfd"  # first bytes of a frame (RFC 8878); no plain message begins with them


def take_bag(path: Path, budget: MemoryBudget) -> None:
    """Add the unpacked size of one file of a bag to the budget; other kinds of file add nothing."""
    match path.suffix.lower():
        case ".mcap":
            take_mcap(read_regular(path), budget)
        case ".bag":
            take_ros1(read_regular(path), budget)
        case ".db3":
            take_messages(path, budget)
        case ".zstd":
            take_frame(read_regular(path), budget)


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
    if kind == b"bz2":
        unpacker: Any = bz2.BZ2Decompressor()
    elif kind == b"lz4":
        from lz4.frame import LZ4FrameDecompressor

        unpacker = LZ4FrameDecompressor()
    elif kind == b"zstd":
        unpacker = _zstd().ZstdDecompressor()
    else:
        return
    unpacked = 0
    with suppress(OSError, RuntimeError, EOFError, _zstd().ZstdError):  # the reader reports damage
        while not unpacker.eof and (packed or not unpacker.needs_input):
            unpacked += len(unpacker.decompress(packed, PART))
            packed = b""
            if unpacked > declared:
                break
    if unpacked > declared:
        raise ValueError(f"a chunk of {declared} bytes unpacks to more")


def take_messages(path: Path, budget: MemoryBudget) -> None:
    """Add the unpacked sizes of all compressed messages in a bag of ROS 2 in SQLite to the budget.

    A message is compressed if it begins like a frame of Zstandard; other messages add nothing.

    **Raises** `InputError` beyond the limit of the budget, `ValueError` for a table whose rows are
    computed and not stored.
    """
    _require_stored(path)
    address = f"{path.resolve().as_uri()}?mode=ro&immutable=1"
    # The reader of the bag reports the damage of a file that is no table of messages.
    with suppress(sqlite3.Error), closing(sqlite3.connect(address, uri=True)) as base:
        for (data,) in base.execute("SELECT data FROM messages"):
            if isinstance(data, bytes) and data.startswith(_ZSTD):
                take_frame(data, budget)


def _require_stored(path: Path) -> None:
    """Raise `ValueError` for a table that is computed while it is read, for example a view.

    A view can have infinitely many rows, and the values of a computed column can have any size.
    """
    address = f"{path.resolve().as_uri()}?mode=ro&immutable=1"
    with suppress(sqlite3.Error), closing(sqlite3.connect(address, uri=True)) as base:
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
    unpacker, packed = zstd.ZstdDecompressor(), data
    with suppress(zstd.ZstdError):  # the reader of the bag reports the damage
        while not unpacker.eof:
            part = unpacker.decompress(packed, PART)
            packed = b""
            budget.take(len(part))
            if not part and unpacker.needs_input:
                return


def _zstd() -> Any:
    """Return the Zstandard library that rosbags uses; it is part of Python from 3.14 on."""
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd

"""Declared or real sizes of packed blocks in binary files, without unpacking them into memory."""

import struct
import zlib
from typing import Any

from ....base.files.limits import PART, MemoryBudget

_DICTIONARY, _BATCH = 2, 3  # kinds of messages in Arrow's `Message.fbs`
_DZ, _DZ_HEAD = b"##DZ", 24  # block of packed data and length of its header (ASAM MDF 4.1)


def take_arrow(stream: Any, budget: MemoryBudget) -> None:
    """Add the unpacked sizes of the buffers of all messages of an Arrow stream to the budget.

    Every packed buffer begins with its unpacked size, and pyarrow allocates this size (Arrow
    columnar format, section "Compression"). `stream` is a `pyarrow.ipc.MessageReader`.
    """
    for message in stream:
        if message.body is None:
            continue
        meta, body = message.metadata.to_pybytes(), memoryview(message.body)
        root = _u32(meta, 0)
        kind_at, header = _field(meta, root, 1), _field(meta, root, 2)
        kind = meta[kind_at] if kind_at else 0
        batch = header + _u32(meta, header)
        if kind == _DICTIONARY:
            inner = _field(meta, batch, 1)
            batch = inner + _u32(meta, inner)
        elif kind != _BATCH:
            budget.take(len(body))
            continue
        packed, buffers = _field(meta, batch, 3), _field(meta, batch, 2)
        start = buffers + _u32(meta, buffers)
        for number in range(_u32(meta, start)):
            place, size = struct.unpack_from("<qq", meta, start + 4 + 16 * number)
            if packed and size >= 8:
                declared = struct.unpack_from("<q", body, place)[0]
                size = max(size, declared)
            budget.take(max(size, 0))


def take_mdf(data: bytes, budget: MemoryBudget) -> None:
    """Add the unpacked sizes of all packed blocks of an MDF 4 file to the budget."""
    place = data.find(_DZ)
    while place >= 0:
        start = place + _DZ_HEAD + 24  # after type, parameter and both sizes
        if len(data) >= start:
            size = struct.unpack_from("<Q", data, start - 8)[0]
            unpacker, packed = zlib.decompressobj(), data[start : start + min(size, len(data))]
            try:
                while packed and not unpacker.eof:
                    budget.take(len(unpacker.decompress(packed, PART)))
                    packed = unpacker.unconsumed_tail
            except zlib.error:  # ##DZ occurs in other data, or the reader reports the damage
                pass
        place = data.find(_DZ, place + 1)


def _u32(data: bytes, place: int) -> int:
    return struct.unpack_from("<I", data, place)[0]


def _field(data: bytes, table: int, slot: int) -> int:
    """Return the byte position of a field of a FlatBuffers table, or 0 if the field is missing."""
    shape = table - struct.unpack_from("<i", data, table)[0]
    if 6 + 2 * slot > struct.unpack_from("<H", data, shape)[0]:
        return 0
    offset = struct.unpack_from("<H", data, shape + 4 + 2 * slot)[0]
    return table + offset if offset else 0

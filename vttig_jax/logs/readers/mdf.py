"""Channels of an ASAM MDF file, after a check of its blocks.

Check of the linked lists of blocks in an MDF file, before asammdf reads the file.

A block contains the addresses of the next block of its list and of the first block of each list
below it. A damaged address can lead back to an earlier block, and asammdf would never stop.

Channels of an ASAM MDF file (.mf4, .mdf, .dat of MDF 3), with the time of their group.
"""

import gc
import io
import struct
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...base.files.limits import MemoryBudget
from .binary import ClockedColumn, each_silent, take_mdf

_HEADER = 64
"""Address (byte position) of the first block in all versions of MDF."""

_LINKS: dict[bytes, tuple[frozenset[bytes], ...]] = {
    b"##HD": tuple(map(frozenset, ([b"##DG"], [b"##FH"], [b"##CH"], [b"##AT"], [b"##EV"]))),
    b"##DG": (frozenset([b"##DG"]), frozenset([b"##CG"])),
    b"##CG": (frozenset([b"##CG"]), frozenset([b"##CN"])),
    b"##CN": (frozenset([b"##CN"]), frozenset([b"##CN", b"##CA"])),
    b"##CA": (frozenset([b"##CN", b"##CA"]),),
    b"##CH": (frozenset([b"##CH"]), frozenset([b"##CH"])),
    b"##FH": (frozenset([b"##FH"]),),
    b"##AT": (frozenset([b"##AT"]),),
    b"##EV": (frozenset([b"##EV"]),),
    b"##DL": (frozenset([b"##DL"]),),
    b"##LD": (frozenset([b"##LD"]),),
}
"""MDF 4: kind of a block → kinds to which its first links lead (ASAM MDF 4.1, chapter 5)."""

_DATA_LINK = 2
"""Index of the link from a data group (DG) to its data, which may be a list."""

_LINKS_3: dict[bytes, tuple[tuple[int, bytes], ...]] = {
    b"HD": ((4, b"DG"),),
    b"DG": ((4, b"DG"), (8, b"CG")),
    b"CG": ((4, b"CG"), (8, b"CN")),
    b"CN": ((4, b"CN"),),
}
"""MDF 3: kind of a block → byte offsets of its links, and the kinds to which they lead."""


def check_links(data: bytes) -> None:
    """Raise `ValueError` for a circular list of blocks or a block of the wrong kind."""
    links = _links_4 if data[_HEADER : _HEADER + 2] == b"##" else _links_3
    open_blocks, done = {_HEADER}, set[int]()
    road = [(_HEADER, links(data, _HEADER))]
    while road:
        place, following = road[-1]
        target = next(following, None)
        if target is None:
            road.pop()
            open_blocks.discard(place)
            done.add(place)
        elif target in open_blocks:
            raise ValueError(f"the block at byte {target} follows itself")
        elif target not in done:
            open_blocks.add(target)
            road.append((target, links(data, target)))


def _links_4(data: bytes, place: int) -> Iterator[int]:
    """Yield the addresses of the blocks to which the block of MDF 4 at byte `place` links."""
    kind = data[place : place + 4]
    if kind not in _LINKS and kind != b"##HL":
        return
    (count,) = struct.unpack_from("<Q", data, place + 16)
    for slot, kinds in enumerate(_LINKS.get(kind, (frozenset([b"##DL", b"##LD"]),))):
        if slot < count:
            yield from _target(data, place + 24 + 8 * slot, kinds)
    if kind == b"##DG" and count > _DATA_LINK:
        yield from _target(data, place + 24 + 8 * _DATA_LINK, None)


def _target(data: bytes, place: int, kinds: frozenset[bytes] | None) -> Iterator[int]:
    (target,) = struct.unpack_from("<Q", data, place)
    if not 0 < target <= len(data) - 24:  # no address, or one that the reader cannot follow
        return
    if kinds is not None and data[target : target + 4] not in kinds:
        raise ValueError(f"a block of the wrong kind at byte {target}")
    yield target


def _links_3(data: bytes, place: int) -> Iterator[int]:
    """Yield the addresses of the blocks to which the block of MDF 3 at byte `place` links."""
    order = ">" if data[24:26] != b"\0\0" else "<"
    for offset, kind in _LINKS_3.get(data[place : place + 2], ()):
        if place + offset + 4 > len(data):
            continue
        (target,) = struct.unpack_from(f"{order}I", data, place + offset)
        if 0 < target < len(data):
            if data[target : target + 2] != kind:
                raise ValueError(f"a block of the wrong kind at byte {target}")
            yield target


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

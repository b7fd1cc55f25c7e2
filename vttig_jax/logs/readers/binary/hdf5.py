"""Reading of the numeric arrays of an HDF5 file, which may be a MATLAB v7.3 file."""

import io
import zlib
from collections.abc import Iterator
from math import prod
from typing import Any

import numpy as np

from ....base.files.limits import LEAST_BYTES, PART, MemoryBudget
from .matlab import DEEPEST, MOST_CELLS

_DEFLATE, _CHECKSUM = 1, 3  # numbers of the filters gzip and fletcher32 of HDF5
_HARMLESS = LEAST_BYTES // 1032  # packed size without a check: deflate packs at most 1032 to 1

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""First bytes of an HDF5 file; in a MATLAB file they follow the header, at byte 512."""


def hdf5_leaves(
    data: bytes, budget: MemoryBudget | None = None
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the name and values of every array of numbers in the bytes of a file.

    Names are `group/array`, and `group/array.field` for fields of a compound. In MATLAB files the
    names are those of `matlab_leaves`, with rows and columns as in MATLAB. Links and data in other
    files are not read. Every group and cell is read only once, even if it contains itself. Damaged
    bytes raise various exceptions of h5py. An array whose declared size exceeds the memory `budget`
    raises `InputError` before it is read.
    """
    import h5py

    with h5py.File(io.BytesIO(data), "r") as file:
        budget = budget or MemoryBudget("the file", len(data))
        yield from _Walk(h5py, file, data.startswith(b"MATLAB"), budget).members(file, "", 0)


def take_dataset(item: Any, budget: MemoryBudget) -> None:
    """Take the memory for reading a data set (its values or its largest chunk) from the budget.

    **Raises** `ValueError` for a chunk that unpacks to more bytes than its declared size, because
    HDF5 would unpack all of it.
    """
    size = item.dtype.itemsize
    room = prod(item.chunks or ()) * size
    budget.take(max(item.size * size, room if item.chunks else 0))
    if not item.chunks:
        return
    plist = item.id.get_create_plist()
    filters = [plist.get_filter(k)[0] for k in range(plist.get_nfilters())]
    if _DEFLATE not in filters:
        return
    if filters.count(_DEFLATE) > 1 or set(filters[filters.index(_DEFLATE) + 1 :]) - {_CHECKSUM}:
        raise ValueError(f"unusual filters {filters}")

    def check(about: Any) -> None:
        if about.size <= _HARMLESS:
            return
        mask, packed = item.id.read_direct_chunk(about.chunk_offset)
        unpacker, unpacked = zlib.decompressobj(), 0
        while packed and not unpacker.eof and not mask:
            unpacked += len(unpacker.decompress(packed, PART))
            packed = unpacker.unconsumed_tail
            if unpacked > room + PART:
                raise ValueError(f"a chunk of {room} bytes unpacks to more than {unpacked}")

    item.id.chunk_iter(check)


class _Walk:
    """Traversal of all groups and arrays of one open file."""

    def __init__(self, h5py: Any, file: Any, matlab: bool, budget: MemoryBudget):
        self.h5py, self.file, self.matlab, self.budget = h5py, file, matlab, budget
        self.seen: set[tuple[int, int]] = set()

    def members(self, group: Any, path: str, depth: int) -> Iterator[tuple[str, np.ndarray]]:
        for name in group:
            hard = isinstance(group.get(name, getlink=True), self.h5py.HardLink)
            if not hard or (self.matlab and name.startswith("#")):  # internal data of MATLAB
                continue
            yield from self.leaves(group[name], path, name, depth)

    def leaves(self, item: Any, path: str, name: str, depth: int) -> Iterator[tuple[str, Any]]:
        """Yield the arrays of the member `name` of the group at `path`."""
        full = f"{path}{'.' if self.matlab else '/'}{name}" if path else name
        if depth > DEEPEST or self._was_entered(item):
            return
        if isinstance(item, self.h5py.Group):
            yield from self.members(item, full, depth + 1)
        if not isinstance(item, self.h5py.Dataset) or item.is_virtual or item.external:
            return
        if self.matlab:
            yield from self.matlab_leaves(item, path, name, full, depth)
        elif item.dtype.kind in "biuf":
            take_dataset(item, self.budget)
            yield full, item[()]
        elif item.dtype.names:
            for field in item.dtype.names:
                if item.dtype[field].kind in "biuf":
                    take_dataset(item, self.budget)
                    yield f"{full}.{field}", item[field]

    def matlab_leaves(
        self, item: Any, path: str, name: str, full: str, depth: int
    ) -> Iterator[tuple[str, Any]]:
        """Yield the arrays of a MATLAB item: data, or references to cells and structs."""
        kind = item.attrs.get("MATLAB_class", b"")
        if {"MATLAB_object_decode", "MATLAB_empty"} & set(item.attrs) or kind == b"char":
            return
        if item.dtype.kind in "biuf":
            take_dataset(item, self.budget)
            yield full, item[()].T
        elif self.h5py.check_ref_dtype(item.dtype) and item.size <= MOST_CELLS:
            for k, reference in enumerate(item[()].T.ravel(order="F"), 1):
                if kind == b"cell":
                    yield from self.leaves(self.file[reference], path, f"{name}{{{k}}}", depth + 1)
                elif path:
                    yield from self.leaves(self.file[reference], f"{path}({k})", name, depth + 1)

    def _was_entered(self, item: Any) -> bool:
        """Return whether a group or an array of references was read before, and mark it as read."""
        if not isinstance(item, self.h5py.Group) and not self.h5py.check_ref_dtype(item.dtype):
            return False
        about = self.h5py.h5o.get_info(item.id)
        place = (int(about.fileno), int(about.addr))
        if place in self.seen:
            return True
        self.seen.add(place)
        return False

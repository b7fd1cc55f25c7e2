"""Reading of the numeric arrays of a MATLAB file (v4 to v7), after a check of its elements.

`scipy.io.loadmat` does not check the type and length in the tag before each element. Damaged tags
make it read outside its buffers and crash the process. It also allocates memory for as many cells,
structs and letters as an element declares.
"""

import io
import struct
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator
from inspect import signature
from math import prod
from typing import Any

import numpy as np

from ....base.files.limits import PART, MemoryBudget

MATRIX, COMPRESSED = 14, 15
FLAGS, SIZE, NAME = {6}, {5, 6}, {1, 16}
COMPLEX = 0x800
CELL, STRUCT, OBJECT, CHAR = 1, 2, 3, 4
NUMBERS = frozenset((1, 2, 3, 4, 5, 6, 7, 9, 12, 13))
TEXT = frozenset((16, 17, 18))
FIRST_NUMERIC_CLASS, LAST_NUMERIC_CLASS, LAST_CLASS = 6, 15, 17

_ITEM, _FIELD, _LETTER = 128, 1024, 4  # rounded memory of a cell, a field and a letter in bytes

Leaves = Iterable[tuple[str, np.ndarray]] | None
"""Paths and values of leaves, or None for a value that holds other values."""

HEADER = 128
"""Number of bytes before the first element; the last two bytes define the byte order."""


def check_tags(data: bytes, budget: MemoryBudget | None = None) -> None:
    """Check the tag (type and length) of every element in the bytes of a MATLAB file.

    **Raises** `ValueError` for an element of unknown type or beyond the end of its container, and
    `InputError` for elements that take more memory than the budget.
    """
    order = "<" if data[HEADER - 2 : HEADER] == b"IM" else ">"
    budget = budget or MemoryBudget("the file", len(data))
    place = HEADER
    while place < len(data):
        kind, start, stop = _element(data, place, len(data), order)
        if kind == MATRIX:
            _check_matrix(data, start, stop, order, budget)
        elif kind == COMPRESSED:
            _check_packed(data[start:stop], order, budget)
        else:
            raise ValueError(f"type {kind} at byte {place}")
        place = stop


def _check_packed(packed: bytes, order: str, budget: MemoryBudget) -> None:
    """Check the array in a compressed element; for an array of numbers only its start is stored."""
    unpacker = zlib.decompressobj()
    kept = [unpacker.decompress(packed, PART)]
    size = len(kept[0])
    budget.take(size)
    plain = _holds_numbers(kept[0], order)
    while not unpacker.eof:
        part = unpacker.decompress(unpacker.unconsumed_tail, PART)
        if not part and not unpacker.eof:
            raise ValueError("a compressed element is cut off")
        budget.take(len(part))
        size += len(part)
        if not plain:
            kept.append(part)
    content = b"".join(kept)
    kind, start, stop = _element(content, 0, size, order)
    if kind != MATRIX:
        raise ValueError(f"type {kind} in a compressed element")
    _check_matrix(content, start, stop, order, budget)


def _holds_numbers(head: bytes, order: str) -> bool:
    """Return whether an element with the start `head` is an array of real numbers.

    All tags of such an array are near its start.
    """
    flags = struct.unpack_from(f"{order}I", head, 16)[0]  # after the tags of array and flags
    return FIRST_NUMERIC_CLASS <= flags & 0xFF <= LAST_NUMERIC_CLASS and not flags & COMPLEX


def _check_matrix(data: bytes, start: int, stop: int, order: str, budget: MemoryBudget) -> None:
    """Check the elements of the array in data[start:stop].

    They are flags, for most classes size and name, and then numbers, text or arrays.
    """
    if start == stop:  # an empty array within a struct
        return
    parts = []
    place = start
    while place < stop:
        kind, begin, end = _element(data, place, stop, order)
        parts.append((kind, begin, end))
        place += 8 + (0 if begin - place == 4 else -(-(end - begin) // 8) * 8)
    kind, begin, end = parts[0]
    if kind not in FLAGS or end - begin != 8:
        raise ValueError(f"no flags at byte {start}")
    flags = struct.unpack_from(f"{order}I", data, begin)[0]
    group = flags & 0xFF
    if not 1 <= group <= LAST_CLASS:
        raise ValueError(f"class {group} at byte {begin}")
    if FIRST_NUMERIC_CLASS <= group <= LAST_NUMERIC_CLASS:
        wanted = (FLAGS, SIZE, NAME, NUMBERS) + (NUMBERS,) * bool(flags & COMPLEX)
        if len(parts) != len(wanted) or any(
            kind not in kinds for (kind, _, _), kinds in zip(parts, wanted, strict=True)
        ):
            raise ValueError(f"no array of numbers at byte {start}")
        return
    if CELL <= group <= CHAR:
        _check_count(data, parts, group, order, budget)
    for kind, begin, end in parts:
        if kind not in NUMBERS | TEXT | {MATRIX}:
            raise ValueError(f"type {kind} at byte {begin}")
        if kind == MATRIX:
            _check_matrix(data, begin, end, order, budget)


def _check_count(
    data: bytes, parts: list[tuple[int, int, int]], group: int, order: str, budget: MemoryBudget
) -> None:
    """Raise `ValueError` for an array that declares another number of cells or fields than it has.

    `parts` are (type, start, end) of its elements, `group` is its class.
    """
    (_, begin, end), rest = parts[1], parts[3:]
    sizes = struct.unpack_from(f"{order}{(end - begin) // 4}i", data, begin)
    count = prod(sizes)
    if min(sizes, default=-1) < 0:
        raise ValueError(f"a size below zero at byte {begin}")
    if group == CHAR:
        budget.take(_LETTER * count)  # SciPy fills missing letters with spaces
        return
    fields = 1
    if group != CELL:
        rest = rest[1:] if group == OBJECT else rest  # the name of the class
        (_, begin, _), (_, first, last), *rest = rest
        fields = (last - first) // max(struct.unpack_from(f"{order}i", data, begin)[0], 1)
        budget.take(_FIELD * fields)
    if len(rest) != count * fields:
        raise ValueError(f"{count * fields} arrays at byte {begin}")
    budget.take(_ITEM * len(rest))


def _element(data: bytes, place: int, stop: int, order: str) -> tuple[int, int, int]:
    """Return the type of the element at byte `place`, and the start and end of its content."""
    if place + 8 > stop:
        raise ValueError(f"no room for an element at byte {place}")
    kind, length = struct.unpack_from(f"{order}II", data, place)
    begin = place + 8
    if kind >> 16:  # a short element, in the last four bytes of its tag
        kind, length, begin = kind & 0xFFFF, kind >> 16, place + 4
        if length > 4:
            raise ValueError(f"a short element of {length} bytes at byte {place}")
    if begin + length > stop:
        raise ValueError(f"an element beyond the end at byte {place}")
    return kind, begin, begin + length


DEEPEST = 16
"""Largest nesting depth of structs and cells that are read (chosen)."""

MOST_CELLS = 1000
"""An array with more cells or structs than this is not read (chosen)."""


def matlab_leaves(
    data: bytes, budget: MemoryBudget | None = None
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the name and values of every array of numbers in the bytes of a file.

    Fields of structs are named `s.f`, of arrays of structs `s(2).f`, and cells `c{2}`. Objects
    (tables, time series, functions), text, complex and sparse arrays are ignored. Damaged bytes
    raise various exceptions of `scipy.io.loadmat`.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadWarning, matfile_version

    if matfile_version(io.BytesIO(data))[0] == 1:  # 0 is v4, which has no tags
        check_tags(data, budget)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MatReadWarning)  # objects share the name "None"
        variables = loadmat(io.BytesIO(data), **_sparse_option(loadmat))
    for name, value in variables.items():
        if not name.startswith("__"):
            yield from leaves(name, value, _numbers)


def _sparse_option(loadmat: Callable[..., dict]) -> dict[str, bool]:
    """Return the argument for sparse arrays that newer versions of SciPy expect, or no argument."""
    return {"spmatrix": False} if "spmatrix" in signature(loadmat).parameters else {}


def _numbers(path: str, value: Any) -> Leaves:
    if type(value) is not np.ndarray:  # objects and functions are subclasses of `ndarray`
        return ()
    return [(path, value)] if value.dtype.kind in "biuf" else None


def leaves(
    path: str,
    value: Any,
    own: Callable[[str, Any], Leaves],
    *,
    lone_cells: bool = True,
    depth: int = 0,
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield path and values of the leaves in nested structs and cells.

    **Arguments**
    - `own`: returns the leaves that a value with this path is itself, or None to look into it.
    - `lone_cells`: whether an array of one cell is named `c{1}` like an array of more, or `c`.
    """
    if depth > DEEPEST:
        return
    found = own(path, value)
    if found is not None:
        yield from found
        return
    inner: list[tuple[str, Any]] = []
    if value.dtype.names and value.size <= MOST_CELLS:
        for k, record in enumerate(value.ravel(order="F"), 1):
            record_path = path if value.size == 1 else f"{path}({k})"
            inner += [(f"{record_path}.{field}", record[field]) for field in value.dtype.names]
    elif value.dtype == object and value.size <= MOST_CELLS:
        numbered = lone_cells or value.size > 1
        for k, cell in enumerate(value.ravel(order="F"), 1):
            inner.append((f"{path}{{{k}}}" if numbered else path, cell))
    for name, item in inner:
        yield from leaves(name, item, own, lone_cells=lone_cells, depth=depth + 1)

"""Whether the elements of a MATLAB file (v5 to v7) are laid out as the format says.

`scipy.io.loadmat` trusts the type and the length in front of each element and ends the whole
process where a damaged one leads it outside its buffers. Compressed elements carry a checksum.
"""

import struct

MATRIX, COMPRESSED = 14, 15
FLAGS, SIZE, NAME = {6}, {5, 6}, {1, 16}
COMPLEX = 0x800
NUMBERS = frozenset((1, 2, 3, 4, 5, 6, 7, 9, 12, 13))
TEXT = frozenset((16, 17, 18))
FIRST_NUMERIC_CLASS, LAST_NUMERIC_CLASS, LAST_CLASS = 6, 15, 17

HEADER = 128
"""Bytes before the first element; the last two tell the byte order."""


def check_tags(data: bytes) -> None:
    """Raise `ValueError` where an element has no type there is, or ends beyond what holds it."""
    order = "<" if data[HEADER - 2 : HEADER] == b"IM" else ">"
    place = HEADER
    while place < len(data):
        kind, start, stop = _element(data, place, len(data), order)
        if kind == MATRIX:
            _check_matrix(data, start, stop, order)
        elif kind != COMPRESSED:
            raise ValueError(f"type {kind} at byte {place}")
        place = stop


def _check_matrix(data: bytes, start: int, stop: int, order: str) -> None:
    """An array: flags, for most classes its size and name, then numbers, text or more arrays."""
    if start == stop:  # how an empty array within a struct is written
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
    for kind, begin, end in parts:
        if kind not in NUMBERS | TEXT | {MATRIX}:
            raise ValueError(f"type {kind} at byte {begin}")
        if kind == MATRIX:
            _check_matrix(data, begin, end, order)


def _element(data: bytes, place: int, stop: int, order: str) -> tuple[int, int, int]:
    """Type of the element at `place`, and where its content begins and ends."""
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

"""Arrays of MATLAB and HDF5 files, and columns of MATLAB tables.

`scipy.io.loadmat` does not check the type and length in the tag before each element of a file of
MATLAB v4 to v7. Damaged tags make it read outside its buffers and crash the process. It also
allocates memory for as many cells, structs and letters as an element declares. So the elements are
checked first. A file of MATLAB v7.3 is an HDF5 file.

Tables, timetables, dates and durations are objects in a separate part of the file, whose bytes are
checked like those of the other variables before the library mat-io reads them.
"""

import io
import struct
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator
from inspect import signature
from math import prod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ...base.errors import UsageError
from ...base.files.limits import LEAST_BYTES, PART, MemoryBudget, kept_bytes
from ...base.logger import LOGGER
from .table import matrix_columns
from .text import library, refuse_larger, unpacked_parts
from .times import since_first

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


def check_tags(data: bytes, budget: MemoryBudget) -> None:
    """Check the tag (type and length) of every element in the bytes of a MATLAB file.

    **Raises** `ValueError` for an element of unknown type or beyond the end of its container, and
    `InputError` for elements that take more memory than the budget.
    """
    order = "<" if data[HEADER - 2 : HEADER] == b"IM" else ">"
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
    parts = unpacked_parts(unpacker, packed)
    kept = [next(parts)]
    size = len(kept[0])
    budget.take(size)
    # All tags of an array of real numbers are near its start, behind those of array and flags.
    flags = struct.unpack_from(f"{order}I", kept[0], 16)[0]
    plain = FIRST_NUMERIC_CLASS <= flags & 0xFF <= LAST_NUMERIC_CLASS and not flags & COMPLEX
    for part in parts:
        budget.take(len(part))
        size += len(part)
        if not plain:
            kept.append(part)
    if not unpacker.eof:
        raise ValueError("a compressed element is cut off")
    content = b"".join(kept)
    kind, start, stop = _element(content, 0, size, order)
    if kind != MATRIX:
        raise ValueError(f"type {kind} in a compressed element")
    _check_matrix(content, start, stop, order, budget)


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
        same = [part[0] in kinds for part, kinds in zip(parts, wanted, strict=False)]
        if len(parts) != len(wanted) or not all(same):
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


def nested_columns(path: Path, data: bytes) -> Iterator[tuple[str, np.ndarray]]:
    """Yield names and columns of the arrays in a MATLAB or HDF5 file; MATLAB v7.3 files are HDF5.

    No code in the file is executed, and no other file is read. Damaged bytes raise various
    exceptions.

    **Raises** `UsageError` for MATLAB tables without the package mat-io, unless the file has plain
    arrays.
    """
    columns: dict[str, np.ndarray] = {}
    take = _take_hdf5 if HDF5_SIGNATURE in (data[:8], data[512:520]) else _take_matlab
    has_objects = take(data, MemoryBudget(str(path), len(data)), columns)
    if has_objects:
        try:
            for name, array in object_leaves(path):
                columns.update(matrix_columns(name, array))
        except UsageError as error:  # tables need a package
            if not columns:
                raise
            LOGGER.warning("%s: they are left out: %s", path, error.message)
    yield from columns.items()


DEEPEST = 16
"""Largest nesting depth of structs and cells that are read (chosen)."""

MOST_CELLS = 1000
"""An array with more cells or structs than this is not read (chosen)."""

WORKSPACE = "__function_workspace__"
"""Name under which SciPy returns the bytes of all objects of a file in format v6 or v7."""


def _take_matlab(data: bytes, budget: MemoryBudget, columns: dict[str, np.ndarray]) -> bool:
    """Add the arrays of numbers in the bytes of a file of MATLAB v4 to v7 to `columns`.

    Fields of structs are named `s.f`, of arrays of structs `s(2).f`, and cells `c{2}`. Text,
    complex and sparse arrays are ignored. Return whether there are objects (tables, time series,
    functions), whose bytes are then checked. Damaged bytes raise various exceptions of
    `scipy.io.loadmat`.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadWarning, matfile_version

    tagged = matfile_version(io.BytesIO(data))[0] == 1  # 0 is v4, which has no tags and no objects
    if tagged:
        check_tags(data, budget)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MatReadWarning)  # objects share the name "None"
        sparse = {"spmatrix": False} if "spmatrix" in signature(loadmat).parameters else {}
        variables = loadmat(io.BytesIO(data), **sparse)  # newer versions of SciPy ask for it
    for variable, value in variables.items():
        if not variable.startswith("__"):
            for name, array in leaves(variable, value, _numbers):
                columns.update(matrix_columns(name, array))
    stored = variables.get(WORKSPACE) if tagged else None
    if stored is not None:
        inner = np.asarray(stored, np.uint8).tobytes()
        # The inner stream has two bytes of version and two of byte order in place of a header.
        check_tags(bytes(HEADER - 2) + inner[2:4] + inner[8:], budget)
    return stored is not None


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
    for k, one in enumerate(value.ravel(order="F") if value.size <= MOST_CELLS else (), 1):
        if value.dtype.names:
            record = path if value.size == 1 else f"{path}({k})"
            inner += [(f"{record}.{field}", one[field]) for field in value.dtype.names]
        elif value.dtype == object:
            inner.append((f"{path}{{{k}}}" if lone_cells or value.size > 1 else path, one))
    for name, item in inner:
        yield from leaves(name, item, own, lone_cells=lone_cells, depth=depth + 1)


_DEFLATE, _CHECKSUM = 1, 3  # numbers of the filters gzip and fletcher32 of HDF5
_HARMLESS = LEAST_BYTES // 1032  # packed size without a check: deflate packs at most 1032 to 1

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""First bytes of an HDF5 file; in a MATLAB file they follow the header, at byte 512."""


_NO_ARRAY = {"MATLAB_object_decode", "MATLAB_empty"}
"""Attributes of what MATLAB stores as an array and is none."""

SUBSYSTEM = "#subsystem#"
"""Name of the group with the objects of a file in format v7.3."""


def _take_hdf5(data: bytes, budget: MemoryBudget, columns: dict[str, np.ndarray]) -> bool:
    """Add the arrays of numbers in the bytes of an HDF5 file to `columns`.

    Return whether there are objects of MATLAB, whose sizes are then checked. Damaged bytes raise
    various exceptions of h5py. An array whose declared size exceeds the memory `budget` raises
    `InputError` before it is read.
    """
    import h5py

    def count(_: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            if item.is_virtual or item.external:
                raise ValueError("data in another file")
            take_dataset(item, budget)

    with h5py.File(io.BytesIO(data), "r") as file:
        for name, array in hdf5_leaves(file, budget, matlab=data.startswith(b"MATLAB")):
            columns.update(matrix_columns(name, array))
        if SUBSYSTEM in file:
            file.visititems(count)
        return SUBSYSTEM in file


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
        if not mask:
            refuse_larger(zlib.decompressobj(), packed, room + PART, f"a chunk of {room} bytes")

    item.id.chunk_iter(check)


def hdf5_leaves(
    file: Any, budget: MemoryBudget, *, matlab: bool
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the name and values of every array of numbers in an open file.

    Names are `group/array`, and `group/array.field` for fields of a compound. In MATLAB files the
    names are those of `leaves`, with rows and columns as in MATLAB. Links and data in other files
    are not read. Every group and cell is read only once, even if it contains itself.
    """
    import h5py

    seen: set[tuple[int, int]] = set()

    def members(group: Any, path: str, depth: int) -> Iterator[tuple[str, np.ndarray]]:
        for name in group:
            hard = isinstance(group.get(name, getlink=True), h5py.HardLink)
            if hard and not (matlab and name.startswith("#")):  # internal data of MATLAB
                yield from arrays(group[name], path, name, depth)

    def arrays(item: Any, path: str, name: str, depth: int) -> Iterator[tuple[str, Any]]:
        """Yield the arrays of the member `name` of the group at `path`."""
        if depth > DEEPEST:
            return
        full = f"{path}{'.' if matlab else '/'}{name}" if path else name
        if isinstance(item, h5py.Group) or h5py.check_ref_dtype(item.dtype):
            about = h5py.h5o.get_info(item.id)  # pyright: ignore
            place = (int(about.fileno), int(about.addr))
            if place in seen:
                return
            seen.add(place)
        if isinstance(item, h5py.Group):
            yield from members(item, full, depth + 1)
        if not isinstance(item, h5py.Dataset) or item.is_virtual or item.external:
            return
        kind = item.attrs.get("MATLAB_class", b"") if matlab else b""
        if matlab and (kind == b"char" or _NO_ARRAY & set(item.attrs)):
            return
        if item.dtype.kind in "biuf":
            take_dataset(item, budget)
            yield full, item[()].T if matlab else item[()]
        elif not matlab:
            for field in item.dtype.names or ():
                if item.dtype[field].kind in "biuf":
                    take_dataset(item, budget)
                    yield f"{full}.{field}", item[field]
        elif h5py.check_ref_dtype(item.dtype) and (item.size or 0) <= MOST_CELLS:
            # References to cells and structs.
            for k, reference in enumerate(item[()].T.ravel(order="F"), 1):
                if kind == b"cell":
                    yield from arrays(file[reference], path, f"{name}{{{k}}}", depth + 1)
                elif path:
                    yield from arrays(file[reference], f"{path}({k})", name, depth + 1)

    yield from members(file, "", 0)


UNIT_KEYS = ("varUnits", "VariableUnits")
"""Names of the attributes with the units of the columns, for a timetable and for a table."""


def object_leaves(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Yield name and values of table columns, dates and durations.

    Dates and durations are converted to seconds since the first value.

    Columns are named `T.column`, and `T.column [unit]` if the table states units. Damaged bytes
    raise various exceptions. **Raises** `UsageError` without the library.
    """
    cure = 'convert the table in MATLAB with `table2struct(T, "ToScalar", true)`'
    matio = library("matio", "tables and other objects of MATLAB", "matlab", str(path), cure)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        variables = _load(matio.load_from_mat, path)
        for name, value in variables.items():
            if not name.startswith("__"):
                yield from leaves(name, value, _objects, lone_cells=False)


def _load(read: Callable[..., dict[str, Any]], path: Path) -> dict[str, Any]:
    """Return the variables of a file; the library opens only files, and no kept bytes."""
    data = kept_bytes(path)
    if data is None:
        return read(str(path), add_table_attrs=True)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "log.mat"
        file.write_bytes(data)
        return read(str(file), add_table_attrs=True)


def _objects(path: str, value: Any) -> Leaves:
    if hasattr(value, "columns") and hasattr(value, "index"):  # a DataFrame of pandas
        return _table(path, value)
    if not isinstance(value, np.ndarray):
        return ()
    return [(f"{path} [s]", since_first(value))] if value.dtype.kind in "mM" else None


def _table(path: str, table: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Yield name and values of the row times of a timetable and of numeric and time columns.

    `table` is a DataFrame.
    """
    if table.index.dtype.kind in "mM":
        yield f"{path}.{table.index.name or 'Time'} [s]", since_first(table.index.to_numpy())
    stated = max((np.ravel(table.attrs.get(key, ())) for key in UNIT_KEYS), key=len)
    for k, column in enumerate(table.columns):
        values = table[column].to_numpy()
        unit = str(stated[k]) if len(stated) == len(table.columns) else ""
        if values.dtype.kind in "mM":
            yield f"{path}.{column} [s]", since_first(values)
        elif values.dtype.kind in "biuf":
            yield f"{path}.{column} [{unit}]" if unit else f"{path}.{column}", values

"""Binary formats: NumPy, Arrow (Parquet, Feather), TDMS and MDF files, and what they share.

The table of a file, whose channels may have separate time stamps; the optional dependency that a
reader needs; and the messages of libraries, which are suppressed. Before a library reads a file,
the sizes that it declares, or that its packed blocks have, are compared with the memory limit.

A block of an MDF file contains the addresses of the next block of its list and of the first block
of each list below it. A damaged address can lead back to an earlier block, and asammdf would never
stop, so that the lists are checked before.
"""

import gc
import hashlib
import io
import logging
import struct
import sys
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, replace
from importlib import import_module
from io import StringIO
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import InputError, LogError, UsageError
from ...base.files.limits import MemoryBudget
from ...base.files.run_folder import data_sha256
from .table import ClockedColumn, Table, matrix_columns, table_of
from .text import library, read_bytes, unpacked_parts
from .times import since_first


@dataclass(frozen=True)
class Format:
    """Binary format.

    **Arguments**
    - `name`: name of the format in messages. - `endings`: its file endings.
    - `reader`: "module:function" that yields columns from the path and the bytes of a file.
    - `needs`: import name of the library; `extra`: extra of vttig-jax that installs it.
    - `note`: note on the time of its channels, "" without a note.
    """

    name: str
    endings: tuple[str, ...]
    reader: str
    needs: str
    extra: str = ""
    note: str = ""


_ARROW = (".parquet", ".pq", ".feather", ".arrow", ".arrows", ".ipc")
_TDMS = "TDMS: the time of a waveform is its increment times the number of the sample"
_MDF = "MDF: every group of channels has its own time stamps"
_ROS = "ROS: stamps are those in the headers of the messages, else those of the recording"
FORMATS = (
    Format("MATLAB or HDF5", (".mat", ".h5", ".hdf5"), "matlab:nested_columns", "numpy"),
    Format("NumPy", (".npy", ".npz"), "binary:numpy_columns", "numpy"),
    Format("Arrow", _ARROW, "binary:arrow_columns", "pyarrow"),
    Format("TDMS", (".tdms",), "binary:tdms_columns", "nptdms", "tdms", _TDMS),
    Format("MDF", (".mf4", ".mdf", ".mf3"), "binary:mdf_columns", "asammdf", "mdf", _MDF),
    Format("ROS", (".mcap", ".bag", ".db3"), "rosbag:rosbag_columns", "rosbags", "ros", _ROS),
)
"""Binary formats."""

BAG = "metadata.yaml"
"""File in the folder of a ROS 2 bag."""


def format_of(path: Path) -> Format | None:
    """Return the binary format of a file or of the folder of a ROS 2 bag, or None."""
    if path.is_dir():
        return FORMATS[-1] if (path / BAG).is_file() else None
    ending = path.suffix.lower()
    return next((one for one in FORMATS if ending in one.endings), None)


def read_binary(path: Path, form: Format) -> Table:
    """Return the columns of a file.

    **Raises** `UsageError` without the library of the format; `LogError` for a missing, damaged or
    unreadable file or one without numbers.
    """
    source = str(path)
    data = b"" if path.is_dir() else read_bytes(path, form.endings)
    digest = data_sha256(path) if path.is_dir() else hashlib.sha256(data).hexdigest()
    module, _, function = form.reader.partition(":")
    library(form.needs, f"{form.name} files", form.extra)
    reader = getattr(import_module(f".{module}", __package__), function)
    try:
        table = table_of(reader(path, data))
    except (InputError, UsageError, MemoryError):
        raise
    except Exception:  # damaged bytes raise various exceptions
        raise LogError(
            f"the file is damaged or no {form.name} file; save it again, or export the log as CSV.",
            where=source,
        ) from None
    if not table.names:
        raise LogError(
            f"the {form.name} file has no array or channel of numbers; save numbers, or export the"
            " log as CSV.",
            where=source,
        )
    notes = (form.note,) if form.note and table.clocks else ()
    return replace(table, source=source, digest=digest, notes=notes)


@contextmanager
def silent() -> Iterator[None]:
    """Suppress warnings, log messages and prints of libraries within a `with` block."""
    hook, disabled = sys.unraisablehook, logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        sys.unraisablehook = lambda _: None  # destructors of half-open files print errors
        with warnings.catch_warnings(), redirect_stderr(StringIO()), redirect_stdout(StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        sys.unraisablehook = hook
        logging.disable(disabled)


def numpy_columns(path: Path, data: bytes) -> Iterator[tuple[str, np.ndarray]]:
    """Yield names and columns; each row or column of a matrix is a separate column.

    Fields of structured arrays are columns too. The array of a .npy file has the name of the file.

    **Raises** `LogError` for arrays of objects, which are pickles, and for headers that declare
    more bytes than the file has; `InputError` beyond the memory limit; `ValueError` and others for
    damaged bytes.
    """
    budget = MemoryBudget(str(path), len(data))
    if path.suffix.lower() == ".npy":
        yield from _columns(path.stem, data, str(path))
        return
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for member in archive.infolist():
            if not member.filename.endswith(".npy"):
                continue
            name = member.filename.removesuffix(".npy")
            budget.take(member.file_size)
            with archive.open(member) as file:  # before all of it is unpacked
                _check_header(file.read(4096), member.file_size, f"{path}: array `{name}`")
            yield from _columns(name, archive.read(member), str(path))


def _columns(name: str, data: bytes, source: str) -> Iterator[tuple[str, np.ndarray]]:
    _check_header(data[:4096], len(data), f"{source}: array `{name}`")
    array = np.load(io.BytesIO(data), allow_pickle=False)
    fields = array.dtype.names
    parts = [(f"{name}.{one}", array[one]) for one in fields] if fields else [(name, array)]
    for full, part in parts:
        if part.dtype.kind == "M":
            yield f"{full} [s]", since_first(part)
        elif part.dtype.kind in "biuf":
            yield from matrix_columns(full, part)


def _check_header(head: bytes, size: int, where: str) -> None:
    """Raise `LogError` for an array of objects or a header that declares too many bytes.

    `size` is the number of bytes of the array file with its header `head`.
    """
    file = io.BytesIO(head)
    version = np.lib.format.read_magic(file)
    form = np.lib.format
    read = form.read_array_header_1_0 if version == (1, 0) else form.read_array_header_2_0
    shape, _, dtype = read(file)
    if dtype.hasobject:
        raise LogError(
            "the array holds Python objects, which only a pickle can store, and pickles are not"
            " read; save numbers.",
            where=where,
        )
    claimed = prod(shape) * dtype.itemsize
    if claimed > size - file.tell():
        raise LogError(
            f"the header claims {claimed} bytes, but {size - file.tell()} follow; the file is cut"
            " off, save it again.",
            where=where,
        )


_WIDEST_TDMS = 16  # bytes of a value, for channels of unknown type

TDMS_UNIT_KEYS = ("unit_string", "NI_UnitDescription", "unit", "units")
"""Properties of a channel that may contain its unit, in order of priority."""


def tdms_columns(path: Path, data: bytes) -> Iterator[ClockedColumn]:
    """Yield every channel of a file under the name `Group/Channel [unit]`.

    **Raises** `LogError` for a file that ends within its data, which nptdms would read without a
    warning. Damaged bytes raise various exceptions of nptdms.
    """
    from nptdms import TdmsFile

    budget = MemoryBudget(str(path), len(data))
    with silent():
        declared = TdmsFile.read_metadata(io.BytesIO(data))
        for channel in (channel for group in declared.groups() for channel in group.channels()):
            budget.take(len(channel) * getattr(channel.dtype, "itemsize", _WIDEST_TDMS))
        file = TdmsFile.read(io.BytesIO(data))
    channels = [(group.name, channel) for group in file.groups() for channel in group.channels()]
    if file.file_status.incomplete_final_segment:
        lengths = [len(channel) for _, channel in channels]
        raise LogError(
            f"the file is cut off: its last segment is incomplete, and its channels have"
            f" {min(lengths, default=0)} to {max(lengths, default=0)} samples; export it again.",
            where=str(path),
        )
    for group, channel in channels:
        name, values = f"{group}/{channel.name}", channel[:]
        if len(values) > 1 and values.dtype.kind == "M":
            yield ClockedColumn(f"{name} [s]", since_first(values))
        elif len(values) > 1 and values.dtype.kind in "biuf":
            own = dict(channel.properties)
            unit = next((own[k] for k in TDMS_UNIT_KEYS if k in own), "")
            time, step = None, own.get("wf_increment")
            if isinstance(step, int | float) and step > 0:  # the channel is a waveform
                time = float(own.get("wf_start_offset", 0.0)) + step * np.arange(len(values))
            yield ClockedColumn(f"{name} [{unit}]" if unit else name, values, time)


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
            packed = data[start : start + min(size, len(data))]
            # ##DZ occurs in other data, or the reader reports the damage.
            with suppress(zlib.error):
                for part in unpacked_parts(zlib.decompressobj(), packed):
                    budget.take(len(part))
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


PARQUET = (".parquet", ".pq")
_WIDEST = 8  # bytes of a number
_MAGIC = 8  # bytes of the signature at the start of an Arrow file, with padding
UNIT_KEYS = (b"unit", b"units", b"unit_string")
"""Keys under which the metadata of a field may contain its unit."""


def arrow_columns(path: Path, data: bytes) -> Iterator[tuple[str, np.ndarray]]:
    """Yield names and columns of numbers and of time stamps; stamps are in s since the first one.

    A unit in the metadata of a field is appended to its name in brackets. Damaged bytes raise
    various exceptions of pyarrow; numbers beyond the memory limit raise `InputError`.
    """
    import pyarrow as pa

    table = _arrow_table(pa, path, data)
    for field, column in zip(table.schema, table.columns, strict=True):
        unit = next((v for k, v in (field.metadata or {}).items() if k.lower() in UNIT_KEYS), b"")
        name = f"{field.name} [{unit.decode('utf-8', 'replace')}]" if unit else field.name
        kinds = pa.types.is_timestamp, pa.types.is_time, pa.types.is_duration
        if any(is_kind(field.type) for is_kind in kinds):
            whole = column.cast(pa.int32() if field.type.bit_width == 32 else pa.int64())
            stamps = whole.fill_null(0).to_numpy().astype(f"timedelta64[{field.type.unit}]")
            missing = whole.is_null().to_numpy(zero_copy_only=False)
            stamps = np.where(missing, np.timedelta64("NaT"), stamps)
            yield f"{field.name} [s]", since_first(stamps)
        elif pa.types.is_integer(field.type) or pa.types.is_floating(field.type):
            yield name, np.asarray(column.to_numpy())
        elif pa.types.is_decimal(field.type):
            yield name, np.asarray(column.cast(pa.float64()).to_numpy())


def _arrow_table(pa: Any, path: Path, data: bytes) -> Any:
    """Return the pyarrow table of a Parquet, Feather or Arrow file."""
    budget = MemoryBudget(str(path), len(data))
    if path.suffix.lower() in PARQUET:
        from pyarrow import parquet

        file = parquet.ParquetFile(io.BytesIO(data))
        meta = file.metadata
        unpacked = sum(meta.row_group(k).total_byte_size for k in range(meta.num_row_groups))
        budget.take(max(_WIDEST * meta.num_rows * meta.num_columns, unpacked))
        return file.read()
    if data[:4] == b"FEA1":
        from pyarrow import feather

        return feather.read_table(io.BytesIO(data))
    # An Arrow file is a stream between signature and footer; the counted messages are those read.
    messages = data[_MAGIC:] if data[:6] == b"ARROW1" else data
    take_arrow(pa.ipc.MessageReader.open_stream(pa.BufferReader(messages)), budget)
    with pa.ipc.open_stream(pa.BufferReader(messages)) as stream:
        return stream.read_all()


_HEADER = 64
"""Address (byte position) of the first block in all versions of MDF."""

_LINKS: dict[bytes, tuple[set[bytes], ...]] = {
    b"##HD": ({b"##DG"}, {b"##FH"}, {b"##CH"}, {b"##AT"}, {b"##EV"}),
    b"##DG": ({b"##DG"}, {b"##CG"}, set()),  # the last link leads to data, perhaps a list of them
    b"##CG": ({b"##CG"}, {b"##CN"}),
    b"##CN": ({b"##CN"}, {b"##CN", b"##CA"}),
    b"##CA": ({b"##CN", b"##CA"},),
    b"##CH": ({b"##CH"}, {b"##CH"}),
    b"##HL": ({b"##DL", b"##LD"},),
    **{kind: ({kind},) for kind in (b"##FH", b"##AT", b"##EV", b"##DL", b"##LD")},
}
"""MDF 4: kind of a block → kinds to which its first links lead (ASAM MDF 4.1, chapter 5); none for
any kind."""

_LINKS_3: dict[bytes, tuple[tuple[int, set[bytes]], ...]] = {
    b"HD": ((4, {b"DG"}),),
    b"DG": ((4, {b"DG"}), (8, {b"CG"})),
    b"CG": ((4, {b"CG"}), (8, {b"CN"})),
    b"CN": ((4, {b"CN"}),),
}
"""MDF 3: kind of a block → byte offsets of its links, and the kinds to which they lead."""


def check_links(data: bytes) -> None:
    """Raise `ValueError` for a circular list of blocks or a block of the wrong kind."""
    open_blocks, done = {_HEADER}, set[int]()
    road = [(_HEADER, _links(data, _HEADER))]
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
            road.append((target, _links(data, target)))


def _links(data: bytes, place: int) -> Iterator[int]:
    """Yield the addresses of the blocks to which the block at byte `place` links.

    An address beyond the data is none, or one that the reader cannot follow.
    """
    if data[_HEADER : _HEADER + 2] == b"##":
        form, size, end = "<Q", 4, len(data) - 23
        links = _LINKS.get(data[place : place + 4], ())
        (count,) = struct.unpack_from("<Q", data, place + 16) if links else (0,)
        places = [(place + 24 + 8 * slot, kinds) for slot, kinds in enumerate(links[:count])]
    else:
        form, size, end = f"{'>' if data[24:26] != bytes(2) else '<'}I", 2, len(data)
        links = _LINKS_3.get(data[place : place + 2], ())
        places = [(place + at, kinds) for at, kinds in links if place + at + 4 <= len(data)]
    for at, kinds in places:
        (target,) = struct.unpack_from(form, data, at)
        if 0 < target < end:
            if kinds and data[target : target + size] not in kinds:
                raise ValueError(f"a block of the wrong kind at byte {target}")
            yield target


_SAMPLE = 16  # bytes of a sample and its time stamp


def mdf_columns(path: Path, data: bytes) -> list[ClockedColumn]:
    """Return every channel of a file under the name `Channel [unit]`.

    A repeated name is preceded by its group: `group 2/Channel [unit]`.
    Damaged bytes raise various exceptions of asammdf.
    """
    from asammdf import MDF

    budget = MemoryBudget(str(path), len(data))
    check_links(data)
    take_mdf(data, budget)
    with silent():
        try:
            with MDF(io.BytesIO(data)) as file:
                return list(_channels(file, budget))
        finally:
            gc.collect()  # runs noisy destructors of half-open files while they are silent


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

"""Small files with large content, and objects that hold themselves."""

import io
import sqlite3
import struct
import zlib
from contextlib import closing

import h5py
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from tests.logs.binary_logs import WRITERS
from vttig_jax.base.errors import InputError
from vttig_jax.base.files.limits import LEAST_BYTES, MemoryBudget, most_memory
from vttig_jax.logs.readers.binary.bag_sizes import take_bag
from vttig_jax.logs.readers.binary.formats import format_of, read_binary
from vttig_jax.logs.readers.open_table import open_table

ROWS = 200_000_000


def arrays(file) -> None:
    for name in ("time_s", "driving_deg"):
        file[name] = np.arange(20.0)


def test_a_declared_size_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "declared.h5"
    with h5py.File(path, "w") as file:
        arrays(file)
        file.create_dataset("huge", (ROWS,), "f8", chunks=(1000,))
    assert path.stat().st_size < 20_000
    with pytest.raises(InputError, match="--most-memory") as caught:
        open_table(path)
    assert caught.value.where == str(path)


def test_the_option_raises_the_limit(tmp_path):
    path = tmp_path / "packed.h5"
    with h5py.File(path, "w") as file:
        arrays(file)
        file.create_dataset("zeros", data=np.zeros(50_000), compression="gzip")
    with most_memory(300_000), pytest.raises(InputError, match="--most-memory"):
        open_table(path)
    assert "zeros" in open_table(path).names


def test_a_group_that_is_linked_to_itself_ends(tmp_path):
    path = tmp_path / "loop.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("g")
        arrays(group)
        for number in range(30):  # 30¹⁶ paths without memory of what was read
            group[f"again{number}"] = group
    assert open_table(path).names == ("g/driving_deg", "g/time_s")


def test_a_cell_that_holds_itself_ends(tmp_path):
    path = tmp_path / "cell.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        arrays(file)
        cell = file.create_dataset("c", (30, 1), h5py.ref_dtype)
        cell.attrs["MATLAB_class"] = np.bytes_("cell")
        cell[:, 0] = [cell.ref] * 30
    head = b"MATLAB 7.3 MAT-file".ljust(512, b" ")
    path.write_bytes(head + path.read_bytes()[512:])
    assert set(open_table(path).names) == {"driving_deg", "time_s"}


def test_a_compressed_element_is_measured_before_it_is_unpacked(tmp_path):
    path = tmp_path / "bomb.mat"
    packed = io.BytesIO()
    deflate = zlib.compressobj(9)
    for _ in range(300):
        packed.write(deflate.compress(bytes(1 << 20)))
    packed.write(deflate.flush())
    header = b"MATLAB 5.0 MAT-file".ljust(124, b" ") + struct.pack("<H", 0x0100) + b"IM"
    content = packed.getvalue()
    path.write_bytes(header + struct.pack("<II", 15, len(content)) + content)
    assert path.stat().st_size < 500_000
    with pytest.raises(InputError, match="--most-memory"):
        open_table(path)


def read(path):
    form = format_of(path)
    assert form is not None
    return read_binary(path, form)[0]


@pytest.mark.parametrize(
    ("suffix", "packed"),
    [(".feather", True), (".arrow", True), (".parquet", True), (".mf4", True), (".tdms", False)],
)
def test_binary_files_are_measured_before_they_are_read(tmp_path, suffix, packed):
    for needed in {".mf4": ["asammdf"], ".tdms": ["nptdms"]}.get(suffix, []):
        pytest.importorskip(needed)
    size = 400_000
    columns = {"time_s": np.arange(size) * 0.01, "driving_deg": np.zeros(size)}
    path = tmp_path / f"log{suffix}"
    path.write_bytes(_zeros(suffix, columns))
    assert not packed or 3 * path.stat().st_size < 16 * size
    with most_memory(16 * size - 1), pytest.raises(InputError, match="--most-memory"):
        read(path)
    with most_memory(100 * size):
        assert {len(one) for one in read(path).arrays} == {size}


def _zeros(suffix: str, columns) -> bytes:
    """A file of many equal numbers, packed where its format can pack."""
    if suffix == ".arrow":
        table, file = pa.table(columns), io.BytesIO()
        options = pa.ipc.IpcWriteOptions(compression="zstd")
        with pa.ipc.new_stream(file, table.schema, options=options) as writer:
            writer.write_table(table)
        return file.getvalue()
    if suffix == ".parquet":
        file = io.BytesIO()
        parquet.write_table(pa.table(columns), file, use_dictionary=False, compression="zstd")
        return file.getvalue()
    return WRITERS[suffix](columns)


def test_a_chunk_of_a_bag_declares_its_size(tmp_path):
    head = b"\x89MCAP0\r\n"
    chunk = struct.pack("<QQQI", 0, 0, 1 << 40, 0) + struct.pack("<I", 4) + b"zstd"
    path = tmp_path / "log.mcap"
    path.write_bytes(head + bytes([6]) + struct.pack("<Q", len(chunk)) + chunk + head)
    pytest.importorskip("rosbags")
    with pytest.raises(InputError, match="--most-memory"):
        read(path)


def _ros1(declared: int) -> bytes:
    """A bag of ROS 1 with one chunk that declares a size."""
    fields = (b"op=" + bytes([5]), b"compression=bz2", b"size=" + struct.pack("<I", declared))
    header = b"".join(struct.pack("<I", len(one)) + one for one in fields)
    chunk = struct.pack("<I", len(header)) + header + struct.pack("<I", 3) + b"BZh"
    return b"#ROSBAG V2.0\n" + chunk


def _messages(path, count: int) -> None:
    """A table of messages of ROS 2, one of them packed."""
    packed = pytest.importorskip("backports.zstd").compress(bytes(count))
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("CREATE TABLE messages (data BLOB)")
        base.executemany("INSERT INTO messages VALUES (?)", [(b"\0\1plain",), (packed,)])


@pytest.mark.parametrize("kind", [".bag", ".db3", ".zstd"])
def test_packed_parts_of_a_bag_are_counted_before_they_are_unpacked(tmp_path, kind):
    pytest.importorskip("rosbags")
    for size, refused in ((1000, False), (LEAST_BYTES + 1, True)):
        path = tmp_path / f"{size}{kind}"
        if kind == ".db3":
            _messages(path, size)
        elif kind == ".bag":
            path.write_bytes(_ros1(size))
        else:
            path.write_bytes(pytest.importorskip("backports.zstd").compress(bytes(size)))
        budget = MemoryBudget(str(path), path.stat().st_size)
        if refused:
            with pytest.raises(InputError, match="--most-memory"):
                take_bag(path, budget)
        else:
            take_bag(path, budget)
            assert budget.taken == size


@pytest.mark.parametrize("kind", [".bag", ".db3", ".zstd"])
def test_a_damaged_bag_has_no_size_and_no_traceback(tmp_path, kind):
    pytest.importorskip("rosbags")
    path = tmp_path / f"damaged{kind}"
    path.write_bytes(b"#ROSBAG V2.0\n\xff\xff\xff")
    budget = MemoryBudget(str(path), 16)
    take_bag(path, budget)
    assert budget.taken == 0

"""Small files with large content, claims that are not true, and objects that hold themselves."""

import bz2
import gzip
import io
import json
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
from tests.logs.readers.seen import seen
from tests.logs.workbooks import ods, ods_cell, xlsx
from vttig_jax import InputError, read_log
from vttig_jax.base.files.limits import LEAST_BYTES, most_memory

TIME = np.arange(20.0)
DAMAGED, LARGE = "damaged", "--most-memory"
SMALL = 1 << 24
"""Bytes of memory where a bomb for the usual limit takes seconds to make."""


@pytest.fixture
def refused(tmp_path):
    """Write the bytes of a file; its refusal must hold a word."""

    def write(name: str, content: bytes, word: str) -> None:
        (tmp_path / name).write_bytes(content)
        code, said = seen(tmp_path / name)
        assert code == 3 and word in said, said

    return write


def hdf5(fill, **options) -> bytes:
    """The bytes of a file with two columns and what a function adds."""
    file = io.BytesIO()
    with h5py.File(file, "w", **options) as root:
        for name in ("time_s", "driving_deg"):
            root[name] = TIME
        fill(root)
    return file.getvalue()


def deflated_zeros(megabytes: int) -> bytes:
    packer, found = zlib.compressobj(9), io.BytesIO()
    for _ in range(megabytes):
        found.write(packer.compress(bytes(1 << 20)))
    return found.getvalue() + packer.flush()


def chunked(chunk: int, megabytes: int):
    def fill(root):
        options = {"maxshape": (None,), "chunks": (chunk,), "compression": "gzip"}
        made = root.create_dataset("x", (20,), "f8", **options)
        made.id.write_direct_chunk((0,), deflated_zeros(megabytes))

    return fill


@pytest.mark.parametrize(
    ("fill", "word"),
    [
        (lambda root: root.create_dataset("x", (200_000_000,), "f8", chunks=(1000,)), LARGE),
        (chunked(100_000_000, 1), LARGE),
        (chunked(20, 300), DAMAGED),
    ],
    ids=["declared", "large chunk", "chunk with too much"],
)
def test_hdf5_is_measured_before_it_is_read(refused, fill, word):
    content = hdf5(fill)
    assert len(content) < 600_000
    refused("log.h5", content, word)


def test_the_option_raises_the_limit(tmp_path):
    path = tmp_path / "packed.h5"
    packed = {"data": np.zeros(50_000), "compression": "gzip"}
    path.write_bytes(hdf5(lambda root: root.create_dataset("zeros", **packed)))
    with most_memory(300_000), pytest.raises(InputError, match=LARGE):
        read_log(path, ratio="1:1")
    assert seen(path)[0] == 0


def many_links(root):
    group = root.create_group("g")
    for number in range(30):  # 30¹⁶ paths without memory of what was read
        group[f"again{number}"] = group


def cell_of_itself(root):
    cell = root.create_dataset("c", (30, 1), h5py.ref_dtype)
    cell.attrs["MATLAB_class"] = np.bytes_("cell")
    cell[:, 0] = [cell.ref] * 30


@pytest.mark.parametrize("fill", [many_links, cell_of_itself])
def test_what_holds_itself_ends(tmp_path, fill):
    path = tmp_path / "log.mat"
    content = hdf5(fill, userblock_size=512)
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + content[512:])
    code, names = seen(path)
    assert code == 0 and set(names) == {"driving_deg", "time_s"}


CELL, STRUCT, CHAR, DOUBLE = 1, 2, 4, 6


def element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def array(kind: int, sizes: tuple[int, ...], name: bytes, *parts: bytes) -> bytes:
    """An array of a MATLAB file."""
    head = element(6, struct.pack("<II", kind, 0)) + element(5, struct.pack("<2i", *sizes))
    return element(14, head + element(1, name) + b"".join(parts))


def fields(width: int, count: int) -> tuple[bytes, bytes]:
    """Width of the names of fields, and the names."""
    return element(5, struct.pack("<i", width)), element(1, b"a".ljust(width, b"\0") * count)


NUMBERS = array(DOUBLE, (1, 20), b"time_s", element(9, TIME.tobytes()))
TOO_MANY = {
    "cells": array(CELL, (1, 1 << 29), b"c"),
    "structs": array(STRUCT, (1, 1 << 29), b"s", *fields(8, 1)),
    "fields": array(STRUCT, (1, 1), b"s", *fields(1, 300_000)),
    "letters": array(CHAR, (1, 1 << 30), b"c", element(16, b"")),
    "inside": array(CELL, (1, 1), b"c", array(CELL, (1 << 20, 1 << 20), b"")),
}


def packed(content: bytes, cut: int = 0) -> bytes:
    short = zlib.compress(content)[: -cut or None]
    return struct.pack("<II", 15, len(short)) + short


def matlab(*elements: bytes) -> bytes:
    header = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    return header + b"".join(elements)


@pytest.mark.parametrize("pack", [bytes, packed])
@pytest.mark.parametrize("kind", TOO_MANY)
def test_an_array_of_matlab_holds_what_it_claims(refused, kind, pack):
    refused("log.mat", matlab(pack(NUMBERS), pack(TOO_MANY[kind])), "")


HEAD, KIND = struct.pack("<II", 9, 160), struct.pack("<III", 6, 8, 6)
LIES = [(HEAD, struct.pack("<II", *one)) for one in ((20, 160), (9, 1600))]
LIES += [(KIND, struct.pack("<III", *one)) for one in ((6, 8, 6 | 0x800), (6, 8, 99), (6, 4, 6))]


@pytest.mark.parametrize(("old", "new"), LIES)
def test_tags_of_matlab_that_lie(refused, old, new):
    data = matlab(NUMBERS)
    assert data.count(old) == 1
    refused("log.mat", data.replace(old, new), DAMAGED)


def test_arrays_that_hold_what_they_claim_are_read(tmp_path):
    path = tmp_path / "log.mat"
    parts = (
        array(CELL, (1, 2), b"c", NUMBERS, NUMBERS),
        array(CHAR, (1, 3), b"t", element(16, b"abc")),
        array(STRUCT, (1, 1), b"s", *fields(8, 1), NUMBERS),
    )
    path.write_bytes(matlab(*map(packed, parts), NUMBERS))
    assert set(seen(path)[1]) == {"c{1}", "c{2}", "s.a", "time_s"}


@pytest.mark.parametrize("cut", [1, 30])
def test_a_packed_element_that_is_cut_off_is_damaged(refused, cut):
    refused("log.mat", matlab(NUMBERS, packed(NUMBERS, cut)), DAMAGED)


def test_a_packed_element_is_measured_before_it_is_unpacked(refused):
    content = deflated_zeros(20)
    with most_memory(SMALL):
        refused("log.mat", matlab(struct.pack("<II", 15, len(content)) + content), LARGE)


def zeros(suffix: str, columns) -> bytes:
    """A file of many equal numbers, packed where its format can pack."""
    file = io.BytesIO()
    if suffix == ".arrow":
        table = pa.table(columns)
        options = pa.ipc.IpcWriteOptions(compression="zstd")
        with pa.ipc.new_stream(file, table.schema, options=options) as writer:
            writer.write_table(table)
    elif suffix == ".parquet":
        parquet.write_table(pa.table(columns), file, use_dictionary=False, compression="zstd")
    else:
        return WRITERS[suffix](columns)
    return file.getvalue()


@pytest.mark.parametrize("suffix", [".feather", ".arrow", ".parquet", ".mf4", ".tdms"])
def test_binary_files_are_measured_before_they_are_read(tmp_path, suffix):
    for needed in {".mf4": ["asammdf"], ".tdms": ["nptdms"]}.get(suffix, []):
        pytest.importorskip(needed)
    size = 400_000
    path = tmp_path / f"log{suffix}"
    path.write_bytes(zeros(suffix, {"time_s": np.arange(size) * 0.01, "x_deg": np.zeros(size)}))
    assert suffix == ".tdms" or 3 * path.stat().st_size < 16 * size
    with most_memory(16 * size - 1), pytest.raises(InputError, match=LARGE):
        read_log(path, ratio="1:1")
    with most_memory(100 * size), pytest.raises(InputError, match="--column"):
        read_log(path, ratio="1:1")  # it is read, and asks for the shafts


@pytest.mark.parametrize("kind", ["HD", "FH", "DG", "CG", "CN"])
def test_a_list_of_blocks_that_comes_back_is_damaged(refused, kind):
    pytest.importorskip("asammdf")
    data = bytearray(WRITERS[".mf4"]({"time_s": TIME, "driving_deg": TIME, "driven_deg": TIME}))
    place = data.index(f"##{kind}".encode())
    struct.pack_into("<Q", data, place + 24, place)
    refused("log.mf4", bytes(data), DAMAGED)


ENDLESS = (
    "CREATE VIEW messages AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)"
    " SELECT x AS id, 1 AS topic_id, x AS timestamp, x'00' AS data FROM c"
)
COMPUTED = (
    "CREATE TABLE messages (id INTEGER, data BLOB GENERATED ALWAYS AS (zeroblob(1000000000)));"
    "INSERT INTO messages (id) VALUES (1)"
)


@pytest.mark.parametrize("script", [ENDLESS, COMPUTED], ids=["a view", "a computed column"])
def test_a_bag_with_computed_messages_is_not_read(tmp_path, refused, script):
    pytest.importorskip("rosbags")
    with closing(sqlite3.connect(tmp_path / "made.db3")) as base, base:
        base.executescript(script)
    refused("log.db3", (tmp_path / "made.db3").read_bytes(), DAMAGED)


def ros1(kind: bytes, content: bytes, declared: int) -> bytes:
    parts = (b"op=\x05", b"compression=" + kind, b"size=" + struct.pack("<I", declared))
    header = b"".join(struct.pack("<I", len(one)) + one for one in parts)
    chunk = struct.pack("<I", len(header)) + header + struct.pack("<I", len(content)) + content
    return b"#ROSBAG V2.0\n" + chunk


def mcap(kind: bytes, content: bytes, declared: int) -> bytes:
    chunk = struct.pack("<QQQI", 0, 0, declared, 0) + struct.pack("<I", len(kind)) + kind
    chunk += struct.pack("<Q", len(content)) + content
    return b"\x89MCAP0\r\n\x06" + struct.pack("<Q", len(chunk)) + chunk


@pytest.mark.parametrize("write", [ros1, mcap])
@pytest.mark.parametrize("kind", ["bz2", "lz4", "zstd"])
def test_a_chunk_of_a_bag_unpacks_to_what_it_declares(tmp_path, write, kind):
    """A true size is no reason to refuse, a false one is damage, and a large one is too much."""
    pytest.importorskip("rosbags")
    from vttig_jax.base.files.limits import MemoryBudget
    from vttig_jax.logs.readers.rosbag import take_bag

    plain = bytes(3_000_000)
    module = {"bz2": "bz2", "lz4": "lz4.frame", "zstd": "backports.zstd"}[kind]
    pack = bz2.compress if kind == "bz2" else pytest.importorskip(module).compress
    path = tmp_path / f"log.{'bag' if write is ros1 else 'mcap'}"

    def take(declared: int) -> None:
        path.write_bytes(write(kind.encode(), pack(plain), declared))
        take_bag(path, MemoryBudget(str(path), path.stat().st_size))

    take(len(plain))
    with pytest.raises(ValueError, match="unpacks to more"):
        take(1000)
    with pytest.raises(InputError, match=LARGE):
        take(max(LEAST_BYTES + 1, (1 << 32) - 1))


def test_packed_messages_of_a_bag_are_counted(tmp_path, refused):
    pytest.importorskip("rosbags")
    big = pytest.importorskip("backports.zstd").compress(bytes(LEAST_BYTES + 1))
    with closing(sqlite3.connect(tmp_path / "made.db3")) as base, base:
        base.execute("CREATE TABLE messages (data BLOB)")
        base.executemany("INSERT INTO messages VALUES (?)", [(b"\0\1plain",), (big,)])
    refused("log.db3", (tmp_path / "made.db3").read_bytes(), LARGE)


MANY_ROWS = '<table:table-row table:number-rows-repeated="3000">{}</table:table-row>'


@pytest.mark.parametrize(
    "bomb",
    [
        lambda: gzip.compress(bytes(1 << 25)),
        lambda: xlsx({"far": '<row r="1"><c r="XFD1048576"><v>1</v></c></row>'}),
        lambda: ods(MANY_ROWS.format(ods_cell(1.0, 16_000))),
        lambda: xlsx({"long": "<row/>" * (3 << 20)}),
    ],
    ids=["gzip", "a far cell", "repeated cells", "long XML"],
)
def test_texts_and_workbooks_are_measured_before_they_are_unpacked(refused, bomb):
    pytest.importorskip("python_calamine")
    with most_memory(SMALL):
        refused("log.txt", bomb(), LARGE)


def test_empty_rows_at_the_end_of_a_sheet_are_no_bomb(tmp_path):
    pytest.importorskip("python_calamine")
    rows = [["time_s", "a_deg"], *([k / 8, 2.0 * k] for k in range(9))]
    table = "".join(
        f"<table:table-row>{''.join(map(ods_cell, row))}</table:table-row>" for row in rows
    )
    empty = '<table:table-cell table:number-columns-repeated="16384"/>'
    empty = f'<table:table-row table:number-rows-repeated="1048000">{empty}</table:table-row>'
    (tmp_path / "log.ods").write_bytes(ods(table + empty))
    assert seen(tmp_path / "log.ods") == (0, ["time_s", "a_deg"])


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (json.dumps({f"k{k}": [1, 2] for k in range(3000)}), "3000"),
        ('{"a":' * 50_000, ""),
        ("[" * 50_000, ""),
        ("a," + "b " * 9000 + "\n1,2\n3,4\n", "name"),
        ('{"t": [' + "1, " * 150_000 + "]}", ""),
        ('"' + "x" * 10**6, ""),
        ("1, " * 150_000, ""),
        ("a b " * 250_000, ""),
    ],
    ids=["lists", "objects", "brackets", "names", "array", "quote", "numbers", "words"],
)
def test_texts_that_are_no_table_end_in_a_sentence(refused, text, word):
    """Nothing in a reader costs more than linear time or depth."""
    refused("log.txt", text.encode(), word)

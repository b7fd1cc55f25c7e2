"""Files that claim more than they hold, or whose parts follow each other without an end."""

import bz2
import io
import sqlite3
import struct
import zlib
from contextlib import closing

import h5py
import numpy as np
import pytest

from tests.logs.binary_logs import WRITERS
from vttig_jax.base.errors import InputError, LogError
from vttig_jax.logs.readers.binary.formats import format_of, read_binary
from vttig_jax.logs.readers.binary.mdf_links import check_links
from vttig_jax.logs.readers.open_table import open_table

TIME = np.arange(20.0)
CELL, STRUCT, CHAR, DOUBLE = 1, 2, 4, 6


def element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def array(kind: int, sizes: tuple[int, ...], name: bytes, *parts: bytes) -> bytes:
    """An array of a MATLAB file."""
    head = element(6, struct.pack("<II", kind, 0))
    return element(
        14, head + element(5, struct.pack("<2i", *sizes)) + element(1, name) + b"".join(parts)
    )


def names(width: int, count: int) -> tuple[bytes, bytes]:
    """Width of the names of fields, and the names."""
    return element(5, struct.pack("<i", width)), element(1, b"a".ljust(width, b"\0") * count)


NUMBERS = array(DOUBLE, (1, 20), b"time_s", element(9, TIME.tobytes()))
TOO_MANY = {
    "cells": array(CELL, (1, 1 << 29), b"c"),
    "structs": array(STRUCT, (1, 1 << 29), b"s", *names(8, 1)),
    "fields": array(STRUCT, (1, 1), b"s", *names(1, 300_000)),
    "letters": array(CHAR, (1, 1 << 30), b"c", element(16, b"")),
    "inside": array(CELL, (1, 1), b"c", array(CELL, (1 << 20, 1 << 20), b"")),
}


def packed(content: bytes) -> bytes:
    return struct.pack("<II", 15, len(zlib.compress(content))) + zlib.compress(content)


def matlab(*elements: bytes) -> bytes:
    header = b"MATLAB 5.0 MAT-file".ljust(124, b" ") + struct.pack("<H", 0x0100) + b"IM"
    return header + b"".join(elements)


@pytest.mark.parametrize("pack", [bytes, packed])
@pytest.mark.parametrize("kind", TOO_MANY)
def test_an_array_of_matlab_holds_what_it_claims(tmp_path, kind, pack):
    path = tmp_path / "log.mat"
    path.write_bytes(matlab(pack(NUMBERS), pack(TOO_MANY[kind])))
    assert path.stat().st_size < 1_000_000
    with pytest.raises(InputError, match=r"damaged|--most-memory"):
        open_table(path)


def test_arrays_that_hold_what_they_claim_are_read(tmp_path):
    path = tmp_path / "log.mat"
    cells = array(CELL, (1, 2), b"c", NUMBERS, NUMBERS)
    text = array(CHAR, (1, 3), b"t", element(16, b"abc"))
    fields = array(STRUCT, (1, 1), b"s", *names(8, 1), NUMBERS)
    path.write_bytes(matlab(*map(packed, (cells, text, fields)), NUMBERS))
    assert set(open_table(path).names) == {"c{1}", "c{2}", "s.a", "time_s"}


@pytest.mark.parametrize("cut", [1, 30])
def test_a_packed_element_that_is_cut_off_is_damaged(tmp_path, cut):
    path = tmp_path / "log.mat"
    short = zlib.compress(NUMBERS)[:-cut]
    path.write_bytes(matlab(NUMBERS, struct.pack("<II", 15, len(short)) + short))
    with pytest.raises(LogError, match="damaged"):
        open_table(path)


def deflated_zeros(megabytes: int) -> bytes:
    packer, found = zlib.compressobj(9), io.BytesIO()
    for _ in range(megabytes):
        found.write(packer.compress(bytes(1 << 20)))
    return found.getvalue() + packer.flush()


@pytest.mark.parametrize(
    ("chunk", "megabytes", "says"),
    [(100_000_000, 1, "--most-memory"), (20, 300, "damaged")],
    ids=["a large chunk", "a chunk with too much in it"],
)
def test_a_chunk_of_hdf5_is_measured_before_it_is_unpacked(tmp_path, chunk, megabytes, says):
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file["time_s"] = TIME
        made = file.create_dataset(
            "driving_deg", (20,), "f8", maxshape=(None,), chunks=(chunk,), compression="gzip"
        )
        made.id.write_direct_chunk((0,), deflated_zeros(megabytes))
    assert path.stat().st_size < 600_000
    with pytest.raises(InputError, match=says):
        open_table(path)


def mdf_blocks(data: bytes) -> dict[str, int]:
    """Kind → address of the first block of this kind."""
    kinds = ("HD", "FH", "DG", "CG", "CN")
    return {kind: data.index(f"##{kind}".encode()) for kind in kinds}


@pytest.fixture(scope="module")
def mdf() -> bytes:
    pytest.importorskip("asammdf")
    return WRITERS[".mf4"]({"time_s": TIME, "driving_deg": TIME, "driven_deg": TIME})


@pytest.mark.parametrize("kind", ["HD", "FH", "DG", "CG", "CN"])
def test_a_list_of_blocks_that_comes_back_is_damaged(tmp_path, mdf, kind):
    check_links(mdf)
    blocks = mdf_blocks(mdf)
    looped = bytearray(mdf)
    struct.pack_into("<Q", looped, blocks[kind] + 24, blocks[kind])
    path = tmp_path / "log.mf4"
    path.write_bytes(looped)
    form = format_of(path)
    assert form is not None
    with pytest.raises(LogError, match="damaged"):
        read_binary(path, form)


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_list_of_mdf_3_that_comes_back_is_damaged(order):
    """HD at 64, two groups of data, one group of channels, one channel."""
    data = bytearray(400)
    data[24:26] = b"\0\0" if order == "<" else b"\1\0"
    for place, kind in ((64, b"HD"), (100, b"DG"), (140, b"DG"), (180, b"CG"), (220, b"CN")):
        data[place : place + 2] = kind
    links = {64 + 4: 100, 100 + 4: 140, 100 + 8: 180, 180 + 8: 220}
    for place, target in links.items():
        struct.pack_into(f"{order}I", data, place, target)
    check_links(bytes(data))
    for place, target in ((140 + 4, 100), (180 + 4, 180), (220 + 4, 64)):
        looped = bytearray(data)
        struct.pack_into(f"{order}I", looped, place, target)
        with pytest.raises(ValueError, match=r"follows itself|wrong kind"):
            check_links(bytes(looped))


ENDLESS = (
    "CREATE VIEW messages AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)"
    " SELECT x AS id, 1 AS topic_id, x AS timestamp, x'00' AS data FROM c"
)
LARGE = (
    "CREATE TABLE messages (id INTEGER, data BLOB GENERATED ALWAYS AS (zeroblob(1000000000)));"
    "INSERT INTO messages (id) VALUES (1)"
)


@pytest.mark.parametrize("script", [ENDLESS, LARGE], ids=["a view", "a computed column"])
def test_a_bag_with_computed_messages_is_not_read(tmp_path, script):
    pytest.importorskip("rosbags")
    path = tmp_path / "log.db3"
    with closing(sqlite3.connect(path)) as base, base:
        base.executescript(script)
    form = format_of(path)
    assert form is not None
    with pytest.raises(LogError, match="damaged"):
        read_binary(path, form)


def ros1(kind: bytes, content: bytes, declared: int) -> bytes:
    fields = (b"op=\x05", b"compression=" + kind, b"size=" + struct.pack("<I", declared))
    header = b"".join(struct.pack("<I", len(one)) + one for one in fields)
    chunk = struct.pack("<I", len(header)) + header + struct.pack("<I", len(content)) + content
    return b"#ROSBAG V2.0\n" + chunk


def mcap(kind: bytes, content: bytes, declared: int) -> bytes:
    chunk = struct.pack("<QQQI", 0, 0, declared, 0) + struct.pack("<I", len(kind)) + kind
    chunk += struct.pack("<Q", len(content)) + content
    return b"\x89MCAP0\r\n\x06" + struct.pack("<Q", len(chunk)) + chunk


@pytest.mark.parametrize("write", [ros1, mcap])
@pytest.mark.parametrize("kind", ["bz2", "lz4", "zstd"])
def test_a_chunk_of_a_bag_unpacks_to_what_it_declares(tmp_path, write, kind):
    pytest.importorskip("rosbags")
    from vttig_jax.base.files.limits import MemoryBudget
    from vttig_jax.logs.readers.binary.bag_sizes import take_bag

    plain = bytes(3_000_000)
    if kind == "bz2":
        content = bz2.compress(plain)
    elif kind == "lz4":
        content = pytest.importorskip("lz4.frame").compress(plain)
    else:
        content = pytest.importorskip("backports.zstd").compress(plain)
    path = tmp_path / f"log.{'bag' if write is ros1 else 'mcap'}"
    for declared, refused in ((len(plain), False), (1000, True)):
        path.write_bytes(write(kind.encode(), content, declared))
        budget = MemoryBudget(str(path), path.stat().st_size)
        if refused:
            with pytest.raises(ValueError, match="unpacks to more"):
                take_bag(path, budget)
        else:
            take_bag(path, budget)

"""Small files with large content, and objects that hold themselves."""

import io
import struct
import zlib

import h5py
import numpy as np
import pytest

from vttig_jax.base.errors import InputError
from vttig_jax.base.files.limits import most_memory
from vttig_jax.logs.readers.nested import read_nested

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
        read_nested(path)
    assert caught.value.where == str(path)


def test_the_option_raises_the_limit(tmp_path):
    path = tmp_path / "packed.h5"
    with h5py.File(path, "w") as file:
        arrays(file)
        file.create_dataset("zeros", data=np.zeros(50_000), compression="gzip")
    with most_memory(300_000), pytest.raises(InputError, match="--most-memory"):
        read_nested(path)
    assert "zeros" in read_nested(path)[0].names


def test_a_group_that_is_linked_to_itself_ends(tmp_path):
    path = tmp_path / "loop.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("g")
        arrays(group)
        for number in range(30):  # 30¹⁶ paths without memory of what was read
            group[f"again{number}"] = group
    assert read_nested(path)[0].names == ("g/driving_deg", "g/time_s")


def test_a_cell_that_holds_itself_ends(tmp_path):
    path = tmp_path / "cell.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        arrays(file)
        cell = file.create_dataset("c", (30, 1), h5py.ref_dtype)
        cell.attrs["MATLAB_class"] = np.bytes_("cell")
        cell[:, 0] = [cell.ref] * 30
    head = b"MATLAB 7.3 MAT-file".ljust(512, b" ")
    path.write_bytes(head + path.read_bytes()[512:])
    assert set(read_nested(path)[0].names) == {"driving_deg", "time_s"}


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
        read_nested(path)

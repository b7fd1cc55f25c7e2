import io

import h5py
import numpy as np
import pytest

from vttig_jax.logs.readers.binary.hdf5 import hdf5_leaves


@pytest.fixture
def leaves():
    """What is found in a file that a function has filled."""

    def run(fill, **options):
        file = io.BytesIO()
        with h5py.File(file, "w", **options) as root:
            fill(root, h5py)
        data = file.getvalue()
        if options:
            data = b"MATLAB 7.3 MAT-file".ljust(512, b" ") + data[512:]
        return {name: array.tolist() for name, array in hdf5_leaves(data)}

    return run


def test_groups_and_compounds(leaves):
    def fill(root, h5py):
        root["t"] = [0.0, 1.0]
        root["rec/raw/pos"] = np.arange(6).reshape(3, 2)
        root["table"] = np.array([(1, 2.5, b"x"), (3, 4.5, b"y")], "i8,f8,S1")
        root["name"] = "rig"

    assert leaves(fill) == {
        "t": [0.0, 1.0],
        "rec/raw/pos": [[0, 1], [2, 3], [4, 5]],
        "table.f0": [1, 3],
        "table.f1": [2.5, 4.5],
    }


def test_links_and_other_files_are_left_alone(leaves, tmp_path):
    def fill(root, h5py):
        root["t"] = [0.0, 1.0]
        root["again"] = h5py.SoftLink("/t")
        root["broken"] = h5py.SoftLink("/nowhere")
        root["outside"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/t")
        layout = h5py.VirtualLayout((2,), "f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "t", (2,))
        root.create_virtual_dataset("virtual", layout)
        raw = tmp_path / "raw.bin"
        root.create_dataset("raw", (2,), "f8", external=[(str(raw), 0, 16)])
        root["group/loop"] = root["/"]

    found = leaves(fill)
    assert found["t"] == [0.0, 1.0]
    assert all(name == "t" or name.startswith("group/loop") for name in found)
    assert len(found) < 20


def test_files_of_matlab(leaves):
    def mark(item, kind):
        item.attrs["MATLAB_class"] = np.bytes_(kind)
        return item

    def fill(root, h5py):
        mark(root.create_dataset("x", data=np.arange(6.0).reshape(3, 2)), "double")
        mark(root.create_dataset("text", data=np.array([[97, 98]], np.uint16)), "char")
        object_ = mark(root.create_dataset("object", data=np.arange(6, dtype=np.uint32)), "table")
        object_.attrs["MATLAB_object_decode"] = 3
        mark(root.create_group("rec"), "struct")
        mark(root.create_dataset("rec/t", data=[[0.0], [1.0]]), "double")
        refs = root.create_group("#refs#")
        mark(refs.create_dataset("a", data=[[5.0], [6.0]]), "double")
        mark(refs.create_dataset("b", data=[[7.0], [8.0]]), "double")
        pair = np.array([[refs["a"].ref], [refs["b"].ref]], h5py.ref_dtype)
        mark(root.create_dataset("c", data=pair, dtype=h5py.ref_dtype), "cell")
        mark(root.create_group("s"), "struct")
        root.create_dataset("s/v", data=pair, dtype=h5py.ref_dtype)

    assert leaves(fill, userblock_size=512) == {
        "x": [[0.0, 2.0, 4.0], [1.0, 3.0, 5.0]],
        "rec.t": [[0.0, 1.0]],
        "c{1}": [[5.0, 6.0]],
        "c{2}": [[7.0, 8.0]],
        "s(1).v": [[5.0, 6.0]],
        "s(2).v": [[7.0, 8.0]],
    }

import contextlib
import hashlib

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

from vttig_jax.base.errors import LogError
from vttig_jax.logs.readers.open_table import open_table
from vttig_jax.logs.readers.table import MOST_COLUMNS, Table


def save(tmp_path, variables, name="log.mat", **options):
    path = tmp_path / name
    savemat(path, variables, **options)
    return path


def test_names_of_vectors_and_of_the_rows_and_columns_of_matrices(tmp_path):
    wide, tall = np.arange(10.0).reshape(2, 5), np.arange(8.0).reshape(4, 2)
    path = save(tmp_path, {"rec": {"t": np.arange(4.0), "wide": wide, "tall": tall}})
    table = open_table(path)
    assert table.names == (
        "rec.t",
        "rec.wide(1,:)",
        "rec.wide(2,:)",
        "rec.tall(:,1)",
        "rec.tall(:,2)",
    )
    found = table.columns(range(5))
    for values, expected in zip(found, [np.arange(4), *wide, *tall.T], strict=True):
        np.testing.assert_array_equal(values, expected)
    assert table.digest == hashlib.sha256(path.read_bytes()).hexdigest()
    assert table.source == str(path) and table.line_of is None
    assert table.left_out([0]) == ()


def test_what_is_no_column(tmp_path):
    variables = {
        "scalar": 0.004,
        "square": np.eye(6),
        "image": np.zeros((MOST_COLUMNS + 1, 2 * MOST_COLUMNS)),
        "stack": np.zeros((2, 3, 4)),
        "empty": np.zeros((0, 5)),
        "text": "abc",
        "signal": np.arange(5.0).reshape(1, 1, 5),
    }
    table = open_table(save(tmp_path, variables))
    assert table.names == ("signal",)


@pytest.mark.parametrize(
    ("values", "kind"),
    [
        (np.array([1, 2], np.uint8), "i"),
        (np.array([True, False]), "i"),
        (np.array([2**62 + 1, 1], np.uint64), "i"),
        (np.array([2**63 + 1, 1], np.uint64), "f"),
        (np.array([0.5, 1], np.float32), "f"),
    ],
)
def test_numbers_keep_their_digits(values, kind):
    (found,) = Table(("x",), (values,), "log.mat").columns([0])
    assert found.dtype.itemsize == 8 and found.dtype.kind == kind
    assert found[0] == values[0]


@pytest.mark.parametrize(
    ("variables", "words"),
    [({"name": "rig"}, "no numeric array"), ({"dt": 0.004}, "arrays, structs or tables")],
)
def test_no_numbers(tmp_path, variables, words):
    with pytest.raises(LogError, match=words) as caught:
        open_table(save(tmp_path, variables))
    assert caught.value.where.endswith("log.mat")


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("log.mat", b"", "empty"),
        ("log.mat", b"time_s,driving_deg\n0,1\n", "damaged or not a MATLAB or HDF5 file"),
        ("log.mat", b"\0" * 600, "damaged|no numeric"),
    ],
)
def test_refused(tmp_path, name, data, words):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(LogError, match=words):
        open_table(path)


def test_missing_and_folder(tmp_path):
    with pytest.raises(LogError, match="no such file"):
        open_table(tmp_path / "log.mat")
    (tmp_path / "folder.mat").mkdir()
    with pytest.raises(LogError, match="folder"):
        open_table(tmp_path / "folder.mat")


@pytest.fixture(scope="module", params=[False, True])
def stored(request, tmp_path_factory):
    """The bytes of a sound file, plain or compressed."""
    folder = tmp_path_factory.mktemp("stored")
    variables = {"rec": {"t": np.arange(50) / 7, "x": np.arange(100.0).reshape(2, 50)}}
    return save(folder, variables, do_compression=request.param).read_bytes()


@given(data=st.data())
def test_damage_is_one_sentence_or_still_a_table(tmp_path_factory, stored, data):
    size = data.draw(st.integers(1, len(stored) - 1))
    spoiled = bytearray(stored[:size])
    for _ in range(data.draw(st.integers(0, 3))):
        spoiled[data.draw(st.integers(0, size - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("damage") / "log.mat"
    path.write_bytes(bytes(spoiled))
    with contextlib.suppress(LogError):  # the one thing that may be raised
        assert open_table(path).names


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_a_file_cut_off(tmp_path, stored, share):
    path = tmp_path / "log.mat"
    path.write_bytes(stored[: int(share * len(stored))])
    with pytest.raises(LogError, match="damaged"):
        open_table(path)


def test_hdf5(tmp_path):
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as root:
        root["rec/t"] = np.arange(5)
        root["rec/pos"] = np.arange(10.0).reshape(5, 2)
    table = open_table(path)
    assert table.names == ("rec/pos(:,1)", "rec/pos(:,2)", "rec/t")
    assert table.columns([1])[0].tolist() == [1.0, 3.0, 5.0, 7.0, 9.0]
    path.write_bytes(path.read_bytes()[:1500])
    with pytest.raises(LogError, match="damaged"):
        open_table(path)

"""Binary formats: the same numbers as the arrays that were stored, and refusals of bad files."""

import io
import logging
import zipfile

import h5py
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import feather, parquet

from tests.logs.rig_log import angles_deg
from vttig_jax.base.errors import LogError, UsageError
from vttig_jax.logs import read_log
from vttig_jax.logs.readers.binary import formats
from vttig_jax.logs.readers.binary.mdf import mdf_columns
from vttig_jax.logs.readers.binary.silence import each_silent

T, X, Y = angles_deg(turns=2)
STAMPS = np.datetime64("2026-11-01T22:15:03", "ns") + np.rint(T * 1e9).astype(np.int64)


def arrow_table(*, dated: bool = False):
    unit = {b"unit": b"deg"}
    fields = [
        pa.field("time", pa.timestamp("ns") if dated else pa.float64()),
        pa.field("motor", pa.float64(), metadata=unit),
        pa.field("load", pa.float64(), metadata=unit),
    ]
    return pa.table([STAMPS if dated else T, X, Y], schema=pa.schema(fields))


def npz(path):
    np.savez_compressed(path, time_s=T, motor_deg=X, load_deg=Y)


def npy(path):
    names = [("time_s", "f8"), ("motor_deg", "f8"), ("load_deg", "f8")]
    record = np.zeros(len(T), names)
    for (name, _), values in zip(names, (T, X, Y), strict=True):
        record[name] = values
    np.save(path, record)


def stream(path):
    table = arrow_table()
    with pa.OSFile(str(path), "wb") as sink, pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)


def hdf5(path):
    with h5py.File(path, "w") as file:
        file["rec/time_s"], file["rec/motor_deg"], file["rec/load_deg"] = T, X, Y


def tdms(path):
    nptdms = pytest.importorskip("nptdms")
    step = {"wf_increment": 0.01, "wf_start_offset": 0.0, "wf_samples": 1, "unit_string": "deg"}
    with nptdms.TdmsWriter(str(path)) as writer:
        channels = [
            nptdms.ChannelObject("Axis", "Motor", X, step),
            nptdms.ChannelObject("Axis", "Load", Y, step),
            nptdms.ChannelObject("Other", "Temp", np.zeros(50), {"unit_string": "degC"}),
        ]
        writer.write_segment(channels)


def mdf(path):
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as file:
        for name, values, late in (("MotorAngle", X, 0.0), ("LoadAngle", Y, 0.0)):
            file.append([asammdf.Signal(values, T + late, unit="deg", name=name)])
        file.save(path, overwrite=True)


def bag(path):
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    state = store.types["sensor_msgs/msg/JointState"]
    head, stamp = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    with Writer(path, version=9) as writer:
        link = writer.add_connection("/joint_states", state.__msgtype__, typestore=store)
        for k in range(len(T)):
            ns = 1_793_570_103_250_000_000 + 10_000_000 * k
            names, values = ["motor", "load"], [np.radians(X[k]), np.radians(Y[k])]
            if k % 3 == 1:  # the order of the joints changes
                names, values = names[::-1], values[::-1]
            none = np.zeros(2)
            when = head(stamp(ns // 10**9, ns % 10**9), "")
            message = state(when, names, np.array(values), none, none)
            raw = store.serialize_cdr(message, state.__msgtype__)
            writer.write(link, ns + 40_000 * (k % 5), raw)


MAKERS = {
    "log.npz": npz,
    "log.npy": npy,
    "log.parquet": lambda path: parquet.write_table(arrow_table(), path),
    "dated.parquet": lambda path: parquet.write_table(arrow_table(dated=True), path),
    "log.feather": lambda path: feather.write_feather(arrow_table(), path),
    "log.arrow": stream,
    "log.h5": hdf5,
    "log.tdms": tdms,
    "log.mf4": mdf,
    "bag": bag,
}


@pytest.mark.parametrize("name", MAKERS)
def test_formats(tmp_path, name, capfd):
    MAKERS[name](tmp_path / name)
    log = read_log(tmp_path / name, ratio="16:9")
    assert log.driven is not None and len(log) == len(T)
    np.testing.assert_allclose(np.diff(log.time), 0.01, rtol=1e-6)
    np.testing.assert_allclose(np.degrees(log.driving_angle), X - X[0], atol=1e-9)
    np.testing.assert_allclose(np.degrees(log.driven_angle), Y - Y[0], atol=1e-9)
    assert len(log.sha256) == 64
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", [name for name in MAKERS if name != "bag"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.97])
def test_files_cut_off_are_refused_in_one_sentence(tmp_path, name, share, capfd):
    path = tmp_path / name
    MAKERS[name](path)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(LogError) as caught:
        read_log(path, ratio="16:9")
    assert name in caught.value.where
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["log.npz", "log.parquet", "log.feather", "log.tdms", "log.mf4"])
def test_wrong_bytes_are_refused(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"time_s,motor_deg\n0,1\n" * 40)
    with pytest.raises((LogError, UsageError), match="damaged"):
        read_log(path, ratio="16:9")


def test_the_reader_of_mdf_silences_the_library_and_not_who_reads_its_channels(tmp_path, capfd):
    mdf(tmp_path / "log.mf4")
    level = logging.getLogger("asammdf").level
    names = []
    for column in mdf_columns(tmp_path / "log.mf4", (tmp_path / "log.mf4").read_bytes()):
        print(column.name)
        names.append(column.name)
        assert logging.getLogger("asammdf").level == level
    assert names == ["MotorAngle [deg]", "LoadAngle [deg]"]
    assert capfd.readouterr().out.split("\n")[:-1] == names


def test_a_silent_generator_that_is_given_up_is_closed_silently(capfd):
    def noisy():
        try:
            print("in")
            yield 1
            yield 2
        finally:
            print("out")

    shown = each_silent(noisy())
    assert next(shown) == 1
    shown.close()
    print("told")
    assert capfd.readouterr().out == "told\n"


def header(text: str, body: bytes = b"") -> bytes:
    """The bytes of a .npy file with this header."""
    padded = text.ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little") + padded.encode() + body


HUGE = "{'descr': '<f8', 'fortran_order': False, 'shape': (10000000000000,), }"
LONGER = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000,), }"
OBJECTS = "{'descr': '|O', 'fortran_order': False, 'shape': (3,), }"


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize(
    ("text", "words"),
    [(HUGE, "claims 80000000000000 bytes"), (LONGER, "claims 8000 bytes"), (OBJECTS, "pickles")],
)
def test_hostile_headers_load_nothing(tmp_path, monkeypatch, text, words, inside):
    def load(*_, **__):
        raise AssertionError("the array was loaded")

    monkeypatch.setattr(np, "load", load)
    data = header(text, bytes(64))
    path = tmp_path / ("log.npz" if inside else "log.npy")
    if inside:
        held = io.BytesIO()
        with zipfile.ZipFile(held, "w") as archive:
            archive.writestr("driving_deg.npy", data)
        data = held.getvalue()
    path.write_bytes(data)
    with pytest.raises(LogError, match=words):
        read_log(path, ratio="16:9")


def test_a_missing_extra_is_one_sentence_with_the_pip_line(tmp_path, monkeypatch):
    def absent(name, *rest):
        raise ImportError(name)

    monkeypatch.setattr(formats, "import_module", absent)
    (tmp_path / "log.tdms").write_bytes(b"TDSm")
    with pytest.raises(UsageError, match=r"`pip install \"vttig-jax\[tdms\]\"`"):
        read_log(tmp_path / "log.tdms", ratio="16:9")


def test_links_to_other_files_are_not_followed(tmp_path):
    hdf5(tmp_path / "other.h5")
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["motor_deg"], file["time_s"] = X, T
        file["load_deg"] = h5py.ExternalLink("other.h5", "rec/load_deg")
    with pytest.raises(LogError, match="no column"):
        read_log(tmp_path / "log.h5", ratio="16:9")


def test_channels_of_one_name_are_told_apart_by_their_group(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    step = {"wf_increment": 0.01, "unit_string": "deg"}
    with nptdms.TdmsWriter(str(tmp_path / "log.tdms")) as writer:
        parts = (("Axis", "Motor", X), ("Axis", "Load", Y), ("Other", "Load", 2 * Y))
        writer.write_segment([nptdms.ChannelObject(g, c, v, step) for g, c, v in parts])
    with pytest.raises(LogError, match="2 columns can be driven"):
        read_log(tmp_path / "log.tdms", ratio="16:9")
    log = read_log(tmp_path / "log.tdms", ratio="16:9", columns={"driven": "Axis/Load"})
    np.testing.assert_allclose(np.degrees(log.driven_angle), Y - Y[0], atol=1e-9)


def test_a_folder_that_is_no_bag(tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(LogError, match="this is a folder"):
        read_log(tmp_path / "folder", ratio="16:9")


def test_a_duration_is_time(tmp_path):
    stamps = pa.array(np.rint(T * 1e9).astype(np.int64), pa.duration("ns"))
    feather.write_feather(pa.table([stamps, X, Y], ["t", "motor_deg", "load_deg"]), tmp_path / "d")
    path = (tmp_path / "d").rename(tmp_path / "log.feather")
    log = read_log(path, ratio="16:9")
    np.testing.assert_allclose(log.time - log.time[0], T - T[0], atol=1e-9)
    assert log.spec is not None and log.spec.log.time == "t [s]"

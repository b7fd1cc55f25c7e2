"""Binary files beyond the corpus: bags, files cut off anywhere, hostile headers, missing extras."""

import io
import sys
import zipfile

import h5py
import numpy as np
import pytest

from tests.logs.binary_logs import WRITERS
from tests.logs.readers.seen import seen
from tests.logs.rig_log import angles_deg
from vttig_jax import LogError, UsageError, read_log
from vttig_jax.base.files.run_folder import data_sha256

T, X, Y = angles_deg(turns=2)
NEEDS = {".tdms": "nptdms", ".mf4": "asammdf"}


def test_a_bag_whose_joints_change_their_order(tmp_path):
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    state = store.types["sensor_msgs/msg/JointState"]
    head, stamp = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    with Writer(tmp_path / "bag", version=9) as writer:
        link = writer.add_connection("/joint_states", state.__msgtype__, typestore=store)
        for k in range(len(T)):
            ns = 1_793_570_103_250_000_000 + 10_000_000 * k
            names, values = ["motor", "load"], [np.radians(X[k]), np.radians(Y[k])]
            if k % 3 == 1:
                names, values = names[::-1], values[::-1]
            when = head(stamp(ns // 10**9, ns % 10**9), "")
            message = state(when, names, np.array(values), np.zeros(2), np.zeros(2))
            raw = store.serialize_cdr(message, state.__msgtype__)
            writer.write(link, ns + 40_000 * (k % 5), raw)
    log = read_log(tmp_path / "bag", ratio="16:9")
    assert log.sha256 == data_sha256(tmp_path / "bag")  # as in run.toml
    np.testing.assert_allclose(np.diff(log.time), 0.01, rtol=1e-6)
    np.testing.assert_allclose(np.degrees(log.driving_angle), X - X[0], atol=1e-9)
    np.testing.assert_allclose(np.degrees(log.driven_angle), Y - Y[0], atol=1e-9)
    (tmp_path / "folder").mkdir()
    assert seen(tmp_path / "folder")[0] == 3


@pytest.mark.parametrize("suffix", [one for one in WRITERS if one != ".jsonl"])  # a text of lines
@pytest.mark.parametrize("share", [0.0, 0.5, 0.97])
def test_files_cut_off_are_refused_in_one_sentence(tmp_path, suffix, share, capfd):
    if suffix in NEEDS:
        pytest.importorskip(NEEDS[suffix])
    data = WRITERS[suffix]({"time_s": T, "motor_deg": X, "load_deg": Y})
    (tmp_path / f"log{suffix}").write_bytes(data[: int(share * len(data))])
    code, said = seen(tmp_path / f"log{suffix}")
    assert code == 3 and "\n" not in said
    assert capfd.readouterr() == ("", "")  # no message of a library


def header(text: str) -> bytes:
    """The bytes of a .npy file with this header."""
    padded = text.ljust(117) + "\n"
    start = b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little")
    return start + padded.encode() + bytes(64)


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize(
    ("dtype", "count"), [("<f8", 10_000_000_000_000), ("<f8", 1000), ("|O", 3)]
)
def test_hostile_headers_load_nothing(tmp_path, monkeypatch, dtype, count, inside):
    def load(*_, **__):
        raise AssertionError("the array was loaded")

    monkeypatch.setattr(np, "load", load)
    data = header(f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': ({count},), }}")
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w") as archive:
        archive.writestr("driving_deg.npy", data)
    path = tmp_path / ("log.npz" if inside else "log.npy")
    path.write_bytes(held.getvalue() if inside else data)
    with pytest.raises(LogError):
        read_log(path, ratio="16:9")


def test_a_missing_extra_is_one_sentence_with_the_pip_line(tmp_path, monkeypatch):
    for module in [*sys.modules]:
        if module.partition(".")[0] == "nptdms":
            monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "nptdms", None)  # importing it raises ImportError
    (tmp_path / "log.tdms").write_bytes(b"TDSm")
    with pytest.raises(UsageError, match=r"`pip install \"vttig-jax\[tdms\]\"`"):
        read_log(tmp_path / "log.tdms", ratio="16:9")


def test_links_to_other_files_are_not_followed(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["load_deg"] = Y
    raw = tmp_path / "raw.bin"
    raw.write_bytes(Y.tobytes())
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["motor_deg"], file["time_s"] = X, T
        file["again"] = h5py.SoftLink("/time_s")
        file["broken"] = h5py.SoftLink("/nowhere")
        file["load_deg"] = h5py.ExternalLink("other.h5", "load_deg")
        layout = h5py.VirtualLayout((len(Y),), "f8")
        layout[:] = h5py.VirtualSource("other.h5", "load_deg", (len(Y),))
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("raw", (len(Y),), "f8", external=[(str(raw), 0, 8 * len(Y))])
    assert seen(tmp_path / "log.h5") == (0, ["motor_deg", "time_s"])

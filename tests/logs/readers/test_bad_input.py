"""What is wrong with a log is one sentence with file and channel, in every format alike."""

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import feather, parquet
from scipy.io import savemat

from tests.logs.rig_log import angles_deg
from tests.logs.rig_log import csv as text_table
from vttig_jax.cli.main import main
from vttig_jax.logs.readers.binary.formats import FORMATS
from vttig_jax.logs.readers.text import NESTED

T, X, Y = (one[:600] for one in angles_deg())


def text(path, columns):
    rows = {name: values.tolist() for name, values in columns.items()}
    longest = max(map(len, rows.values()), default=0)
    lines = [
        ",".join(f"{values[k]:.6f}" if k < len(values) else "" for values in rows.values())
        for k in range(longest)
    ]
    path.write_text("\n".join([",".join(columns), *lines, ""]))


def stream(path, columns):
    table = pa.table(columns)
    with pa.ipc.new_stream(path, table.schema) as writer:
        writer.write_table(table)


def hdf5(path, columns):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file[f"rec/{name}"] = values


def tdms(path, columns):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(str(path)) as writer:
        channels = [nptdms.ChannelObject("rec", name, one) for name, one in columns.items()]
        writer.write_segment(channels)


def mdf(path, columns):
    asammdf = pytest.importorskip("asammdf")
    time = columns["time_s"]
    signals = [
        asammdf.Signal(values, time[: len(values)], name=name)
        for name, values in columns.items()
        if name != "time_s"
    ]
    with asammdf.MDF() as file:
        for one in signals:
            file.append([one])
        file.save(path, overwrite=True)


def matlab_table(path, columns):
    matio, pandas = pytest.importorskip("matio"), pytest.importorskip("pandas")
    matio.save_to_mat(str(path), {"T": pandas.DataFrame(columns)}, version="v7")


ARRAYS = {
    "log.csv": text,
    "log.npz": lambda path, columns: np.savez(path, **columns),
    "log.mat": lambda path, columns: savemat(path, columns),
    "log.h5": hdf5,
    "log.tdms": tdms,
}
"""Formats whose channels may differ in length."""

TABLES = {
    "log.parquet": lambda path, columns: parquet.write_table(pa.table(columns), path),
    "log.feather": lambda path, columns: feather.write_feather(pa.table(columns), path),
    "log.arrow": stream,
    "table.mat": matlab_table,
}
"""Formats of tables."""

CLOCKED = {"log.mf4": mdf}
"""Formats whose channels have stamps of their own."""

ALL = ARRAYS | TABLES | CLOCKED

GOOD = {"time_s": T, "motor_deg": X, "load_deg": Y}


@pytest.fixture
def refused(tmp_path, capfd):
    """Write a log, and return the sentence with which `inspect` and `fit` refuse it."""

    def attempt(name: str, columns, *options: str, code: int = 3) -> str:
        path = tmp_path / name
        ALL[name](path, columns)
        capfd.readouterr()
        said = set()
        for verb in ("inspect", "fit"):
            found = main([verb, str(path), "--ratio", "16:9", "-q", *options])
            out, err = capfd.readouterr()
            assert (found, out) == (code, ""), (verb, found, err)
            assert err.startswith("error: ") and err.count("\n") == 1 and name in err, err
            said.add(err)
        assert len(said) == 1, said
        return said.pop()

    return attempt


def test_the_good_log_is_read(tmp_path, capfd):
    for name, write in ALL.items():
        write(tmp_path / name, GOOD)
        assert main(["inspect", str(tmp_path / name), "--ratio", "16:9", "-q"]) == 0, name
        assert capfd.readouterr().err == ""


@pytest.mark.parametrize("name", ALL)
def test_a_channel_that_is_not_there(refused, name):
    assert "motr_deg" in refused(name, GOOD, "--column", "driving=motr_deg")


@pytest.mark.parametrize("name", ALL)
def test_channels_without_data(refused, name):
    sentence = refused(name, {key: values[:0] for key, values in GOOD.items()})
    words = ("without a single line of numbers", "no channel of numbers", "no numeric array")
    assert any(word in sentence for word in (*words, "only 0 samples")), sentence


@pytest.mark.parametrize("name", ARRAYS)
def test_channels_of_unequal_length(refused, name):
    sentence = refused(name, GOOD | {"load_deg": Y[:500]})
    assert "load_deg" in sentence


@pytest.mark.parametrize("name", ARRAYS | TABLES)
@pytest.mark.parametrize(
    "time", [T[::-1], np.full_like(T, 2.5), np.where(np.arange(len(T)) == 300, T - 2, T)]
)
def test_time_that_goes_back_or_stands(refused, name, time):
    sentence = refused(name, GOOD | {"time_s": time})
    assert "time" in sentence


@pytest.mark.parametrize("name", ALL)
def test_units_that_contradict(refused, name):
    sentence = refused(name, GOOD, "--unit", "driving=rad")
    assert "motor_deg" in sentence and "rad" in sentence


ENDINGS = [ending for form in FORMATS for ending in form.endings] + list(NESTED)


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("content", [b"", b"time_s,motor_deg\n0,1\n" * 40, bytes(range(256)) * 9])
def test_files_of_another_content(tmp_path, capfd, ending, content):
    path = tmp_path / f"log{ending}"
    path.write_bytes(content)
    code = main(["fit", str(path), "--ratio", "16:9"])
    out, err = capfd.readouterr()
    assert (code, out) == (3, "") and err.startswith(f"error: {path}"), err
    assert err.count("\n") == 1 and ("damaged" in err or "empty" in err or "no " in err), err


def test_the_helper_writes_what_the_other_tests_write(tmp_path):
    text(tmp_path / "log.csv", GOOD)
    assert (tmp_path / "log.csv").read_text() == text_table(",".join(GOOD), T, X, Y, digits=6)

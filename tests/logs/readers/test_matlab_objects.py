"""Tables, timetables and times of MATLAB, written by the library that writes them."""

import builtins
import warnings

import numpy as np
import pytest

import vttig_jax
from tests.logs.rig_log import GAP_DEG, angles_deg
from vttig_jax.base.errors import LogError, UsageError
from vttig_jax.logs.readers.open_table import open_table

matio = pytest.importorskip("matio")
pandas = pytest.importorskip("pandas")

SECONDS = np.array([0.0, 0.000503, 0.001006, 0.0015093])
COLUMNS = {"motor": np.arange(4) * 9.5, "load": np.arange(4) * 5.34, "mode": list("aabb")}


@pytest.fixture(params=["v7", "v7.3"])
def save(request, tmp_path):
    """Write variables to a MATLAB file of either format."""

    def write(**variables):
        path = tmp_path / "log.mat"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            matio.save_to_mat(str(path), variables, version=request.param)
        return path

    return write


def durations(seconds):
    return pandas.to_timedelta(np.rint(seconds * 1e9).astype(np.int64), unit="ns")


def test_a_table_with_durations(save):
    frame = pandas.DataFrame({"t": durations(SECONDS), **COLUMNS})
    table = open_table(save(T=frame, rate=100.0))
    assert table.names == ("T.t [s]", "T.motor", "T.load")
    time, motor, _ = table.columns([0, 1, 2])
    np.testing.assert_allclose(time, SECONDS, rtol=0, atol=1e-9)
    assert motor.tolist() == COLUMNS["motor"].tolist()


def test_a_timetable_with_dates(save):
    """Dates of today in ns exceed float64; they are subtracted as whole numbers."""
    stamps = np.datetime64("2026-11-01T12:00:00", "ns") + np.rint(SECONDS * 1e9).astype(int)
    frame = pandas.DataFrame(COLUMNS, index=pandas.DatetimeIndex(stamps, name="When"))
    table = open_table(save(TT=frame))
    assert table.names == ("TT.When [s]", "TT.motor", "TT.load")
    # A double holds milliseconds since 1970 to 0.25 µs; the library keeps no finer part.
    np.testing.assert_allclose(table.columns([0])[0], SECONDS, rtol=0, atol=3e-7)


def test_times_outside_of_tables_stand_beside_plain_arrays(save):
    table = open_table(save(t=durations(SECONDS).to_numpy(), motor=COLUMNS["motor"]))
    assert set(table.names) == {"t [s]", "motor"}


def test_a_fit_of_a_timetable(save):
    time, motor, load = angles_deg()
    frame = pandas.DataFrame(
        {"motor_deg": motor, "load_deg": load}, index=durations(time).rename("Time")
    )
    log = vttig_jax.read_log(save(T=frame), ratio="16:9")
    gap = vttig_jax.fit(log, delay="off").parameters["constant_backlash_deg"].value
    assert gap == pytest.approx(GAP_DEG, abs=1e-4)


@pytest.fixture
def without_library(monkeypatch):
    imported = builtins.__import__

    def refuse(name, *arguments, **keywords):
        if name == "matio":
            raise ImportError(name)
        return imported(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", refuse)


def test_without_the_library(save, without_library, caplog):
    path = save(T=pandas.DataFrame({"t": durations(SECONDS), **COLUMNS}))
    with pytest.raises(UsageError, match=r'pip install "vttig-jax\[matlab\]".*table2struct'):
        open_table(path)
    path = save(T=pandas.DataFrame(COLUMNS), motor=COLUMNS["motor"])
    assert open_table(path).names == ("motor",)
    assert "they are left out" in caplog.text and "matlab" in caplog.text


@pytest.mark.parametrize("share", [0.4, 0.7, 0.95])
def test_a_table_cut_off(save, share):
    path = save(T=pandas.DataFrame({"t": durations(SECONDS), **COLUMNS}))
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(LogError, match=r"damaged|no numeric"):
        open_table(path)


def test_text_alone_is_no_log(save):
    with pytest.raises(LogError, match="no numeric array"):
        open_table(save(T=pandas.DataFrame({"mode": list("abc")})))

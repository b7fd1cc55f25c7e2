"""Tables of MATLAB beyond the corpus: without the library that reads them, and in a fit."""

import sys
import warnings

import numpy as np
import pytest

import vttig_jax
from tests.logs.rig_log import GAP_DEG, angles_deg

matio = pytest.importorskip("matio")
pandas = pytest.importorskip("pandas")

TIME, MOTOR, LOAD = angles_deg()


@pytest.fixture(params=["v7", "v7.3"])
def save(request, tmp_path):
    """Write variables to a MATLAB file of either format."""

    def write(**variables):
        path = tmp_path / "log.mat"
        with warnings.catch_warnings(action="ignore"):
            matio.save_to_mat(str(path), variables, version=request.param)
        return path

    return write


def test_a_fit_of_a_timetable(save):
    stamps = pandas.to_timedelta(np.rint(TIME * 1e9).astype(np.int64), unit="ns").rename("Time")
    path = save(T=pandas.DataFrame({"motor_deg": MOTOR, "load_deg": LOAD}, index=stamps))
    log = vttig_jax.read_log(path, ratio="16:9")
    gap = vttig_jax.fit(log, delay="off").parameters["constant_backlash_deg"].value
    assert gap == pytest.approx(GAP_DEG, abs=1e-4)


def test_without_the_library(save, monkeypatch):
    monkeypatch.setitem(sys.modules, "matio", None)
    table = pandas.DataFrame({"motor": MOTOR, "load": LOAD})
    with pytest.raises(vttig_jax.UsageError, match=r'pip install "vttig-jax\[matlab\]"'):
        vttig_jax.read_log(save(T=table), ratio="16:9")
    beside = save(T=table, motor=MOTOR, load=LOAD)  # the plain arrays are read
    log = vttig_jax.read_log(beside, ratio="16:9", unit="deg", sample_rate_hz=100.0)
    assert log.spec is not None and log.spec.log.driving == "motor"

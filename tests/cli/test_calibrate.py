"""`vttig calibrate`: a run folder in, coverage out; exit codes and files."""

import json

import pytest
import tomli_w

from vttig_jax.cli.verbs.demo import log_csv
from vttig_jax.pair.load import spec_of
from vttig_jax.pair.pair_file import spec_table
from vttig_jax.posterior.calibration import calibrate as room
from vttig_jax.rig import PassMotion, paper_rig


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rig")
    rig = paper_rig(motion=PassMotion(speed_rpm=240.0, reversal_deg=3600.0, ramp_s=0.2))
    (folder / "log.csv").write_text(log_csv(rig.log(0)))
    (folder / "pair.toml").write_text(tomli_w.dumps(spec_table(spec_of(rig.pair))))
    return folder


@pytest.fixture
def run(vttig, logged, tmp_path):
    options = ("--pair", logged / "pair.toml", "--out", tmp_path / "run", "--no-figures")
    assert vttig("fit", logged / "log.csv", *options)[0] == 0
    return tmp_path / "run"


@pytest.mark.portable
def test_table_and_file(vttig, run, tmp_path):
    out = tmp_path / "found"
    code, text, _ = vttig("calibrate", run, "--rigs", "30", "--out", out)
    assert code == 0 and "calibrated: yes" in text and "driving_eccentricity_mm" in text
    record = json.loads((out / "calibration.json").read_text())
    assert record["schema"] == "vttig.calibrate/2" and record["rigs"] == 30
    assert vttig("calibrate", run, "--rigs", "30", "--out", out)[0] == 2


def test_intervals_that_do_not_hold_are_exit_4(vttig, run, monkeypatch):
    monkeypatch.setattr(room, "TOLERATED", 0.999999)
    code, out, err = vttig("calibrate", run, "--rigs", "40")
    assert code == 4
    assert "calibrated: NO" in out
    assert "too narrow" in err


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ((), 2, "RUN"),
        (("nowhere",), 2, "no such run"),
        (("nowhere", "--rigs", "3"), 2, "20"),
        (("nowhere", "--overwrite"), 2, "--out"),
        (("nowhere", "--seed", "-1"), 2, "-1"),
    ],
)
def test_usage(vttig, arguments, code, said):
    found, _, err = vttig("calibrate", *arguments)
    assert found == code and said in err


def test_a_changed_log_is_refused(vttig, logged, run):
    text = (logged / "log.csv").read_text()
    (logged / "log.csv").write_text(text.replace("\n", "\n", 1) + "# more\n")
    try:
        code, _, err = vttig("calibrate", run)
    finally:
        (logged / "log.csv").write_text(text)
    assert code == 3 and "changed" in err

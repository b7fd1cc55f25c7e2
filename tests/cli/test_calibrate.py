"""`vttig calibrate`: a run folder in, coverage out; exit codes and files."""

import json
import shutil

import pytest

from vttig_jax.posterior.calibration import calibrate as room


@pytest.mark.portable
def test_table_and_file(vttig, run_folder, tmp_path):
    out = tmp_path / "found"
    code, text, _ = vttig("calibrate", run_folder, "--rigs", "30", "--out", out)
    assert code == 0 and "calibrated: yes" in text and "driving_eccentricity_mm" in text
    record = json.loads((out / "calibration.json").read_text())
    assert record["schema"] == "vttig.calibrate/2" and record["rigs"] == 30
    assert vttig("calibrate", run_folder, "--rigs", "30", "--out", out)[0] == 2


@pytest.mark.slow
@pytest.mark.portable
def test_intervals_that_are_too_narrow_are_told(vttig, run_folder, monkeypatch):
    monkeypatch.setattr(room, "TOLERATED", 0.999999)
    code, text, err = vttig("calibrate", run_folder, "--rigs", "30", "--seed", "1")
    assert code == 4
    assert "calibrated: NO" in text and "too narrow" in err


def test_usage(vttig):
    for arguments, said in (
        ((), "RUN"),
        (("nowhere",), "no such run"),
        (("nowhere", "--rigs", "3"), "20"),
        (("nowhere", "--overwrite"), "--out"),
        (("nowhere", "--seed", "-1"), "-1"),
    ):
        code, _, err = vttig("calibrate", *arguments)
        assert code == 2 and said in err


def test_a_changed_log_is_refused(vttig, rig_folder, run_folder, tmp_path):
    run = tmp_path / run_folder.relative_to(run_folder.parents[1])
    shutil.copytree(run_folder, run)
    shutil.copytree(rig_folder, tmp_path / rig_folder.name)  # as the run names it
    with (tmp_path / rig_folder.name / "log.csv").open("a") as file:
        file.write("# more\n")
    code, _, err = vttig("calibrate", run)
    assert code == 3 and "changed" in err

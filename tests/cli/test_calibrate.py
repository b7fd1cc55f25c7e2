"""`vttig calibrate`: a run folder in, coverage out; exit codes and files."""

import json
import shutil

import pytest

from vttig_jax.posterior.calibration import calibrate as room


@pytest.mark.portable
def test_table_and_file(vttig, told, run_folder, tmp_path):
    call = ("calibrate", run_folder, "--rigs", "20", "--out", tmp_path / "found")
    text = told(*call)
    assert "calibrated: yes" in text and "driving_eccentricity_mm" in text
    record = json.loads((tmp_path / "found" / "calibration.json").read_text())
    assert record["schema"] == "vttig.calibrate/2" and record["rigs"] == 20
    assert vttig(*call)[0] == 2


@pytest.mark.slow
@pytest.mark.portable
def test_intervals_that_are_too_narrow_are_told(vttig, run_folder, monkeypatch):
    monkeypatch.setattr(room, "TOLERATED", 0.999999)
    code, text, err = vttig("calibrate", run_folder, "--rigs", "30", "--seed", "1")
    assert code == 4 and "calibrated: NO" in text and "too narrow" in err


def test_refusals(refused, rig_folder, run_folder, tmp_path):
    for words, *arguments in (
        ("RUN",),
        ("no such run", "nowhere"),
        ("20", "nowhere", "--rigs", "3"),
        ("--out", "nowhere", "--overwrite"),
        ("-1", "nowhere", "--seed", "-1"),
    ):
        refused(2, words, "calibrate", *arguments)
    run = shutil.copytree(run_folder, tmp_path / run_folder.relative_to(run_folder.parents[1]))
    shutil.copytree(rig_folder, tmp_path / rig_folder.name)  # as the run names it
    with (tmp_path / rig_folder.name / "log.csv").open("a") as file:
        file.write("# more\n")
    refused(3, "changed", "calibrate", run)

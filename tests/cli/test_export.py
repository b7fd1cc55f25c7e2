import json
import shutil

import numpy as np
import pytest

from tests.cli.commands import fit_into, table_of
from tests.cli.drive import write_drive, write_pair
from tests.control import headers
from tests.control.headers import called, compiled, needs_cc
from vttig_jax import open_run

COUNTS = 90_000
RADIUS_MM = 80.0
SLOPE = 2 * np.tan(np.radians(3.0))


@pytest.fixture
def table(told, run_folder, tmp_path):
    """The map of the run as `vttig map` writes it."""
    told("map", run_folder, "--out", tmp_path / "by_map.csv")
    return tmp_path / "by_map.csv"


READ = """
        const struct rig_displacement shift =
            rig_shift(rig_driving_rad(x[0]), rig_driven_rad(x[1]), x[2]);
        y[0] = shift.shift_mm;
        y[1] = rig_driving_rad(x[0]);
        y[2] = y[3] = 0.0;
        y[4] = shift.status;
"""


@needs_cc
def test_the_header_takes_the_counters_of_the_log(vttig, rig_folder, run_folder, tmp_path, table):
    log = table_of(rig_folder / "log.csv")
    code, out, err = vttig("export", run_folder, "--out", tmp_path / "rig.h", "--name", "rig")
    assert (code, err) == (0, "")
    assert "within" in out and str(tmp_path / "rig.h") in out
    text = (tmp_path / "rig.h").read_text(encoding="ascii")
    assert str(tmp_path) not in text and str(run_folder) not in text
    program = compiled(tmp_path, text, "rig", READ)
    counts = [log[name][::100] % COUNTS for name in ("driving_counts", "driven_counts")]
    shift, _, _, _, status = called(program, *counts, 0.0)
    assert not status.any()
    turned = 360 * (log["driving_counts"][::100] - log["driving_counts"][0]) / COUNTS
    rows = table_of(table)
    expected = np.interp(turned % 5760, rows["driving_deg"], rows["axial_mm"])
    # The tooth mesh bends the map by this much between two degrees of the table.
    np.testing.assert_allclose(shift, expected, atol=0.005)
    foreign = called(program, counts[0], counts[1] + 2000, 0.0)
    assert foreign[4].all() and not foreign[0].any()


def test_json_is_the_map_as_harmonics(found, run_folder, tmp_path, table):
    record = found("export", run_folder, "--out", tmp_path / "x.json")
    assert record["schema"] == "vttig.compensation/1"
    assert json.loads((tmp_path / "x.json").read_text()) == record
    rows = table_of(table)
    driving = np.radians(rows["driving_deg"])
    backlash = np.full(len(driving), record["constant_rad"])
    for one in record["harmonics"]:
        phase = (one["driving_order"] + 45 / 80 * one["driven_order"]) * driving
        backlash += one["cos_rad"] * np.cos(phase) + one["sin_rad"] * np.sin(phase)
    np.testing.assert_allclose(np.degrees(backlash), rows["backlash_deg"], atol=1e-8)
    axial = backlash / record["closing_rad_per_mm"]
    np.testing.assert_allclose(axial, rows["axial_mm"], atol=1e-7)
    assert record["closing_rad_per_mm"] == pytest.approx(SLOPE / RADIUS_MM)
    assert record["tolerance_rad"] > np.radians(0.1) and record["locating"]


def test_accuracy_tolerance_and_constant_change_what_is_exported(found, told, run_folder, tmp_path):
    out, header = tmp_path / "x.json", tmp_path / "x.h"
    export, again = ("export", run_folder, "--out"), ("--overwrite",)
    first = found(*export, out)
    fitted = open_run(run_folder).fit.parameters["constant_backlash_deg"]
    assert first["constant_backlash_deg"] == {"low95": fitted.low95, "high95": fitted.high95}
    told(*export, header)
    text = header.read_text()
    assert "The constant backlash of the fit" in text and "vttig_rig_of_the_paper_shift(" in text
    other = found(*export, out, "--accuracy-arcsec", "0.1", "--tolerance-arcsec", "36", *again)
    assert len(other["harmonics"]) < len(first["harmonics"]) / 2
    assert np.degrees(other["error_rad"]) * 3600 < 0.1
    narrower = np.degrees(first["tolerance_rad"] - other["tolerance_rad"])
    assert narrower == pytest.approx(0.1 - 0.01, abs=1e-9)
    constant = ("--constant-backlash-deg", "0.05", *again)
    moved = found(*export, out, *constant)
    assert np.degrees(moved["constant_rad"]) == pytest.approx(0.05, abs=1e-3)
    assert moved["constant_backlash_deg"] is None
    told(*export, header, *constant)
    assert "The constant backlash of the fit" not in header.read_text()


@pytest.mark.portable
def test_csv_is_the_table_of_the_map(refused, told, found, run_folder, tmp_path, table):
    record = found("export", run_folder, "--out", tmp_path / "compensation.csv")
    assert (record["schema"], record["rows"]) == ("vttig.map/1", 5760)
    assert (tmp_path / "compensation.csv").read_bytes() == table.read_bytes()
    assert not (tmp_path / "compensation.json").exists()
    told("export", run_folder, "--out", tmp_path / "fine.csv", "--step-deg", "0.5")
    assert (tmp_path / "fine.csv").read_text().count("\n") == 11_521
    finer = ("export", run_folder, "--out", tmp_path / "x.csv", "--step-deg", "0.01")
    refused(2, "give --step-deg 0.03 or more", *finer)


def test_bad_calls_end_in_one_sentence(refused, run_folder, monkeypatch):
    monkeypatch.chdir(run_folder.parent)
    for arguments, code, words in (
        ("run", 2, "Missing option '--out'"),
        ("run --out x.txt", 2, "writes .csv, .json or .h"),
        ("run --out x.csv --name a", 2, "a .csv file takes no --name"),
        ("run --out x.json --name a --step-deg 2", 2, "takes no --name and no --step-deg"),
        ("run --out x.h --step-deg 2", 2, "a .h file takes no --step-deg"),
        ("run --out x.h --name 2a", 2, "--name: '2a' cannot begin"),
        ("run --out x.h --accuracy-arcsec -1", 2, "--accuracy-arcsec"),
        ("run --out x.h --tolerance-arcsec nan", 2, "finite number"),
        # A tolerance as wide as the turns is no answer.
        ("run --out x.h --tolerance-arcsec 41000", 4, "do not tell the turn"),
        ("nothing --out x.h", 2, "vttig fit LOG"),
    ):
        refused(code, words, "export", *arguments.split())
        assert not list(run_folder.parent.glob("x.*"))


@pytest.mark.parametrize("verb", ["map", "export"])
@pytest.mark.parametrize("name", ["fit.json", "summary.npz", "run.toml", "pair.toml"])
def test_no_file_of_the_run_is_written_over(refused, run_folder, tmp_path, monkeypatch, verb, name):
    run = shutil.copytree(run_folder, tmp_path / "run")
    (run / "pair.toml").touch()  # as `vttig demo --out` keeps it in its run folder
    monkeypatch.chdir(run)
    before = (run / name).read_bytes()
    any_name = verb == "export" and not name.endswith(".json")
    options = ("--for", "csv", "--travel", "0", "360") if any_name else ()
    for out in (name, run / name):
        refused(3, "of the run itself", verb, run, "--out", out, "--overwrite", *options)
    assert (run / name).read_bytes() == before


def test_the_log_and_what_stands_beside_a_table_are_kept_too(vttig, told, run_folder, tmp_path):
    (log,) = open_run(run_folder).logs
    assert vttig("export", run_folder, "--out", log)[0] == 3
    run = shutil.copytree(run_folder, tmp_path / "run")
    assert vttig("map", run, "--out", run / "fit.csv", "--overwrite")[0] == 3  # fit.json beside it
    told("map", run, "--out", run / "map.csv")


def test_one_flank_needs_the_constant_backlash(refused, found, one_flank_folder, tmp_path):
    export = ("export", one_flank_folder, "--out", tmp_path / "x.h")
    refused(4, "--constant-backlash-deg", *export)
    record = found(*export, "--constant-backlash-deg", "0.038")
    assert record["conditional_on"] == ["perfect_encoders"]
    assert "perfect_encoders" in (tmp_path / "x.h").read_text()


@needs_cc
def test_a_drive_has_a_backlash_and_no_shift(refused, found, tmp_path):
    log = write_drive(tmp_path / "log.csv", delay_s=0.0)
    run = fit_into(tmp_path / "run", log, write_pair(tmp_path / "pair.toml"))
    export = ("export", run, "--out", tmp_path / "drive.h")
    said = refused(2, "no axial displacement closes this gap", *export)
    assert "--quantity backlash" in said
    assert found(*export, "--quantity", "backlash")["closing_rad_per_mm"] is None
    text = (tmp_path / "drive.h").read_text()
    program = compiled(tmp_path, text, "drive", headers.BACKLASH)
    rows = table_of(log)
    driving, driven = (np.radians(rows[f"{shaft}_deg"]) for shaft in ("driving", "driven"))
    backlash, *_, status = called(program, driving, driven, 0.0)
    assert status.mean() < 0.05  # but for the ramps, where the flanks change
    np.testing.assert_allclose(np.degrees(backlash[status == 0]) * 3600, 100.0, atol=3.0)


def test_a_curve_in_place_of_the_driven_channel_has_no_header(refused, told, run_folder, tmp_path):
    run = shutil.copytree(run_folder, tmp_path / "run")
    record = json.loads((run / "fit.json").read_text())
    record["zero_readings"]["driven"] = None
    (run / "fit.json").write_text(json.dumps(record))
    refused(4, "fit a log of both encoders", "export", run, "--out", tmp_path / "x.h")
    told("export", run, "--out", tmp_path / "x.json")

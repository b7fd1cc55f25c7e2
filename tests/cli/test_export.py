import json
import shutil

import jsonschema
import numpy as np
import pytest

from tests.cli.drive import write_drive, write_pair
from tests.control import headers
from tests.control.headers import called, compiled, needs_cc
from tests.schemas import load_schema
from vttig_jax import open_run

COUNTS = 90_000
RADIUS_MM = 80.0
SLOPE = 2 * np.tan(np.radians(3.0))


@pytest.fixture(scope="module")
def log(rig_folder):
    return np.genfromtxt(rig_folder / "log.csv", delimiter=",", names=True)


@pytest.fixture
def table(vttig, run_folder, tmp_path):
    """The map of the run as `vttig map` writes it."""
    path = tmp_path / "by_map.csv"
    assert vttig("map", run_folder, "--out", path)[0] == 0
    return path


READ = """
        const struct rig_displacement shift =
            rig_shift(rig_driving_rad(x[0]), rig_driven_rad(x[1]), x[2]);
        y[0] = shift.shift_mm;
        y[1] = rig_driving_rad(x[0]);
        y[2] = y[3] = 0.0;
        y[4] = shift.status;
"""


@needs_cc
def test_the_header_takes_the_counters_of_the_log(vttig, run_folder, tmp_path, log, table):
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
    rows = np.genfromtxt(table, delimiter=",", names=True)
    expected = np.interp(turned % 5760, rows["driving_deg"], rows["axial_mm"])
    # The tooth mesh bends the map by this much between two degrees of the table.
    np.testing.assert_allclose(shift, expected, atol=0.005)
    foreign = called(program, counts[0], counts[1] + 2000, 0.0)
    assert foreign[4].all() and not foreign[0].any()


def test_json_is_the_map_as_harmonics(vttig_json, run_folder, tmp_path, table):
    path = tmp_path / "compensation.json"
    code, record = vttig_json("export", run_folder, "--out", path)
    assert code == 0
    beside = json.loads(path.read_text())
    assert beside == record
    jsonschema.validate(beside, load_schema("vttig.compensation/1"))
    rows = np.genfromtxt(table, delimiter=",", names=True)
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


def test_accuracy_and_tolerance_change_what_is_kept_and_known(vttig_json, run_folder, tmp_path):
    first = vttig_json("export", run_folder, "--out", tmp_path / "a.json")[1]
    options = ["--accuracy-arcsec", "0.1", "--tolerance-arcsec", "36"]
    other = vttig_json("export", run_folder, "--out", tmp_path / "b.json", *options)[1]
    assert len(other["harmonics"]) < len(first["harmonics"]) / 2
    assert np.degrees(other["error_rad"]) * 3600 < 0.1
    narrower = np.degrees(first["tolerance_rad"] - other["tolerance_rad"])
    assert narrower == pytest.approx(0.1 - 0.01, abs=1e-9)
    moved = vttig_json(
        "export", run_folder, "--out", tmp_path / "c.json", "--constant-backlash-deg", "0.05"
    )[1]
    assert np.degrees(moved["constant_rad"]) == pytest.approx(0.05, abs=1e-3)


def test_the_interval_of_the_fitted_backlash_is_kept_unless_it_is_replaced(
    vttig, vttig_json, run_folder, tmp_path
):
    fitted = open_run(run_folder).fit.parameters["constant_backlash_deg"]
    for constant in ((), ("--constant-backlash-deg", "0.05")):
        json_file, header = tmp_path / f"{len(constant)}.json", tmp_path / f"{len(constant)}.h"
        _, record = vttig_json("export", run_folder, "--out", json_file, *constant)
        ends = record["constant_backlash_deg"]
        assert ends == (None if constant else {"low95": fitted.low95, "high95": fitted.high95})
        assert vttig("export", run_folder, "--out", header, *constant)[0] == 0
        assert ("The constant backlash of the fit" in header.read_text()) is not bool(constant)


@pytest.mark.portable
def test_csv_is_the_table_of_the_map(vttig, vttig_json, run_folder, tmp_path, table):
    code, record = vttig_json("export", run_folder, "--out", tmp_path / "compensation.csv")
    assert (code, record["schema"], record["rows"]) == (0, "vttig.map/1", 5760)
    assert (tmp_path / "compensation.csv").read_bytes() == table.read_bytes()
    assert not (tmp_path / "compensation.json").exists()
    path = tmp_path / "fine.csv"
    assert vttig("export", run_folder, "--out", path, "--step-deg", "0.5")[0] == 0
    assert path.read_text().count("\n") == 11_521
    code, _, err = vttig("export", run_folder, "--out", tmp_path / "x.csv", "--step-deg", "0.01")
    assert code == 2 and "give --step-deg 0.03 or more" in err


def test_names_come_from_the_pair_and_files_repeat(vttig, run_folder, tmp_path):
    for name in ("one.h", "two.h"):
        assert vttig("export", run_folder, "--out", tmp_path / name)[0] == 0
    text = (tmp_path / "one.h").read_text()
    assert "vttig_rig_of_the_paper_shift(" in text
    assert text == (tmp_path / "two.h").read_text()


def test_bad_calls_end_in_one_sentence(vttig, run_folder, monkeypatch):
    for arguments, words in (
        (["export", "run"], "Missing option '--out'"),
        (["export", "run", "--out", "x.txt"], "writes .csv, .json or .h"),
        (["export", "run", "--out", "x.csv", "--name", "a"], "a .csv file takes no --name"),
        (
            ["export", "run", "--out", "x.json", "--name", "a", "--step-deg", "2"],
            "a .json file takes no --name and no --step-deg",
        ),
        (["export", "run", "--out", "x.h", "--step-deg", "2"], "a .h file takes no --step-deg"),
        (["export", "run", "--out", "x.h", "--name", "2a"], "--name: '2a' cannot begin"),
        (["export", "run", "--out", "x.h", "--accuracy-arcsec", "-1"], "--accuracy-arcsec"),
        (["export", "run", "--out", "x.h", "--tolerance-arcsec", "nan"], "finite number"),
        (["export", "nothing", "--out", "x.h"], "vttig fit LOG"),
    ):
        monkeypatch.chdir(run_folder.parent)
        code, out, err = vttig(*arguments)
        assert (code, out) == (2, "")
        assert words in err and err.count("\n") == 1
        assert not list(run_folder.parent.glob("x.*"))


@pytest.mark.parametrize("verb", ["map", "export"])
@pytest.mark.parametrize("name", ["fit.json", "summary.npz", "run.toml", "pair.toml"])
def test_no_file_of_the_run_is_written_over(vttig, run_folder, tmp_path, monkeypatch, verb, name):
    run = shutil.copytree(run_folder, tmp_path / "run")
    (run / "pair.toml").touch()  # as `vttig demo --out` keeps it in its run folder
    monkeypatch.chdir(run)
    before = (run / name).read_bytes()
    options = () if name.endswith(".json") else ("--for", "csv", "--travel", "0", "360")
    for out in (name, run / name):
        asked = options if verb == "export" else ()
        code, shown, err = vttig(verb, run, "--out", out, "--overwrite", *asked)
        assert (code, shown) == (3, "") and err.count("\n") == 1 and "of the run itself" in err
    assert (run / name).read_bytes() == before


def test_the_log_and_what_stands_beside_a_table_are_kept_too(vttig, run_folder, tmp_path):
    (log,) = open_run(run_folder).logs
    assert vttig("export", run_folder, "--out", log)[0] == 3
    run = shutil.copytree(run_folder, tmp_path / "run")
    assert vttig("map", run, "--out", run / "fit.csv", "--overwrite")[0] == 3  # fit.json beside it
    assert vttig("map", run, "--out", run / "map.csv")[0] == 0


@pytest.mark.portable
def test_a_tolerance_as_wide_as_the_turns_is_no_answer(vttig, run_folder, tmp_path):
    code, _, err = vttig(
        "export", run_folder, "--out", tmp_path / "x.h", "--tolerance-arcsec", "41000"
    )
    assert code == 4
    assert "do not tell the turn" in err and "--tolerance-arcsec" in err


def test_overwrite_replaces(vttig, run_folder, tmp_path):
    path = tmp_path / "x.json"
    path.write_text("{}")
    assert vttig("export", run_folder, "--out", path, "--overwrite")[0] == 0
    assert len(path.read_text()) > 1000


def test_one_flank_needs_the_constant_backlash(vttig, vttig_json, one_flank_folder, tmp_path):
    export = ("export", one_flank_folder, "--out", tmp_path / "x.h")
    code, _, err = vttig(*export)
    assert code == 4 and "--constant-backlash-deg" in err
    code, record = vttig_json(*export, "--constant-backlash-deg", "0.038")
    assert code == 0
    assert record["conditional_on"] == ["perfect_encoders"]
    assert "perfect_encoders" in (tmp_path / "x.h").read_text()


@needs_cc
def test_a_drive_has_a_backlash_and_no_shift(vttig, vttig_json, tmp_path):
    log, pair, run = (
        write_drive(tmp_path / "log.csv", delay_s=0.0),
        write_pair(tmp_path / "pair.toml"),
        tmp_path / "run",
    )
    assert vttig("fit", log, "--pair", pair, "--out", run, "--no-figures")[0] == 0
    code, _, err = vttig("export", run, "--out", tmp_path / "drive.h")
    assert code == 2
    assert "no axial displacement closes this gap" in err and "--quantity backlash" in err
    code, record = vttig_json(
        "export", run, "--out", tmp_path / "drive.h", "--quantity", "backlash"
    )
    assert code == 0 and record["closing_rad_per_mm"] is None
    text = (tmp_path / "drive.h").read_text()
    program = compiled(tmp_path, text, "drive", headers.BACKLASH)
    rows = np.genfromtxt(log, delimiter=",", names=True)
    driving, driven = (np.radians(rows[f"{shaft}_deg"]) for shaft in ("driving", "driven"))
    backlash, *_, status = called(program, driving, driven, 0.0)
    assert status.mean() < 0.05  # but for the ramps, where the flanks change
    np.testing.assert_allclose(np.degrees(backlash[status == 0]) * 3600, 100.0, atol=3.0)


def test_a_curve_in_place_of_the_driven_channel_has_no_header(vttig, run_folder, tmp_path):
    run = shutil.copytree(run_folder, tmp_path / "run")
    record = json.loads((run / "fit.json").read_text())
    record["zero_readings"]["driven"] = None
    (run / "fit.json").write_text(json.dumps(record))
    code, _, err = vttig("export", run, "--out", tmp_path / "x.h")
    assert code == 4 and "fit a log of both encoders" in err
    assert vttig("export", run, "--out", tmp_path / "x.json")[0] == 0

import json
import shutil

import numpy as np
import pytest

from tests.cli.drive import write_drive, write_pair
from vttig_jax.runs.map_table import csv_text

COUNTS = 90_000


@pytest.fixture(scope="module")
def log(rig_folder):
    """Time and both counters of the log of the run."""
    return np.genfromtxt(rig_folder / "log.csv", delimiter=",", names=True)


def within_turn(counts: float) -> int:
    return int(counts) % COUNTS


def test_every_moment_of_the_log_is_found_from_readings_within_a_turn(vttig_json, run_folder, log):
    for share in (0.02, 0.31, 0.55, 0.97):
        row = log[int(share * len(log))]
        driving, driven = row["driving_counts"], row["driven_counts"]
        counts = {"driving": within_turn(driving), "driven": within_turn(driven)}
        turned = (driving - log["driving_counts"][0]) / COUNTS
        options = [part for one in counts.items() for part in (f"--{one[0]}-counts", one[1])]
        code, record = vttig_json("locate", run_folder, *options)
        assert code == 0
        assert record["turn"] == int(turned // 1)
        assert record["driving_deg"] == pytest.approx(360 * turned, abs=1e-6)
        assert record["probability"] > 0.999999 > record["runner_up"]["probability"]
    degrees = [
        part
        for shaft, value in counts.items()
        for part in (f"--{shaft}-deg", f"{value * 360 / COUNTS:.3f}")
    ]
    code, other = vttig_json("locate", run_folder, *degrees)
    assert code == 0
    assert other["driving_deg"] == pytest.approx(record["driving_deg"], abs=1e-6)
    assert other["std_arcsec"] < record["std_arcsec"]  # a count is 14″, a thousandth of 1° is 3.6″


def test_backlash_and_shift_are_those_of_the_map(vttig, vttig_json, run_folder, log, tmp_path):
    row = log[20_000]
    counts = [within_turn(row[name]) for name in ("driving_counts", "driven_counts")]
    arguments = ["--driving-counts", counts[0], "--driven-counts", counts[1]]
    _, record = vttig_json("locate", run_folder, *arguments)
    vttig("map", run_folder, "--out", tmp_path / "map.csv", "--step-deg", "0.5")
    table = np.genfromtxt(tmp_path / "map.csv", delimiter=",", names=True)
    for name in ("backlash_deg", "backlash_mm", "axial_mm"):
        expected = np.interp(record["driving_deg"], table["driving_deg"], table[name])
        assert record[name] == pytest.approx(expected, rel=1e-2)
    code, out, err = vttig("locate", run_folder, *arguments)
    assert (code, err) == (0, "")
    assert f"of 0 … {record['hunting_turns'] - 1}" in out
    assert f"{record['driving_deg']:.4f}° of 5760°" in out
    assert f"{record['axial_mm']:.4f} mm" in out
    assert "first sample of the log" in out


@pytest.mark.portable
def test_the_flank_that_carries_is_taken_at_its_word(vttig_json, run_folder, log):
    forward = log[int(0.2 * len(log))]
    counts = [within_turn(forward[name]) for name in ("driving_counts", "driven_counts")]
    arguments = ["--driving-counts", counts[0], "--driven-counts", counts[1]]
    _, on_a = vttig_json("locate", run_folder, *arguments, "--flank", "A")
    _, on_b = vttig_json(
        "locate", run_folder, *arguments, "--flank", "B", "--reading-std-arcsec", "60"
    )
    assert (on_a["flank"], on_b["flank"]) == ("A", "B")
    assert on_a["misfit_arcsec"] < 30
    assert on_b["misfit_arcsec"] == pytest.approx(3600 * on_b["backlash_deg"], abs=30)


def test_digits_say_how_good_a_reading_is(vttig, vttig_json, run_folder, log):
    row = log[20_000]
    degrees = [row[name] * 360 / COUNTS % 360 for name in ("driving_counts", "driven_counts")]
    rounded = ["--driving-deg", f"{degrees[0]:.0f}", "--driven-deg", f"{degrees[1]:.0f}"]
    code, coarse = vttig_json("locate", run_folder, *rounded)
    assert code == 0
    assert coarse["std_arcsec"] == pytest.approx(
        3600 * np.hypot(1, 45 / 80) / np.sqrt(12), rel=0.001
    )
    exact = [f"{rounded[1]}.0000", f"{rounded[3]}.0000"]
    code, _, err = vttig("locate", run_folder, "--driving-deg", exact[0], "--driven-deg", exact[1])
    assert code == 4 and "fit no turn" in err
    code, _, _ = vttig(
        "locate",
        run_folder,
        "--driving-deg",
        exact[0],
        "--driven-deg",
        exact[1],
        "--reading-std-arcsec",
        "2000",
    )
    assert code == 0


@pytest.mark.portable
def test_foreign_readings_and_doubtful_turns_are_no_answer(vttig, run_folder, log):
    row = log[20_000]
    counts = [within_turn(row[name]) for name in ("driving_counts", "driven_counts")]
    code, out, err = vttig(
        "locate", run_folder, "--driving-counts", counts[0], "--driven-counts", counts[1] + 2000
    )
    assert (code, out) == (4, "")
    assert "fit no turn" in err and "--reading-std-arcsec" in err
    arguments = ["--driving-counts", counts[0], "--driven-counts", counts[1]]
    code, _, err = vttig("locate", run_folder, *arguments, "--reading-std-arcsec", "30000")
    assert code == 4
    assert "the turn is not certain" in err and "--flank" in err
    code, _, _ = vttig(
        "locate", run_folder, *arguments, "--reading-std-arcsec", "30000", "--certainty", "0.3"
    )
    assert code == 0
    code, _, err = vttig(
        "locate", run_folder, *arguments, "--reading-std-arcsec", "30000", "--flank", "A"
    )
    assert code == 4 and "--flank" not in err


def test_bad_calls_end_in_one_sentence(vttig, run_folder, monkeypatch):
    for arguments, words in (
        (["locate", "run"], "give one of --driving-deg and --driving-counts"),
        (["locate", "run", "--driving-deg", "1"], "give one of --driven-deg and --driven-counts"),
        (
            ["locate", "run", "--driving-deg", "1", "--driving-counts", "1", "--driven-deg", "1"],
            "give one of --driving-deg",
        ),
        (["locate", "run", "--driving-deg", "1,5", "--driven-deg", "1"], "is not a number"),
        (["locate", "run", "--driving-deg", "nan", "--driven-deg", "1"], "not a finite number"),
        (["locate", "run", "--driving-deg", "1e999", "--driven-deg", "1"], "not a finite number"),
        (["locate", "run", "--driving-deg", "1e30", "--driven-deg", "1"], "is no reading"),
        (["locate", "run", "--driving-counts", "1.5", "--driven-deg", "1"], "valid integer"),
        (
            ["locate", "run", "--driving-counts", "9" * 400, "--driven-deg", "1"],
            "--driving-counts is no reading of an encoder",
        ),
        (["locate", "run", "--certainty", "1"], "--certainty"),
        (["locate", "nothing", "--driving-deg", "1", "--driven-deg", "1"], "vttig fit LOG"),
    ):
        monkeypatch.chdir(run_folder.parent)
        code, out, err = vttig(*arguments)
        assert (code, out) == (2, "")
        assert words in err and err.count("\n") == 1


def test_one_flank_needs_the_constant_backlash(vttig, vttig_json, one_flank_folder, log):
    row = log[20_000]
    driving, driven = (within_turn(row[f"{shaft}_counts"]) for shaft in ("driving", "driven"))
    arguments = ("locate", one_flank_folder, "--driving-counts", driving, "--driven-counts", driven)
    code, _, err = vttig(*arguments)
    assert code == 4 and "--constant-backlash-deg" in err
    code, record = vttig_json(*arguments, "--constant-backlash-deg", "0.038")
    assert code == 0
    assert record["conditional_on"] == ["perfect_encoders"]
    turned = (row["driving_counts"] - log["driving_counts"][0]) / COUNTS
    assert record["driving_deg"] == pytest.approx(360 * turned, abs=1e-6)


# Where the angles of a fit are zero.


def fitted_drive(vttig, folder, *, start_deg=0.0, layout=""):
    """Run folder of a drive 1 : 2 whose columns show what absolute encoders would."""
    log = write_drive(folder / "log.csv", start_deg=start_deg, delay_s=0.0)
    table = np.genfromtxt(log, delimiter=",", names=True)
    names = list(table.dtype.names or ())
    rows = np.stack([table[name] for name in names], axis=1)
    rows[:, names.index("driving_deg")] += start_deg
    rows[:, names.index("driven_deg")] += start_deg
    log.write_text(csv_text(dict(zip(names, rows.T, strict=True))))
    pair = write_pair(folder / "pair.toml")
    pair.write_text(pair.read_text().replace("[log]", f"[log]\n{layout}"))
    run = folder / "run"
    code, _, err = vttig("fit", log, "--pair", pair, "--out", run, "--no-figures")
    assert code == 0, err
    return run, rows[:, names.index("driving_deg")], rows[:, names.index("driven_deg")]


def located(vttig_json, run, driving, driven, row):
    code, record = vttig_json(
        "locate",
        run,
        "--driving-deg",
        f"{driving[row] % 360:.5f}",
        "--driven-deg",
        f"{driven[row] % 360:.5f}",
        "--reading-std-arcsec",
        "20",
    )
    assert code == 0
    assert record["axial_mm"] is record["backlash_mm"] is None
    return record


@pytest.mark.parametrize(("layout", "zero"), [("", "start"), ('zero = "reading"', "reading")])
def test_a_fit_from_the_first_sample_takes_its_reading_off(
    vttig, vttig_json, tmp_path, layout, zero
):
    run, driving, driven = fitted_drive(vttig, tmp_path, start_deg=37.0, layout=layout)
    off = driving[0] if zero == "start" else 0.0
    for row in (200, 300, 400):
        record = located(vttig_json, run, driving, driven, row)
        assert record["zero"] == zero
        assert record["driving_deg"] == pytest.approx((driving[row] - off) % 720, abs=1e-4)


def test_the_unit_of_the_first_reading_is_asked_of_names_then_of_the_log(
    vttig, vttig_json, tmp_path
):
    run, driving, driven = fitted_drive(vttig, tmp_path, start_deg=37.0)
    (tmp_path / "log.csv").rename(tmp_path / "gone.csv")
    arguments = ["locate", run, "--driving-deg", "1.00", "--driven-deg", "1.00"]
    code, _, err = vttig(*arguments)
    assert code == 3
    assert "in which unit only the log says" in err and "[log]" in err
    shutil.copy(tmp_path / "gone.csv", tmp_path / "log.csv")
    located(vttig_json, run, driving, driven, 300)
    (tmp_path / "log.csv").write_text((tmp_path / "gone.csv").read_text() + "\n")
    assert vttig(*arguments)[0] == 3  # another log says nothing
    named = tmp_path / "named"
    named.mkdir()
    layout = 'driving = "driving_deg"\ndriven = "driven_deg"'
    run, driving, driven = fitted_drive(vttig, named, start_deg=37.0, layout=layout)
    (named / "log.csv").unlink()
    record = located(vttig_json, run, driving, driven, 300)
    assert record["driving_deg"] == pytest.approx((driving[300] - driving[0]) % 720, abs=1e-4)


def test_a_drive_has_no_counts_unless_its_file_says_so(vttig, tmp_path):
    run, *_ = fitted_drive(vttig, tmp_path)
    code, _, err = vttig("locate", run, "--driving-counts", "5", "--driven-deg", "1.00")
    assert code == 2
    assert "how many counts make a revolution of the driving shaft" in err


def test_a_curve_in_place_of_the_driven_channel_has_no_reading(vttig, tmp_path):
    run, *_ = fitted_drive(vttig, tmp_path)
    record = json.loads((run / "fit.json").read_text())
    record["zero_readings"]["driven"] = None
    (run / "fit.json").write_text(json.dumps(record))
    code, _, err = vttig("locate", run, "--driving-deg", "1.00", "--driven-deg", "1.00")
    assert code == 4
    assert "fit a log of both encoders" in err

import shutil

import numpy as np
import pytest

from tests.cli.commands import fit_into, table_of
from tests.cli.drive import write_drive, write_pair
from vttig_jax.runs.map_table import csv_text

COUNTS = 90_000


@pytest.fixture(scope="module")
def log(rig_folder):
    """Time and both counters of the log of the run."""
    return table_of(rig_folder / "log.csv")


def counts_of(row) -> tuple:
    """Options with both readings within a turn."""
    shafts = ("driving", "driven")
    return tuple(
        part for s in shafts for part in (f"--{s}-counts", int(row[f"{s}_counts"]) % COUNTS)
    )


@pytest.fixture
def call(run_folder, log) -> tuple:
    """The command for a moment in the middle of the log."""
    return ("locate", run_folder, *counts_of(log[20_000]))


def test_every_moment_of_the_log_is_found_from_readings_within_a_turn(found, run_folder, log):
    for share in (0.02, 0.31, 0.55, 0.97):
        row = log[int(share * len(log))]
        turned = (row["driving_counts"] - log["driving_counts"][0]) / COUNTS
        record = found("locate", run_folder, *counts_of(row))
        assert record["turn"] == int(turned // 1)
        assert record["driving_deg"] == pytest.approx(360 * turned, abs=1e-6)
        assert record["probability"] > 0.999999 > record["runner_up"]["probability"]
    _, driving, _, driven = counts_of(row)
    driving_deg, driven_deg = (f"{360 * value / COUNTS:.3f}" for value in (driving, driven))
    degrees = ("--driving-deg", driving_deg, "--driven-deg", driven_deg)
    other = found("locate", run_folder, *degrees)
    assert other["driving_deg"] == pytest.approx(record["driving_deg"], abs=1e-6)
    assert other["std_arcsec"] < record["std_arcsec"]  # a count is 14″, a thousandth of 1° is 3.6″


def test_backlash_and_shift_are_those_of_the_map(vttig, told, found, run_folder, call, tmp_path):
    record = found(*call)
    told("map", run_folder, "--out", tmp_path / "map.csv", "--step-deg", "0.5")
    table = table_of(tmp_path / "map.csv")
    for name in ("backlash_deg", "backlash_mm", "axial_mm"):
        expected = np.interp(record["driving_deg"], table["driving_deg"], table[name])
        assert record[name] == pytest.approx(expected, rel=1e-2)
    code, out, err = vttig(*call)
    assert (code, err) == (0, "")
    for words in (
        f"of 0 … {record['hunting_turns'] - 1}",
        f"{record['driving_deg']:.4f}° of 5760°",
        f"{record['axial_mm']:.4f} mm",
        "first sample of the log",
    ):
        assert words in out


@pytest.mark.portable
def test_the_flank_that_carries_is_taken_at_its_word(found, run_folder, log):
    call = ("locate", run_folder, *counts_of(log[int(0.2 * len(log))]))
    on_a = found(*call, "--flank", "A")
    on_b = found(*call, "--flank", "B", "--reading-std-arcsec", "60")
    assert (on_a["flank"], on_b["flank"]) == ("A", "B") and on_a["misfit_arcsec"] < 30
    assert on_b["misfit_arcsec"] == pytest.approx(3600 * on_b["backlash_deg"], abs=30)


def test_digits_say_how_good_a_reading_is(refused, told, found, run_folder, log):
    row = log[20_000]
    driving, driven = (
        f"{row[f'{shaft}_counts'] * 360 / COUNTS % 360:.0f}" for shaft in ("driving", "driven")
    )
    coarse = found("locate", run_folder, "--driving-deg", driving, "--driven-deg", driven)
    rounding = 3600 * np.hypot(1, 45 / 80) / np.sqrt(12)
    assert coarse["std_arcsec"] == pytest.approx(rounding, rel=0.001)
    exact = ("--driving-deg", f"{driving}.0000", "--driven-deg", f"{driven}.0000")
    refused(4, "fit no turn", "locate", run_folder, *exact)
    told("locate", run_folder, *exact, "--reading-std-arcsec", "2000")


@pytest.mark.portable
def test_foreign_readings_and_doubtful_turns_are_no_answer(refused, told, call):
    said = refused(4, "fit no turn", *call[:-1], call[-1] + 2000)
    assert "--reading-std-arcsec" in said
    loose = (*call, "--reading-std-arcsec", "30000")
    assert "--flank" in refused(4, "the turn is not certain", *loose)
    told(*loose, "--certainty", "0.3")
    assert "--flank" not in refused(4, "the turn is not certain", *loose, "--flank", "A")


def test_bad_calls_end_in_one_sentence(refused, run_folder, monkeypatch):
    monkeypatch.chdir(run_folder.parent)
    for arguments, words in (
        ("run", "give one of --driving-deg and --driving-counts"),
        ("run --driving-deg 1", "give one of --driven-deg and --driven-counts"),
        ("run --driving-deg 1 --driving-counts 1 --driven-deg 1", "give one of --driving-deg"),
        ("run --driving-deg 1,5 --driven-deg 1", "is not a number"),
        ("run --driving-deg nan --driven-deg 1", "not a finite number"),
        ("run --driving-deg 1e999 --driven-deg 1", "not a finite number"),
        ("run --driving-deg 1e30 --driven-deg 1", "is no reading"),
        ("run --driving-counts 1.5 --driven-deg 1", "valid integer"),
        (f"run --driven-deg 1 --driving-counts {'9' * 400}", "--driving-counts is no reading of"),
        ("run --certainty 1", "--certainty"),
        ("nothing --driving-deg 1 --driven-deg 1", "vttig fit LOG"),
    ):
        refused(2, words, "locate", *arguments.split())


def test_one_flank_needs_the_constant_backlash(refused, found, one_flank_folder, log):
    row = log[20_000]
    call = ("locate", one_flank_folder, *counts_of(row))
    refused(4, "--constant-backlash-deg", *call)
    record = found(*call, "--constant-backlash-deg", "0.038")
    assert record["conditional_on"] == ["perfect_encoders"]
    turned = (row["driving_counts"] - log["driving_counts"][0]) / COUNTS
    assert record["driving_deg"] == pytest.approx(360 * turned, abs=1e-6)


# Where the angles of a fit are zero.


def fitted_drive(folder, *, start_deg=0.0, layout=""):
    """Run folder of a drive 1 : 2 whose columns show what absolute encoders would."""
    log = write_drive(folder / "log.csv", start_deg=start_deg, delay_s=0.0)
    table = table_of(log)
    columns = {name: table[name] for name in table.dtype.names or ()}
    angles = [columns[f"{shaft}_deg"] + start_deg for shaft in ("driving", "driven")]
    columns |= {"driving_deg": angles[0], "driven_deg": angles[1]}
    log.write_text(csv_text(columns))
    pair = write_pair(folder / "pair.toml")
    pair.write_text(pair.read_text().replace("[log]", f"[log]\n{layout}"))
    return fit_into(folder / "run", log, pair), *angles


@pytest.fixture
def located(found):
    """Function that locates a row of the angles of a drive."""

    def locate(run, driving, driven, row):
        degrees = (f"{angle[row] % 360:.5f}" for angle in (driving, driven))
        shafts = zip(("--driving-deg", "--driven-deg"), degrees, strict=True)
        options = (part for one in shafts for part in one)
        record = found("locate", run, *options, "--reading-std-arcsec", "20")
        assert record["axial_mm"] is record["backlash_mm"] is None
        return record

    return locate


@pytest.mark.parametrize(("layout", "zero"), [("", "start"), ('zero = "reading"', "reading")])
def test_a_fit_from_the_first_sample_takes_its_reading_off(located, tmp_path, layout, zero):
    run, driving, driven = fitted_drive(tmp_path, start_deg=37.0, layout=layout)
    off = driving[0] if zero == "start" else 0.0
    for row in (200, 300, 400):
        record = located(run, driving, driven, row)
        assert record["zero"] == zero
        assert record["driving_deg"] == pytest.approx((driving[row] - off) % 720, abs=1e-4)


def test_the_unit_of_the_first_reading_is_asked_of_names_then_of_the_log(
    refused, located, tmp_path
):
    run, driving, driven = fitted_drive(tmp_path, start_deg=37.0)
    log, gone = tmp_path / "log.csv", tmp_path / "gone.csv"
    log.rename(gone)
    call = ("locate", run, "--driving-deg", "1.00", "--driven-deg", "1.00")
    assert "[log]" in refused(3, "in which unit only the log says", *call)
    shutil.copy(gone, log)
    located(run, driving, driven, 300)
    log.write_text(gone.read_text() + "\n")
    refused(3, "", *call)  # another log says nothing
    (tmp_path / "named").mkdir()
    layout = 'driving = "driving_deg"\ndriven = "driven_deg"'
    run, driving, driven = fitted_drive(tmp_path / "named", start_deg=37.0, layout=layout)
    (tmp_path / "named" / "log.csv").unlink()
    record = located(run, driving, driven, 300)
    assert record["driving_deg"] == pytest.approx((driving[300] - driving[0]) % 720, abs=1e-4)


def test_a_drive_has_no_counts_unless_its_file_says_so(refused, tmp_path):
    run, *_ = fitted_drive(tmp_path)
    words = "how many counts make a revolution of the driving shaft"
    refused(2, words, "locate", run, "--driving-counts", "5", "--driven-deg", "1.00")

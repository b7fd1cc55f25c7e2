"""`vttig export --for`: error tables of an axis, beside a transmission error written down here."""

import re

import numpy as np
import pytest

from tests.cli.known_error import GAP_ARCSEC, error_arcsec, fitted, worm_arcsec
from vttig_jax.control.compensation.table_formats import read_linuxcnc


@pytest.fixture
def export(vttig_json, tmp_path):
    def run(folder, control, *options):
        out = tmp_path / "table"
        return (*vttig_json("export", folder, "--for", control, "--out", out, *options), out)

    return run


def left_arcsec(rows, flank, column, shift_deg=0.0):
    """What an axis that is corrected by rows shows, by the true error of the drive 1 : 2."""
    asked = np.linspace(1.0, 359.0, 3000)
    added = np.interp(asked, rows[:, 0], rows[:, column])
    driving = 2 * np.radians(asked + added - shift_deg)
    level = error_arcsec("A", np.linspace(0, 4 * np.pi, 4096)).mean()
    return 3600 * added + error_arcsec(flank, driving) - level


def test_a_table_takes_out_the_error_of_both_directions(export, both):
    code, record, out = export(both, "linuxcnc", "--acceleration-deg-s2", "1000")
    assert code == 0 and record["schema"] == "vttig.correction/1"
    rows, *_ = read_linuxcnc(out.read_text())
    assert len(rows) == 256 and record["ini"] == {"COMP_FILE": "table", "COMP_FILE_TYPE": 1}
    for column, (flank, name) in enumerate((("A", "forward"), ("B", "reverse")), 1):
        left = left_arcsec(rows, flank, column)
        before = record["before_arcsec"][name]["rms"]
        # The level of the encoders is no error of the gears.
        assert np.std(left) < 0.03 * before
        assert record["after_arcsec"][name]["rms"] < 0.03 * before
    forward, reverse = (left_arcsec(rows, f, c).mean() for c, f in ((1, "A"), (2, "B")))
    assert reverse - forward == pytest.approx(0.0, abs=0.5)
    assert record["lost_motion_arcsec"]["before"] > GAP_ARCSEC
    steepest = np.abs(np.diff(rows[:, 1:], axis=0)).max() / (360 / 255)
    assert record["fastest_deg_s"] == pytest.approx(0.25 / steepest, rel=1e-3)


def test_the_zero_and_the_sense_of_the_axis(export, both):
    shift_deg = 77.5
    code, record, _ = export(both, "json", "--axis-zero-deg", shift_deg)
    assert code == 0 and record["positions_deg"][0] == pytest.approx(shift_deg, abs=1e-4)
    ahead = np.stack([record["positions_deg"], record["corrections_deg"]["forward"]], axis=1)
    asked = np.linspace(shift_deg, shift_deg + 360, 500)
    added = np.interp(asked, *ahead.T)
    driving = 2 * np.radians(asked + added - shift_deg)
    assert np.std(3600 * added + error_arcsec("A", driving)) < 1.0
    _, behind, _ = export(both, "json", "--axis-zero-deg", shift_deg, "--reversed", "--overwrite")
    # Counted the other way, flank B carries forward, and what was ahead is behind.
    added = np.interp(asked, behind["positions_deg"], behind["corrections_deg"]["forward"])
    driving = -2 * np.radians(asked + added - shift_deg)
    left = 3600 * added - error_arcsec("B", driving)
    assert np.std(left) < 1.0
    # The direction in which an axis is homed has the mean zero, whichever flank carries it.
    level = error_arcsec("B", np.linspace(0, 4 * np.pi, 4096)).mean()
    assert np.mean(left) == pytest.approx(-level, abs=0.5)


def test_one_direction_of_a_worm_over_its_own_turn(export, worm):
    code, record, out = export(worm, "csv", "--axis", "driving")
    assert code == 0 and set(record["corrections_deg"]) == {"forward"}
    table = np.genfromtxt(out, delimiter=",", names=True)
    driving = np.radians(table["position_deg"] + table["forward_correction_deg"])
    added = 3600 * table["forward_correction_deg"] / 40 + worm_arcsec("A", driving)
    assert np.std(added) < 1.0 < 0.05 * np.std(worm_arcsec("A", driving))


def test_the_table_of_a_part_of_a_turn_takes_out_what_the_log_covers(refused, export, tmp_path):
    """Less than a turn of the axis, over which its slow orders are a bend of the log."""

    def error(flank, driving):
        return error_arcsec(flank, driving, 1 / 40)

    short = fitted(tmp_path / "short", error, "--delay", "off", ratio=1 / 40)
    code, record, out = export(short, "json", "--travel", "4", "60")
    assert code == 0
    asked, positions = np.linspace(4, 60, 2000), record["positions_deg"]
    for flank, direction in (("A", "forward"), ("B", "reverse")):
        added = np.interp(asked, positions, record["corrections_deg"][direction])
        left = 3600 * added + error(flank, np.radians(40 * (asked + added)))
        high = record["after_arcsec"][direction]["rms95"][1]
        assert np.std(left) < high < 0.15 * record["before_arcsec"][direction]["rms"]
    assert record["lost_motion_arcsec"]["before"] > 0.5 * GAP_ARCSEC
    out.unlink()
    again = ("export", short, "--for", "json", "--out", out)
    refused(2, "", *again, "--travel", "60", "200")
    # What is covered is said in positions of the axis, of which the zero is elsewhere.
    said = refused(2, "", *again, "--axis-zero-deg", "100", "--travel", "104", "400")
    first, last = map(float, re.findall(r"([\d.]+)°", said))
    assert first == pytest.approx(104, abs=0.1) and 160 < last < 200


def test_a_table_that_is_held_over_further_turns_is_refused(export, run_folder):
    code, record, _ = export(run_folder, "linuxcnc", "--travel", "0", "360")
    assert code == 0
    left = max(one["rms"] for one in record["after_arcsec"].values())
    beyond = ("--travel", "0", "360", "--over", "0", "3240", "--overwrite")
    code, record, _ = export(run_folder, "linuxcnc", *beyond)
    held = [one["rms"] for one in record.get("after_arcsec", {}).values()]
    assert code == 4 or (code == 0 and min(held) > 5 * left)


def test_what_makes_no_table_writes_nothing(export, vttig, run_folder, both, tmp_path):
    for options in (
        "",  # the turns of 45/80 do not repeat
        "--travel 10 10",
        "--travel 0 360 --step-deg 7",
        "--travel 0 360 --step-deg 1",  # 361 rows
        "--place-unknown --travel 0 400",
        "--travel 0 360 --gap low95",
        "--travel 0 360 --name axis",
    ):
        code, record, out = export(run_folder, "linuxcnc", *options.split())
        assert code == 2 and record["schema"] == "vttig.error/1" and not out.exists()
    # Options of an axis are of no use without a control.
    assert vttig("export", both, "--out", tmp_path / "map.csv", "--travel", "0", "360")[0] == 2


def test_the_mean_of_the_turns(export, run_folder):
    code, record, _ = export(run_folder, "json", "--place-unknown")
    assert code == 0 and record["turns"] == 9 and not record["place_known"]
    for name, before in record["before_arcsec"].items():
        assert record["after_arcsec"][name]["rms"] < before["rms"]


def test_what_linuxcnc_would_read_of_a_file(vttig, told, found, export, both):
    *_, out = export(both, "linuxcnc")
    read = ("inspect", out, "--for", "linuxcnc")
    record, rows = found(*read), np.loadtxt(out.read_text().splitlines()[:256])
    assert record["schema"] == "vttig.comp-file/1"
    assert (record["rows"], record["comp_file_type"]) == (256, 1)
    largest = np.abs(rows[:, 1:]).max()
    assert record["largest"] == pytest.approx(largest)
    said = told(*read)
    assert "COMP_FILE_TYPE" in said and f"{largest:.4g}" in said
    # The same as positions, for COMP_FILE_TYPE = 0.
    np.savetxt(out, rows + rows[:, :1] * [0, 1, 1])
    record = found(*read)
    assert record["comp_file_type"] == 0 and record["largest"] == pytest.approx(largest, rel=1e-6)
    assert vttig(*read, "--ratio", "1:2")[0] == 2
    out.write_text("# forward, reverse\n1, 2, 3\n")
    assert vttig(*read)[0] == 3 and "Line 1 " in vttig(*read)[2]
    assert vttig("inspect", out.with_name("none"), "--for", "linuxcnc")[0] == 3


def test_beckhoff_is_twincat_and_c_is_a_header(export, both):
    texts = []
    for control in ("twincat", "beckhoff", "c"):
        *_, out = export(both, control, "--name", "axis_2", "--overwrite")
        texts.append(out.read_text())
    assert texts[0] == texts[1] and "axis_2_forward_deg(double position_deg)" in texts[2]
    assert export(both, "c", "--name", "2 x", "--overwrite")[0] == 2

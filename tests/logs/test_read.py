import hashlib

import numpy as np
import pytest
from scipy.io import savemat

from tests.logs.profiles import DEG, drive, spec
from vttig_jax.base.errors import LogError, UsageError
from vttig_jax.logs.read import read_log
from vttig_jax.logs.readers.delimited import TextTable
from vttig_jax.logs.recognition.questions import LogQuestion
from vttig_jax.pair.pair_file import parse_pair_spec

PAIR = spec()
COUNT = 200
FIRST = 450 * np.arange(COUNT)
SECOND = FIRST * 9 // 16


def write(tmp_path, header="time_s,driving_counts,driven_counts", rows=None, name="log.csv"):
    if rows is None:
        rows = [f"{k / 100:.2f},{FIRST[k]},{SECOND[k]}" for k in range(COUNT)]
    path = tmp_path / name
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def test_counts(tmp_path):
    path = write(tmp_path)
    log = read_log(path, PAIR)
    np.testing.assert_array_equal(log.driving.reading, FIRST)
    np.testing.assert_allclose(log.time, np.arange(COUNT) / 100)
    assert log.source == str(path)
    assert log.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_same_log_in_other_dress(tmp_path):
    plain = read_log(write(tmp_path), PAIR)
    rows = [
        f"{k * 10};{FIRST[k] / 250:.3f};{SECOND[k] / 250:.3f}".replace(".", ",")
        for k in range(COUNT)
    ]
    german = read_log(write(tmp_path, "time_ms;driving [deg];driven (deg)", rows), PAIR)
    np.testing.assert_allclose(german.time, plain.time, rtol=1e-14)
    np.testing.assert_allclose(german.driving_angle, plain.driving_angle, atol=1e-12)
    np.testing.assert_allclose(german.transmission_error, plain.transmission_error, atol=1e-12)


def test_columns_and_sample_rate_win_over_the_pair_file(tmp_path):
    rows = [f"{k / 100:.2f},{FIRST[k]},{SECOND[k]},{2 * FIRST[k]}" for k in range(COUNT)]
    path = write(tmp_path, "t_s,a_counts,b_counts,c_counts", rows)
    pair = spec(time="t_s", driving="a_counts", driven="b_counts")
    assert read_log(path, pair).driving.reading[1] == 450
    other = read_log(path, pair, columns={"driving": "c_counts"})
    assert other.driving.reading[1] == 900
    assert read_log(path, pair, sample_rate_hz=50).time[1] == pytest.approx(0.02)
    rated = spec(sample_rate_hz=20.0, driving="a_counts", driven="b_counts")
    assert read_log(path, rated).time[1] == pytest.approx(0.05)
    assert read_log(path, rated, sample_rate_hz=50.0).time[1] == pytest.approx(0.02)
    assert read_log(path, rated, columns={"time": "t_s"}).time[1] == pytest.approx(0.01)


def test_layout_of_the_pair_file(tmp_path):
    rows = [f"{k / 100:.2f}".replace(".", ",") + f" {FIRST[k]} {SECOND[k]}" for k in range(COUNT)]
    path = write(tmp_path, "time_s driving_counts driven_counts", rows)
    assert read_log(path, spec(delimiter="space")).time[1] == 0.01
    with pytest.raises(LogError):
        read_log(path, spec(delimiter=";"))
    rows = [row.replace(",", "§") for row in rows]
    path.write_bytes("\n".join(["φ", "time_s driving_counts driven_counts", *rows]).encode("utf-8"))
    with pytest.raises(LogError, match="not ascii"):
        read_log(path, spec(encoding="ascii"))


def test_decimal_of_call_and_pair_file(tmp_path):
    rows = [f"{k},{FIRST[k]},{SECOND[k]}" for k in range(9)]
    rows = [row.replace(",", " ") for row in rows]
    rows = [f"0,{k:03d} {row.split(' ', 1)[1]}" for k, row in enumerate(rows)]
    path = write(tmp_path, "time_s driving_counts driven_counts", rows)
    with pytest.raises(LogError, match=r"`0,000` means 0\.000 or 0000"):
        read_log(path, PAIR)
    assert read_log(path, PAIR, decimal=",").time[1] == 0.001
    assert read_log(path, spec(decimal=",")).time[1] == 0.001
    assert read_log(path, spec(decimal=","), decimal=".").time[1] == 1.0


def test_curve_with_further_columns(tmp_path):
    rows = [f"{k},{3 * k},{np.sin(k):.4f},{k % 2},{k * 0.5},{k * 10}" for k in range(COUNT)]
    header = "time_s,driving_deg,transmission_error_arcsec,way,load,shift_um"
    layout = {"direction": "way", "torque": "load", "axial_mm": "shift_um"}
    log = read_log(write(tmp_path, header, rows), drive("1/225", **layout))
    np.testing.assert_allclose(
        log.transmission_error, np.round(np.sin(np.arange(COUNT)), 4) * DEG / 3600, rtol=1e-12
    )
    assert log.direction is not None and log.direction[3] == 1
    assert log.torque is not None and log.torque[3] == 1.5
    assert log.axial_mm is not None and log.axial_mm[3] == pytest.approx(0.03)
    assert read_log(write(tmp_path, header, rows), drive("1/225")).torque is None


def test_speed_and_acceleration(tmp_path):
    rows = [f"{k / 100:.2f},{FIRST[k]},{SECOND[k]},{k},{-k}" for k in range(COUNT)]
    path = write(tmp_path, "time_s,driving_counts,driven_counts,w_rpm,a_deg_per_s2", rows)
    log = read_log(path, spec(speed="w_rpm"), columns={"acceleration": "a_deg_per_s2"})
    assert log.speed is not None and log.acceleration is not None
    np.testing.assert_allclose(log.speed, np.arange(COUNT) * 2 * np.pi / 60, rtol=1e-14)
    np.testing.assert_allclose(log.acceleration, -np.arange(COUNT) * DEG, rtol=1e-14)
    assert read_log(path, PAIR).speed is None


def test_time_without_a_unit_is_noted(tmp_path):
    log = read_log(write(tmp_path, "time,driving_counts,driven_counts"), PAIR)
    assert "in seconds" in log.notes[0]
    assert read_log(write(tmp_path), PAIR).notes == ()


@pytest.mark.parametrize(
    ("edit", "where", "words"),
    [
        (
            lambda rows: [*rows[:5], "0.05,nan,9", *rows[6:]],
            "line 7, column `driving_counts`",
            "nan",
        ),
        (
            lambda rows: [*rows[:5], "x,1,9", *rows[6:]],
            "line 7, column `time_s`",
            "`x` is no number",
        ),
        (lambda rows: [*rows[:5], "", "# x", *rows[3:]], "line 9, column `time_s`", "backwards"),
        (lambda rows: rows[:2], "column `time_s`", "only 2 samples"),
        (lambda rows: [], "line 1", "without a single line"),
        (lambda rows: [r.rsplit(",", 1)[0] + ",7" for r in rows], "`driven_counts`", "constant"),
    ],
)
def test_bad_rows(tmp_path, edit, where, words):
    rows = [f"{k / 100:.2f},{FIRST[k]},{SECOND[k]}" for k in range(COUNT)]
    with pytest.raises(LogError) as caught:
        read_log(write(tmp_path, rows=edit(rows)), PAIR)
    assert where in caught.value.where and words in caught.value.message, caught.value


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"columns": {"load": "x"}}, "`load` is no role"),
        ({"decimal": ";"}, "decimal must be"),
        ({"sample_rate_hz": 0.0}, "positive"),
        ({"sample_rate_hz": 9, "columns": {"time": "t"}}, "a sample rate and a time column"),
    ],
)
def test_wrong_options(tmp_path, options, words):
    with pytest.raises(UsageError, match=words):
        read_log(write(tmp_path), PAIR, **options)


def test_plain_numbers_are_not_read_field_by_field(tmp_path, monkeypatch):
    """Only the last row is, which may be cut off."""
    read, field = [], TextTable._field
    monkeypatch.setattr(TextTable, "_field", lambda *call: read.append(call) or field(*call))
    plain = read_log(write(tmp_path), PAIR)
    rows = [f"{k / 100:.2f};{FIRST[k]};{SECOND[k]}".replace(".", ",") for k in range(COUNT)]
    comma = read_log(write(tmp_path, "time_s;driving_counts;driven_counts", rows), PAIR)
    np.testing.assert_array_equal(comma.time, plain.time)
    assert len(read) < 20
    read_log(
        write(tmp_path, rows=[f'"0,{k:03d}",{450 * k},{253 * k}' for k in range(COUNT)]),
        PAIR,
        decimal=",",
    )
    assert len(read) > COUNT


def test_a_cut_last_line_is_noted(tmp_path):
    path = write(tmp_path)
    path.write_bytes(path.read_bytes()[:-8])
    log = read_log(path, PAIR)
    assert len(log) == COUNT - 1
    assert log.notes == (f"the last line ({COUNT + 1}) is cut off and left out",)
    path.write_text(path.read_text()[: -len("1.98")])
    assert read_log(path, PAIR).notes == log.notes


def test_mixed_line_ends_marks_and_blank_ends(tmp_path):
    plain = read_log(write(tmp_path), PAIR)
    lines = (tmp_path / "log.csv").read_text().splitlines()
    ends = ["\r\n", "\n", "\r"]
    text = "".join(line + ends[k % 3] for k, line in enumerate(lines)) + "\r\n \r\n"
    for encoding in ("utf-8", "utf-8-sig", "cp1252", "utf-16", "utf-16-le"):
        path = tmp_path / f"{encoding}.csv"
        path.write_bytes(text.encode(encoding))
        log = read_log(path, PAIR)
        np.testing.assert_array_equal(log.driving.reading, plain.driving.reading)
        assert len(log.notes) == (encoding == "utf-16-le")


def test_thousands(tmp_path):
    plain = read_log(write(tmp_path), PAIR)
    for mark, decimal in ((",", "."), (".", ","), ("'", None), ("\u202f", None)):
        rows = [f"0,{k:03d};{f'{FIRST[k]:,}'.replace(',', mark)};{SECOND[k]}" for k in range(COUNT)]
        if decimal == ".":
            rows = [row.replace("0,", "0.", 1) for row in rows]
        path = write(tmp_path, "time_s;driving_counts;driven_counts", rows)
        log = read_log(path, PAIR, decimal=decimal)
        np.testing.assert_array_equal(log.driving.reading, plain.driving.reading)


def test_numbers_of_columns_without_a_header(tmp_path):
    rows = [f"{k / 100:.2f},{FIRST[k]},{SECOND[k]}" for k in range(1, COUNT)]
    path = write(tmp_path, f"0.00,{FIRST[0]},{SECOND[0]}", rows)
    pair = spec(time="#1", driving="#2", unit={"driving": "counts", "driven": "counts"})
    log = read_log(path, pair, columns={"driven": "#3"})
    np.testing.assert_array_equal(log.driving.reading, FIRST)
    assert log.time[1] == 0.01
    with pytest.raises(LogQuestion) as caught:
        read_log(path, PAIR)
    assert caught.value.slug == "no-time"


def test_row_numbers(tmp_path):
    path = write(tmp_path)
    pair = spec(driving="#row", driving_encoder={"counts_per_rev": 200}, unit={"driving": "counts"})
    log = read_log(path, pair)
    assert log.driving.reading.dtype == np.int64
    np.testing.assert_array_equal(log.driving.reading, np.arange(COUNT))
    assert read_log(path, PAIR, columns={"time": "#row"}).time[-1] == COUNT - 1


def nested(tmp_path, **arrays):
    path = tmp_path / "log.mat"
    counts = {"driving_counts": FIRST, "driven_counts": SECOND, "time_s": np.arange(COUNT) / 100}
    savemat(path, {"rec": counts | arrays})
    return path


def test_nested_file(tmp_path):
    log = read_log(nested(tmp_path), PAIR)
    np.testing.assert_array_equal(log.driving.reading, FIRST)
    assert log.driving.reading.dtype == np.int64
    assert log.time[1] == 0.01 and log.notes == ()
    assert log.sha256 == hashlib.sha256((tmp_path / "log.mat").read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("arrays", "columns", "where", "words"),
    [
        (
            {"driven_counts": SECOND[:-1]},
            {},
            "column `rec.driven_counts`",
            "199 values, but `rec.driving_counts` has 200",
        ),
        (
            {"time_s": np.append(np.arange(COUNT - 1.0), np.nan)},
            {},
            "sample 199, column `rec.time_s`",
            "nan",
        ),
        ({}, {"driving": "motor_deg"}, "log.mat", "no column motor_deg; the log has rec."),
        ({}, {"driving": "#9"}, "log.mat", "no column #9; the log has 3"),
    ],
)
def test_bad_nested_files(tmp_path, arrays, columns, where, words):
    with pytest.raises(LogError) as caught:
        read_log(nested(tmp_path, **arrays), PAIR, columns=columns)
    assert where in caught.value.where and words in caught.value.message, caught.value


def test_matlab_log_of_a_robot_is_the_table_made_of_it(data_dir):
    folder = data_dir / "kuka_kr300"
    exact, printed = "7/1798", {"time": "t_s", "driving_scale": "1798/7"}
    text = drive(exact, driving="mot1_deg", driven="se1_deg", torque="tau1_Nm", **printed)
    names = {"driving": "act_pos_mot_deg(1,:)", "driven": "rec.act_pos_se_deg(1, :)"}
    layout = names | {"torque": "act_torque_abs_nm(1,:)", "driving_scale": "1798/7"}
    csv = read_log(folder / "kr300_A_axes123.csv", text)
    for time in ({"time": "rec.time_cont"}, {"sample_rate_hz": 250.0}):
        mat = read_log(folder / "kr300_A.mat", drive(exact, **layout, **time))
        np.testing.assert_allclose(mat.time, csv.time, rtol=0, atol=5e-4)
        assert mat.driven is not None and csv.driven is not None
        assert mat.torque is not None and csv.torque is not None
        np.testing.assert_allclose(mat.driving.reading, csv.driving.reading, rtol=0, atol=5.1e-8)
        np.testing.assert_allclose(mat.driven.reading, csv.driven.reading, rtol=0, atol=5.1e-8)
        np.testing.assert_allclose(mat.torque, csv.torque, rtol=0, atol=5.1e-5)
    with pytest.raises(
        LogError, match=r"6 columns fit `act_pos_mot_deg` \(rec.act_pos_mot_deg\(1…6"
    ):
        read_log(folder / "kr300_A.mat", drive(exact, **layout | {"driving": "act_pos_mot_deg"}))


def test_calibration_table_of_an_encoder(data_dir):
    layout = {"driving": "#1", "driven": "#row", "sample_rate_hz": 1000.0}
    pair = parse_pair_spec(
        {
            "drive": {"ratio": "1"},
            "driven": {"encoder": {"counts_per_rev": 16384}},
            "log": layout,
            "unit": {"driving": "deg", "driven": "counts"},
        }
    )
    log = read_log(data_dir / "as5047" / "lookup_01.csv", pair)
    assert len(log) == 16384 and log.driving.wraps == 1
    # By hand: unwrap, take the mean off, and the first order of what is left.
    angle = np.loadtxt(data_dir / "as5047" / "lookup_01.csv")
    wave = np.exp(-2j * np.pi * np.arange(16384) / 16384)
    error = np.unwrap(angle, period=360) - np.arange(16384) * 360 / 16384
    first = 2 * abs(np.mean((error - error.mean()) * wave))
    found = -log.transmission_error / DEG
    assert 2 * abs(np.mean((found - found.mean()) * wave)) == pytest.approx(first, rel=1e-9)
    assert 0.008 < first < 0.47


def test_measured_logs(data_dir):
    worm = read_log(data_dir / "worm_mount" / "ap_gt1100.csv", drive("1/225"))
    assert len(worm) == 666 and worm.driving.turns == pytest.approx(5.694, abs=1e-3)
    kuka = drive("7/1798", time="t_s", driving="mot1_deg", driven="se1_deg", driving_scale="1798/7")
    log = read_log(data_dir / "kuka_kr300" / "kr300_A_axes123.csv", kuka)
    assert log.driving.turns == pytest.approx(33.08, abs=0.01)
    assert np.ptp(log.transmission_error) / DEG * 3600 < 600

import hashlib
import time as clock

import numpy as np
import pytest

from tests.logs.profiles import DEG, drive, spec
from vttig_jax.base.errors import LogError, UsageError
from vttig_jax.logs.read import read_log

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
    with pytest.raises(LogError, match=r"`0,000` is 0\.000 or 0000"):
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


def test_time_without_a_unit_is_noted(tmp_path):
    log = read_log(write(tmp_path, "time,driving_counts,driven_counts"), PAIR)
    assert "taken as seconds" in log.notes[0]
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
        ({"columns": {"speed": "x"}}, "`speed` is no role"),
        ({"decimal": ";"}, "decimal must be"),
        ({"sample_rate_hz": 0.0}, "positive"),
        ({"sample_rate_hz": 9, "columns": {"time": "t"}}, "both a sample rate and a time column"),
    ],
)
def test_wrong_options(tmp_path, options, words):
    with pytest.raises(UsageError, match=words):
        read_log(write(tmp_path), PAIR, **options)


def test_ninety_thousand_lines_cost_little_more_than_their_parsing(tmp_path):
    rows = [f"{k / 2000:.4f},{45 * k},{45 * k * 9 // 16}" for k in range(90_000)]
    path = write(tmp_path, rows=rows)

    def seconds(work):
        spent = []
        for _ in range(3):
            begin = clock.perf_counter()
            work()
            spent.append(clock.perf_counter() - begin)
        return min(spent)

    parsing = seconds(lambda: np.loadtxt(path, delimiter=",", skiprows=1))
    assert len(read_log(path, PAIR)) == 90_000
    assert seconds(lambda: read_log(path, PAIR)) < 4 * parsing


def test_measured_logs(data_dir):
    worm = read_log(data_dir / "worm_mount" / "ap_gt1100.csv", drive("1/225"))
    assert len(worm) == 666 and worm.driving.turns == pytest.approx(5.694, abs=1e-3)
    kuka = drive("7/1798", time="t_s", driving="mot1_deg", driven="se1_deg", driving_scale="1798/7")
    log = read_log(data_dir / "kuka_kr300" / "kr300_A_axes123.csv", kuka)
    assert log.driving.turns == pytest.approx(33.08, abs=0.01)
    assert np.ptp(log.transmission_error) / DEG * 3600 < 600

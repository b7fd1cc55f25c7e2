"""Logs beyond the corpus: measured ones, files that cannot be read, and what a log keeps."""

import gc
import hashlib
import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from tests.logs.profiles import DEG, drive, spec
from vttig_jax import LogError, load_pair, read_log

KUKA = Path(__file__).parents[2] / "fits" / "kuka_kr300"
COUNT = 200
FIRST = 450 * np.arange(COUNT)


@pytest.fixture
def path(tmp_path):
    """A log of counts."""
    rows = [f"{k / 100:.2f},{450 * k},{450 * k * 9 // 16}" for k in range(COUNT)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time_s,driving_counts,driven_counts", *rows]) + "\n")
    return path


def test_a_log_keeps_its_file(path):
    log = read_log(path, spec())
    assert log.source == str(path) and log.path == path.resolve()
    assert log.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert log.driving.reading.dtype == np.int64
    again = read_log(path, log.spec or spec(), **log.keywords)
    np.testing.assert_array_equal(again.driven_angle, log.driven_angle)
    known = read_log(path, ratio="16:9", counts=90_000)
    assert known.spec is not None and known.spec.driving.encoder.counts_per_rev == 90_000
    again = read_log(path, known.spec)
    np.testing.assert_array_equal(again.driving.reading, known.driving.reading)


@pytest.mark.slow
@pytest.mark.parametrize("unit", ["counts", "deg"])
def test_a_long_log_takes_little_more_memory_than_its_text_and_columns(tmp_path, unit):
    count = 200_000
    turned = np.cumsum(np.where(np.arange(count) // 50_000 % 2, -90, 90))
    rows = zip(turned.tolist(), (turned * 9 // 16).tolist(), strict=True)
    scale, digits = (1, "d") if unit == "counts" else (0.004, ".3f")
    path = tmp_path / "long.csv"
    lines = [
        f"{k / 500:.3f},{scale * a:{digits}},{scale * b:{digits}}" for k, (a, b) in enumerate(rows)
    ]
    path.write_text("\n".join([f"time_s,driving_{unit},driven_{unit}", *lines]) + "\n")
    options = {"ratio": "16:9", "counts": 90_000 if unit == "counts" else None}
    log = read_log(path, **options)  # modules are imported once
    columns = 3 * 8 * len(log)
    most = max(2.4 * columns, columns + path.stat().st_size) + 2e6
    peak = np.inf
    for _ in range(3):  # other threads and pools of the process allocate too
        gc.collect()
        tracemalloc.start()
        read_log(path, **options)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        if peak < most:
            break
    assert len(log) == count and peak < most


@pytest.mark.parametrize("late_s", [1.37e-4, 1.7e-3])
def test_channels_with_clocks_of_their_own_keep_the_gap(tmp_path, late_s):
    """Each channel is counted at its own stamps, which jitter; a long table holds both."""
    gap, step, jitter = 0.06, 0.004, np.random.default_rng(5).normal(0.0, 5e-5, 12_000)
    stamps = np.arange(12_000) / 500
    lines = ["time,name,value"]

    def driving(time):
        return 437.0 * (6.0 - np.abs(time % 12.0 - 6.0))

    for first, second in zip(stamps, stamps + late_s + jitter, strict=True):
        forward = second % 12.0 < 6.0
        driven = driving(second) * 9 / 16 + (0.0 if forward else gap)
        lines += [
            f"{first:.6f},motor [deg],{step * np.rint(driving(first) / step):.3f}",
            f"{second:.6f},load [deg],{step * np.rint(driven / step):.3f}",
        ]
    path = tmp_path / "long.csv"
    path.write_text("\n".join(lines) + "\n")
    log = read_log(path, ratio="16:9")
    error, phase = np.degrees(log.transmission_error), log.time % 6.0
    steady = (phase > 0.1) & (phase < 5.9)
    back = log.time % 12.0 > 6.0
    seen = error[steady & back].mean() - error[steady & ~back].mean()
    assert abs(seen - gap) < 2e-4
    assert any("clock" in note and "interpolated" in note for note in log.notes)


@pytest.mark.parametrize("name", ["absent.csv", "absent.mat", "folder.csv", "folder.mat", "fold"])
def test_what_is_no_file(tmp_path, name):
    if name.startswith("fold"):
        (tmp_path / name).mkdir()
    with pytest.raises(LogError, match=r"no such file|folder") as caught:
        read_log(tmp_path / name, ratio="16:9")
    assert caught.value.where == str(tmp_path / name)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_no_permission(path):
    path.chmod(0)
    with pytest.raises(LogError, match="no permission"):
        read_log(path, ratio="16:9")


def test_matlab_log_of_a_robot_is_the_table_made_of_it(data_dir):
    folder = data_dir / "kuka_kr300"
    names = {"driving": "act_pos_mot_deg(1,:)", "driven": "rec.act_pos_se_deg(1, :)"}
    layout = names | {"torque": "act_torque_abs_nm(1,:)", "driving_scale": "1798/7"}
    timed = drive("7/1798", **layout, time="rec.time_cont")
    csv = read_log(folder / "kr300_A_axes123.csv", load_pair(KUKA / "axis1.toml"))
    assert csv.driving.turns == pytest.approx(33.08, abs=0.01)
    assert np.ptp(csv.transmission_error) / DEG * 3600 < 600
    for pair in (timed, load_pair(KUKA / "axis1_mat.toml")):
        mat = read_log(folder / "kr300_A.mat", pair)
        np.testing.assert_allclose(mat.time, csv.time, rtol=0, atol=5e-4)
        assert mat.driven is not None and csv.driven is not None
        assert mat.torque is not None and csv.torque is not None
        np.testing.assert_allclose(mat.driving.reading, csv.driving.reading, rtol=0, atol=5.1e-8)
        np.testing.assert_allclose(mat.driven.reading, csv.driven.reading, rtol=0, atol=5.1e-8)
        np.testing.assert_allclose(mat.torque, csv.torque, rtol=0, atol=5.1e-5)


def test_rows_that_are_left_out_are_as_if_they_were_not_there(tmp_path):
    """One turn is lost in the readings of the part that is cut out."""
    turns = np.linspace(0, 4, 161)
    angles = np.column_stack([turns, 360 * turns, 202.5 * turns])
    part = (turns > 1.01) & (turns < 1.09)
    wrapped, whole, damaged = tmp_path / "w.csv", tmp_path / "n.csv", tmp_path / "d.csv"
    readings = angles % [9, 360, 360]
    lost = np.where(part[:, None], [0, 180, 0], readings * [0, 1, 1]) + angles * [1, 0, 0]
    for path, values in ((wrapped, readings), (whole, angles[~part]), (damaged, lost)):
        np.savetxt(path, values, "%.6f", ",", header="time_s,motor_deg,load_deg", comments="")
    expected = read_log(whole, ratio="16:9")
    for path in (wrapped, damaged):
        found = read_log(path, ratio="16:9", cut="1.01:1.09")
        for name in ("time", "driving_angle", "driven_angle"):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-7)
        again = read_log(path, found.spec)
        np.testing.assert_array_equal(again.driven_angle, found.driven_angle)

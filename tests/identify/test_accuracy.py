"""Accuracy in the terms of standards, from logs with known truth."""

from fractions import Fraction

import numpy as np
import pytest

import vttig_jax
from benchmarks.standards import single_flank_truth
from tests.identify.drives import drive, drive_log, level, there_and_back
from tests.identify.quick import quick_rig
from tests.kinematics.test_accuracy import axis_looped
from vttig_jax.base import NoAnswerError
from vttig_jax.logs import EncoderLog
from vttig_jax.pair import Drive
from vttig_jax.pair.gear_pair import Flank

AXIS = Drive(Fraction(1), name="axis")


def table(up: np.ndarray, down: np.ndarray, twice: int = 1) -> EncoderLog:
    """A log of an axis that reads `up` and `down` (target, pass), ″, each reading `twice`."""
    targets, passes = up.shape
    place = np.append(np.arange(targets), np.arange(targets)[::-1])
    driving = np.repeat(np.tile(place * 360.0 / targets, passes), twice)
    error = np.repeat(np.concatenate([up, down[::-1]]).T.ravel(), twice)
    way = np.tile(np.repeat([1, -1], targets * twice), passes)
    time, driven = np.arange(len(driving), dtype=float), driving + error / 3600
    return EncoderLog.from_arrays(time, driving, driven, pair=AXIS, unit="deg", direction=way)


def accuracy(log: EncoderLog) -> dict:
    return vttig_jax.fit(log, AXIS, standstill=True, perfect_gears=True).accuracy.to_json()


def readings(targets: int = 12, passes: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng, angle = np.random.default_rng(3), 2 * np.pi * np.arange(targets) / targets
    mean = 20 * np.sin(angle)[:, None] + np.array([0.0, 6.0])[:, None, None]
    return tuple(mean + rng.normal(size=(2, targets, passes)))


@pytest.mark.slow
def test_a_gear_pair_that_runs():
    """Every number of the paper's rig is near its truth, on each flank, shaft, and the pair."""
    rig = quick_rig(0)
    record = vttig_jax.fit(rig.log(0), rig.pair).accuracy.to_json()
    assert record["circle_mm"] == 80.0 and "not a conformity statement" in record["definition"]
    flanks: tuple[Flank, ...] = ("A", "B")
    truth = {flank: single_flank_truth(rig, flank, 16) for flank in flanks}
    rows = record["single_flank"]
    assert [(row["flank"], row["period"]) for row in rows] == [
        (flank, period) for flank in ("A", "B") for period in truth[flank]
    ]
    outside = 0
    for row in rows:
        for name, true in truth[row["flank"]][row["period"]].items():
            value, low, high = (row[name][f"{k}_arcsec"] for k in ("value", "low95", "high95"))
            half = (high - low) / 2
            assert abs(value - true) < 3 * half
            assert half < {"F_is": 0.1, "f_l": 0.1}.get(name, 0.8) * true
            assert row[name]["value_um"] == pytest.approx(np.radians(value / 3600) * 80.0 * 1e3)
            outside += not low <= true <= high
    assert outside <= 4


def test_a_table_is_that_of_its_readings():
    up, down = readings()
    axis = accuracy(table(up, down))["axis"]
    truth = axis_looped(up, down)
    assert axis["passes"] == 5 and axis["targets"] == 12
    again = accuracy(table(up, down, twice=3))["axis"]["numbers"]
    for name, value in truth.items():
        for numbers in (axis["numbers"], again):
            assert numbers[name]["read_arcsec"] == pytest.approx(value, rel=1e-6)
    assert 0.1 < axis["numbers"]["A"]["noise_share"] < 0.3  # seven of an A of about fifty
    # Few passes tell no repeatability.
    record = accuracy(table(*readings(passes=4)))
    numbers = record["axis"]["numbers"]
    assert numbers["A"] is None and numbers["R"] is None and "5 passes" in record["open"][0]
    assert numbers["B"]["low95_arcsec"] < 6 < numbers["B"]["high95_arcsec"]


def test_repeated_passes_are_those_of_an_axis():
    """A worm drive that turns five times to and fro, with a gap of 20″ and an error of 30″."""
    time = np.arange(0, 100, 0.01)
    phase = np.mod(time, 20.0)
    driven = 1.1 * 360 * np.clip(np.minimum(phase, 20 - phase) / 9 - 0.05, 0, 1)
    error = 15 * np.sin(np.radians(driven)) + 20 * (phase > 10)
    error = error + np.random.default_rng(0).normal(0, 1, len(time))
    drive = Drive(Fraction(1, 10), name="worm")
    log = EncoderLog.from_arrays(time, 10 * driven, driven + error / 3600, pair=drive, unit="deg")
    record = vttig_jax.fit(log, drive).accuracy.to_json()
    numbers = record["axis"]["numbers"]
    assert record["axis"]["passes"] >= 5
    assert numbers["B"]["value_arcsec"] == pytest.approx(20, abs=1)
    assert numbers["M"]["value_arcsec"] == pytest.approx(30, abs=1)
    assert 0 < numbers["R"]["noise_share"] < 0.5


def test_few_samples_in_a_turn_do_not_flatten_its_orders_and_few_turns_tell_none():
    """At 14 samples in a turn a chord between two of them cuts a fifth of order 5 off."""
    pair = drive("1/10", orders=(1, 5))
    error = lambda angle, speed: 20 * np.sin(angle) + 10 * np.sin(5 * angle)  # noqa: E731
    motion = there_and_back((300.0,), 12.0)
    log = drive_log(pair, motion, gap=level(100.0), error=error, rate_hz=71.3)
    rows = vttig_jax.fit(log, pair).accuracy.to_json()["single_flank"]
    turn = np.linspace(0.0, 2 * np.pi, 10_001)
    truth = np.ptp(error(turn, turn))
    shown = [row["F_is"] for row in rows if row["period"] == "driving shaft"]
    assert [one["value_arcsec"] for one in shown] == pytest.approx([truth, truth], rel=0.01)
    rig = quick_rig(1, reversal_deg=1.2 * 360, passes=1)
    with pytest.raises(NoAnswerError, match="2 turns"):
        vttig_jax.fit(rig.log(0), rig.pair).accuracy  # noqa: B018

"""Rows of a log against direct loops over its samples."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vttig_jax.base import DEG
from vttig_jax.model import BENDS, KNOTS, LAGS, PARTS, RowName, Run, Shafts, Wave, rows_of

WAVES = (
    Wave("driving", 1, 1, 0),
    Wave("driving", 3, 3, 0),
    Wave("driven", 2, 0, 2),
    Wave("both", -1, 1, -1),
    Wave("line", 2.7, 2.7, 0),
)
RATIO = 0.6


def shafts(delay_s: float = 0.0, torque: bool = True, interval_s: float = 0.01) -> Shafts:
    """A log with two runs; the driven shaft shows where the driving one was `delay_s` ago."""
    time = np.arange(0, 30, interval_s)
    angle = lambda t: 2 * t + 3 * np.sin(0.4 * t)  # noqa: E731
    error = 0.02 * np.sin(angle(time)) + RATIO * (angle(time - delay_s) - angle(time)) + 0.3
    half, speed = len(time) // 2, 2 + 1.2 * np.cos(0.4 * time)
    return Shafts(
        time=time,
        driving=angle(time),
        error=error,
        speed=speed,
        steady=speed,
        ratio=RATIO,
        interval_s=interval_s,
        runs=(Run(20, half - 37, "A"), Run(half + 11, len(time) - 30, "B")),
        ramps=(),
        nominal=(RATIO + 1e-3, 0.2),
        resolution=1e-6,
        torque=np.cos(time) if torque else None,
    )


def test_rows_are_means_of_columns_at_the_samples():
    one, size, bends = shafts(), 7, np.linspace(0.9, 2.9, BENDS)
    one = replace(one, steady=-one.speed)
    rows = rows_of(one, WAVES, size * one.interval_s, 0.0, bends, ratio=True)
    expected = []
    span = one.time[-1] - one.time[0]
    level = np.rint(np.median(one.error) / DEG) * DEG
    for start, stop, _ in one.runs:
        for first in range(start, stop - size + 1, size):
            k = np.arange(first, first + size)
            phi, nominal = one.driving[k], one.nominal[0] * one.driving[k] + one.nominal[1]
            values: dict[RowName, Any] = {
                RowName("one"): 1.0,
                RowName("delay"): np.mean(-RATIO * one.steady[k]),
                RowName("late"): np.mean(-RATIO * one.speed[k]),
                RowName("ratio"): phi.mean(),
                RowName("torque"): np.asarray(one.torque)[k].mean(),
                RowName("y"): np.mean(one.error[k]) - level,
            }
            for wave in WAVES:
                phase = wave.driving * phi + wave.driven * nominal
                values[wave.row("cos")] = np.cos(phase).mean()
                values[wave.row("sin")] = np.sin(phase).mean()
            x = (one.time[k].mean() - one.time[0]) / span
            for j in range(KNOTS):
                values[RowName("drift", j)] = np.clip(KNOTS * x - j, 0, 1)
            for j in range(PARTS):
                hat = max(0.0, 1 - abs(x * (PARTS - 1) - j))
                values[RowName("part", j)] = values[RowName("delay")] * hat
            for j in range(BENDS):
                values[RowName("bend", j)] = max(0.0, abs(one.speed[k].mean()) - bends[j])
            expected.append(values)
    assert len(rows.table) == len(expected)
    for name, place in rows.names.items():
        column = np.array([values[name] for values in expected])
        found = rows.table[:, place]
        if name.kind in ("ratio", "torque"):  # centred
            found, column = found - found.mean(), column - column.mean()
        np.testing.assert_allclose(found, column, atol=1e-11, err_msg=str(name))
    assert np.abs(rows.table[:, rows.names[RowName("y")]]).max() > 0.01
    assert rows.flanks == ("A", "B")
    assert rows.last[-1] == len(rows.table) - 1
    assert rows.flank[rows.first].tolist() == ["A", "B"]
    np.testing.assert_array_equal(rows.samples[0], np.arange(20, 27))


def test_runs_of_few_rows_are_left_out():
    one = shafts()
    short = replace(one, runs=(Run(0, LAGS + 1, "A"), Run(100, 100 + LAGS + 2, "B")))
    rows = rows_of(short, WAVES, one.interval_s, 0.0, np.ones(BENDS), ratio=True)
    assert len(rows.table) == LAGS + 2 and rows.flanks == ("B",)


@pytest.mark.parametrize("delay_s", [0.0137, -0.0042])
def test_a_delay_is_taken_off(delay_s):
    """At the delay of the log, y is the error that the shafts have; at another it is not."""
    one = shafts(delay_s)
    truth = shafts()
    for asked, near in ((delay_s, True), (delay_s + 1e-3, False), (-delay_s, False)):
        rows = rows_of(one, WAVES, 0.05, asked, np.ones(BENDS), ratio=False)
        y = rows.table[:, -1] + np.rint(np.median(one.error) / DEG) * DEG
        expected = truth.error[rows.samples].mean(1)
        assert (np.abs(y - expected).max() < 1e-6) == near
        inside = rows.samples
        assert inside.min() >= 20 and inside.max() < len(one.time) - 30


def test_outliers_and_twins_of_a_time_stamp_leave_their_neighbours_alone():
    one = shafts()
    spoilt, driving = np.array([500, 501, 900]), one.driving.copy()
    driving[spoilt] += 0.5
    clean = replace(one, driving=driving).without(spoilt)
    apart = clean.delayed(0.004)[0] - one.delayed(0.004)[0]
    assert np.abs(np.delete(apart, spoilt)).max() < 1e-5
    np.testing.assert_allclose(apart[spoilt], 0.5, atol=1e-3)
    assert np.abs(clean.speed - one.speed).max() < 0.05
    time = one.time.copy()
    time[700] = time[699]
    apart = replace(one, time=time).delayed(0.004)[0] - one.delayed(0.004)[0]
    assert np.abs(apart[np.r_[:650, 750:3000]]).max() < 1e-12

"""What a residual still holds, on residuals that hold something or nothing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.identify.summaries import random_log
from vttig_jax.base.units import ARCSEC
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.noise.noise_model import NoiseModel
from vttig_jax.identify.report import residual_tests
from vttig_jax.identify.report.checks import Whiteness
from vttig_jax.identify.report.comparisons.repeatability import passes
from vttig_jax.identify.report.residual_tests import whiteness
from vttig_jax.identify.solve.residuals import Weights
from vttig_jax.kinematics.te_curve import TECurve
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.lines.search import Stretch as LineRun
from vttig_jax.pair.schema import HarmonicOrders
from vttig_jax.rig.imperfections import OrderError
from vttig_jax.rig.motion import PassMotion

WHITE = NoiseModel(np.empty(0), 1.0, 1.0, 0.01)
COLOURED = NoiseModel(np.array([0.7]), 1.0, 1.4, 0.01)


def _coloured(seed: int, count: int = 2000) -> np.ndarray:
    shocks = np.random.default_rng(seed).standard_normal(count)
    return np.asarray(lfilter([1.0], [1.0, -0.7], shocks))


def _tested(residual: np.ndarray, noise: NoiseModel) -> Whiteness | None:
    return whiteness([residual], [np.arange(len(residual)) * noise.block_s], [noise])


def test_the_right_noise_model_leaves_white_innovations():
    seen = [_tested(_coloured(seed), COLOURED) for seed in range(40)]
    chances = np.array([one.probability for one in seen if one is not None])
    assert len(chances) == 40
    assert 0.2 < np.median(chances) < 0.8
    assert np.mean(chances < 0.05) < 0.2


def test_a_noise_model_without_memory_is_found_out():
    found = _tested(_coloured(0), WHITE)
    assert found is not None and found.probability < 1e-12
    assert found.autocorrelation[0] == pytest.approx(0.7, abs=0.06)


def test_too_few_rows_say_nothing():
    assert _tested(_coloured(0, 60), COLOURED) is None
    assert whiteness([], [], []) is None


def test_a_line_that_no_order_explains_is_found(noisy_rig, noisy_fit, noisy_log):
    assert not noisy_fit.checks.lines
    angle = noisy_log.driving_angle
    spoiled = noisy_log.driven.reading + np.rint(
        6.0 * np.sin(9.41 * angle + 0.4)  # 86″ in counts of 14.4″
    ).astype(np.int64)
    log = EncoderLog.from_arrays(
        noisy_log.time, noisy_log.driving.reading, spoiled, pair=noisy_rig.pair
    )
    [line, *_] = fit(log, noisy_rig.pair, lines="report").checks.lines
    assert line.cycles_per_rev == pytest.approx(9.41, abs=0.02)
    assert line.amplitude_arcsec == pytest.approx(86.4, rel=0.1)
    assert line.false_alarm < 1e-6


def test_an_order_left_out_of_the_model_is_found(noisy_rig):
    louder = replace(
        noisy_rig,
        orders=(
            OrderError("driving", 3, "A", 0.01, 20.0),
            OrderError("driving", 3, "B", 0.01, 20.0),
        ),
    )
    options = HarmonicOrders(driving_orders=(1,), driven_orders=(1,), mesh_orders=0)
    lines = fit(louder.log(0), louder.pair, orders=options).checks.lines
    assert lines[0].cycles_per_rev == pytest.approx(3.0, abs=0.01)
    assert lines[0].amplitude_arcsec == pytest.approx(36.0, rel=0.05)


def test_passes_are_compared(paper_pair):
    angle = np.linspace(0.0, 30.0, 400)
    error = 1e-4 * np.sin(angle)
    time = np.arange(400.0)
    curves = (
        TECurve("A", angle, error, time),
        TECurve("B", angle[::-1], error[::-1] + 5e-4, time),
        TECurve("A", angle, error + 2e-5, time),
    )
    [found] = passes(curves)
    assert found.flank == "A" and found.passes == (1, 2)
    assert found.mean_deg == pytest.approx(np.degrees(2e-5), rel=1e-6)
    assert found.scatter_deg == pytest.approx(0.0, abs=1e-12)
    assert passes(curves[:2]) == []


def test_a_rig_that_changes_is_seen_in_its_halves(quick_rig):
    rig = replace(quick_rig, motion=PassMotion(speed_rpm=120.0, reversal_deg=3600.0, dwell_s=0.3))
    log = rig.log(0)
    assert log.driven is not None
    calm = fit(log, rig.pair)
    found = calm.checks.halves
    assert len(found) == 4
    assert all(one.difference_arcsec < 5 * one.std_arcsec for one in found)
    assert "from the first half" not in str(calm)
    angle = log.driving_angle
    growing = np.where(angle > angle.max() / 2, 4.0, 0.0) * np.sin(angle)
    spoiled = log.driven.reading + np.rint(growing).astype(np.int64)
    log = EncoderLog.from_arrays(log.time, log.driving.reading, spoiled, pair=rig.pair)
    changed = fit(log, rig.pair)
    worst = max(changed.checks.halves, key=lambda one: one.difference_arcsec)
    assert worst.shaft == "driving"
    assert worst.difference_arcsec > 6 * worst.std_arcsec
    assert "from the first half" in str(changed)


def test_passes_of_a_rig_that_goes_forth_twice(noisy_rig):
    rig = replace(noisy_rig, motion=PassMotion(reversal_deg=1080.0, passes=4, dwell_s=0.3))
    found = fit(rig.log(0), rig.pair).checks.passes
    assert {one.flank for one in found} == {"A", "B"}
    for one in found:
        assert abs(one.mean_deg) < 0.0005
        assert one.overlap_deg > 700


def test_a_long_run_is_searched_the_same_without_a_copy_of_its_regressors(monkeypatch):
    log, generator = random_log(2, ("offset",), "AB", count=900), np.random.default_rng(3)
    weights: Weights = {
        run.segment.flank: generator.standard_normal(log.columns.width) for run in log.runs
    }
    copied = residual_tests._all_runs([log], [weights])
    monkeypatch.setattr(residual_tests, "_MOST_CELLS", 1000)
    bare = residual_tests._all_runs([log], [weights])
    for run, (_, one), (_, other) in zip(log.runs, copied, bare, strict=True):
        np.testing.assert_allclose(one.value, run.rows @ weights[run.segment.flank])
        assert one.nuisance.strides != other.nuisance.strides == (0, 0)
        short = [residual_tests._affordable([each], 0.3)[0] for each in (one, other)]
        assert len(short[0].value) < len(one.value)
        for name in ("angle", "value", "nuisance"):
            np.testing.assert_array_equal(*(getattr(each, name) for each in short))


@pytest.mark.parametrize("columns", [1, 1200])  # with many cells the search averages the rows
def test_a_few_fast_rows_limit_the_search(columns: int):
    """A cycle of the highest frequency has two rows where the log has most of its travel, too."""
    rng = np.random.default_rng(0)
    count = 6400
    angle = 2 * np.pi * np.cumsum(np.where(np.arange(count) % 800 < 79, 0.26, 0.026))
    value = ARCSEC * (20 * np.sin(0.37 * angle) + rng.normal(0, 5, count))
    run = LineRun(angle, value, np.ones((count, columns)))
    assert run.nuisance.size > residual_tests._MOST_CELLS or columns == 1
    found = residual_tests._searched([run])
    assert [line.cycles_per_rev for line in found] == pytest.approx([0.37], abs=0.001)

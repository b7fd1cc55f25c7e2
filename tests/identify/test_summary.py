"""The summary against the rows it stands for."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.identify.summaries import flank_summary
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.identify.blocks import block_size
from vttig_jax.identify.fit import fit
from vttig_jax.identify.scope import find_scope
from vttig_jax.identify.summary import HIGHEST_LAG, compress
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.segments import find_segments


def _filtered(filter_: np.ndarray, runs: list[np.ndarray]) -> np.ndarray:
    """Σ w wᵀ over the rows with a full history, by filtering the rows themselves."""
    order = len(filter_) - 1
    kept = [lfilter(filter_, [1.0], rows, axis=0)[order:] for rows in runs]
    rows = np.concatenate(kept)
    return rows.T @ rows


def _runs(seed: int, *lengths: int) -> list[np.ndarray]:
    generator = np.random.default_rng(seed)
    return [np.cumsum(generator.standard_normal((n, 5)), axis=0) for n in lengths]


@pytest.mark.parametrize("lengths", [(40,), (17, 60), (33, 21, 90)])
@pytest.mark.parametrize("order", [0, 1, 2, 5, 8])
def test_whitened_equals_filtering_the_rows(lengths, order):
    runs = _runs(order, *lengths)
    summary = flank_summary("A", runs, 8)
    filter_ = np.append(1.0, np.random.default_rng(order + 1).uniform(-0.6, 0.6, order))
    expected = _filtered(filter_, runs)
    np.testing.assert_allclose(summary.whitened(filter_), expected, rtol=1e-10, atol=1e-10)
    assert summary.whitened_rows(order) == sum(lengths) - order * len(lengths)


def test_forgetting_an_end_would_be_seen():
    runs = _runs(1, 40, 50)
    filter_ = np.array([1.0, -0.7, 0.1])
    summary = flank_summary("A", runs, 8)
    ended = flank_summary("A", [rows[:-1] for rows in runs], 8)
    assert np.abs(summary.whitened(filter_) - ended.whitened(filter_)).max() > 1e-3
    started = flank_summary("A", [rows[1:] for rows in runs], 8)
    assert np.abs(summary.whitened(filter_) - started.whitened(filter_)).max() > 1e-3


@pytest.fixture(scope="module")
def compressed(noisy_rig, noisy_log):
    segments = find_segments(noisy_log).segments
    scope = find_scope(noisy_log, segments, noisy_rig.pair, noisy_rig.pair.fit, None)
    return scope, compress(noisy_log, scope.segments, scope.terms, 1, {})


def test_compress_counts_what_it_used(compressed, noisy_log):
    scope, summary = compressed
    size = summary.plan.size
    assert summary.segments == scope.segments
    assert [curve.flank for curve in summary.curves] == [s.flank for s in scope.segments]
    for segment, curve in zip(summary.segments, summary.curves, strict=True):
        assert len(curve) == (segment.stop - segment.start) // size
    assert summary.rows == sum(map(len, summary.curves))
    assert sum(summary.samples_used.values()) == size * summary.rows <= len(noisy_log)
    assert summary.block_s == pytest.approx(size / 1987, rel=1e-6)
    lags = {f.lag_products.shape[0] - 1 for f in summary.flanks}
    assert len(lags) == 1 and 1 <= lags.pop() <= HIGHEST_LAG


def test_curves_are_block_means(compressed, noisy_log):
    _, summary = compressed
    size = summary.plan.size
    for segment, curve in zip(summary.segments, summary.curves, strict=True):
        part = slice(segment.start, segment.start + size * len(curve))
        for name, channel in (
            ("driving_angle", noisy_log.driving_angle),
            ("transmission_error", noisy_log.transmission_error),
            ("time", noisy_log.time),
        ):
            means = channel[part].reshape(-1, size).mean(axis=1)
            np.testing.assert_allclose(getattr(curve, name), means, atol=1e-12)


def test_lag_products_are_those_of_the_runs(compressed):
    """y is the last column and 1 stands behind the free ones: both are known from the curves."""
    _, summary = compressed
    one = 2 * len(summary.plan.free)
    for flank in summary.flanks:
        curves = [c.transmission_error for c in summary.curves if c.flank == flank.flank]
        for lag in range(len(flank.lag_products)):
            own = sum(float(y[lag:] @ y[: len(y) - lag]) for y in curves)
            assert flank.lag_products[lag, -1, -1] == pytest.approx(own, rel=1e-9)
            level = sum(float(y[lag:].sum()) for y in curves)
            assert flank.lag_products[lag, -1, one] == pytest.approx(level, rel=1e-9)


def test_correction_is_taken_away_on_its_flank(compressed, noisy_log):
    scope, summary = compressed
    moved = compress(
        noisy_log, scope.segments, scope.terms, 1, {"B": np.full(len(noisy_log), 1e-3)}
    )
    for before, after in zip(summary.curves, moved.curves, strict=True):
        expected = 1e-3 if before.flank == "B" else 0.0
        gone = before.transmission_error - after.transmission_error
        np.testing.assert_allclose(gone, expected, atol=1e-15)


def test_drift_columns_are_as_many_as_asked(compressed, noisy_log):
    scope, summary = compressed
    other = compress(noisy_log, scope.segments, scope.terms, 4, {})
    assert other.plan.width == summary.plan.width + 3
    time = (noisy_log.time[0] + noisy_log.time[-1]) / 2
    assert other.time_origin_s == pytest.approx(time)
    assert other.time_scale_s == pytest.approx(np.ptp(noisy_log.time) / 2)


def test_a_run_too_short_to_filter_is_left_out(noisy_rig, noisy_log, compressed):
    """Only whole runs are summarised; the fit then says which flanks remain."""
    scope, _ = compressed
    short = tuple(
        s if s.flank == "A" else type(s)(s.start, s.start + 5, s.flank, s.speed)
        for s in scope.segments
    )
    left = compress(noisy_log, short, scope.terms, 1, {})
    assert [f.flank for f in left.flanks] == ["A"]
    assert left.samples_used["B"] == 0
    assert fit(noisy_log, noisy_rig.pair).flanks == ("A", "B")


def test_the_fastest_plateau_sets_the_block(noisy_rig):
    """60 and then 180 rpm: no block may cover more of a cycle than at one speed."""
    time = np.arange(40_000) / 2000.0
    speed = np.where(time < 12, 60.0, 180.0) * np.pi / 30
    driving = np.cumsum(speed) / 2000.0
    driven = 0.5625 * driving + 1e-4 * np.sin(driving + 0.5)
    log = EncoderLog.from_arrays(time, driving / DEG, driven / DEG, pair=noisy_rig.pair, unit="deg")
    pair = noisy_rig.pair
    scope = find_scope(log, find_segments(log).segments, pair, pair.fit, None)
    assert len(scope.segments) == 2
    summary = compress(log, scope.segments, scope.terms, 0, {})
    per_turn = 2000.0 * 60 / 180
    assert summary.plan.size == block_size(per_turn, 45.0) < block_size(2 * per_turn, 45.0)
    result = fit(log, pair)
    shaft = {(o.shaft, o.order): o for o in result.orders}
    assert shaft["driving", 1].amplitude_arcsec * ARCSEC == pytest.approx(1e-4, rel=1e-6)
    assert result.residual_rms_deg * DEG < 1e-9

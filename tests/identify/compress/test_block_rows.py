"""Block rows of a log: which samples they hold, how long a block is, and their curves."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.identify.summaries import looked
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.identify.compress import block_rows
from vttig_jax.identify.compress.block_means import block_size
from vttig_jax.identify.compress.block_rows import block_seconds, log_rows
from vttig_jax.identify.compress.regressors import Drift, read_channels
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.preliminary.linear_fit import residual_of, residuals_of
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.pair.gear_pair import Flank


@pytest.fixture(scope="module")
def seen(noisy_log, noisy_rig):
    return looked(noisy_log, noisy_rig.pair, drift=Drift(1))


def test_rows_count_what_they_hold(seen, noisy_log):
    scope, linear = seen
    (rows,) = linear.rows
    assert tuple(run.segment for run in rows.runs) == scope.segments[0]
    for run in rows.runs:
        count = (run.segment.stop - run.segment.start) // rows.size
        assert len(run.rows) == len(run.curve) == count
        assert run.rows.shape[1] == rows.columns.width
        assert run.curve.flank == run.segment.flank
    used = rows.size * sum(len(run.rows) for run in rows.runs)
    assert 0.5 * len(noisy_log) < used <= len(noisy_log)
    assert rows.block_s == pytest.approx(rows.size / 1987, rel=1e-6)


def test_curves_are_block_means(seen, noisy_log):
    (rows,) = seen[1].rows
    for run in rows.runs:
        part = slice(run.segment.start, run.segment.start + rows.size * len(run.rows))
        for name, channel in (
            ("driving_angle", noisy_log.driving_angle),
            ("transmission_error", noisy_log.transmission_error),
            ("time", noisy_log.time),
        ):
            means = channel[part].reshape(-1, rows.size).mean(axis=1)
            np.testing.assert_allclose(getattr(run.curve, name), means, atol=1e-12)
        np.testing.assert_allclose(run.rows[:, -1], run.curve.transmission_error, atol=1e-12)


def test_own_columns_are_as_many_as_asked(seen, noisy_log, noisy_rig):
    (rows,) = seen[1].rows
    (other,) = looked(noisy_log, noisy_rig.pair, drift=Drift(4))[1].rows
    assert other.columns.width == rows.columns.width + 3
    time = noisy_log.time
    scaled = (2 * time - time[0] - time[-1]) / (time[-1] - time[0])
    for power in (1, 4):
        place = other.columns.index(f"drift_{power}")
        run = other.runs[1]
        part = slice(run.segment.start, run.segment.start + other.size * len(run.rows))
        means = (scaled[part] ** power).reshape(-1, other.size).mean(axis=1)
        np.testing.assert_allclose(run.rows[:, place], means, atol=1e-12)


def test_by_flank_keeps_long_runs_only(seen):
    (rows,) = seen[1].rows
    lengths = {run.segment.flank: len(run.rows) for run in rows.runs}
    assert set(rows.by_flank()) == {"A", "B"}
    longest = max(lengths.values())
    assert rows.by_flank(longer_than=longest) == {}
    assert all(len(runs[0]) == longest for runs in rows.by_flank(longest - 1).values())


def test_a_delay_shortens_its_segments(seen, noisy_log, noisy_rig):
    """6 ms are 12 samples at 1987 Hz, at the start where the shift looks back."""
    scope, linear = seen
    model = linear.model
    for delay_s, start, stop in ((6e-3, 12, 0), (-6e-3, 0, 12)):
        channels = read_channels(noisy_log, noisy_rig.pair, (), model.drift, delay_s)
        rows = log_rows(channels, scope.segments[0], scope.terms, linear.block_s)
        for run, whole in zip(rows.runs, scope.segments[0], strict=True):
            assert (run.segment.start, run.segment.stop) == (
                whole.start + start,
                whole.stop - stop,
            )


@pytest.fixture(scope="module")
def cut(seen, noisy_log, noisy_rig):
    """Channels with weights and a delay, and short pieces of both flanks with one long one."""
    scope, linear = seen
    weight = np.random.default_rng(0).uniform(0, 1, len(noisy_log))
    regressors = ("delay",)
    channels = read_channels(
        noisy_log, noisy_rig.pair, regressors, linear.model.drift, 2e-3, weight=weight
    )
    pieces = []
    for whole in scope.segments[0]:
        edges = [*range(whole.start, whole.start + 9000, 701), whole.stop]
        pieces += [replace(whole, start=a, stop=b) for a, b in pairwise(edges)]
    return channels, tuple(pieces), scope.terms, linear.block_s


def test_short_runs_have_the_same_rows_together_and_alone(cut, monkeypatch):
    together = log_rows(*cut)
    monkeypatch.setattr(block_rows, "SHORT_RUN", 0)
    alone = log_rows(*cut)
    assert len(together.runs) == len(alone.runs) > 20
    for one, other in zip(together.runs, alone.runs, strict=True):
        assert one.segment == other.segment
        np.testing.assert_array_equal(one.rows, other.rows)
        for name in ("driving_angle", "transmission_error", "time"):
            np.testing.assert_array_equal(getattr(one.curve, name), getattr(other.curve, name))


@pytest.mark.parametrize("stride", [1, 7])
def test_short_runs_have_the_same_residuals_together_and_alone(cut, stride):
    channels, segments, *_ = cut
    columns = log_rows(*cut).columns
    rng = np.random.default_rng(1)
    weights: dict[Flank, np.ndarray] = {f: rng.standard_normal(columns.width) for f in ("A", "B")}
    found = residuals_of(channels, segments, columns, weights, stride)
    for segment, residual in zip(segments, found, strict=True):
        alone = residual_of(channels, segment, columns, weights[segment.flank], stride)
        np.testing.assert_allclose(residual, alone, rtol=0, atol=1e-12)


def _two_speeds(pair, last_rpm: float) -> EncoderLog:
    time = np.arange(40_000) / 2000.0
    speed = np.where(time < 12, 60.0, last_rpm) * np.pi / 30
    driving = np.cumsum(speed) / 2000.0
    driven = 0.5625 * driving + 1e-4 * np.sin(driving + 0.5)
    return EncoderLog.from_arrays(time, driving / DEG, driven / DEG, pair=pair, unit="deg")


def test_the_fastest_plateau_sets_the_block(noisy_rig):
    """60 and then 180 rpm: no block may cover more of a cycle than at one speed."""
    pair = noisy_rig.pair
    log = _two_speeds(pair, 180.0)
    scope, linear = looked(log, pair)
    assert len(scope.segments[0]) == 2
    per_turn = 2000.0 * 60 / 180
    assert linear.rows[0].size == block_size(per_turn, 45.0) < block_size(2 * per_turn, 45.0)
    result = fit(log, pair)
    shaft = {(o.shaft, o.order): o for o in result.orders}
    assert shaft["driving", 1].amplitude_arcsec * ARCSEC == pytest.approx(1e-4, rel=1e-6)
    assert result.residual_rms_deg * DEG < 1e-9


def test_the_fastest_log_sets_the_block(noisy_rig):
    """Whatever log comes first."""
    logs = [_two_speeds(noisy_rig.pair, rpm) for rpm in (60.0, 180.0)]
    seen = [looked(log, noisy_rig.pair) for log in logs]
    channels = [linear.channels[0] for _, linear in seen]
    segments = [scope.segments[0] for scope, _ in seen]
    terms = seen[0][0].terms
    slow, fast = (block_seconds([c], [s], terms) for c, s in zip(channels, segments, strict=True))
    assert fast < 0.5 * slow
    assert block_seconds(channels, segments, terms) == fast
    assert block_seconds(channels[::-1], segments[::-1], terms) == fast

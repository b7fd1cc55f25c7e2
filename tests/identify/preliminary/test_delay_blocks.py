"""Delays of the blocks of a log: one delay, delays that scatter, and what the interval contains."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import t as student

from tests.identify.drives import drive, known
from vttig_jax.base.numerics.quantiles import NORMAL_95
from vttig_jax.identify.compress import regressors
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.preliminary.delay import Delay
from vttig_jax.identify.preliminary.delay_blocks import DelayBlocks
from vttig_jax.logs.encoder_log import EncoderLog

BLOCK_MS = 0.01 * np.array([1.0, 2.0, 1.5, 1.0, 3.0, 1.0, 2.0, 1.2])
"""Standard errors of the delays of eight blocks."""

PAIR = drive("1/6")


def _drawn(seed: int, scatter_ms: float) -> DelayBlocks:
    rng = np.random.default_rng(seed)
    value = 1e-3 * (BLOCK_MS * rng.normal(size=8) + scatter_ms * rng.normal(size=8))
    return DelayBlocks(value, np.diag((1e-3 * BLOCK_MS) ** 2))


def test_the_interval_contains_the_mean_of_delays_that_scatter():
    drawn = [_drawn(seed, 0.1) for seed in range(200)]
    assert np.mean([one.scatters for one in drawn]) > 0.95
    wide = [one.half_width_s(float(one.value.mean())) for one in drawn]
    inside = [abs(one.value.mean()) < half for one, half in zip(drawn, wide, strict=True)]
    assert np.mean(inside) > 0.9
    alone = [abs(one.value.mean()) < NORMAL_95 * one.common_std_s for one in drawn]
    assert np.mean(alone) < 0.3  # the standard error of one common delay does not contain it


def test_one_delay_is_seldom_called_a_scatter():
    assert np.mean([_drawn(seed, 0.0).scatters for seed in range(400)]) < 0.02


def test_without_noise_the_half_width_is_that_of_students_interval():
    value = 1e-3 * np.random.default_rng(0).normal(size=8)
    blocks = DelayBlocks(value, 1e-14 * np.eye(8))
    expected = student.ppf(0.975, 7) * value.std(ddof=1) / np.sqrt(8)
    assert blocks.half_width_s(float(value.mean())) == pytest.approx(expected, rel=0.1)


def test_two_blocks_tell_no_scatter():
    assert not DelayBlocks(np.array([0.0, 1.0]), 1e-6 * np.eye(2)).scatters


def _one_way(seed: int, creep_s: float, delay_s: float = 3e-3) -> Fit:
    """Fit of 48 s in one direction, whose speed wanders by 3 %.

    The delay grows by `creep_s` from start to end.
    """
    rng = np.random.default_rng(seed)
    time, fine = np.arange(1500) * 0.032, np.arange(6200) * 0.008
    wander = np.asarray(lfilter([1.0], [1.0, -0.985], rng.normal(size=len(fine) + 500)))[500:]
    speed = 33.0 * (1 + 0.03 * wander / wander.std())
    turned = np.concatenate([[0.0], 0.008 * np.cumsum(speed)[:-1]])
    delay = delay_s + creep_s * (time / time[-1] - 0.5)
    late = np.interp(time - delay, fine, turned) / 6
    driven = late + np.radians(0.2 * np.sin(late) + 0.05 * rng.normal(size=len(time)))
    log = EncoderLog.from_arrays(
        time, np.interp(time, fine, turned), driven, pair=PAIR, unit="rad", source=f"rig {seed}"
    )
    return fit(log, PAIR)


@pytest.mark.parametrize("seed", range(2))
def test_a_delay_that_creeps_in_one_direction_is_said_and_contained(seed: int):
    result = _one_way(seed, 4e-3)
    delay = result.parameters["delay_s"]
    assert known(delay.high95) - known(delay.low95) > 2 * 0.3 * 2e-3
    assert known(delay.low95) < 3e-3 < known(delay.high95)
    assert any(note.startswith("the delay changes by +") for note in result.warnings)


@pytest.mark.parametrize("seed", range(2))
def test_a_constant_delay_in_one_direction_keeps_its_interval(seed: int):
    result = _one_way(seed, 0.0)
    delay = result.parameters["delay_s"]
    assert known(delay.std) < 0.25e-3
    assert abs(known(delay.value) - 3e-3) < 3 * known(delay.std)
    assert not any(note.startswith("the delay changes by") for note in result.warnings)


def test_the_rest_of_a_step_tells_the_share_of_the_delay():
    assert Delay("fitted", step_s=0.0).after(1e-3).share == 1.0
    assert Delay("fitted", step_s=7e-4).after(1e-3).share == pytest.approx(0.3)
    assert Delay("fitted", step_s=-1e-4).after(1e-3).share == 1.0
    assert Delay("fitted", step_s=2e-3).after(1e-3).share == pytest.approx(0.05)


def test_a_noisy_speed_increases_the_standard_error(monkeypatch: pytest.MonkeyPatch):
    """Noise in the column of the speed that the shift of the driving angle does not contain."""
    exact = regressors._COLUMNS["delay"]

    def noisy(log: EncoderLog, driving: np.ndarray, ratio: float) -> np.ndarray:
        speed = exact(log, driving, ratio)[:]
        noise = np.random.default_rng(int(log.source.split()[-1]))
        return speed + np.std(speed) * noise.normal(size=len(speed))

    monkeypatch.setitem(regressors._COLUMNS, "delay", noisy)
    delays = [_one_way(seed, 0.0).parameters["delay_s"] for seed in range(10, 18)]
    scores = [(known(one.value) - 3e-3) / known(one.std) for one in delays]
    assert 0.4 < np.sqrt(np.mean(np.square(scores))) < 1.6

"""Several logs of one rig whose delays are equal, or differ."""

from dataclasses import replace

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, known, level, there_and_back
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.preliminary.delays_of_logs import DelaysOfLogs
from vttig_jax.logs.encoder_log import EncoderLog

PAIR = drive("1/2")


def log(delay_s: float, seed: int) -> EncoderLog:
    return drive_log(
        PAIR,
        there_and_back([60.0, 120.0], 6.0),
        gap=level(200.0),
        error=lambda angle, _: 60 * np.sin(angle + 0.3) + 40 * np.sin(angle / 2 + 1),
        delay_s=level(delay_s),
        noise_arcsec=10.0,
        seed=seed,
    )


def test_delays_that_differ_are_said_and_contained():
    result = fit([log(1.0e-3, 1), log(1.8e-3, 2)], PAIR)
    (sentence,) = [one for one in result.warnings if one.startswith("the delays of the logs")]
    assert "(log 1)" in sentence and "(log 2)" in sentence
    delay = result.parameters["delay_s"]
    assert known(delay.low95) <= 1.001e-3 and known(delay.high95) >= 1.799e-3


def test_equal_delays_give_no_sentence_and_a_narrow_interval():
    result = fit([log(1.4e-3, 3), log(1.4e-3, 4)], PAIR)
    assert not any("delays of the logs" in one for one in result.notes)
    delay = result.parameters["delay_s"]
    assert known(delay.low95) < 1.4e-3 < known(delay.high95)
    assert known(delay.high95) - known(delay.low95) < 1e-4


def test_between_logs_of_equal_precision_it_is_the_plain_variance():
    """With equal s, τ² is the variance of the delays less s², and the mean has (τ² + s²)/n."""
    value = np.array([1.0, 1.6, 2.8, 3.0]) * 1e-3
    found = DelaysOfLogs((1, 2, 3, 4), value, np.full(4, 1e-4))
    assert found.differ
    assert found.between_s == pytest.approx(np.sqrt(np.var(value, ddof=1) - 1e-8))
    assert found.mean_std_s == pytest.approx(np.std(value, ddof=1) / 2)
    assert found.farthest_s(2e-3) == pytest.approx(1e-3)


def test_delays_within_their_noise_do_not_differ():
    found = DelaysOfLogs((1, 3), np.array([1.0e-3, 1.1e-3]), np.array([5e-5, 5e-5]))
    assert not found.differ and found.between_s == pytest.approx(5e-5)
    assert not replace(found, std=np.array([2e-4, 2e-4])).between_s
    assert "1 ± 0.05 ms (log 1), 1.1 ± 0.05 ms (log 3)" in found.sentence

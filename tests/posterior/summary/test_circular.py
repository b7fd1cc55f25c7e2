"""Phases: means across the zero, spread, and intervals that may leave the turn."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.angles import difference_deg
from vttig_jax.posterior.summary.draws import phase_of_draws


def _draws(mean: float, std: float, count: int = 20_000) -> np.ndarray:
    return mean + std * np.random.default_rng(0).standard_normal(count)


def _phase(draws: np.ndarray) -> Any:
    """The parameter of draws, whose numbers are all given."""
    return phase_of_draws("phase_deg", draws)


@given(st.floats(0, 360), st.floats(0.01, 20))
def test_a_narrow_phase_is_that_of_the_line_wherever_it_lies(mean, std):
    found = _phase(np.mod(_draws(mean, std), 360.0))
    assert abs(difference_deg(found.value, mean)) < 0.03 * std + 1e-9
    assert found.std == pytest.approx(std, rel=0.03)
    assert found.high95 - found.low95 == pytest.approx(2 * 1.96 * std, rel=0.05)
    assert found.low95 < found.value < found.high95 and 0 <= found.value < 360


def test_across_zero_the_plain_mean_is_wrong_and_the_interval_leaves_the_turn():
    draws = np.mod(_draws(359.0, 3.0), 360.0)
    assert abs(difference_deg(draws.mean(), 359.0)) > 20  # what the circular mean is for
    found = _phase(draws)
    assert abs(difference_deg(found.value, 359.0)) < 0.1
    assert found.high95 > 360 and found.low95 > 350
    below = _phase(np.mod(_draws(1.0, 3.0), 360.0))
    assert below.low95 < 0 < below.value < below.high95


def test_a_mean_that_rounds_to_a_whole_turn_stands_inside_its_interval():
    for shift in (0.0, 1e-14, -1e-14, 360.0):
        found = _phase(np.array([350.0, 355.0, 0.0, 5.0, 370.0]) + shift)
        assert found.low95 < found.value < found.high95 and 0 <= found.value < 360


def test_turns_added_change_nothing():
    draws = _draws(100.0, 5.0)
    turns = 360.0 * np.random.default_rng(1).integers(-3, 4, len(draws))
    one, other = _phase(draws), _phase(draws + turns)
    assert vars(other) == pytest.approx(vars(one), abs=1e-9)


def test_the_interval_holds_its_share():
    draws = _draws(200.0, 10.0)
    found = _phase(draws)
    inside = (draws >= found.low95) & (draws <= found.high95)
    assert np.mean(inside) == pytest.approx(0.95, abs=1e-3)

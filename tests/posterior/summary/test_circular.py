"""Phases: means across the zero, spread, and intervals that may leave the turn."""

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from vttig_jax.base.angles import difference_deg
from vttig_jax.posterior.summary.draws import phase_of_draws


def _phase(draws: np.ndarray) -> Any:
    """The parameter of draws, whose numbers are all given."""
    return phase_of_draws("phase_deg", draws)


@given(st.floats(0, 360), st.floats(0.01, 20))
@example(359.0, 3.0)
@example(1.0, 3.0)
def test_a_phase_is_that_of_the_line_wherever_it_lies(mean, std):
    draws = mean + std * np.random.default_rng(0).standard_normal(20_000)
    found = _phase(np.mod(draws, 360.0))
    assert abs(difference_deg(found.value, mean)) < 0.03 * std + 1e-9
    assert found.std == pytest.approx(std, rel=0.03)
    assert found.high95 - found.low95 == pytest.approx(2 * 1.96 * std, rel=0.05)
    assert found.low95 < found.value < found.high95 and 0 <= found.value < 360
    off = np.asarray(difference_deg(draws, found.value))
    inside = (off >= found.low95 - found.value) & (off <= found.high95 - found.value)
    assert np.mean(inside) == pytest.approx(0.95, abs=1e-3)


def test_a_mean_that_rounds_to_a_whole_turn_stands_inside_its_interval():
    for shift in (0.0, 1e-14, -1e-14, 360.0):
        found = _phase(np.array([350.0, 355.0, 0.0, 5.0, 370.0]) + shift)
        assert found.low95 < found.value < found.high95 and 0 <= found.value < 360


def test_turns_added_change_nothing():
    random = np.random.default_rng(0)
    draws = 100.0 + 5.0 * random.standard_normal(20_000)
    one, other = _phase(draws), _phase(draws + 360.0 * random.integers(-3, 4, len(draws)))
    assert vars(other) == pytest.approx(vars(one), abs=1e-9)

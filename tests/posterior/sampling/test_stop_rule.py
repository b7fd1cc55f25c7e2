import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.posterior.sampling.stop_rule import BLOCK_STEPS, Until, next_decision, steps_needed

pytestmark = pytest.mark.smoke


@given(st.integers(0, 10**6))
def test_decisions_are_at_block_ends_and_never_far(steps):
    decision = next_decision(steps)
    assert decision > steps and decision % BLOCK_STEPS == 0
    assert decision <= max(1000, 1.2 * steps + 2 * BLOCK_STEPS)
    assert next_decision(decision - 1) == decision  # the same from wherever it is looked for


def test_a_chain_of_the_steps_needed_is_long_enough_after_burn_in():
    steps = steps_needed(37.0, Until())
    assert 0.75 * steps / 37.0 >= 50 > 0.75 * (steps - BLOCK_STEPS) / 37.0
    assert steps_needed(math.inf, Until()) == 0


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"autocorrelation_times": 0.0}, "autocorrelation_times"),
        ({"autocorrelation_times": math.nan}, "autocorrelation_times"),
        ({"r_hat": 1.0}, "r_hat"),
        ({"r_hat": math.inf}, "r_hat"),
        ({"most_steps": 199}, "most_steps"),
    ],
)
def test_rules_that_make_no_sense_are_refused(options, name):
    with pytest.raises(ValueError, match=f"Argument `{name}` must be"):
        Until(**options)

"""The remark beside a value that is not significant never contradicts its interval."""

from collections.abc import Sequence

import numpy as np
import pytest

from vttig_jax.base.numerics.quantiles import NORMAL_95
from vttig_jax.identify.preliminary.delay import SIGNIFICANT, judge_delay
from vttig_jax.identify.preliminary.nuisance import NuisanceRegression
from vttig_jax.identify.report.check_sentences import doubt
from vttig_jax.identify.report.parameters import BELOW

STD = 2e-5


class OneDelay(NuisanceRegression):
    """Regression that finds a delay of `total` s."""

    def left(self, name: str) -> float:
        return 1.0

    def estimate(self, name: str, among: Sequence[str]) -> tuple[float, float]:
        return self.total, STD


@pytest.mark.parametrize("errors", [-3.9, -3.2, -2.1, -1.0, 0.0, 1.9, 2.0, 2.9, 3.1, 3.99])
def test_a_delay_below_four_standard_errors_states_this_rule(errors):
    judged = judge_delay(
        OneDelay(("delay",), np.eye(2), 10.0, errors * STD, np.ones(1)),
        (),
        0.0,
        forced=False,
        two_flanks=True,
        steady=False,
        within_s=1e-3,
    )
    assert judged.state == "insignificant" and abs(errors) < SIGNIFICANT
    low, high = ((errors + side * NORMAL_95) * STD for side in (-1, 1))
    mark = doubt(judged.step_s, low, high, judged.reason)
    if low <= 0 <= high:
        assert mark == " (not significant)"
    else:
        assert mark == " (below 4 standard errors, taken as zero)"


def test_other_values_state_the_rule_that_judges_them():
    assert doubt(2.5, 0.5, 4.5, BELOW) == " (below three standard errors)"
    assert doubt(-5.0, -7.0, -3.0, "negative, which no gap is: a wrong sign") == " (below zero)"

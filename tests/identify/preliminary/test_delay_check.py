"""A delay that leaves more than none does is open, and a right one of many samples stays."""

from dataclasses import replace

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, level, there_and_back
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.preliminary import model_selection
from vttig_jax.identify.preliminary.delay import Delay
from vttig_jax.identify.preliminary.delay_check import explaining

PAIR = drive("1/2")


def test_a_delay_must_explain_the_log(monkeypatch):
    """The driven channel is late by five samples; thirty samples explain nothing."""
    seen = []

    def kept(delay, weights, linear, *, bound_s):
        seen.append((delay, weights, linear))
        return explaining(delay, weights, linear, bound_s=bound_s)

    monkeypatch.setattr(model_selection, "explaining", kept)
    motion = there_and_back([60, 30], 6)

    def error(angle, _):
        return 900 * np.sin(angle + 0.3)

    log = drive_log(PAIR, motion, gap=level(300.0), error=error, delay_s=level(0.05))
    delay = fit(log, PAIR).parameters["delay_s"]
    assert delay.significant and delay.value == pytest.approx(0.05, abs=1e-3)
    right, weights, linear = seen[-1]
    assert explaining(right, weights, linear, bound_s=0.01) is right
    off = weights.look(linear.inputs, replace(linear.model, regressors=()), 0.3, linear.block_s)
    wrong = Delay("fitted", 0.3, 1e-6, 1e-4)
    found = explaining(wrong, weights, off, bound_s=0.01)
    assert found.state == "open" and "larger residual" in found.reason and found.within_s == 0.01
    for bound_s in (0.3, np.inf):
        assert explaining(wrong, weights, off, bound_s=bound_s) is wrong
    other = Delay("insignificant", 0.0, 0.3, 0.1)
    assert explaining(other, weights, off, bound_s=0.01) is other

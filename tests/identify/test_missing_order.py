"""An order that the model leaves out and that stands out by ten standard errors is told.

Nine fits of a second each: most of it is the search for lines, which is what is tested.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.residual_check import (
    MODELLED,
    Seen,
    cycles_of,
    missing,
    random_rig,
    seen,
    share,
    standard_error_deg,
    with_orders,
)
from vttig_jax.identify.fitting import fit

TURNS = 6.0
PLACE = ("driving", 3)


@cache
def told(number: int, height: float, apart_deg: float | None = None) -> Seen:
    """What the fit of a rig says of an order of this height: one flank, or both so far apart."""
    generator = np.random.default_rng([41, number])
    rig = random_rig(generator, TURNS)
    amplitude = height * standard_error_deg(*PLACE, TURNS)
    orders = missing(*PLACE, "one_flank" if height else "none", amplitude, generator)
    if apart_deg is not None:
        orders = tuple(
            replace(orders[0], flank=flank, phase_deg=20.0 + turn)
            for flank, turn in (("A", 0.0), ("B", apart_deg))
        )
    result = fit(with_orders(rig, orders).log(number), rig.pair, orders=MODELLED)
    case = ("none", "one_flank", "both_flanks")[len(orders)]
    return seen(result, case, orders, PLACE, TURNS)


def test_ten_standard_errors_on_one_flank_are_told():
    assert all(told(number, 10.0).flagged for number in range(2))
    assert all(told(number, 10.0).line for number in range(2))


def test_nothing_is_told_where_nothing_is_missing():
    assert not any(told(number, 0.0).flagged for number in range(2))


def test_a_tenth_of_it_is_not_told():
    assert not told(0, 1.0).line


def test_one_phase_on_both_flanks_is_told():
    assert told(0, 10.0, 0.0).line


def test_opposite_phases_on_both_flanks_are_told():
    assert told(0, 10.0, 180.0).flagged


def test_the_standard_error_falls_with_the_length_of_the_log():
    """As the root of the turns, and near that of white noise of the same strength at low frequency.

    A sample of variance s² with a memory of τ has the spectral density 2 s² τ; the amplitude in a
    log of T seconds then has the variance 2 · 2 s² τ / T.
    """
    expected = np.sqrt(4 * 0.002**2 * 0.00475 / TURNS)
    assert standard_error_deg(*PLACE, TURNS) == pytest.approx(expected, rel=0.15)


def test_cycles_and_shares():
    assert cycles_of("driven", 2) == 1.125
    found = share([True] * 19 + [False])
    assert found["share"] == 0.95
    assert found["low95"] == pytest.approx(0.7513, abs=1e-4)
    assert found["high95"] == pytest.approx(0.9987, abs=1e-4)

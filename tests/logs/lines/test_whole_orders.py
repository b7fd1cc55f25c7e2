"""Whole orders of a shaft are found in all turns of a log, and nothing else is."""

import numpy as np
import pytest

from vttig_jax.logs.lines.whole_orders import whole_orders

ORDERS = range(9, 25)
FIRST = 1e-3


def run(
    parts: dict[float, float], *, turns: float = 12.7, start: float = 0.3, seed: int = 0, rows=200
):
    """Angle and transmission error with {cycles: amplitude} beside large low orders."""
    angle = 2 * np.pi * (start + np.linspace(0.0, turns, int(turns * rows)))
    value = FIRST * np.sin(angle) + 2 * FIRST * np.sin(4 * angle + 1) + 1e-4 * angle
    value += sum(a * np.sin(c * angle + 0.4) for c, a in parts.items())
    return angle, value + np.random.default_rng(seed).normal(0.0, 1e-5, len(angle))


def certain(*runs) -> dict[int, float]:
    return {
        one.order: one.amplitude for one in whole_orders(runs, ORDERS) if one.false_alarm < 1e-8
    }


@pytest.mark.parametrize("order", [9, 12, 24])
def test_an_order_is_found_with_its_amplitude(order: int):
    assert certain(run({order: 1e-4})) == {order: pytest.approx(1e-4, rel=0.05)}


def test_runs_of_both_ways_have_one_phase():
    angle, value = run({12: 2e-5}, turns=6.3)
    other = run({12: 2e-5}, turns=5.2, start=7.9, seed=1)
    assert not certain((angle, value))
    assert list(certain((angle, value), (other[0][::-1], other[1][::-1]))) == [12]


@pytest.mark.parametrize("parts", [{}, {12.31: 1e-4}, {12.04: 1e-4}, {17 * 9 / 16: 1e-4}])
def test_noise_and_lines_beside_an_order_are_none(parts: dict[float, float]):
    assert not certain(run(parts))


def test_the_probability_is_that_of_noise():
    """Of all orders in noise, one in a hundred has a probability below one in a hundred."""
    runs, counted = 400, len(ORDERS)
    below = sum(
        one.false_alarm < 1e-2
        for seed in range(runs)
        for one in whole_orders([run({}, seed=seed, turns=20.4)], ORDERS)
    )
    assert 0.3e-2 < below / (runs * counted) < 1.7e-2


def test_too_few_turns_show_nothing():
    assert whole_orders([run({12: 1e-4}, turns=4.5)], ORDERS) == []
    assert whole_orders([], ORDERS) == [] and whole_orders([run({})], range(9, 9)) == []

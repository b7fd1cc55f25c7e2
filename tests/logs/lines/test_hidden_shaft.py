"""Multiples of one frequency are a shaft, and lines anywhere are none."""

import numpy as np
import pytest

from vttig_jax.logs.lines.search import hidden_shaft

STDS = [0.003, 0.0004, 0.002, 0.004]
pytestmark = pytest.mark.smoke


def seen(generator: np.random.Generator, cycles: np.ndarray, stds: list[float]) -> list[float]:
    return (cycles + generator.normal(size=len(cycles)) * stds[: len(cycles)]).tolist()


@pytest.mark.parametrize("orders", [(1, 2, 3), (1, 2, 3, 4), (2, 3, 5), (1, 2, 4)])
def test_a_shaft_is_found(orders):
    generator, found = np.random.default_rng(1), []
    for _ in range(200):
        turns = generator.uniform(0.7, 2.3)
        stds = STDS[: len(orders)]
        shaft = hidden_shaft(seen(generator, turns * np.array(orders), stds), stds)
        if shaft is not None and shaft.orders == orders:
            found.append((shaft.turns - turns) / shaft.std)
    assert len(found) > 170
    assert np.std(found) == pytest.approx(1.0, abs=0.2)


def test_lines_anywhere_are_no_shaft():
    """At most a thousandth of them."""
    generator = np.random.default_rng(2)
    named = 0
    for _ in range(4000):
        count = int(generator.integers(2, 5))
        named += hidden_shaft(generator.uniform(0.5, 12, count).tolist(), STDS[:count]) is not None
    assert named <= 8


def test_a_further_line_is_not_counted():
    shaft = hidden_shaft([1.5, 3.0004, 4.5, 2.2], STDS)
    assert shaft is not None and shaft.orders == (1, 2, 3)


@pytest.mark.parametrize("cycles", [[], [1.5], [1.5, 2.9], [1.5, 3.0]])
def test_one_line_or_a_rough_pair_is_no_shaft(cycles):
    assert hidden_shaft(cycles, [0.01] * len(cycles)) is None


def test_a_sharp_pair_is_a_shaft():
    shaft = hidden_shaft([1.5437, 3.0874], [1e-5, 1e-5])
    assert shaft is not None and shaft.orders == (1, 2)


@pytest.mark.parametrize(
    ("turns", "orders"),
    [(0.0325, (2, 4, 5, 6, 8, 9)), (0.8333, (1, 2, 4, 8))],
)
def test_even_orders_alone_are_no_shaft_of_twice_the_speed(turns, orders):
    generator, found = np.random.default_rng(3), 0
    stds = [2e-4 * turns] * len(orders)
    for _ in range(100):
        shaft = hidden_shaft(seen(generator, turns * np.array(orders), stds), stds)
        found += shaft is not None and shaft.orders == orders
    assert found > 75

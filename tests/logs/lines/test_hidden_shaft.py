"""Multiples of one frequency are a shaft, and lines anywhere are none."""

import numpy as np
import pytest

from vttig_jax.logs.lines.search import hidden_shaft

STDS = [0.003, 0.0004, 0.002, 0.004]
pytestmark = pytest.mark.smoke


SHAFTS = [((0.7, 2.3), orders, STDS) for orders in ((1, 2, 3), (1, 2, 3, 4), (2, 3, 5), (1, 2, 4))]
# Even orders alone are no shaft of twice the speed.
SHAFTS += [((0.0325, 0.0325), (2, 4, 5, 6, 8, 9), [6.5e-6] * 6)]
SHAFTS += [((0.8333, 0.8333), (1, 2, 4, 8), [1.6666e-4] * 4)]


@pytest.mark.parametrize(("turns_between", "orders", "stds"), SHAFTS)
def test_a_shaft_is_found(turns_between, orders, stds):
    generator, found = np.random.default_rng(1), []
    stds = stds[: len(orders)]
    for _ in range(200):
        turns = generator.uniform(*turns_between)
        seen = turns * np.array(orders) + generator.normal(size=len(orders)) * stds
        shaft = hidden_shaft(seen.tolist(), stds)
        if shaft is not None and shaft.orders == orders:
            found.append((shaft.turns - turns) / shaft.std)
    assert len(found) > (150 if turns_between[0] == turns_between[1] else 170)
    assert np.std(found) == pytest.approx(1.0, abs=0.2)


def test_lines_anywhere_are_no_shaft():
    """At most a thousandth of them."""
    generator = np.random.default_rng(2)
    named = 0
    for _ in range(4000):
        count = int(generator.integers(2, 5))
        named += hidden_shaft(generator.uniform(0.5, 12, count).tolist(), STDS[:count]) is not None
    assert named <= 8


@pytest.mark.parametrize(
    ("cycles", "stds", "orders"),
    [
        ([], [], None),
        ([1.5], [0.01], None),
        ([1.5, 2.9], [0.01] * 2, None),
        ([1.5, 3.0], [0.01] * 2, None),  # a rough pair
        ([1.5437, 3.0874], [1e-5] * 2, (1, 2)),
        ([1.5, 3.0004, 4.5, 2.2], STDS, (1, 2, 3)),  # a further line is not counted
    ],
)
def test_a_shaft_needs_three_lines_or_a_sharp_pair(cycles, stds, orders):
    shaft = hidden_shaft(cycles, stds)
    assert (None if shaft is None else shaft.orders) == orders

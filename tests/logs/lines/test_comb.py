"""Power at multiples of the frequency of a line is a shaft, and lines anywhere are none."""

import numpy as np
import pytest
from scipy.signal import lfilter

from vttig_jax.logs import Stretch
from vttig_jax.logs.lines.comb import shaft_of_multiples

pytestmark = pytest.mark.smoke


def seen(
    seed: int,
    lines: dict[float, float],
    *,
    turns: float = 40.0,
    memory: float = 0.9,
    sides: int = 2,
) -> list[list[Stretch]]:
    """Lines with amplitudes in standard deviations of noise that remembers."""
    generator, rows = np.random.default_rng([seed, 7]), int(40 * turns)
    angle = 2 * np.pi * turns * np.linspace(0.0, 1.0, rows)
    found = []
    for side in range(sides):
        noise = lfilter([1.0], [1.0, -memory], generator.normal(size=rows))
        value = noise * np.sqrt(1 - memory**2) + sum(
            size * np.sin(cycles * angle + generator.uniform(0, 2 * np.pi))
            for cycles, size in lines.items()
        )
        found.append([Stretch(angle, 1e-5 * value, np.ones((rows, 1)), str(side))])
    return found


def shaft_of(sides: list[list[Stretch]], *lines: float, highest: float = 12.0):
    def is_order(cycles: float) -> bool:
        return abs(cycles - round(cycles)) < 0.025

    return shaft_of_multiples(sides, lines, highest=highest, is_order=is_order)


@pytest.mark.parametrize("orders", [(1, 2, 3, 4), (2, 3, 4, 5), (1, 2, 4, 5)])
def test_a_shaft_is_found(orders):
    errors = []
    for seed in range(5):
        turns = float(np.random.default_rng(seed).uniform(1.43, 1.46))
        sizes = {order * turns: 10.0 if order == 2 else 2.0 for order in orders}
        shaft = shaft_of(seen(seed, sizes), 2 * turns)
        assert shaft is not None and shaft.orders == orders and shaft.coincidence < 1e-3
        errors.append((shaft.turns - turns) / shaft.std)
    assert 0.3 < np.sqrt(np.mean(np.square(errors))) < 2.0


def test_lines_anywhere_are_no_shaft():
    """The probability of a name is at most a thousandth; here none of 15 sets has one."""
    generator = np.random.default_rng(2)
    for seed in range(15):
        strong, *weak = generator.uniform(0.7, 11.5, int(generator.integers(2, 6)))
        lines = {strong: 10.0} | {cycles: generator.uniform(1.0, 5.0) for cycles in weak}
        memory = float(generator.choice([0.0, 0.9, 0.97]))
        assert shaft_of(seen(seed, lines, memory=memory), *lines) is None, (seed, lines)


def test_noise_beside_a_line_is_no_shaft():
    for seed in range(5):
        assert shaft_of(seen(seed, {3.0874: 20.0}, memory=0.98), 3.0874) is None


def test_a_further_line_is_not_counted():
    lines = {1.44: 3.0, 2.88: 10.0, 4.32: 3.0, 5.76: 3.0, 2.2: 8.0}
    shaft = shaft_of(seen(0, lines), 2.88, 2.2)
    assert shaft is not None and shaft.orders == (1, 2, 3, 4)


def test_the_amplitudes_may_differ_between_the_sides():
    lines = {1.44: 3.0, 2.88: 10.0, 4.32: 3.0, 5.76: 3.0}
    both = [seen(1, lines)[0], seen(2, {2.88: 10.0, 4.32: 3.0})[1]]
    shaft = shaft_of(both, 2.88)
    assert shaft is not None and set(shaft.orders) >= {1, 2, 3}


def test_whole_orders_do_not_count():
    lines = {1.5: 10.0, 3.0: 5.0, 6.0: 5.0, 9.0: 5.0}
    assert shaft_of(seen(3, lines), 1.5) is None
    moved = {1.53 * order: 5.0 for order in (1, 2, 4, 6)}
    assert shaft_of(seen(3, moved), 1.53) is not None


def test_a_pair_is_no_shaft_unless_it_is_sharp():
    """On 40 turns any two lines may be multiples; on 1500 turns they are not by chance."""
    lines = {1.4437: 10.0, 2.8874: 10.0}
    assert shaft_of(seen(4, lines), *lines) is None
    many = seen(4, lines, turns=1500.0, memory=0.0, sides=1)
    shaft = shaft_of(many, *lines)
    assert shaft is not None and shaft.orders == (1, 2)


@pytest.mark.parametrize(("lines", "turns"), [([], 40.0), ([1.44], 0.05), ([14.0], 40.0)])
def test_nothing_to_judge_is_no_shaft(lines, turns):
    assert shaft_of(seen(0, {1.44: 5.0}, turns=max(turns, 1.0)), *lines, highest=turns) is None

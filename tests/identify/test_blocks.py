"""Block means of every column against direct NumPy means."""

import numpy as np
import pytest

from vttig_jax.identify import blocks
from vttig_jax.identify.blocks import BlockPlan, block_rows, block_size


def _channels(plan: BlockPlan, count: int = 5003):
    """Ragged motion, to and fro, that covers a quarter of the highest cycle in a block at most."""
    generator = np.random.default_rng(3)
    highest = max([1.0, *(abs(a) + abs(b) for a, b in plan.free + plan.tied)])
    step = np.pi / 2 / (highest * plan.size)
    driving = np.cumsum(generator.uniform(-0.3, 0.99, count)) * step - 40.0
    driven = 0.5625 * driving + 1e-3 * np.sin(driving)
    time = np.linspace(-1, 1, count)
    return driving, driven, time, generator.standard_normal(count)


def _direct(plan: BlockPlan, driving, driven, time, error):
    def harmonics(terms):
        for first, second in terms:
            phase = first * driving + second * driven
            yield np.cos(phase)
            yield np.sin(phase)

    drift = [time**power for power in range(plan.drift_order + 1)]
    every = [*harmonics(plan.free), *drift, *harmonics(plan.tied), error]
    count = len(error) // plan.size
    return np.stack(
        [c[: count * plan.size].reshape(count, plan.size).mean(axis=1) for c in every], axis=1
    )


PLANS = {
    "one": BlockPlan((), ((1, 0),), 0, 10),
    "paper": BlockPlan(((2, 0), (3, 0), (0, 2), (45, 0)), ((1, 0), (0, 1), (1, 1), (1, -1)), 2, 11),
    "single samples": BlockPlan(((5, 0),), ((1, 0), (0, 1)), 1, 1),
    "negative orders": BlockPlan(((3, -2), (-1, 2), (0, -3)), ((2, -1),), 0, 7),
    "high drift": BlockPlan((), ((0, 1),), 6, 25),
    "no harmonics": BlockPlan((), (), 3, 4),
}


@pytest.mark.parametrize("plan", PLANS.values(), ids=list(PLANS))
def test_rows_are_plain_means(plan):
    channels = _channels(plan)
    rows = block_rows(plan, *channels)
    expected = _direct(plan, *channels)
    assert rows.shape == expected.shape == (5003 // plan.size, plan.width)
    np.testing.assert_allclose(rows, expected, atol=1e-8)
    # The tolerance tells neighbouring samples apart.
    shifted = _direct(plan, *(np.roll(c, 1) for c in channels))
    assert np.abs(rows - shifted).max() > 1e-4


@pytest.mark.parametrize("count", [16_383, 16_384, 16_385, 40_000])
def test_chunks_leave_no_seam(count):
    plan = BlockPlan(((2, 0),), ((1, 0),), 1, 7)
    channels = _channels(plan, count)
    np.testing.assert_allclose(block_rows(plan, *channels), _direct(plan, *channels), atol=1e-8)


def test_small_chunks_give_the_same(monkeypatch):
    plan = BlockPlan(((2, 0),), ((1, 0), (0, 1)), 1, 10)
    channels = _channels(plan, 1000)
    whole = block_rows(plan, *channels)
    monkeypatch.setattr(blocks, "_CHUNK_CELLS", 37)
    np.testing.assert_allclose(block_rows(plan, *channels), whole, atol=1e-14)


def test_an_incomplete_block_is_dropped():
    plan = BlockPlan((), ((1, 0),), 0, 10)
    channels = _channels(plan, 95)
    rows = block_rows(plan, *channels)
    assert len(rows) == 9
    np.testing.assert_array_equal(rows, block_rows(plan, *(c[:90] for c in channels)))
    assert len(block_rows(plan, *(c[:9] for c in channels))) == 0


def test_width_counts_the_columns():
    plan = PLANS["paper"]
    assert plan.width == 4 * 2 + 3 + 4 * 2 + 1
    assert plan.tied_columns == 3 + 4 * 2


@pytest.mark.parametrize(
    ("samples_per_turn", "highest", "size"),
    [
        (1987, 45, 11),  # four blocks a cycle of order 45
        (1987, 8, 62),  # never under 32 blocks a turn
        (5000, 200, 10),  # 2.5 blocks a cycle beyond 256
        (10_000, 90, 39),  # 256 where 4 a cycle would be more
        (100, 45, 1),
        (10, 1, 1),
    ],
)
def test_block_size(samples_per_turn, highest, size):
    assert block_size(float(samples_per_turn), float(highest)) == size

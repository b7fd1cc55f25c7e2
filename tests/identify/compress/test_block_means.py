"""Block means of every column against direct NumPy means."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest

from vttig_jax.identify.compress import block_means as blocks
from vttig_jax.identify.compress.block_means import block_means, block_rows, block_size
from vttig_jax.identify.model.column_layout import OFFSET, ColumnLayout


@dataclass(frozen=True)
class Case:
    """A layout and the samples in a block."""

    columns: ColumnLayout
    size: int


def _case(free, tied, powers: int, size: int) -> Case:
    own = (OFFSET, *(f"drift_{power}" for power in range(1, powers + 1)))
    return Case(ColumnLayout(free, tied, (own,)), size)


def _channels(case: Case, count: int = 5003):
    """Ragged motion, to and fro, that covers a quarter of the highest cycle in a block at most."""
    generator = np.random.default_rng(3)
    orders = case.columns.free + case.columns.tied
    highest = float(max([1.0, *(abs(a) + abs(b) for a, b in orders)]))
    step = np.pi / 2 / (highest * case.size)
    driving = np.cumsum(generator.uniform(-0.3, 0.99, count)) * step - 40.0
    driven = 0.5625 * driving + 1e-3 * np.sin(driving)
    time = np.linspace(-1, 1, count)
    own = time ** np.arange(1, case.columns.own_width)[:, None]
    return driving, driven, own, generator.standard_normal(count)


def _direct(case: Case, driving, driven, own, error, weight=None):
    def harmonics(terms):
        for first, second in terms:
            phase = float(first) * driving + float(second) * driven
            yield np.cos(phase)
            yield np.sin(phase)

    columns, size = case.columns, case.size
    ones = np.ones_like(error)
    every = [*harmonics(columns.free), ones, *own, *harmonics(columns.tied), error]
    weight = ones if weight is None else weight
    count = len(error) // size
    total = weight[: count * size].reshape(count, size).sum(axis=1)
    with np.errstate(invalid="ignore"):
        # A weighted mean that counts with the root of the share of weight in its block.
        means = [
            (weight * c)[: count * size].reshape(count, size).sum(axis=1) / np.sqrt(total * size)
            for c in every
        ]
    return np.nan_to_num(np.stack(means, axis=1))


CASES = {
    "one": _case((), ((1, 0),), 0, 10),
    "paper": _case(((2, 0), (3, 0), (0, 2), (45, 0)), ((1, 0), (0, 1), (1, 1), (1, -1)), 2, 11),
    "single samples": _case(((5, 0),), ((1, 0), (0, 1)), 1, 1),
    "negative orders": _case(((3, -2), (-1, 2), (0, -3)), ((2, -1),), 0, 7),
    "high drift": _case((), ((0, 1),), 6, 25),
    "no harmonics": _case((), (), 3, 4),
    "long blocks": _case(((3, 0), (0, 2)), ((1, 0), (1, -1)), 1, 100),
    "fractions": _case(((Fraction(7, 3), 0), (2, Fraction(1, 2))), ((1, 0),), 0, 9),
}


@pytest.mark.parametrize("case", CASES.values(), ids=list(CASES))
def test_rows_are_plain_means(case):
    channels = _channels(case)
    rows = block_rows(case.columns, case.size, *channels)
    expected = _direct(case, *channels)
    assert rows.shape == expected.shape == (5003 // case.size, case.columns.width)
    np.testing.assert_allclose(rows, expected, atol=1e-8)
    # The tolerance tells neighbouring samples apart.
    shifted = _direct(case, *(np.roll(c, 1, axis=-1) for c in channels))
    assert np.abs(rows - shifted).max() > 1e-4


@pytest.mark.parametrize("case", [CASES["paper"], CASES["single samples"]], ids=["paper", "single"])
def test_weighted_rows_are_weighted_means_times_the_root_of_their_share(case):
    channels = _channels(case)
    weight = np.random.default_rng(0).uniform(0, 1, 5003)
    weight[100:160] = 0.0
    rows = block_rows(case.columns, case.size, *channels, weight)
    np.testing.assert_allclose(rows, _direct(case, *channels, weight), atol=1e-8)
    # Neither the plain mean nor a sum that is not rescaled.
    assert np.abs(rows - _direct(case, *channels)).max() > 1e-2
    empty = slice(-(-100 // case.size), 160 // case.size)
    np.testing.assert_array_equal(rows[empty], 0.0)
    assert empty.stop - empty.start >= 4


def test_weights_of_one_and_of_a_half():
    """Weight 1/2 everywhere scales every row by √½: least squares then counts half the rows."""
    case = CASES["paper"]
    channels = _channels(case)
    plain = block_rows(case.columns, case.size, *channels)
    for share in (1.0, 0.5):
        rows = block_rows(case.columns, case.size, *channels, np.full(5003, share))
        np.testing.assert_allclose(rows, np.sqrt(share) * plain, atol=1e-12)


def test_least_squares_on_weighted_blocks_of_one_sample_is_weighted_least_squares():
    case = CASES["single samples"]
    channels = _channels(case)
    weight = np.random.default_rng(1).choice([0.0, 0.3, 1.0], 5003)
    plain = _direct(case, *channels)
    rows = block_rows(case.columns, case.size, *channels, weight)
    found = np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=None)[0]
    x, y = plain[:, :-1], plain[:, -1]
    expected = np.linalg.solve(x.T @ (weight[:, None] * x), x.T @ (weight * y))
    np.testing.assert_allclose(found, expected, atol=1e-9)
    unweighted = np.linalg.lstsq(x, y, rcond=None)[0]
    assert np.abs(found - unweighted).max() > 1e-3


@pytest.mark.parametrize("count", [16_383, 16_384, 16_385, 40_000])
def test_chunks_leave_no_seam(count):
    case = _case(((2, 0),), ((1, 0),), 1, 7)
    channels = _channels(case, count)
    rows = block_rows(case.columns, case.size, *channels)
    np.testing.assert_allclose(rows, _direct(case, *channels), atol=1e-8)


def test_small_chunks_give_the_same(monkeypatch):
    case = _case(((2, 0),), ((1, 0), (0, 1)), 1, 10)
    channels = _channels(case, 1000)
    weight = np.random.default_rng(2).uniform(0, 1, 1000)
    plain = block_rows(case.columns, case.size, *channels)
    weighted = block_rows(case.columns, case.size, *channels, weight)
    monkeypatch.setattr(blocks, "_CHUNK", 37)
    for rows, more in ((plain, ()), (weighted, (weight,))):
        again = block_rows(case.columns, case.size, *channels, *more)
        np.testing.assert_allclose(again, rows, atol=1e-14)


def test_an_incomplete_block_is_dropped():
    case = _case((), ((1, 0),), 0, 10)
    channels = _channels(case, 95)
    rows = block_rows(case.columns, 10, *channels)
    assert len(rows) == 9
    np.testing.assert_array_equal(
        rows, block_rows(case.columns, 10, *(c[..., :90] for c in channels))
    )
    assert len(block_rows(case.columns, 10, *(c[..., :9] for c in channels))) == 0
    np.testing.assert_array_equal(block_means(np.arange(7.0), 3), [1.0, 4.0])


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

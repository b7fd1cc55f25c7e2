"""Terms of ISO 1328-1 and ISO 230-2 beside loops over their definitions."""

import numpy as np
import pytest

from vttig_jax.kinematics.accuracy import (
    AXIS,
    SINGLE_FLANK,
    axis_numbers,
    axis_terms,
    perfect_axis,
    single_flank,
    single_flank_numbers,
)


def looped(curve: np.ndarray, pitches: int) -> dict[str, float]:
    """F_is, both f_is and f_l of a turn: windows one by one, long waves by least squares."""
    count = len(curve)
    angle = 2 * np.pi * np.arange(count) / count
    waves = [np.ones(count)]
    for k in range(1, pitches):
        if k < pitches / 2:
            waves += [np.cos(k * angle), np.sin(k * angle)]
    basis = np.column_stack(waves)
    long = basis @ np.linalg.lstsq(basis, curve, rcond=None)[0]
    step = count // pitches

    def largest(values: np.ndarray) -> float:
        found = 0.0
        for start in range(count):
            seen = [values[(start + k) % count] for k in range(step + 1)]
            found = max(found, max(seen) - min(seen))
        return found

    return {
        "F_is": max(curve) - min(curve),
        "f_is_1995": largest(curve),
        "f_is_2013": largest(curve - long),
        "f_l": max(long) - min(long),
    }


def series(rng: np.random.Generator, pitches: int) -> tuple[np.ndarray, np.ndarray]:
    """Orders and complex amplitudes of a gear: long waves, and the mesh with its double."""
    order = np.arange(1, 3 * pitches)
    size = 10.0 / order**1.5 * (order < 7) + 2.0 * (order == pitches) + (order == 2 * pitches)
    return order, size * np.exp(1j * rng.uniform(0, 2 * np.pi, len(order)))


def summed(order: np.ndarray, value: np.ndarray, count: int) -> np.ndarray:
    angle = 2 * np.pi * np.arange(count) / count
    return np.real(value @ np.exp(1j * np.outer(order, angle)))


@pytest.mark.parametrize("pitches", [12, 17])
def test_single_flank_is_that_of_loops(pitches):
    order, value = series(np.random.default_rng(pitches), pitches)
    points = 12 * pitches
    curve = summed(order, value, points)
    long = summed(order, value * (order < pitches / 2), points)
    truth = looped(curve, pitches)
    found = dict(zip(SINGLE_FLANK, single_flank(curve, long, pitches), strict=True))
    assert found == pytest.approx(truth, rel=1e-9)
    assert len({round(one, 6) for one in truth.values()}) == 4
    std = np.full(len(order), 1e-9)
    numbers = single_flank_numbers(value, std, order, pitches, points, order >= pitches)
    assert numbers[0] == pytest.approx(list(truth.values()), rel=1e-9)
    assert numbers[1] == pytest.approx(numbers[0], rel=1e-6)


def test_without_teeth_the_range_alone_is_defined():
    found = single_flank(np.array([[0.0, 3.0], [1.0, -1.0]]), np.zeros((2, 2)), 0)
    assert found[:, 0].tolist() == [3.0, 2.0] and np.isnan(found[:, 1:]).all()


def test_noise_is_taken_off_a_range():
    """Of drawn gears the range as read is too large; the value is not, and intervals hold."""
    rng, pitches = np.random.default_rng(5), 12
    std, inside, off = np.full(3 * pitches - 1, 0.5), [], []
    for _ in range(30):
        order, value = series(rng, pitches)
        truth = looped(summed(order, value, 192), pitches)["F_is"]
        read = value + 0.5 * (rng.normal(size=len(order)) + 1j * rng.normal(size=len(order)))
        numbers = single_flank_numbers(read, std, order, pitches, 192, order >= pitches)
        as_read, found, low, high = numbers[:, 0]
        inside.append(low <= truth <= high)
        off.append([as_read - truth, found - truth])
    assert sum(inside) >= 25
    assert abs(np.mean(off, axis=0)[1]) < 0.4 * np.mean(off, axis=0)[0]


def test_what_one_wave_tells_is_not_taken_off_as_noise_of_another():
    """Order 1 could be large noise, which here is small; order 8 alone makes 2 × 0.25."""
    order, std = np.arange(1, 11), np.array([0.5, *np.full(9, 0.02)])
    value = 0.01 * np.exp(1j * order) + 0.25 * (order == 8) + 0.05 * (order == 1)
    _, found, low, high = single_flank_numbers(value, std, order, 0, 256, order > 10)[:, 0]
    assert 0.35 < found < high and low <= 0.5 <= high


def axis_looped(up: np.ndarray, down: np.ndarray) -> dict[str, float]:
    """The terms of readings (target, pass) by loops over the definitions of ISO 230-2."""
    found = {"B": 0.0, "R": 0.0}
    middles, means, tops, bottoms = [], [], [], []
    for one, other in zip(up, down, strict=True):
        x, y = sum(one) / len(one), sum(other) / len(other)
        s = (sum((v - x) ** 2 for v in one) / (len(one) - 1)) ** 0.5
        t = (sum((v - y) ** 2 for v in other) / (len(other) - 1)) ** 0.5
        found["B"] = max(found["B"], abs(x - y))
        found["R"] = max(found["R"], 2 * s + 2 * t + abs(x - y), 4 * s, 4 * t)
        middles.append((x + y) / 2)
        means += [x, y]
        tops += [x + 2 * s, y + 2 * t]
        bottoms += [x - 2 * s, y - 2 * t]
    found |= {"M": max(middles) - min(middles), "E": max(means) - min(means)}
    return found | {"A": max(tops) - min(bottoms)}


def test_the_axis_is_that_of_loops():
    rng = np.random.default_rng(2)
    readings = rng.normal(size=(9, 2, 6)) + 3 * rng.normal(size=(9, 2, 1))
    mean, std = readings.mean(axis=2), readings.std(axis=2, ddof=1)
    found = dict(zip(AXIS, axis_terms(mean, std), strict=True))
    assert found == pytest.approx(axis_looped(readings[:, 0], readings[:, 1]), rel=1e-12)
    count = np.full((9, 2), 6)
    numbers = axis_numbers(mean, std, count, count - 1)
    assert numbers[0] == pytest.approx(list(found.values()))
    assert (numbers[2] <= numbers[1]).all() and (numbers[1] <= numbers[3]).all()


def test_an_axis_without_error_shows_its_noise():
    """Ten targets, five passes each way, noise σ: A = 7.0 σ and R = 6.6 σ, and B may be zero."""
    rng, terms = np.random.default_rng(4), []
    for _ in range(300):
        readings = 2.0 * rng.normal(size=(10, 2, 5))
        terms.append(axis_looped(readings[:, 0], readings[:, 1]))
    for name, in_noise in {"A": 7.0, "R": 6.6}.items():
        assert np.mean([one[name] for one in terms]) / 2.0 == pytest.approx(in_noise, abs=0.15)
    count = np.full((10, 2), 5)
    told = dict(zip(AXIS, perfect_axis(count, count - 1).mean(axis=0), strict=True))
    assert told["A"] == pytest.approx(7.0, abs=0.05) and told["R"] == pytest.approx(6.6, abs=0.05)
    readings = 2.0 * rng.normal(size=(10, 2, 5))
    mean, std = readings.mean(axis=2), readings.std(axis=2, ddof=1)
    low = axis_numbers(mean, std, count, count - 1)[2]
    assert low[:3].tolist() == [0.0, 0.0, 0.0]

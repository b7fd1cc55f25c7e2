"""The largest density: one optimum from far starts, and which of two modes is taken."""

import jax.numpy as jnp
import numpy as np
import pytest

from tests.model.small import Small, drawn, rows_with
from vttig_jax.model import (
    GROUPS,
    LAGS,
    Column,
    RowName,
    first_theta,
    largest,
    log_density,
    maximise,
)


def _far(start: np.ndarray, seed: int) -> jnp.ndarray:
    rng = np.random.default_rng([3, seed])
    far = np.array([1.0] + [0.4] * (LAGS - 1) + [2.0] + [2.5] * len(GROUPS))
    return jnp.asarray(start + far * rng.normal(size=len(start)))


@pytest.mark.parametrize("seed", range(4))
def test_far_starts_end_in_one_optimum(seed):
    problem = drawn(seed, ((60, 45), (50, 70))).problem
    start = first_theta(problem.compressed)
    best = maximise(problem.compressed)
    told = best.aux
    step = np.linalg.solve(told.hessian, told.gradient)
    assert told.gradient @ step < 1e-8
    assert np.linalg.eigvalsh(told.hessian)[0] > 0
    for number in range(5):
        other = maximise(problem.compressed, _far(start, number))
        assert float(other.aux.value) == pytest.approx(float(told.value), abs=1e-6)
    assert float(-log_density(_far(start, 0), problem.compressed)) > float(told.value) + 1


def _sine_beside_noise(share: float) -> Small:
    """Five cycles of a sine over 160 rows: the order of a group, or noise with a resonance."""
    rng = np.random.default_rng(0)
    count = 160
    phase = 2 * np.pi * 5 * np.arange(count) / count
    noise = np.zeros(count + 50)
    for k in range(2, count + 50):
        noise[k] = 1.9 * np.cos(phase[1]) * noise[k - 1] - 0.9025 * noise[k - 2] + rng.normal()
    noise = noise[50:]
    y = share * noise.std() * np.sin(phase + 0.4) + noise
    table = np.c_[np.ones(count), np.cos(phase), np.sin(phase), y]
    one, c, s = names = [RowName(kind) for kind in ("one", "c", "s")]
    columns = Column(one, (0,)), Column(c, prior="driving"), Column(s, prior="driving")
    rows = rows_with(names, table, [count], ["A"])
    return Small(columns, (rows,), {}, dict.fromkeys(GROUPS, 0.05))


@pytest.mark.parametrize("share", [0.0, 1.0, 3.0])
def test_the_better_of_two_modes_is_taken(share):
    """The largest density is at least as good as twenty searches from far starts."""
    problem = _sine_beside_noise(share).problem
    start = first_theta(problem.compressed)
    values = [float(maximise(problem.compressed, _far(start, k)).aux.value) for k in range(20)]
    found = largest(problem.compressed)
    assert float(found.aux.value) < min(values) + 1e-6

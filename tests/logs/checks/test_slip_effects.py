"""The compact design matrix of the slip test against its dense definition."""

import numpy as np
import pytest

from vttig_jax.logs import EncoderLog
from vttig_jax.logs.checks.slip import ORDERS, Effects
from vttig_jax.pair import parse_pair_spec

pytestmark = pytest.mark.smoke


@pytest.mark.parametrize("both", [True, False])
@pytest.mark.parametrize("torque", [True, False])
def test_rows_products_and_means_are_those_of_the_dense_matrix(both, torque):
    generator = np.random.default_rng(0)
    time = np.arange(900) / 100.0
    driving = 5e3 + 400.0 * np.where(time < 5, time, 10 - time)
    drive = parse_pair_spec({"drive": {"ratio": "9/16"}})
    load = generator.normal(3.0, 1.0, 900) if torque else None
    driven = 9 / 16 * driving
    log = EncoderLog.from_arrays(time, driving, driven, pair=drive, unit="deg", torque=load)
    rows = np.concatenate([np.arange(20, 480), np.arange(520, 860)])
    forward = rows < 500 if both else np.ones(len(rows), bool)
    group = (rows >= 500).astype(np.int64) + (rows >= 700)
    effects = Effects.of(log, rows, group, forward)

    centred = time[rows] - time[rows].mean()
    speed = log.driving_speed.value[rows]
    columns = [1.0 * (group == k) for k in range(3)]
    columns += [centred / np.ptp(time[rows]), speed / np.abs(speed).max()]
    for angle in (log.driving_angle[rows], log.driven_angle[rows]):
        for order in range(1, ORDERS + 1):
            for wave in (np.cos(order * angle), np.sin(order * angle)):
                columns += [wave * forward, wave * ~forward] if both else [wave]
    if torque:
        assert log.torque is not None
        columns.append(log.torque[rows] / np.abs(log.torque[rows]).max())
    dense = np.column_stack(columns)

    assert effects.width == dense.shape[1]
    np.testing.assert_array_equal(dense[:, effects.speed_place], columns[4])
    coefficients = generator.normal(size=dense.shape[1])
    np.testing.assert_allclose(effects.times(coefficients), dense @ coefficients, atol=1e-10)
    few = effects.few(generator.permutation(len(rows))[:50])
    own, weight, values = dense[few.rows], generator.uniform(size=50), generator.normal(size=50)
    np.testing.assert_allclose(few.times(coefficients), own @ coefficients, atol=1e-10)
    matrix, right = few.normal(weight, values)
    np.testing.assert_allclose(matrix, (weight[:, None] * own).T @ own, atol=1e-10)
    np.testing.assert_allclose(right, (weight[:, None] * own).T @ values, atol=1e-10)
    starts = np.arange(0, len(rows), 20)
    size = np.diff(np.append(starts, len(rows)))
    means = [dense[first : first + 20].mean(axis=0) for first in range(0, len(rows), 20)]
    np.testing.assert_allclose(effects.means(starts, size), means, atol=1e-11)

"""Fits of tables of readings at standstill."""

import numpy as np
import pytest

import vttig_jax
from vttig_jax.base.errors import NoAnswerError

ARCSEC = 1 / 3600


def table(tmp_path, angle, *, gap=0.0, noise=2.0, ratio=1, wrapped=False):
    """A file with readings of an encoder that has orders 1 and 2, and of its reference."""
    error = 1800 * np.sin(np.radians(angle / ratio + 40)) + 300 * np.sin(
        np.radians(2 * angle / ratio)
    )
    back = np.append(False, np.diff(angle) <= 0) & (gap > 0)
    error = error + gap * back + np.random.default_rng(1).normal(0, noise, len(angle))
    driven = angle / ratio + error * ARCSEC
    path = tmp_path / "table.csv"
    values = np.column_stack([angle, driven % 360 if wrapped else driven])
    np.savetxt(path, values, delimiter=",", header="reference_deg,encoder_deg", comments="")
    return path


def fitted(path, ratio="1:1", **options):
    columns = {"driving": "reference_deg", "driven": "encoder_deg"}
    log = vttig_jax.read_log(path, ratio=ratio, columns=columns, sample_rate_hz=1.0)
    return vttig_jax.fit(log, perfect_gears=True, **options)


def near(order, true):
    assert abs(order.amplitude_arcsec - true) < 4 * order.std_arcsec
    assert order.std_arcsec < 4.0


@pytest.mark.parametrize(
    ("step", "ratio", "wrapped"), [(10, 1, False), (5, 1, True), (15, 20, True)]
)
def test_n_places_are_one_turn(tmp_path, step, ratio, wrapped):
    """n steps of 360°/n tell the first orders; a single-turn encoder wraps as it likes."""
    angle = ratio * np.tile(np.arange(0.0, 360.0, step), 2)
    result = fitted(table(tmp_path, angle, ratio=ratio, wrapped=wrapped), f"{ratio}:1")
    shaft = "driving" if ratio == 1 else "driven"
    found = {(one.shaft, one.order): one for one in result.orders}
    near(found[shaft, 1], 1800)
    near(found[shaft, 2], 300)
    assert result.parameters[f"{shaft}_encoder_arcsec"].determined
    assert not result.parameters["delay_s"].determined
    assert "no_delay" in result.conditional_on


def test_the_reversal_value(tmp_path):
    """Approached from both sides, the gap is the reversal value of ISO 230-2."""
    up = np.arange(0.0, 361.0, 10.0)
    gap = fitted(table(tmp_path, np.append(up, up[::-1]), gap=20.0)).checks.gap_over_angles_covered
    assert gap.value is not None and gap.std is not None
    assert gap.std / ARCSEC < 1.0
    assert abs(gap.value / ARCSEC - 20.0) < 4 * gap.std / ARCSEC


def test_few_places_leave_out_high_orders(tmp_path):
    """Twelve places cannot tell order 8 from order 4; half of the readings tell the noise."""
    result = fitted(table(tmp_path, np.arange(0.0, 361.0, 30.0)))
    assert {one.order for one in result.orders} == {1, 2}
    assert "orders-equal" in {one.slug for one in result.findings}


def test_a_quarter_of_a_turn_tells_no_order(tmp_path):
    result = fitted(table(tmp_path, np.arange(0.0, 90.0, 5.0)))
    assert not result.orders
    assert not result.parameters["driving_encoder_arcsec"].determined


def test_too_few_readings_are_refused(tmp_path):
    with pytest.raises(NoAnswerError):
        fitted(table(tmp_path, np.arange(0.0, 360.0, 45.0)))


def test_running_and_standstill_are_the_users_word(tmp_path):
    path = table(tmp_path, np.arange(0.0, 1080.0, 5.0))
    assert fitted(path).core.shafts[0].still
    assert not fitted(path, standstill=False).core.shafts[0].still

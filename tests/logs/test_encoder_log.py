from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.logs.profiles import DEG, drive, spec
from vttig_jax.base.errors import LogError
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.pair.gear_pair import pair_from_spec

PAIR = spec()
TIME = np.arange(2000) / 1000.0
FIRST = 45 * np.arange(2000)
SECOND = FIRST * 9 // 16
CURVE = {"driven": None, "transmission_error": TIME}


def from_arrays(
    time: Any = TIME, driving: Any = FIRST, driven: Any = SECOND, pair: Any = PAIR, **options: Any
) -> EncoderLog:
    return EncoderLog.from_arrays(time, driving, driven, pair=pair, **options)


def test_angles_and_error():
    log = from_arrays()
    np.testing.assert_allclose(log.driving_angle, FIRST * 2 * np.pi / 90_000, rtol=1e-15)
    np.testing.assert_allclose(log.driven_angle, SECOND * 2 * np.pi / 90_000, rtol=1e-15)
    expected = (SECOND - FIRST * 9 / 16) * 2 * np.pi / 90_000
    np.testing.assert_allclose(log.transmission_error, expected, atol=1e-15)
    assert len(log) == 2000 and log.ratio == PAIR.ratio
    assert log.error is None and log.source == "arrays" and log.sha256 == ""


@given(st.integers(-(2**50), 2**50), st.integers(-(2**50), 2**50))
def test_error_is_exact_however_far_the_counters_stand(first, second):
    near = from_arrays().transmission_error
    far = from_arrays(driving=FIRST + first, driven=SECOND + second).transmission_error
    np.testing.assert_array_equal(far, near)


def test_error_at_reading_zero_loses_no_digits():
    turns = 16 * 90_000 * 10_000
    pair = spec(zero="reading")
    far = from_arrays(driving=FIRST + turns, driven=SECOND + turns * 9 // 16, pair=pair)
    near = from_arrays(pair=pair)
    np.testing.assert_array_equal(far.transmission_error, near.transmission_error)
    naive = far.driven_angle - 0.5625 * far.driving_angle
    assert np.abs(naive - near.transmission_error).max() > 1e-12


def test_zero():
    start, reading = (
        from_arrays(driving=FIRST + 900, pair=spec(zero=zero)) for zero in ("start", "reading")
    )
    assert start.driving_angle[0] == 0.0 and start.zero == "start"
    assert reading.driving_angle[0] == pytest.approx(3.6 * DEG) and reading.zero == "reading"


def test_units_of_each_shaft_and_the_scale_and_sign_of_the_pair_file():
    log, plain = from_arrays(driven=SECOND * 0.004, unit=("counts", "deg")), from_arrays()
    np.testing.assert_allclose(log.driven_angle, plain.driven_angle, rtol=1e-12)
    assert log.driving.unit == "counts" and log.driven is not None and log.driven.unit == "deg"
    scaled = from_arrays(pair=spec(driving_scale="1/2", driven_encoder={"sign": -1}))
    np.testing.assert_allclose(scaled.driving_angle, plain.driving_angle / 2, rtol=1e-14)
    np.testing.assert_allclose(scaled.driven_angle, -plain.driven_angle, rtol=1e-14)
    assert scaled.driving.per_turn is None
    np.testing.assert_array_equal(scaled.driving.reading, FIRST)


def test_curve_instead_of_the_second_shaft():
    curve = np.sin(TIME)
    log = from_arrays(driven=None, transmission_error=curve, transmission_error_unit="deg")
    np.testing.assert_allclose(log.transmission_error, curve * DEG, rtol=1e-15)
    np.testing.assert_allclose(
        log.driven_angle, 0.5625 * log.driving_angle + curve * DEG, rtol=1e-14
    )
    assert log.driven is None
    arcsec = from_arrays(driven=None, transmission_error=curve)
    np.testing.assert_allclose(arcsec.transmission_error, curve * DEG / 3600, rtol=1e-14)


def test_further_columns_and_copies_of_the_readings():
    driving = FIRST.copy()
    columns = {"direction": np.sign(TIME - 1), "axial_mm": TIME, "torque": -TIME, "source": "rig"}
    log = from_arrays(driving=driving, **columns)
    driving[:] = 0
    assert log.driving.reading[-1] == FIRST[-1]
    assert log.direction is not None and log.direction.dtype == np.int8
    assert log.axial_mm is not None and log.axial_mm[-1] == TIME[-1]
    assert log.torque is not None and log.torque[-1] == -TIME[-1]
    assert log.source == "rig"


def test_gear_pair_serves_like_the_pair_file():
    log = from_arrays(pair=pair_from_spec(PAIR))
    np.testing.assert_array_equal(log.transmission_error, from_arrays().transmission_error)
    plain = from_arrays(unit="deg", pair=pair_from_spec(drive("9/16")))
    assert plain.ratio == PAIR.ratio


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"driven": None}, "neither is given"),
        ({"transmission_error": TIME}, "both are given"),
        ({"unit": "furlong"}, "'furlong'"),
        ({"unit": ("deg", "furlong")}, "'furlong'"),
        ({**CURVE, "transmission_error_unit": "counts"}, "count"),
        ({"driven": SECOND[:-1]}, r"`driven` must be of shape \(2000,\)"),
        ({"time": TIME[:, None]}, "`time_s` must be one-dimensional"),
        ({"driving": FIRST.astype(str)}, "`driving` must hold numbers"),
        ({"torque": [1.0]}, "`torque`"),
    ],
)
def test_wrong_arguments(options, words):
    with pytest.raises(ValueError, match=words) as caught:
        from_arrays(**options)
    assert str(caught.value).startswith("Argument `")


def spoiled(values, row, value):
    values = values.astype(np.float64)
    values[row] = value
    return values


@pytest.mark.parametrize(
    ("options", "where", "words"),
    [
        ({"driving": spoiled(FIRST, 5, np.nan)}, "sample 5, argument `driving`", "nan"),
        ({"time": spoiled(TIME, 9, np.inf)}, "sample 9, argument `time_s`", "inf"),
        ({"torque": spoiled(TIME, 3, np.nan)}, "sample 3, argument `torque`", "nan"),
        ({"time": spoiled(TIME, 9, 0.0)}, "sample 9", "backwards, from 0.008 s to 0 s"),
        ({"time": np.zeros(2000)}, "time_s", "1999 of 1999 time steps are zero"),
        ({"driven": np.full(2000, 3)}, "`driven`", "constant"),
        ({"driving": FIRST // 500}, "`driving`", "standstill"),
        ({"direction": spoiled(FIRST * 0, 8, 2)}, "sample 8", "2 is not a direction"),
        ({"driven": None, "transmission_error": np.zeros(2000)}, "transmission_error", "constant"),
        ({**CURVE, "pair": spec(driven_scale=2)}, "log.driven_scale", "remove this scale"),
    ],
)
def test_bad_data(options, where, words):
    with pytest.raises(LogError) as caught:
        from_arrays(**options)
    assert where in caught.value.where and words in caught.value.message, caught.value

"""Files of backlash readings beyond the corpus: units, what is written, and arrays."""

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.errors import LogError
from vttig_jax.base.units import DEG
from vttig_jax.logs import BacklashReadings, read_backlash_readings

pytestmark = pytest.mark.smoke

DRIVING = np.array([0.0, 90.0, 1080.0, 7560.0, 90.0])
BACKLASH = np.array([0.036, 0.0, 0.0342, 0.0412, 0.0005])
SIZES = {"deg": 1.0, "rad": DEG, "rev": 1 / 360, "arcsec": 3600.0, "urad": DEG * 1e6}
"""Of one degree, worked out apart from `base.units` but for the radian."""


def write(tmp_path, text):
    path = tmp_path / "readings.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("driving", ["deg", "rad", "rev"])
@pytest.mark.parametrize("backlash", ["deg", "arcsec", "urad", "rad"])
def test_units(tmp_path, driving, backlash):
    columns = (DRIVING * SIZES[driving]).tolist(), (BACKLASH * SIZES[backlash]).tolist()
    rows = [f"{a!r},{b!r}" for a, b in zip(*columns, strict=True)]
    path = write(tmp_path, "\n".join([f"driving_{driving},Backlash [{backlash}]", *rows]))
    readings = read_backlash_readings(path)
    np.testing.assert_allclose(readings.driving_angle, DRIVING * np.pi / 180, rtol=1e-14)
    np.testing.assert_allclose(readings.backlash, BACKLASH * np.pi / 180, rtol=1e-14)
    assert len(readings) == 5 and readings.source == str(path)
    assert readings.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


PLACES, GAPS = (st.floats(*ends, allow_subnormal=False) for ends in ((-1e5, 1e5), (0, 10)))


@given(st.lists(st.tuples(PLACES, GAPS), min_size=1, max_size=20))
def test_what_is_written_is_read_back(tmp_path_factory, rows):
    driving, backlash = np.array(rows).T
    readings = BacklashReadings.from_arrays(driving, backlash)
    back = read_backlash_readings(write(tmp_path_factory.mktemp("r"), readings.to_csv()))
    np.testing.assert_allclose(back.driving_angle, driving * DEG, rtol=1e-11)
    np.testing.assert_allclose(back.backlash, backlash * DEG, rtol=1e-11)
    np.testing.assert_array_equal(back.lines, readings.lines)


def test_arrays_are_checked_like_a_file():
    for driving, backlash in (([0.0, 1.0], [0.03, -0.01]), ([np.nan], [0.03]), ([1e11], [0.03])):
        with pytest.raises(LogError):
            BacklashReadings.from_arrays(driving, backlash)
    for driving, backlash in (([0.0, 1.0], [0.03]), ([[0.0]], [[0.03]]), ([], [])):
        with pytest.raises(ValueError, match="Argument `backlash_deg`"):
            BacklashReadings.from_arrays(driving, backlash)

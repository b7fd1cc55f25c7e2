"""Files of backlash readings: units, dress, and every file that is refused."""

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.errors import LogError
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.logs import BacklashReadings, read_backlash_readings

pytestmark = pytest.mark.smoke

DRIVING = np.array([0.0, 90.0, 1080.0, 7560.0, 90.0])
BACKLASH = np.array([0.036, 0.0, 0.0342, 0.0412, 0.0005])
SIZES = {"deg": 1.0, "rad": DEG, "rev": 1 / 360, "arcsec": 3600.0, "urad": DEG * 1e6}
"""Of one degree, worked out apart from `base.units` but for the radian."""


def write(tmp_path, text, name="readings.csv", encoding="utf-8"):
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    return path


def table(header="driving_deg,backlash_deg", driving=DRIVING, backlash=BACKLASH):
    rows = (f"{a!r},{b!r}" for a, b in zip(driving.tolist(), backlash.tolist(), strict=True))
    return "\n".join([header, *rows]) + "\n"


def assert_read(readings, lines):
    np.testing.assert_allclose(readings.driving_angle, DRIVING * np.pi / 180, rtol=1e-14)
    np.testing.assert_allclose(readings.backlash, BACKLASH * np.pi / 180, rtol=1e-14)
    np.testing.assert_array_equal(readings.lines, lines)


@pytest.mark.parametrize("driving", ["deg", "rad", "rev"])
@pytest.mark.parametrize("backlash", ["deg", "arcsec", "urad", "rad"])
def test_units(tmp_path, driving, backlash):
    header = f"driving_{driving},Backlash [{backlash}]"
    text = table(header, DRIVING * SIZES[driving], BACKLASH * SIZES[backlash])
    assert_read(read_backlash_readings(write(tmp_path, text)), [2, 3, 4, 5, 6])


@pytest.mark.parametrize(
    ("names", "size"),
    [
        ("driving_deg,Spiel [µm]", 50e3),
        ("driving_deg,dial_gauge_mm", 50.0),
        ("driving (deg),Backlash (in)", 50.0 / 25.4),
    ],
)
def test_a_length_at_a_radius(tmp_path, names, size):
    text = table(names, backlash=BACKLASH * DEG * size)
    readings = read_backlash_readings(write(tmp_path, text), lead_mm=2 * np.pi * 50.0)
    assert_read(readings, [2, 3, 4, 5, 6])


def test_other_dress(tmp_path):
    rows = [f"{b}\t{k}\t{a}" for k, (a, b) in enumerate(zip(DRIVING, BACKLASH, strict=True))]
    text = "bench, 12 May\n\nbacklash (°)\tpass\tdriving_deg\n" + "\n".join(rows)
    path = write(tmp_path, text.replace(".", ","), "readings.tsv", "utf-16")
    assert_read(read_backlash_readings(path), [4, 5, 6, 7, 8])
    lines = table().splitlines()
    lines[2:2] = ["# tooth 12", "", "  "]
    path = write(tmp_path, "\r\n".join(lines))
    readings = read_backlash_readings(path)
    assert_read(readings, [2, 6, 7, 8, 9])
    assert len(readings) == 5 and readings.source == str(path)
    assert readings.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_doubtful_comma_is_settled_by_decimal(tmp_path):
    path = write(tmp_path, "driving_deg|backlash_arcsec\n90|1,234\n180|1,100\n")
    with pytest.raises(LogError, match="--decimal"):
        read_backlash_readings(path)
    for decimal, values in ((",", [1.234, 1.1]), (".", [1234.0, 1100.0])):
        found = read_backlash_readings(path, decimal=decimal).backlash / ARCSEC
        np.testing.assert_allclose(found, values)


H = "driving_deg,backlash_deg\n"


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("0,0.03\n90,0.02\n", ""),
        (H, "line 1"),
        ("backlash_deg\n0.03\n", ""),
        (H + "0,5,0,03\n", "line 2"),
        ("\n", ""),
        ("angle_deg,backlash_deg\n0,0.03\n", ""),
        ("driving_deg,backlash_mm\n0,0.03\n", "column `backlash_mm`"),
        ("driving_deg,backlash_deg,backlash_rad\n0,0,0\n", ""),
        ("driving_deg,backlash\n0,0.03\n", "column `backlash`"),
        ("driving_deg,backlash_deg [rad]\n0,0.03\n", "column `backlash_deg [rad]`"),
        (H + "0,0.03\n90,\n", "line 3, column `backlash_deg`"),
        (H + "0,0.03\nx,0.03\n", "line 3, column `driving_deg`"),
        (H + "0,0.03\n9,nan\n", "line 3, column `backlash_deg`"),
        (H + "0,0.03\n\ninf,0\n", "line 4, column `driving_deg`"),
        (H + "0,0.03\n90,-0.02\n180,-0.01\n", "line 3, column `backlash_deg`"),
        (H + "0,0.02\n1e11,0.03\n", "line 3, column `driving_deg`"),
        (H + "0,0.02\n90,181\n", "line 3, column `backlash_deg`"),
        (H + "0,0.02\n90,1e308\n", "line 3, column `backlash_deg`"),
    ],
)
def test_refused(tmp_path, text, where):
    path = write(tmp_path, text)
    with pytest.raises(LogError) as caught:
        read_backlash_readings(path)
    assert caught.value.where == (f"{path}: {where}" if where else str(path))
    assert not {"encoder", "time_s"} & set(caught.value.message.split())


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

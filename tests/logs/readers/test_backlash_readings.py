"""Files of backlash readings: units, dress, and every file that is refused."""

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.errors import LogError
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.logs.readers.backlash_readings import BacklashReadings, read_backlash_readings

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


def assert_read(readings):
    np.testing.assert_allclose(readings.driving_angle, DRIVING * np.pi / 180, rtol=1e-14)
    np.testing.assert_allclose(readings.backlash, BACKLASH * np.pi / 180, rtol=1e-14)


def test_a_file(tmp_path):
    path = write(tmp_path, table())
    readings = read_backlash_readings(path)
    assert_read(readings)
    assert len(readings) == 5
    assert readings.source == str(path)
    assert readings.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    np.testing.assert_array_equal(readings.lines, [2, 3, 4, 5, 6])
    text = str(readings)
    assert "0° … 7560°" in text
    assert "0.00000° … 0.04120°" in text


@pytest.mark.parametrize("driving", ["deg", "rad", "rev"])
@pytest.mark.parametrize("backlash", ["deg", "arcsec", "urad", "rad"])
def test_units(tmp_path, driving, backlash):
    header = f"driving_{driving},Backlash [{backlash}]"
    text = table(header, DRIVING * SIZES[driving], BACKLASH * SIZES[backlash])
    assert_read(read_backlash_readings(write(tmp_path, text)))


def test_other_dress(tmp_path):
    rows = [f"{b}\t{k}\t{a}" for k, (a, b) in enumerate(zip(DRIVING, BACKLASH, strict=True))]
    text = "bench, 12 May\n\nbacklash (°)\tpass\tdriving_deg\n" + "\n".join(rows)
    path = write(tmp_path, text.replace(".", ","), "readings.tsv", "utf-16")
    readings = read_backlash_readings(path)
    assert_read(readings)
    np.testing.assert_array_equal(readings.lines, [4, 5, 6, 7, 8])


def test_lines_skip_what_is_no_reading(tmp_path):
    lines = table().splitlines()
    lines[2:2] = ["# tooth 12", "", "  "]
    readings = read_backlash_readings(write(tmp_path, "\r\n".join(lines)))
    assert_read(readings)
    np.testing.assert_array_equal(readings.lines, [2, 6, 7, 8, 9])


def test_a_doubtful_comma_is_settled_by_decimal(tmp_path):
    path = write(tmp_path, "driving_deg|backlash_arcsec\n90|1,234\n180|1,100\n")
    with pytest.raises(LogError, match="--decimal"):
        read_backlash_readings(path)
    small = read_backlash_readings(path, decimal=",")
    np.testing.assert_allclose(small.backlash / ARCSEC, [1.234, 1.1])
    large = read_backlash_readings(path, decimal=".")
    np.testing.assert_allclose(large.backlash / ARCSEC, [1234.0, 1100.0])


H = "driving_deg,backlash_deg\n"
REFUSED = {
    "no header": ("0,0.03\n90,0.02\n", "", "write a line driving_deg,backlash_deg"),
    "no rows": (H, "line 1", "write a line driving_deg,backlash_deg"),
    "one column": ("backlash_deg\n0.03\n", "", "write a line driving_deg,backlash_deg"),
    "too many fields": (H + "0,5,0,03\n", "line 2", "semicolons between numbers"),
    "nothing": ("\n", "", "the file is empty"),
    "no driving": ("angle_deg,backlash_deg\n0,0.03\n", "", "no column driving_deg, _rad or _rev"),
    "no backlash": (
        "driving_deg,backlash_mm\n0,0.03\n",
        "",
        "no column backlash_deg, _arcsec, _urad or _rad; the file has driving_deg, backlash_mm",
    ),
    "two": ("driving_deg,backlash_deg,backlash_rad\n0,0,0\n", "", "2 columns could be `backlash`"),
    "no unit": ("driving_deg,backlash\n0,0.03\n", "column `backlash`", "no unit; rename it"),
    "two units": (
        "driving_deg,backlash_deg [rad]\n0,0.03\n",
        "column `backlash_deg [rad]`",
        "the units deg and rad",
    ),
    "empty field": (H + "0,0.03\n90,\n", "line 3, column `backlash_deg`", "empty; write a"),
    "no number": (H + "0,0.03\nx,0.03\n", "line 3, column `driving_deg`", "`x` is no number"),
    "nan": (H + "0,0.03\n9,nan\n", "line 3, column `backlash_deg`", "nan is not a reading"),
    "infinite": (H + "0,0.03\n\ninf,0\n", "line 4, column `driving_deg`", "inf is not a reading"),
    "negative": (
        H + "0,0.03\n90,-0.02\n180,-0.01\n",
        "line 3, column `backlash_deg`",
        r"a negative backlash (-0.02, 2 of 3 readings); subtract the position on flank A",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(tmp_path, name):
    text, where, sentence = REFUSED[name]
    path = write(tmp_path, text)
    with pytest.raises(LogError) as caught:
        read_backlash_readings(path)
    assert caught.value.where.startswith(str(path))
    assert caught.value.where.endswith(where)
    assert sentence in caught.value.message
    assert caught.value.message.endswith(".")
    assert "encoder" not in caught.value.message
    assert "time_s" not in caught.value.message


def test_no_such_file(tmp_path):
    with pytest.raises(LogError, match="no such file"):
        read_backlash_readings(tmp_path / "absent.csv")


@given(
    st.lists(
        st.tuples(
            st.floats(-1e5, 1e5, allow_subnormal=False), st.floats(0, 10, allow_subnormal=False)
        ),
        min_size=1,
        max_size=20,
    )
)
def test_what_is_written_is_read_back(tmp_path_factory, rows):
    driving, backlash = np.array(rows).T
    readings = BacklashReadings.from_arrays(driving, backlash)
    back = read_backlash_readings(write(tmp_path_factory.mktemp("r"), readings.to_csv()))
    np.testing.assert_allclose(back.driving_angle, driving * DEG, rtol=1e-11)
    np.testing.assert_allclose(back.backlash, backlash * DEG, rtol=1e-11)
    np.testing.assert_array_equal(back.lines, readings.lines)


def test_arrays_are_checked_like_a_file():
    with pytest.raises(LogError, match="a negative backlash"):
        BacklashReadings.from_arrays([0.0, 1.0], [0.03, -0.01])
    with pytest.raises(LogError, match="nan is not a reading"):
        BacklashReadings.from_arrays([np.nan], [0.03])
    for driving, backlash in (([0.0, 1.0], [0.03]), ([[0.0]], [[0.03]]), ([], [])):
        with pytest.raises(ValueError, match="Argument `backlash_deg` must have one reading"):
            BacklashReadings.from_arrays(driving, backlash)


@pytest.mark.parametrize("size", [181.0, 1e17, 1e308])
@pytest.mark.parametrize("column", [0, 1])
def test_an_impossible_angle_is_refused_at_its_line(tmp_path, size, column):
    rows = [[0.0, 0.02], [90.0, 0.03]]
    rows[1][column] = size * (1e9 if column == 0 and size < 1e9 else 1.0)
    path = tmp_path / "readings.csv"
    path.write_text("driving_deg,backlash_deg\n" + "\n".join(f"{a!r},{b!r}" for a, b in rows))
    with pytest.raises(LogError, match=r"° is not an? ") as caught:
        read_backlash_readings(path)
    assert "line 3" in caught.value.where
    with pytest.raises(LogError, match=r"° is not an? "):
        BacklashReadings.from_arrays(*np.array(rows).T)

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.errors import LogError
from vttig_jax.logs.readers.column_names import (
    ACCELERATION_UNITS,
    ANGLES,
    SPEED_UNITS,
    TIME_UNITS,
    default_column,
    index_of,
    listed,
    name_and_unit,
    number_of,
    units_of,
)

MATRIX = [f"rec.pos_deg({k},:)" for k in range(1, 7)]


@pytest.mark.parametrize(
    ("name", "split"),
    [
        ("driving_deg", ("driving", "deg")),
        ("driving_counts", ("driving", "counts")),
        ("driving [rad]", ("driving", "rad")),
        ("driving (rev)", ("driving", "rev")),
        ("driving[°]", ("driving", "deg")),
        ("driving_deg [deg]", ("driving", "deg")),
        ("Motor Angle_DEG", ("Motor Angle", "deg")),
        ("driving", ("driving", None)),
        ("driving [left]", ("driving", None)),
        ("shaft_two", ("shaft_two", None)),
        ("deg", ("deg", None)),
    ],
)
def test_units_in_names(name, split):
    assert name_and_unit(name, ANGLES, "log.csv") == split


@pytest.mark.parametrize(
    ("name", "role", "split"),
    [
        ("w_rpm", "speed", ("w", "rpm")),
        ("w_deg_per_s", "speed", ("w", "deg_per_s")),
        ("w_RAD_per_s", "speed", ("w", "rad_per_s")),
        ("w [1/min]", "speed", ("w", "rpm")),
        ("w [°/s]", "speed", ("w", "deg_per_s")),
        ("w_deg", "speed", ("w_deg", None)),
        ("w_rad_per_s2", "speed", ("w_rad_per_s2", None)),
        ("a_rad_per_s2", "acceleration", ("a", "rad_per_s2")),
        ("a (deg/s^2)", "acceleration", ("a", "deg_per_s2")),
        ("a_rad_per_s", "acceleration", ("a_rad_per_s", None)),
        ("w_deg_per_s", "time", ("w_deg_per_s", None)),
        ("t_s", "time", ("t", "s")),
        ("tau1_Nm", "torque", ("tau1", "nm")),
        ("load [N·m]", "torque", ("load", "nm")),
        ("rec.pos_deg(1,:)", "driving", ("rec.pos", "deg")),
    ],
)
def test_units_of_roles(name, role, split):
    assert name_and_unit(name, units_of(role), "log.csv") == split


def test_sizes_of_units():
    assert SPEED_UNITS["rpm"] * 60 == pytest.approx(SPEED_UNITS["deg_per_s"] * 360)
    assert SPEED_UNITS["deg_per_s"] == ACCELERATION_UNITS["deg_per_s2"] != 1.0
    assert SPEED_UNITS["rad_per_s"] == ACCELERATION_UNITS["rad_per_s2"] == 1.0
    assert TIME_UNITS["ms"] == 1e-3


@given(st.integers(1, 999_999))
def test_numbers(number):
    assert number_of(f"#{number}") == number
    assert number_of(f"#{number}x") == number_of(str(number)) == 0


def test_what_is_no_number():
    for name in (None, "", "#", "#0", "#01", "#-1", "#row", "#1.5"):
        assert number_of(name) == 0


@pytest.mark.parametrize(
    ("name", "index"),
    [
        ("rec.t", 0),
        ("t", 0),
        ("REC.T", 0),
        ("pos_deg(3,:)", 3),
        ("rec.pos_deg(3, :)", 3),
        ("pos_deg( 3,: )", 3),
        ("/raw/pos_deg", 7),
        ("raw/pos_deg", 7),
        ("raw/pos", 7),
        ("#8", 7),
    ],
)
def test_names_of_nested_files(name, index):
    assert index_of(name, "driving", ["rec.t", *MATRIX, "raw/pos_deg"], "log.mat") == index


def test_a_last_part_must_be_a_whole_part():
    with pytest.raises(LogError, match="no column os_deg"):
        index_of("os_deg", "driving", ["rec.t", "raw/pos_deg"], "log.mat")
    with pytest.raises(LogError, match="no column eg"):
        index_of("eg", "driving", ["a.deg"], "log.mat")


@pytest.mark.parametrize(
    ("name", "names", "words"),
    [
        ("t", ["a.t", "b.t"], "2 columns fit `t` (a.t, b.t); write the full name."),
        ("t", ["t", "t"], "2 columns fit `t` (t, t); rename one."),
        (
            "pos_deg",
            MATRIX,
            "6 columns fit `pos_deg` (rec.pos_deg(1…6,:)); write the full name.",
        ),
        ("vel_deg", [*MATRIX, "t"], "no column vel_deg; the log has rec.pos_deg(1…6,:), t"),
    ],
)
def test_doubtful_names(name, names, words):
    with pytest.raises(LogError) as caught:
        index_of(name, "driving", names, "log.mat")
    assert words in caught.value.message


def test_default_names_as_last_parts():
    names = ["log.time_s", "log.driving_counts", "old.driving"]
    assert default_column("time", names, "log.mat") == 0
    assert default_column("driven", names, "log.mat") is None
    with pytest.raises(LogError, match="2 columns could be `driving`"):
        default_column("driving", names, "log.mat")
    assert default_column("driving", [*names, "driving_deg"], "log.mat") == 3


def test_listed():
    assert listed(f"c{k}" for k in range(14)).endswith("c11 and 2 more")
    assert listed(["m(:,1)", "m(:,2)", "x", "n(2,:)"]) == "m(:,1…2), x, n(2,:)"

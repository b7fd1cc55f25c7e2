from typing import Any

import pytest

from vttig_jax.base.errors import LogError
from vttig_jax.logs.readers.column_roles import ROLES, ROW_INDEX, find_columns, requested_names
from vttig_jax.pair.schema import LogLayout, UnitTable

pytestmark = pytest.mark.smoke

COUNTED = {"driving": "deg", "driven": "counts"}


def find(names, *, timed=True, unit=None, override=None, **layout: Any):
    found = find_columns(
        names.split(","),
        LogLayout(**layout),
        UnitTable(**(unit or {})),
        override or {},
        "log.csv",
        timed=timed,
    )
    return {role: (column.index, column.unit) for role, column in found.items()}


def test_defaults():
    assert find("time_s,driving_counts,driven_deg") == {
        "time": (0, "s"),
        "driving": (1, "counts"),
        "driven": (2, "deg"),
    }
    assert find("driving_deg,x,transmission_error_urad,time_ms") == {
        "time": (3, "ms"),
        "driving": (0, "deg"),
        "transmission_error": (2, "urad"),
    }
    assert find("Time [us],Driving [rad],Driven [rad]")["time"] == (0, "us")


def test_optional_columns_only_when_named():
    names = "time_s,driving_deg,driven_deg,direction,torque,axial_mm"
    assert set(find(names)) == {"time", "driving", "driven"}
    found = find(names, direction="direction", torque="torque", axial_mm="axial_mm")
    assert found["direction"] == (3, "") and found["torque"] == (4, "")
    assert found["axial_mm"] == (5, "mm")
    assert find("time_s,driving_deg,driven_deg,s_um", axial_mm="s_um")["axial_mm"] == (3, "um")


def test_names_from_the_pair_file_and_overrides():
    names = "t_s,mot1_deg,mot2_deg,se1_deg"
    layout: dict[str, Any] = {"time": "t_s", "driving": "mot1_deg", "driven": "se1_deg"}
    assert find(names, **layout)["driving"] == (1, "deg")
    assert find(names, **layout, override={"driving": "mot2_deg"})["driving"] == (2, "deg")
    layout["driving"] = "MOT1"
    assert find("T_S,mot1,rig/se1_deg", **layout, unit={"driving": "rad"}) == {
        "time": (0, "s"),
        "driving": (1, "rad"),
        "driven": (2, "deg"),
    }


def test_units_from_the_pair_file():
    layout: dict[str, Any] = {"driving": "a", "driven": "b"}
    found = find("time_s,a,b_rad", **layout, unit={"driving": "rev", "driven": "rad"})
    assert found["driving"] == (1, "rev") and found["driven"] == (2, "rad")


def test_curve_or_second_shaft():
    names = "time_s,driving_deg,driven_deg,transmission_error_arcsec"
    assert "transmission_error" not in find(names)
    assert "driven" not in find(names, transmission_error="transmission_error_arcsec")
    override = {"transmission_error": "transmission_error_arcsec"}
    assert "driven" not in find(names, driven="driven_deg", override=override)
    override = {"driven": "driven_deg"}
    found = find(names, transmission_error="transmission_error_arcsec", override=override)
    assert "transmission_error" not in found


def test_speed_and_acceleration_of_the_driving_shaft():
    names = "time_s,driving_deg,driven_deg,w_rpm,a [rad/s²],speed_deg_per_s"
    assert set(find(names)) == {"time", "driving", "driven"}
    found = find(names, speed="w", acceleration="a")
    assert found["speed"] == (3, "rpm") and found["acceleration"] == (4, "rad_per_s2")
    assert find(names, speed="speed")["speed"] == (5, "deg_per_s")


def test_columns_by_number():
    found = find("time_s,a_deg,b", driving="#2", driven="#3", unit={"driven": "rad"})
    assert found == {"time": (0, "s"), "driving": (1, "deg"), "driven": (2, "rad")}
    found = find("#1", timed=False, driving="#1", driven="#row", unit=COUNTED)
    assert found == {"driving": (0, "deg"), "driven": (ROW_INDEX, "counts")}
    override = {"driving": "#2"}
    found = find("a_deg,b_deg,driven_deg", timed=False, driving="#1", override=override)
    assert found["driving"] == (1, "deg")


def test_requested_names():
    layout = LogLayout(driving="a", driven="b", speed="c")
    named = requested_names(layout, {"driving": "#2", "transmission_error": "te"})
    assert tuple(named) == ROLES
    assert named["driving"] == "#2" and named["speed"] == "c" and named["torque"] is None
    assert named["driven"] is None and named["transmission_error"] == "te"


def test_sample_rate_instead_of_time():
    assert "time" not in find("time_s,driving_deg,driven_deg", timed=False)
    assert "time" not in find("driving_deg,driven_deg", timed=False)


@pytest.mark.parametrize(
    ("names", "options", "words"),
    [
        ("t_s,driving_deg,driven_deg", {}, ["time_s", "t_s, driving_deg", "--sample-rate"]),
        ("time_s,drving_deg,driven_deg", {}, ["closest: drving_deg", "--column driving=NAME"]),
        ("time_s,driving_deg", {}, ["driven_*", "time_s, driving_deg"]),
        ("time_s,a_deg,driven_deg", {"driving": "b_deg"}, ["b_deg", "closest: a_deg"]),
        ("time_s,driving_deg,driving_rad,driven_deg", {}, ["2 columns", "driving_rad"]),
        ("time_s,a_deg,a_deg,driven_deg", {"driving": "a_deg"}, ["2 columns"]),
        ("time_s,driving,driven_deg", {}, ["no unit", "[unit]"]),
        ("time_s,driving_deg [rad],driven_deg", {}, ["the units deg and rad"]),
        ("time_s,driving_deg,driven_deg", {"unit": {"driving": "rad"}}, ["unit deg", "has rad"]),
        ("time_s,driving_deg,driven_deg", {"driven": "driving_deg"}, ["at once"]),
        (
            "time_s,driving_deg,te",
            {"transmission_error": "te", "unit": {"transmission_error": "counts"}},
            ["counts is no unit"],
        ),
        (
            "time_s,driving_deg,driven_deg,te_deg",
            {"override": {"driven": "driven_deg", "transmission_error": "te_deg"}},
            ["both named; keep one"],
        ),
        ("time_s,driving_deg,driven_deg,w", {"speed": "w"}, ["no unit", "_rpm", "`w`"]),
        ("time_s,driving_deg,driven_deg,w_deg", {"speed": "w_deg"}, ["no unit", "_rad_per_s"]),
        (
            "time_s,driving_deg,driven_deg,w_rad_per_s",
            {"acceleration": "w_rad_per_s"},
            ["no unit", "_rad_per_s2"],
        ),
        ("time_s,driving_deg,driven_deg", {"driving": "#4"}, ["no column #4", "the log has 3"]),
        ("time_s,driving_deg,driven_deg", {"driving": "#0"}, ["no column #0"]),
        ("#2,#1,driven_deg", {"driving": "#1"}, ["number of a column and the name of another"]),
        ("time_s,a", {"driving": "#row", "unit": COUNTED, "driven": "#row"}, ["at once"]),
        ("time_s,driving_deg", {"driven": "#row"}, ["no unit", "`#row`", "[unit]"]),
    ],
)
def test_refused(names, options, words):
    with pytest.raises(LogError) as caught:
        find(names, **options)
    assert all(word in str(caught.value) for word in words), caught.value
    assert "log.csv" in caught.value.where

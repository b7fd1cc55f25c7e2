"""The pair file read: the contract's example word for word, and every other key."""

import tomllib
from fractions import Fraction

import pytest

from tests.pair.texts import CONTRACT, DRIVE, MINIMAL, OTHER_KEYS
from vttig_jax.pair.gear_pair import Drive, GearPair, load_pair
from vttig_jax.pair.pair_file import load_pair_spec, parse_pair_spec, spec_table, stated_table
from vttig_jax.pair.schema import (
    Encoder,
    GearTable,
    HarmonicOrders,
    LogLayout,
    PairTable,
    RackTable,
    UnitTable,
    as_fraction,
    as_ratio,
)

pytestmark = pytest.mark.smoke


@pytest.fixture
def write(tmp_path):
    def write(text):
        path = tmp_path / "pair.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_the_contracts_example(write):
    spec = load_pair_spec(write(f"\ufeff{CONTRACT}"))  # a byte order mark is no fault
    encoder = Encoder(counts_per_rev=90000, accuracy_arcsec=18.0)
    gear = {"face_width_mm": 20.0, "helix_angle_deg": 3.0, "encoder": encoder}
    assert spec.name == "VTTIG rig"
    assert spec.pair == PairTable(module_mm=2.0, pressure_angle_deg=20.0, centre_distance_mm=125.12)
    assert spec.driving == GearTable(teeth=45, **gear)
    assert spec.driven == GearTable(teeth=80, **gear)
    assert spec.log == LogLayout(time="time_s", driving="driving_counts", driven="driven_counts")
    assert spec.fit == HarmonicOrders()
    assert spec.fit.driving_orders == spec.fit.driven_orders == (1, 2, 3, 4, 5, 6, 7, 8)
    assert spec.drive is None and spec.unit == UnitTable()
    assert spec.rack == RackTable(addendum=1.0, clearance=0.25, tip_radius=None)
    assert spec.driving.stated is None and "stated" not in str(spec_table(spec))
    assert (spec.driving.profile_shift, spec.driven.crowning_um) == (0.0, 0.0)
    assert spec.ratio == Fraction(9, 16)
    assert encoder.sign == 1 and encoder.modulus is None


TOOTH_KEYS = """
[pair]
module_mm = 2.0
pressure_angle_deg = 20.0
centre_distance_mm = 125.9
[rack]
addendum = 0.9
clearance = 0.3
tip_radius = 0.25
[driving]
teeth = 45
face_width_mm = 20.0
profile_shift = 0.4
crowning_um = 8.0
stated = { tooth_thickness_thin_mm = 2.5, tooth_thickness_thick_mm = 4.7, tip_diameter_mm = 94.8 }
[driven]
teeth = 80
[driven.stated]
root_diameter_mm = 154.9
span_mm = 52.4
span_teeth = 9
over_balls_mm = 165.1
ball_diameter_mm = 3.5
"""


@pytest.mark.parametrize("text", [CONTRACT, OTHER_KEYS, TOOTH_KEYS, MINIMAL, DRIVE])
def test_a_spec_goes_back_to_the_table_it_came_from(text):
    """The keys of a file are those that would be written."""
    read = tomllib.loads(text)
    spec = parse_pair_spec(read)
    for table in (spec_table(spec), stated_table(spec)):
        assert parse_pair_spec(table) == spec
        assert "None" not in str(table)
    if text == CONTRACT:
        return  # it states defaults
    for section, name in (("fit", "driving_orders"), ("fit", "driven_orders"), ("log", "cut")):
        if name in read.get(section, {}):
            read[section][name] = tuple(read[section][name])
    assert stated_table(spec) == read


def test_a_written_pair_file_has_no_defaults():
    table = stated_table(parse_pair_spec(tomllib.loads(DRIVE)))
    assert "driving_scale" not in table.get("log", {}) and not {"rack", "fit", "unit"} & set(table)
    changed = tomllib.loads(DRIVE) | {"log": {"driving_scale": 2, "zero": "start"}}
    assert stated_table(parse_pair_spec(changed))["log"] == {"driving_scale": 2}


def test_sections_reach_the_computed_objects(write):
    pair = load_pair(write(OTHER_KEYS))
    assert isinstance(pair, GearPair)
    assert pair.log.driving == "a/motor" and pair.unit.driving == "rev"
    assert pair.fit.mesh_orders == 0 and pair.driving.encoder.modulus == 65536
    drive = load_pair(write(DRIVE + '[log]\nzero = "reading"\n[unit]\ndriving = "deg"\n'))
    assert isinstance(drive, Drive)
    assert drive.log.zero == "reading" and drive.unit.driving == "deg"


@pytest.mark.parametrize(
    ("value", "fraction"),
    [
        ("7/1798", Fraction(7, 1798)),
        (" 7 / 1798 ", Fraction(7, 1798)),
        ("0.5625", Fraction(9, 16)),
        (0.1, Fraction(1, 10)),
        (1e-05, Fraction(1, 100000)),
        (2, Fraction(2)),
        ("1/7.2976", Fraction(10000, 72976)),
        ("0.5/1.5", Fraction(1, 3)),
        ("9e11/9e10", Fraction(10)),
    ],
)
def test_ratios_are_read_as_written(value, fraction):
    assert as_fraction(value, "drive.ratio") == as_ratio(value, "drive.ratio") == fraction


@pytest.mark.parametrize(
    ("value", "fraction"),
    [("6:1", Fraction(1, 6)), ("16 : 9", Fraction(9, 16)), ("7.2976:1", Fraction(10000, 72976))],
)
def test_driving_turns_to_driven_turns(value, fraction):
    assert as_ratio(value, "drive.ratio") == fraction
    assert parse_pair_spec({"drive": {"ratio": value}}).ratio == fraction

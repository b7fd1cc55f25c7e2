"""The pair file read: the contract's example word for word, every other key, and wrong ones."""

import math
import tomllib
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.pair.texts import CONTRACT, DRIVE, FOLDER, MINIMAL, OTHER_KEYS, TOOTH_KEYS
from vttig_jax.base.errors import PairError
from vttig_jax.pair.gear_pair import Drive, GearPair, ShaftReading, load_pair, shaft_reading
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


def test_ratios_are_read_as_written():
    """And with a colon as driving turns to driven turns."""
    for value, of in (
        *(("7/1798", (7, 1798)), (" 7 / 1798 ", (7, 1798)), ("0.5625", (9, 16))),
        *((0.1, (1, 10)), (1e-05, (1, 100000)), (2, (2, 1)), ("1/7.2976", (10000, 72976))),
        *(("0.5/1.5", (1, 3)), ("9e11/9e10", (10, 1))),
    ):
        assert as_fraction(value, "drive.ratio") == as_ratio(value, "drive.ratio") == Fraction(*of)
    for value, of in (("6:1", (1, 6)), ("16 : 9", (9, 16)), ("7.2976:1", (10000, 72976))):
        assert as_ratio(value, "drive.ratio") == Fraction(*of)
        assert parse_pair_spec({"drive": {"ratio": value}}).ratio == Fraction(*of)


BAD = tomllib.loads((FOLDER / "bad.toml").read_text("utf-8"))["bad"]


@pytest.mark.parametrize(("name", "old", "new", "key"), BAD)
def test_a_bad_table_is_one_sentence_that_names_file_and_key(write, name, old, new, key):
    text = "" if name == "empty" else (FOLDER / f"{name}.toml").read_text("utf-8")
    assert old in text
    path = write(text.replace(old, new) if old else f"{text}{new}\n")
    with pytest.raises(PairError) as caught:
        load_pair(path)
    assert caught.value.where == f"{path}: {key}"
    assert caught.value.message[-1] in ".?" and "\n" not in str(caught.value)
    assert caught.value.exit_code == 3


def test_a_table_of_no_file_and_a_file_that_is_not_there(tmp_path):
    with pytest.raises(PairError, match="no such file"):
        load_pair(tmp_path / "pair.toml")
    with pytest.raises(PairError, match="folder"):
        load_pair(tmp_path)
    with pytest.raises(PairError) as caught:
        parse_pair_spec({"pair": {"module_mm": 2.0, "pressure_angle_deg": 20.0}})
    assert caught.value.where == "driving.teeth"


@pytest.mark.parametrize("failure", [PermissionError(13, "denied"), OSError(5, "Input/output")])
def test_a_file_that_cannot_be_read_is_refused(failure, write, monkeypatch):
    """The failure is made, because a superuser may read everything."""

    def refuse(_):
        raise failure

    path = write(MINIMAL)
    monkeypatch.setattr("vttig_jax.base.files.toml_io.read_regular", refuse)
    with pytest.raises(PairError):
        load_pair(path)


@given(
    counts=st.integers(-(10**9), 10**9),
    origin=st.integers(-(10**6), 10**6),
    sign=st.sampled_from([1, -1]),
)
def test_counts_and_degrees_of_one_place_are_one_angle(counts, origin, sign):
    encoder = Encoder(counts_per_rev=90_000, sign=sign)
    shaft = shaft_reading(encoder, 2 * math.pi * origin / 90_000)
    expected = sign * 2 * math.pi * (counts - origin) / 90_000
    assert shaft.unit == "counts"
    assert shaft.angle(counts) == pytest.approx(expected, abs=1e-9)
    assert shaft.angle_of_deg(counts / 250) == pytest.approx(expected, abs=1e-9)


def test_a_scale_multiplies_counts_and_without_counts_readings_are_angles():
    """Degrees have the scale already."""
    shaft = shaft_reading(Encoder(counts_per_rev=100), math.radians(36.0), 2.0)
    assert shaft.angle(30) == pytest.approx(math.radians(2 * (30 * 3.6 - 36.0)))
    assert shaft.angle_of_deg(216.0) == pytest.approx(math.radians(216.0 - 72.0))
    shaft = shaft_reading(Encoder(sign=-1), 0.5)
    assert shaft == ShaftReading("rad", -1.0, 0.5)
    assert shaft.angle(0.7) == pytest.approx(-0.2)

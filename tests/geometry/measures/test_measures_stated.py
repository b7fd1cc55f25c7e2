"""What is stated beside what is computed, and when the two may not be compared."""

import pytest

from tests.geometry.shop_gears import shop_gear
from vttig_jax.geometry.measures import (
    Stated,
    compare_stated,
    measure_gear,
    measure_pair,
    measures_text,
)
from vttig_jax.pair.gear_pair import Gear, GearPair
from vttig_jax.pair.schema import StatedTable

TAPERED = shop_gear(helix=(3.0, 3.0))


INSPECTED = StatedTable(span_mm=27.9, span_teeth=5, over_balls_mm=95.0, ball_diameter_mm=3.5)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"span_teeth": 6, "ball_mm": 3.5}, ["The stated span is over 5 teeth."]),
        ({"span_teeth": 5, "ball_mm": 3.4}, ["over balls is over balls of 3.5 mm."]),
        ({"span_teeth": 5, "ball_mm": 3.5, "section_mm": 2.0}, ["span is that of the middle"] * 2),
    ],
)
def test_what_was_measured_otherwise_is_shown_and_not_compared(options, words):
    beside, notes = compare_stated(INSPECTED, measure_gear(TAPERED, **options))
    assert None in {one.difference for one in beside.values()}
    assert beside["span_mm"].value == 27.9
    assert len(notes) == len(words) and words[0] in notes[0]


def test_what_cannot_be_computed_is_not_compared():
    stated = StatedTable(tooth_thickness_thin_mm=2.0, over_balls_mm=95.0, ball_diameter_mm=1.0)
    found = measure_gear(shop_gear(width=None), ball_mm=1.0)
    beside, _ = compare_stated(stated, found)
    assert [one.difference for one in beside.values()] == [None, None]


# As a table.


def table(gears, stated=None, notes=None):
    nothing = {name: {} for name in gears}
    mesh = measure_pair(GearPair(Gear(45), Gear(80), module_mm=2.0, pressure_angles_deg=20.0))
    empty = {name: [] for name in gears}
    return measures_text(gears, stated or nothing, notes or empty, "Title", mesh)


def cells(text: str, label: str) -> list[str]:
    (line,) = [line for line in text.splitlines() if line.strip().startswith(label)]
    return line.split(label)[1].split()


def test_a_column_a_gear_and_stated_columns_only_where_something_is():
    gears = {"one": measure_gear(TAPERED), "other": measure_gear(shop_gear(80))}
    plain = table(gears)
    assert plain.splitlines()[0] == "Title" and "stated" not in plain and "notes" not in plain
    assert cells(plain, "thickness, thin end") == ["2.0934", "3.1416"]
    stated = {"one": {"tip_diameter_mm": Stated(94.5, 0.5)}, "other": {}}
    beside = table(gears, stated)
    assert cells(beside, "tip diameter") == ["94.0000", "94.5", "+0.5000", "164.0000"]
    unlike = table(gears, {"one": {"span_mm": Stated(27.9, None)}, "other": {}})
    assert cells(unlike, "span")[1:3] == ["27.9", "–"]


def test_flanks_of_a_gear_have_rows_of_their_own_and_a_hand():
    helical, tapered = measure_gear(shop_gear(helix=(15.0, -15.0))), measure_gear(TAPERED)
    text = table({"a": helical, "b": tapered, "c": measure_gear(shop_gear())})
    left = cells(text, "base helix and hand, left flank [°]")
    right = cells(text, "base helix and hand, right flank [°]")
    assert (left[1], left[3], left[4]) == ("L", "L", "0.0000")
    assert (right[1], right[3], right[4]) == ("L", "R", "0.0000")
    one = measure_gear(shop_gear(helix=(2.0, 14.0), normal_pressure_angle_deg=20.0))
    text = table({"one": one})
    left, right = (cells(text, f"base diameter, {side} flank") for side in ("left", "right"))
    assert float(left[0]) > float(right[0])
    assert cells(text, "teeth spanned") == ["–"]
    assert "span, a computed figure" in table({"one": tapered})
    assert "computed" not in table({"one": measure_gear(shop_gear())})


def test_notes_of_all_gears_stand_once():
    gears = {"one": measure_gear(TAPERED), "other": measure_gear(TAPERED)}
    text = table(gears, notes={"one": ["Both.", "Mine."], "other": ["Both."]})
    assert text.splitlines()[-3:] == ["notes:", "  Both.", "  one: Mine."]

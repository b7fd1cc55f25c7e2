import math

import pytest

from tests.cli.commands import PAPER, row_of
from tests.pair.texts import CONTRACT, DRIVE, MINIMAL


def row(text: str, label: str) -> list[str]:
    return row_of(text, label).split()


def test_prints_table_1_of_the_paper_beside_its_own_numbers(vttig):
    code, out, err = vttig("measure", PAPER)
    assert (code, err) == (0, "")
    assert row(out, "thickness, thin end") == ["2.0934", "2.093", "-0.0004"] * 2
    assert row(out, "thickness, thick end") == ["4.1897", "4.195", "+0.0053"] * 2
    assert row(out, "tip diameter") == ["94.0000", "94", "+0.0000", "164.0000", "164", "+0.0000"]
    assert row(out, "root diameter") == ["85.0000", "85", "+0.0000", "155.0000", "155", "+0.0000"]
    assert out.count("no micrometer can take it") == 1
    assert "z = 0 mm in the middle of the face" in out


@pytest.mark.portable
def test_numbers_of_the_contract(found):
    record = found("measure", PAPER)
    for shaft, tip, root in (("driving", 94.0, 85.0), ("driven", 164.0, 155.0)):
        gear = record[shaft]
        assert gear["tooth_thickness_thin_mm"] == pytest.approx(2.0934, abs=5e-5)
        assert gear["tooth_thickness_thick_mm"] == pytest.approx(4.1897, abs=5e-5)
        assert (gear["tip_diameter_mm"], gear["root_diameter_mm"]) == (tip, root)
        assert gear["span_mm"]["teeth"] >= 2 and gear["over_balls_mm"]["ball_diameter_mm"] == 3.5
        assert gear["over_balls_mm"]["value"] > tip
        beside = gear["stated"]["tooth_thickness_thick_mm"]
        assert beside["value"] == 4.195
        assert beside["difference"] == pytest.approx(4.195 - gear["tooth_thickness_thick_mm"])
    pitches = (record["driving"]["span_mm"]["teeth"] - 1) * 2 * math.pi
    alpha = math.radians(20)
    expected = math.cos(alpha) * (pitches + math.pi + 90 * (math.tan(alpha) - alpha))
    assert record["driving"]["span_mm"]["value"] == pytest.approx(expected)
    assert record["driving"]["span_mm"]["measurable"] is False


def test_section_balls_and_teeth_are_those_asked_for(told, found, pair_file):
    path = pair_file(CONTRACT)
    before = found("measure", path)["driving"]
    options = ("--section-mm", "-4", "--ball-mm", "3.4", "--span-teeth", "6")
    record = found("measure", path, *options)
    gear = record["driving"]
    assert record["section_mm"] == -4.0
    assert gear["over_balls_mm"]["ball_diameter_mm"] == 3.4 and gear["span_mm"]["teeth"] == 6
    thicker = 8 * math.tan(math.radians(3.0))
    assert gear["tooth_thickness_mm"] == pytest.approx(before["tooth_thickness_mm"] + thicker)
    assert gear["tooth_thickness_thin_mm"] == before["tooth_thickness_thin_mm"]
    out = told("measure", path, *options)
    assert "section z = -4 mm" in out and "Hold the centres of the balls at z = -4 mm" in out
    assert row(out, "ball diameter") == ["3.4", "3.4"]


def test_thickness_at_radii(told, found, pair_file):
    call = ("measure", pair_file(CONTRACT), "--thickness-at-mm", "46", "--thickness-at-mm", "80")
    record = found(*call)
    driving, driven = (record[shaft]["thickness_at"] for shaft in ("driving", "driven"))
    assert [one["radius_mm"] for one in driving] == [46.0, 80.0]
    assert driving[0]["thin_mm"] < driving[0]["section_mm"] and driving[1]["section_mm"] is None
    assert driven[1]["section_mm"] == pytest.approx(math.pi)
    out = told(*call)
    assert row(out, "thickness at r = 80, section") == ["–", "3.1416"]
    assert "driving: There is no involute at a radius of 80 mm" in out


def test_stated_balls_and_teeth_are_the_default(told, found, pair_file):
    stated = "[driven.stated]\nover_balls_mm = 164.2\nball_diameter_mm = 3.25\n"
    call = ("measure", pair_file(f"{CONTRACT}{stated}span_mm = 58.3\nspan_teeth = 10\n"))
    record = found(*call)
    gear = record["driven"]
    assert gear["over_balls_mm"]["ball_diameter_mm"] == 3.25 and gear["span_mm"]["teeth"] == 10
    for name in ("over_balls_mm", "span_mm"):
        beside = gear["stated"][name]
        assert beside["difference"] == pytest.approx(beside["value"] - gear[name]["value"])
    assert record["driving"]["over_balls_mm"]["ball_diameter_mm"] == 3.5
    other = found(*call, "--ball-mm", "3.5", "--section-mm", "1")["driven"]
    assert other["stated"]["over_balls_mm"] == {"value": 164.2, "difference": None}
    assert any("stated measure over balls" in note for note in other["notes"])
    said = "driven: The stated measure over balls is over balls of 3.25 mm."
    assert said in told(*call, "--ball-mm", "3.5")


def replaced(old, new, text=CONTRACT):
    assert old in text
    return text.replace(old, new)


def test_gears_that_cannot_be_measured(refused, pair_file, tmp_path):
    face, both = "face_width_mm = 20.0", "teeth = 80\nface_width_mm = 20.0"
    for text, place, words in (
        (DRIVE, "drive", "a drive without gears has nothing to measure; give [pair]"),
        (replaced(face, face.replace("2", "3")), "driving: tip circle", "pointed at z = 15 mm"),
        (replaced(face, face.replace("2", "9")), "driving: thickness", "circle at z = 45 mm"),
        (replaced(both, both.replace("2", "4")), "driven: tip circle", "make the face narrower"),
        (replaced("teeth = 45", "teeth = 2", MINIMAL), "driving: root radius", "above 0"),
    ):
        path = pair_file(text)
        said = refused(3, words, "measure", path)
        assert said.startswith(f"error: {path}: {place}: ")
    refused(3, "no such file", "measure", tmp_path / "nothing.toml")


def test_bad_calls_end_in_one_sentence(refused, pair_file):
    for option, value, words in (
        ("--section-mm", "10.5", "outside of the driving gear, whose face ends at ±10 mm"),
        ("--section-mm", "nan", "not a finite number"),
        ("--thickness-at-mm", "60", "--thickness-at-mm 60 lies on neither gear"),
        ("--thickness-at-mm", "0", "--thickness-at-mm"),
        ("--span-teeth", "0", "--span-teeth"),
        ("--ball-mm", "-1", "--ball-mm"),
    ):
        refused(2, words, "measure", pair_file(CONTRACT), option, value)

import math
from pathlib import Path

import pytest

from tests.pair.texts import CONTRACT, DRIVE, MINIMAL

PAPER = Path(__file__).parents[2] / "fits" / "paper" / "pair.toml"
HELICAL = """
name = "helical"
[pair]
normal_module_mm = 3.0
normal_pressure_angle_deg = 20.0
centre_distance_mm = 140.5
[driving]
teeth = 24
face_width_mm = 40.0
helix_left_deg = 25.0
helix_right_deg = -25.0
profile_shift = 0.4
[driven]
teeth = 60
face_width_mm = 40.0
helix_left_deg = 25.0
helix_right_deg = -25.0
"""


def row(text: str, label: str) -> list[str]:
    (line,) = [line for line in text.splitlines() if line.startswith(f"  {label}  ")]
    return line.removeprefix(f"  {label}").split()


@pytest.mark.portable
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
def test_numbers_of_the_contract(vttig_json):
    code, record = vttig_json("measure", PAPER)
    assert code == 0
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


def test_shift_counts_in_normal_modules(vttig_json, pair_file):
    """The worked example of the KHK gear handbook."""
    code, record = vttig_json("measure", pair_file(HELICAL), "--span-teeth", "5")
    assert code == 0
    span = record["driving"]["span_mm"]
    assert span["value"] == pytest.approx(42.0085, abs=6e-5) and span["measurable"]
    assert span["transverse"] > span["value"]
    assert record["driving"]["over_balls_mm"]["per_axial_mm"] == pytest.approx(0.0, abs=1e-9)


def test_section_balls_and_teeth_are_those_asked_for(vttig, vttig_json, pair_file):
    path = pair_file(CONTRACT)
    _, middle = vttig_json("measure", path)
    options = ["--section-mm", "-4", "--ball-mm", "3.4", "--span-teeth", "6"]
    code, record = vttig_json("measure", path, *options)
    assert code == 0 and record["section_mm"] == -4.0
    gear, before = record["driving"], middle["driving"]
    assert gear["over_balls_mm"]["ball_diameter_mm"] == 3.4 and gear["span_mm"]["teeth"] == 6
    thicker = 8 * math.tan(math.radians(3.0))
    assert gear["tooth_thickness_mm"] == pytest.approx(before["tooth_thickness_mm"] + thicker)
    assert gear["tooth_thickness_thin_mm"] == before["tooth_thickness_thin_mm"]
    _, out, _ = vttig("measure", path, *options)
    assert "section z = -4 mm" in out and "Hold the centres of the balls at z = -4 mm" in out
    assert row(out, "ball diameter") == ["3.4", "3.4"]


def test_thickness_at_radii(vttig, vttig_json, pair_file):
    path = pair_file(CONTRACT)
    radii = ["--thickness-at-mm", "46", "--thickness-at-mm", "80"]
    code, record = vttig_json("measure", path, *radii)
    assert code == 0
    found = {shaft: record[shaft]["thickness_at"] for shaft in ("driving", "driven")}
    assert [one["radius_mm"] for one in found["driving"]] == [46.0, 80.0]
    assert found["driving"][0]["thin_mm"] < found["driving"][0]["section_mm"]
    assert found["driving"][1]["section_mm"] is None
    assert found["driven"][1]["section_mm"] == pytest.approx(math.pi)
    _, out, _ = vttig("measure", path, *radii)
    assert row(out, "thickness at r = 80, section") == ["–", "3.1416"]
    assert "driving: There is no involute at a radius of 80 mm" in out


def test_stated_balls_and_teeth_are_the_default(vttig, vttig_json, pair_file):
    stated = "[driven.stated]\nover_balls_mm = 164.2\nball_diameter_mm = 3.25\n"
    stated += "span_mm = 58.3\nspan_teeth = 10\n"
    path = pair_file(CONTRACT + stated)
    _, record = vttig_json("measure", path)
    gear = record["driven"]
    assert gear["over_balls_mm"]["ball_diameter_mm"] == 3.25 and gear["span_mm"]["teeth"] == 10
    for name in ("over_balls_mm", "span_mm"):
        beside = gear["stated"][name]
        assert beside["difference"] == pytest.approx(beside["value"] - gear[name]["value"])
    assert record["driving"]["over_balls_mm"]["ball_diameter_mm"] == 3.5
    _, other = vttig_json("measure", path, "--ball-mm", "3.5", "--section-mm", "1")
    assert other["driven"]["stated"]["over_balls_mm"] == {"value": 164.2, "difference": None}
    assert any("stated measure over balls" in note for note in other["driven"]["notes"])
    _, out, _ = vttig("measure", path, "--ball-mm", "3.5")
    assert "driven: The stated measure over balls is over balls of 3.25 mm." in out


def test_without_face_width_there_are_no_ends(vttig, vttig_json, pair_file):
    path = pair_file(MINIMAL)
    code, record = vttig_json("measure", path)
    assert code == 0
    assert record["driving"]["tooth_thickness_thin_mm"] is None
    assert record["driving"]["tooth_thickness_mm"] == pytest.approx(math.pi)
    _, out, _ = vttig("measure", path, "--section-mm", "100")
    assert row(out, "thickness, thin end") == ["–", "–"]
    assert "  The drawing gives no face_width_mm" in out


def replaced(old, new, text=CONTRACT):
    assert old in text
    return text.replace(old, new)


SPUR = "helix_angle_deg = 0.0"
BAD_GEARS = {
    "drive": (DRIVE, "drive", "a drive without gears has nothing to measure; give [pair]"),
    "pointed": (
        replaced("face_width_mm = 20.0", "face_width_mm = 30.0"),
        "driving: tip circle",
        "pointed at z = 15 mm",
    ),
    "no thickness": (
        replaced("face_width_mm = 20.0", "face_width_mm = 90.0"),
        "driving: thickness",
        "on the reference circle at z = 45 mm",
    ),
    "the driven gear alone": (
        replaced("teeth = 80\nface_width_mm = 20.0", "teeth = 80\nface_width_mm = 40.0"),
        "driven: tip circle",
        "make the face narrower",
    ),
    "no root": (replaced("teeth = 45", "teeth = 2", MINIMAL), "driving: root radius", "above 0"),
}


def test_gears_that_cannot_be_measured(vttig, pair_file):
    for name in BAD_GEARS:
        text, place, words = BAD_GEARS[name]
        path = pair_file(text)
        code, out, err = vttig("measure", path)
        assert (code, out) == (3, "")
        assert err.startswith(f"error: {path}: {place}: ") and words in err and err.count("\n") == 1


def test_an_undercut_gear_is_measured_and_told(vttig, pair_file):
    code, out, _ = vttig("measure", pair_file(replaced("teeth = 45", "teeth = 12", MINIMAL)))
    assert code == 0
    assert "driving: The teeth are undercut" in out


def test_bad_calls_end_in_one_sentence(vttig, pair_file):
    for options, words in (
        (["--section-mm", "10.5"], "outside of the driving gear, whose face ends at ±10 mm"),
        (["--section-mm", "nan"], "not a finite number"),
        (["--thickness-at-mm", "60"], "--thickness-at-mm 60 lies on neither gear"),
        (["--thickness-at-mm", "0"], "--thickness-at-mm"),
        (["--span-teeth", "0"], "--span-teeth"),
        (["--ball-mm", "-1"], "--ball-mm"),
    ):
        code, out, err = vttig("measure", pair_file(CONTRACT), *options)
        assert (code, out) == (2, "")
        assert words in err and err.count("\n") == 1


def test_balls_and_teeth_that_do_not_serve_leave_a_dash_and_a_reason(vttig, pair_file):
    options = ["--ball-mm", "1", "--span-teeth", "2"]
    code, out, _ = vttig("measure", pair_file(CONTRACT), *options)
    assert code == 0
    assert row(out, "over balls") == ["–", "–"]
    assert "A ball of 1 mm lies below the base circle" in out
    assert "driven: Over 2 teeth the jaws would touch" in out


def test_a_missing_file_is_told(vttig, tmp_path):
    code, _, err = vttig("measure", tmp_path / "nothing.toml")
    assert code == 3 and "no such file" in err

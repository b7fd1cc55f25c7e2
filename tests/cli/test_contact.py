import csv
import json
from pathlib import Path

import numpy as np
import pytest

import vttig_jax
from tests.pair.texts import CONTRACT, DRIVE, MINIMAL
from vttig_jax.pair.gear_pair import Eccentricities
from vttig_jax.rig.paper import paper_pair
from vttig_jax.runs.maps import fitted_rig

PAPER = Path(__file__).parents[2] / "fits" / "paper" / "pair.toml"
SHORT = ("--span-rev", "0.05", "--step-deg", "2")


def columns(path: Path) -> dict[str, np.ndarray]:
    with path.open() as file:
        head, *rows = csv.reader(file)
    return dict(zip(head, np.array(rows, float).T, strict=True))


def test_the_table_is_the_exact_relation_of_the_rig(vttig, vttig_json, run_folder, tmp_path):
    out = tmp_path / "contact"
    code, record = vttig_json(
        *("contact", PAPER, "--rig", run_folder, "--axial-mm", "0.2", "--out", out, "-q"),
        *("--step-deg", "97"),
    )
    assert code == 0 and record["rows"] == 60 and record["span_turns"] == 16
    found, pair, rig = columns(out / "contact.csv"), paper_pair(), fitted_rig(run_folder, PAPER)
    drawn = float(np.degrees(pair.drawing_backlash))
    exact = Eccentricities(
        *(rig.driving_mm, rig.driving_phase_deg, rig.driven_mm, rig.driven_phase_deg),
        *(drawn, 0.2),
    )
    angle = np.radians(found["driving_deg"])
    for flank in ("A", "B"):
        expected = np.degrees(vttig_jax.exact_transmission_error(angle, pair, exact, flank))
        got = found[f"transmission_error_{flank.lower()}_deg"]
        np.testing.assert_allclose(got, expected, rtol=1e-8, atol=1e-8)
    difference = found["transmission_error_b_deg"] - found["transmission_error_a_deg"]
    np.testing.assert_allclose(found["backlash_deg"], difference, atol=1e-8)
    assert record["smallest"]["backlash_deg"] == pytest.approx(difference.min(), abs=1e-8)
    assert record["apparent_backlash_deg"] == pytest.approx(float(rig.constant_backlash_deg))
    assert record["drawn_backlash_deg"] == pytest.approx(
        drawn - np.degrees(0.2 * float(pair.thinning) / 80), abs=1e-9
    )
    names = {path.name for path in (out / "figures").iterdir()}
    assert names == {"contact_A.png", "contact_B.png"}
    before = (out / "contact.csv").read_bytes()
    assert vttig("contact", PAPER, "--out", out, *SHORT)[0] == 2
    assert (out / "contact.csv").read_bytes() == before
    code, text, _ = vttig("contact", PAPER, "--out", out, *SHORT, "--overwrite")
    assert code == 0 and "of the run" not in text
    assert (out / "contact.csv").read_bytes() != before


def test_true_gears_touch_along_lines_everywhere(vttig, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = vttig("contact", PAPER, *SHORT)
    assert (code, err) == (0, "")
    assert out.count("line, flank         9 of 9") == 2 and "undefined" not in out
    assert "0.06279° at" in out and "backlash from the teeth" in out
    assert not list(tmp_path.iterdir())


def test_every_option_changes_the_backlash(vttig_json):
    for option in (
        ("--axial-mm", "0.3"),
        ("--centre-distance-mm", "125.2"),
        ("--inclination-urad", "200"),
        ("--deviation-urad", "200"),
    ):
        _, plain = vttig_json("contact", PAPER, *SHORT, "-q")
        code, moved = vttig_json("contact", PAPER, *SHORT, *option, "-q")
        difference = moved["smallest"]["backlash_deg"] - plain["smallest"]["backlash_deg"]
        assert code == 0 and abs(difference) > 1e-4
        tilted = option[0].endswith("urad")
        assert moved["flanks"]["A"]["largest_misfit_deg"] > 1e-4 or not tilted
        assert any("point" in kind for kind in moved["flanks"]["A"]["kinds"]) == tilted


MAP = ["gear,flank,roll_mm,z_mm,deviation_um"]
MAP += [f"driving,A,{roll},{z},{5 + z / 10}" for roll in (8, 20) for z in (-9, 9)]
PITCH = ["gear,flank,tooth,deviation_um", *(f"driven,B,{n},{-n % 7}" for n in range(1, 81))]


@pytest.fixture
def measured(tmp_path):
    """Options that name a file of each kind: A is moved by 4 to 6 µm, B by up to 6 µm."""
    files = {"--deviations": MAP, "--pitch": PITCH}
    for option, lines in files.items():
        (tmp_path / f"{option}.csv").write_text("\n".join(lines))
    return {option: (option, tmp_path / f"{option}.csv") for option in files}


@pytest.mark.slow
def test_measured_flanks_move_the_contact(vttig, vttig_json, measured, tmp_path):
    """By their deviation over the base radius; their picture lies beside the others."""
    out = tmp_path / "contact"
    options = (*measured["--deviations"], *measured["--pitch"])
    code, record = vttig_json("contact", PAPER, *SHORT, *options, "--out", out, "-q")
    assert code == 0
    assert record["deviations"].endswith("--deviations.csv")
    assert record["pitch"].endswith("--pitch.csv")
    base = 80 * np.cos(np.radians(20.0))
    highest = np.degrees(5.9e-3 / base)
    assert record["flanks"]["A"]["transmission_error_max_deg"] == pytest.approx(highest, rel=1e-3)
    lowest = record["flanks"]["B"]["transmission_error_min_deg"]
    drawn = float(np.degrees(paper_pair().drawing_backlash))
    assert np.degrees(3e-3 / base) < drawn - lowest <= np.degrees(6.001e-3 / base)
    names = {path.name for path in (out / "figures").iterdir()}
    assert names == {"contact_A.png", "contact_B.png", "deviations.png"}
    code, text, _ = vttig("contact", PAPER, *SHORT, *options)
    assert code == 0 and "driven pitch B   80 teeth, 0.00 … 6.00 µm" in text
    assert "driving flank A  2 × 2 points, 4.10 … 5.90 µm" in text
    assert vttig("contact", PAPER, *SHORT, "--out", out, "--overwrite")[0] == 0
    assert not (out / "figures" / "deviations.png").exists()  # nothing is measured any more


@pytest.mark.portable
def test_where_only_part_of_a_turn_has_contact(vttig, vttig_json, tmp_path):
    """Tips that only just reach each other leave angles without a touch: empty, null, counted."""
    out = tmp_path / "contact"
    options = ("contact", PAPER, *SHORT, "--centre-distance-mm", "128.98")
    code, record = vttig_json(*options, "--out", out, "-q")
    without = record["flanks"]["A"]["kinds"]["nothing"]
    assert code == 0 and 0 < without < 9 and 0 < record["rows_with_backlash"] <= 9 - without
    assert record["flanks"]["A"]["pairs_in_contact"] < 1
    with (out / "contact.csv").open() as file:
        rows = list(csv.DictReader(file))
    empty = [row for row in rows if not row["transmission_error_a_deg"]]
    assert len(empty) == without and all(row["driving_deg"] for row in rows)
    assert not any(row["backlash_deg"] or row["z_a_mm"] or row["driven_tooth_a"] for row in empty)
    assert json.loads((out / "contact.json").read_text())["smallest"]["backlash_deg"] > 1.0
    assert (out / "figures" / "contact_A.png").exists()
    code, text, _ = vttig(*options)
    missing = 9 - record["rows_with_backlash"]
    assert code == 0 and f"undefined  at {missing} of 9 angles: no tooth in reach" in text


def test_teeth_that_interfere_are_named(vttig):
    _, closed, _ = vttig("contact", PAPER, *SHORT, "--axial-mm", "2")
    assert closed.count("where the teeth interfere") == 2
    assert "where the teeth interfere" not in vttig("contact", PAPER, *SHORT)[1]


def test_an_existing_result_is_refused_before_anything_is_computed(vttig, tmp_path, monkeypatch):
    monkeypatch.setattr("vttig_jax.geometry.contact_report.contact_at", None)
    (tmp_path / "contact.csv").write_text("mine")
    code, _, err = vttig("contact", PAPER, *SHORT, "--out", tmp_path)
    assert code == 2 and "already exists" in err
    assert {path.name for path in tmp_path.iterdir()} == {"contact.csv"}


def test_bad_calls_end_in_one_sentence(vttig, tmp_path):
    for text, options, code, words in (
        (DRIVE, (), 3, "a drive without gears has no teeth to touch"),
        (CONTRACT, ("--axial-mm", "30"), 2, "--axial-mm must leave the faces some overlap"),
        (CONTRACT, ("--step-deg", "400"), 2, "--step-deg"),
        (CONTRACT, ("--step-deg", "1e-6"), 2, "more than 200000 rows"),
        (CONTRACT, ("--centre-distance-mm", "140"), 3, "--centre-distance-mm: 140 mm is too far"),
        (CONTRACT, ("--centre-distance-mm", "117"), 3, "lets the base circles overlap"),
        (CONTRACT, ("--deviation-urad", "1e6"), 2, "--deviation-urad"),
        (CONTRACT, ("--deviations", "nowhere.csv"), 3, "nowhere.csv: no such file"),
        (CONTRACT, ("--pitch", "nowhere.csv"), 3, "nowhere.csv: no such file"),
        (CONTRACT, ("--rig", "nowhere"), 2, "no such run"),
        (MINIMAL, ("--deviation-urad", "100"), 3, "face_width_mm: the face width is missing"),
    ):
        path = tmp_path / "pair.toml"
        path.write_text(text)
        got, out, err = vttig("contact", path, *SHORT, *options)
        assert (got, out) == (code, "") and words in err and err.count("\n") == 1

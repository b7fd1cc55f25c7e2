import csv
import json

import numpy as np
import pytest

import vttig_jax
from tests.cli.commands import PAPER, table_of
from tests.pair.texts import CONTRACT, DRIVE, MINIMAL
from vttig_jax.pair.gear_pair import Eccentricities
from vttig_jax.rig.paper import paper_pair
from vttig_jax.runs.maps import fitted_rig

SHORT = ("contact", PAPER, "--span-rev", "0.05", "--step-deg", "2")
DRAWN_DEG = float(np.degrees(paper_pair().drawing_backlash))


def test_the_table_is_the_exact_relation_of_the_rig(vttig, told, found, run_folder, tmp_path):
    out = tmp_path / "contact"
    options = ("--rig", run_folder, "--axial-mm", "0.2", "--step-deg", "97", "--out", out, "-q")
    record = found("contact", PAPER, *options)
    assert record["rows"] == 60 and record["span_turns"] == 16
    table, pair, rig = table_of(out / "contact.csv"), paper_pair(), fitted_rig(run_folder, PAPER)
    exact = Eccentricities(
        *(rig.driving_mm, rig.driving_phase_deg, rig.driven_mm, rig.driven_phase_deg),
        *(DRAWN_DEG, 0.2),
    )
    angle = np.radians(table["driving_deg"])
    for flank in ("A", "B"):
        expected = np.degrees(vttig_jax.exact_transmission_error(angle, pair, exact, flank))
        got = table[f"transmission_error_{flank.lower()}_deg"]
        np.testing.assert_allclose(got, expected, rtol=1e-8, atol=1e-8)
    difference = table["transmission_error_b_deg"] - table["transmission_error_a_deg"]
    np.testing.assert_allclose(table["backlash_deg"], difference, atol=1e-8)
    assert record["smallest"]["backlash_deg"] == pytest.approx(difference.min(), abs=1e-8)
    assert record["apparent_backlash_deg"] == pytest.approx(float(rig.constant_backlash_deg))
    closed = np.degrees(0.2 * float(pair.thinning) / 80)
    assert record["drawn_backlash_deg"] == pytest.approx(DRAWN_DEG - closed, abs=1e-9)
    names = {path.name for path in (out / "figures").iterdir()}
    assert names == {"contact_A.png", "contact_B.png"}
    before = (out / "contact.csv").read_bytes()
    assert vttig(*SHORT, "--out", out)[0] == 2
    assert (out / "contact.csv").read_bytes() == before
    assert "of the run" not in told(*SHORT, "--out", out, "--overwrite")
    assert (out / "contact.csv").read_bytes() != before


def test_true_gears_touch_along_lines_everywhere(vttig, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = vttig(*SHORT)
    assert (code, err) == (0, "") and not list(tmp_path.iterdir())
    assert out.count("line, flank         9 of 9") == 2 and "undefined" not in out
    assert "0.06279° at" in out and "backlash from the teeth" in out
    assert "where the teeth interfere" not in out
    closed = vttig(*SHORT, "--axial-mm", "2")[1]
    assert closed.count("where the teeth interfere") == 2


def test_every_option_changes_the_backlash(found):
    plain = found(*SHORT, "-q")["smallest"]["backlash_deg"]
    for option in (
        ("--axial-mm", "0.3"),
        ("--centre-distance-mm", "125.2"),
        ("--inclination-urad", "200"),
        ("--deviation-urad", "200"),
    ):
        moved = found(*SHORT, *option, "-q")
        assert abs(moved["smallest"]["backlash_deg"] - plain) > 1e-4
        tilted = option[0].endswith("urad")
        assert moved["flanks"]["A"]["largest_misfit_deg"] > 1e-4 or not tilted
        assert any("point" in kind for kind in moved["flanks"]["A"]["kinds"]) == tilted


MAP = ["gear,flank,roll_mm,z_mm,deviation_um"]
MAP += [f"driving,A,{roll},{z},{5 + z / 10}" for roll in (8, 20) for z in (-9, 9)]
PITCH = ["gear,flank,tooth,deviation_um", *(f"driven,B,{n},{-n % 7}" for n in range(1, 81))]


@pytest.mark.slow
def test_measured_flanks_move_the_contact(told, found, tmp_path):
    """A by 4 to 6 µm and B by up to 6 µm, over the base radius; their picture is drawn too."""
    out, options = tmp_path / "contact", []
    for option, lines in (("--deviations", MAP), ("--pitch", PITCH)):
        (tmp_path / f"{option}.csv").write_text("\n".join(lines))
        options += [option, tmp_path / f"{option}.csv"]
    record = found(*SHORT, *options, "--out", out, "-q")
    assert record["deviations"].endswith("--deviations.csv")
    assert record["pitch"].endswith("--pitch.csv")
    base = 80 * np.cos(np.radians(20.0))
    highest = np.degrees(5.9e-3 / base)
    assert record["flanks"]["A"]["transmission_error_max_deg"] == pytest.approx(highest, rel=1e-3)
    lowest = DRAWN_DEG - record["flanks"]["B"]["transmission_error_min_deg"]
    assert np.degrees(3e-3 / base) < lowest <= np.degrees(6.001e-3 / base)
    names = {path.name for path in (out / "figures").iterdir()}
    assert names == {"contact_A.png", "contact_B.png", "deviations.png"}
    text = told(*SHORT, *options)
    assert "driven pitch B   80 teeth, 0.00 … 6.00 µm" in text
    assert "driving flank A  2 × 2 points, 4.10 … 5.90 µm" in text
    told(*SHORT, "--out", out, "--overwrite")
    assert not (out / "figures" / "deviations.png").exists()  # nothing is measured any more


@pytest.mark.portable
def test_where_only_part_of_a_turn_has_contact(told, found, tmp_path):
    """Tips that only just reach each other leave angles without a touch: empty, null, counted."""
    out, options = tmp_path / "contact", (*SHORT, "--centre-distance-mm", "128.98")
    record = found(*options, "--out", out, "-q")
    without = record["flanks"]["A"]["kinds"]["nothing"]
    assert 0 < without < 9 and 0 < record["rows_with_backlash"] <= 9 - without
    assert record["flanks"]["A"]["pairs_in_contact"] < 1
    with (out / "contact.csv").open() as file:
        rows = list(csv.DictReader(file))
    empty = [row for row in rows if not row["transmission_error_a_deg"]]
    assert len(empty) == without and all(row["driving_deg"] for row in rows)
    assert not any(row["backlash_deg"] or row["z_a_mm"] or row["driven_tooth_a"] for row in empty)
    assert json.loads((out / "contact.json").read_text())["smallest"]["backlash_deg"] > 1.0
    assert (out / "figures" / "contact_A.png").exists()
    missing = 9 - record["rows_with_backlash"]
    assert f"undefined  at {missing} of 9 angles: no tooth in reach" in told(*options)


def test_an_existing_result_is_refused_before_anything_is_computed(refused, tmp_path, monkeypatch):
    monkeypatch.setattr("vttig_jax.geometry.contact_report.contact_at", None)
    (tmp_path / "contact.csv").write_text("mine")
    refused(2, "already exists", *SHORT, "--out", tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"contact.csv"}


def test_bad_calls_end_in_one_sentence(refused, pair_file):
    for text, option, value, code, words in (
        (DRIVE, "--axial-mm", "0", 3, "a drive without gears has no teeth to touch"),
        (CONTRACT, "--axial-mm", "30", 2, "--axial-mm must leave the faces some overlap"),
        (CONTRACT, "--step-deg", "400", 2, "--step-deg"),
        (CONTRACT, "--step-deg", "1e-6", 2, "more than 200000 rows"),
        (CONTRACT, "--centre-distance-mm", "140", 3, "--centre-distance-mm: 140 mm is too far"),
        (CONTRACT, "--centre-distance-mm", "117", 3, "lets the base circles overlap"),
        (CONTRACT, "--deviation-urad", "1e6", 2, "--deviation-urad"),
        (CONTRACT, "--deviations", "nowhere.csv", 3, "nowhere.csv: no such file"),
        (CONTRACT, "--pitch", "nowhere.csv", 3, "nowhere.csv: no such file"),
        (CONTRACT, "--rig", "nowhere", 2, "no such run"),
        (MINIMAL, "--deviation-urad", "100", 3, "face_width_mm: the face width is missing"),
    ):
        refused(code, words, "contact", pair_file(text), *SHORT[2:], option, value)

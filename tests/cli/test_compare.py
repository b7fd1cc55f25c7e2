"""`vttig compare`: differences of two runs, and which of them count."""

import json
import math
import random
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from tests.cli.commands import fit_into
from tests.cli.drive import write_drive, write_pair
from vttig_jax.report import compare_runs


def rows(record: dict) -> dict[str, dict]:
    return {row["name"]: row for row in record["differences"]}


@pytest.mark.portable
def test_a_run_and_itself_do_not_differ(vttig, found, run_folder):
    record = found("compare", run_folder, run_folder)
    judged = [row for row in record["differences"] if row["counts"]]
    assert len(judged) > 10 and {row["counts"] for row in judged} == {"no"}
    assert all(row["difference"] == 0 for row in judged)
    assert "nothing" in record["verdict"][1] and "contains zero" in record["verdict"][0]
    code, out, err = vttig("compare", run_folder, run_folder)
    assert code == 0 and err == "" and out.splitlines()[:3] == record["verdict"]


def test_differences_have_the_errors_of_both(found, run_folder, half_folder):
    record = found("compare", run_folder, half_folder)
    fits = [json.loads((f / "fit.json").read_text()) for f in (run_folder, half_folder)]
    row = rows(record)["driving_eccentricity_mm"]
    first, second = (fit["parameters"][row["name"]] for fit in fits)
    assert row["difference"] == pytest.approx(second["value"] - first["value"])
    assert row["std"] == pytest.approx(math.hypot(first["std"], second["std"]))
    reach = (row["high95"] - row["low95"]) / 2
    assert 1.95 < reach / row["std"] < 2.1
    assert row["counts"] in ("no", "perhaps")  # one rig
    assert rows(record)["driving_phase_deg"]["difference"] is None  # zeros of their own


def moved(folder: Path, place: Path, stds: float) -> Path:
    """Copy a run, with another constant backlash in fit.json: a rig that was adjusted."""
    run = Path(shutil.copytree(folder, place / f"moved{stds:g}"))
    fit = json.loads((run / "fit.json").read_text())
    own = fit["parameters"]["constant_backlash_deg"]
    for end in ("value", "low95", "high95"):
        own[end] += stds * math.sqrt(2) * own["std"]
    (run / "fit.json").write_text(json.dumps(fit))
    return run


@pytest.mark.parametrize(
    ("stds", "counts"), [(1.5, "no"), (2.5, "perhaps"), (3.5, "yes"), (-4.0, "yes")]
)
def test_what_counts(found, run_folder, tmp_path, stds, counts):
    record = found("compare", run_folder, moved(run_folder, tmp_path, stds))
    row = rows(record)["constant_backlash_deg"]
    assert row["counts"] == counts and row["difference"] / row["std"] == pytest.approx(stds)
    assert ("constant_backlash_deg" in record["verdict"][1]) is (counts == "yes")


def test_the_verdict_says_which_way_and_names_few(run_folder):
    comparison = compare_runs(run_folder, run_folder)
    judged = [one for one in comparison.differences if one.counts]

    def verdict(change: float, count: int) -> tuple[str, str, str]:
        """Of a comparison whose first numbers differ by this change, which counts."""
        moved = [replace(one, difference=change, std=0.01, counts="yes") for one in judged[:count]]
        return replace(comparison, differences=tuple(moved)).verdict

    first, second, _ = verdict(-0.1, len(judged))
    assert "falls from" in first and "which counts" in first
    assert second.endswith(f", and {len(judged) - 7} more.") and second.count(",") == 7
    first, second, _ = verdict(0.1, 3)
    assert "rises from" in first and "more." not in second
    assert "goes from" in comparison.verdict[0]


def test_what_one_run_does_not_tell(found, run_folder, one_flank_folder):
    record = found("compare", run_folder, one_flank_folder)
    gap = rows(record)["constant_backlash_deg"]
    assert gap["second"] is None and gap["counts"] is None and "first" in gap["reason"]
    assert "peak to peak of flank B" in rows(record)


def test_runs_of_two_drives(refused, run_folder, tmp_path):
    drive = write_drive(tmp_path / "log.csv"), write_pair(tmp_path / "pair.toml")
    refused(2, "9/16", "compare", run_folder, fit_into(tmp_path / "run", *drive))


def test_the_page_of_two_runs(found, run_folder, half_folder, tmp_path):
    out, half = tmp_path / "two.html", tmp_path / "half"
    shutil.copytree(half_folder, half)
    (half / "large.csv").write_text(random.Random(0).randbytes(400_000).hex())
    record = found("report", run_folder, half, "--out", out)
    page = out.read_text("utf-8")
    assert len(page) < 3_000_000 and "differences" in record["sections"]
    assert record["comparison"] == found("compare", run_folder, half)
    assert record["verdict"] == record["comparison"]["verdict"]
    # Two runs share the room that the files of one may take.
    assert "large.csv (800000 bytes, too large" in page and 'download="large.csv' not in page
    assert page.count("<h3>First run") == page.count("<h3>Second run") > 5

import json

import numpy as np
import pytest

from tests.cli.commands import fit_into, table_of
from tests.cli.drive import write_drive, write_pair


def test_prints_the_extremes_and_writes_nothing(vttig, told, run_folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = vttig("map", run_folder)
    assert (code, err) == (0, "") and list(tmp_path.iterdir()) == []
    assert "smallest" in out and "safe axial closing" in out
    assert "no file is written; `--out map.csv`" in out
    assert "These values do not contain the noise of the fit" in out
    assert "no file" not in told("map", run_folder, "--out", tmp_path / "map.csv")


@pytest.mark.portable
def test_csv_and_json_agree_with_each_other(found, run_folder, tmp_path):
    record = found("map", run_folder, "--out", tmp_path / "map.csv", "--step-deg", "0.5")
    assert json.loads((tmp_path / "map.json").read_text()) == record
    table, least = table_of(tmp_path / "map.csv"), record["smallest"]["backlash_deg"]
    lengths = ("backlash_mm", "axial_mm")  # and, as the ramps tell the delay, no interval
    names = ("driving_deg", "backlash_deg", *lengths, "backlash_first_order_deg")
    assert table.dtype.names == names
    assert len(table) == record["rows"] == 16 * 720
    assert -1e-9 <= table["backlash_deg"].min() - least < 1e-4
    radius, slope = 80.0, 2 * np.tan(np.radians(3.0))
    np.testing.assert_allclose(table["backlash_mm"], np.radians(table["backlash_deg"]) * radius)
    np.testing.assert_allclose(table["axial_mm"], table["backlash_mm"] / slope, rtol=1e-7)
    assert record["safe_closing_mm"] == pytest.approx(np.radians(least) * radius / slope)
    near = abs(table["backlash_first_order_deg"] - table["backlash_deg"])
    assert 0 < near.max() < 0.02


def test_it_says_what_was_seen_and_what_is_extrapolated(told, found, run_folder):
    """Eight of sixteen turns there and back, with the ramps that stay on their flank."""
    text, record = told("map", run_folder), found("map", run_folder)
    (line,) = [line for line in text.splitlines() if "covered" in line]
    assert "of the 16 driving turns of the hunting period on both flanks" in line
    assert "of 720 tooth pairs" in line and "extrapolated by the fitted orders" in line
    coverage = record["coverage"]
    assert coverage["sentence"] in line
    assert coverage["turns"] == pytest.approx(16 * coverage["share"]) == pytest.approx(8, abs=0.1)
    (span,) = coverage["spans_deg"]
    assert span[1] - span[0] == pytest.approx(360 * coverage["turns"])
    assert span[0] >= 0 and span[1] <= 8 * 360
    extremes = [record[name] for name in ("smallest", "largest")]
    for one in extremes:
        assert one["extrapolated"] is not (span[0] <= one["driving_deg"] < span[1])
    shown = [
        line
        for line in text.splitlines()
        if line.rstrip().endswith("extrapolated") or ", extrapolated (" in line
    ]
    assert len(shown) == sum(one["extrapolated"] for one in extremes) > 0


@pytest.mark.parametrize(("off", "freed"), [(0.0, False), (1e-3, True)])
def test_a_freed_ratio_leaves_no_hunting_period(vttig, told, found, tmp_path, off, freed):
    """The map says what `export` says; with the ratio as given it names the period."""
    log = write_drive(tmp_path / "log.csv", delay_s=0.0)
    rows = table_of(log)
    rows["driven_deg"] *= 1 + off
    header = ",".join(rows.dtype.names or ())
    np.savetxt(log, rows, "%.9g", delimiter=",", header=header, comments="")
    run = fit_into(tmp_path / "run", log, write_pair(tmp_path / "pair.toml"))
    text = told("map", run)
    assert ("none: the shafts turn at" in text) is freed
    assert ("until both shafts have made whole turns" in text) is not freed
    refusal = vttig("export", run, "--out", tmp_path / "x.csv")[2]
    assert (str(found("map", run)["no_period"]) in refusal) is freed


def test_step_span_and_constant_backlash_change_the_map(vttig, found, run_folder):
    plain = found("map", run_folder)
    assert found("map", run_folder, "--step-deg", "2")["rows"] == plain["rows"] / 2
    assert found("map", run_folder, "--span-rev", "2")["rows"] == 720
    moved = plain["constant_backlash_deg"] + 0.01
    shifted = found("map", run_folder, "--constant-backlash-deg", moved)
    before, after = (r["smallest"]["backlash_deg"] for r in (plain, shifted))
    assert after - before == pytest.approx(0.01, abs=1e-5)
    # A long hunting period is cut, and that is said.
    code, _, err = vttig("map", run_folder, "--step-deg", "0.01")
    assert code == 0 and "200000 rows" in err and "--span-rev 16" in err


def test_one_flank_needs_the_constant_backlash(refused, found, one_flank_folder, tmp_path):
    refused(4, "--constant-backlash-deg", "map", one_flank_folder)
    record = found("map", one_flank_folder, "--constant-backlash-deg", "0.038")
    assert record["conditional_on"] == ["perfect_encoders"]
    # It is said before anything else is read.
    for flanks, code in (('["A"]', 4), ('["A", "B"]', 2)):
        (tmp_path / "fit.json").write_text(f'{{"flanks": {flanks}}}')
        refused(code, "", "map", tmp_path)


def test_bad_calls_end_in_one_sentence(refused, run_folder, tmp_path, monkeypatch):
    monkeypatch.chdir(run_folder.parent)
    for arguments, code, words in (
        ("nothing", 2, "vttig fit LOG"),
        ("run --step-deg 0", 2, "--step-deg"),
        ("run --step-deg 1e9", 2, "--step-deg"),
        ("run --step-deg nan", 2, "not a finite number"),
        ("run --span-rev inf", 2, "not a finite number"),
        ("run --span-rev 1e9", 2, "rows"),
        ("run --constant-backlash-deg nan", 2, "not a finite number"),
        ("run --probability 0.9", 2, "--probability needs draws; make them with `vttig sample"),
        ("run --out run/fit.json", 3, "of the run itself"),
    ):
        refused(code, words, "map", *arguments.split())
    for name in ("fit.json", "run.toml"):
        (tmp_path / name).write_bytes((run_folder / name).read_bytes())
    refused(2, "summary.npz", "map", tmp_path)
    (tmp_path / "summary.npz").write_bytes((run_folder / "summary.npz").read_bytes()[:1000])
    refused(3, "damaged", "map", tmp_path)

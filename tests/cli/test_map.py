import json

import jsonschema
import numpy as np
import pytest

from tests.cli.drive import write_drive, write_pair
from tests.schemas import load_schema


def rows_of(path):
    return np.genfromtxt(path, delimiter=",", names=True)


def test_prints_the_extremes_and_writes_nothing(vttig, run_folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = vttig("map", run_folder)
    assert code == 0
    assert "smallest" in out
    assert "safe axial closing" in out
    assert err == ""
    assert list(tmp_path.iterdir()) == [] and "no file is written; `--out map.csv`" in out
    assert "These values do not contain the noise of the fit" in out
    assert "no file" not in vttig("map", run_folder, "--out", tmp_path / "map.csv")[1]


def test_a_probability_needs_draws(vttig, run_folder):
    code, out, err = vttig("map", run_folder, "--probability", "0.9")
    assert code == 2 and out == "" and "--probability needs draws" in err and "vttig sample" in err


@pytest.mark.portable
def test_csv_and_json_agree_with_each_other(vttig_json, run_folder, tmp_path):
    code, record = vttig_json("map", run_folder, "--out", tmp_path / "map.csv", "--step-deg", "0.5")
    assert code == 0
    table = rows_of(tmp_path / "map.csv")
    lengths = ("backlash_mm", "axial_mm")  # and, as the ramps tell the delay, no interval
    names = ("driving_deg", "backlash_deg", *lengths, "backlash_first_order_deg")
    assert table.dtype.names == names
    assert len(table) == record["rows"] == 16 * 720
    beside = json.loads((tmp_path / "map.json").read_text())
    assert beside == record
    jsonschema.validate(beside, load_schema("vttig.map/1"))
    assert table["backlash_deg"].min() >= record["smallest"]["backlash_deg"] - 1e-9
    assert table["backlash_deg"].min() == pytest.approx(
        record["smallest"]["backlash_deg"], abs=1e-4
    )
    radius = 80.0
    np.testing.assert_allclose(table["backlash_mm"], np.radians(table["backlash_deg"]) * radius)
    slope = 2 * np.tan(np.radians(3.0))
    np.testing.assert_allclose(table["axial_mm"], table["backlash_mm"] / slope, rtol=1e-7)
    assert record["safe_closing_mm"] == pytest.approx(
        np.radians(record["smallest"]["backlash_deg"]) * radius / slope
    )
    near = abs(table["backlash_first_order_deg"] - table["backlash_deg"])
    assert 0 < near.max() < 0.02


def test_it_says_what_was_seen_and_what_is_extrapolated(vttig, vttig_json, run_folder, tmp_path):
    """Eight of sixteen turns there and back, with the ramps that stay on their flank."""
    _, text, _ = vttig("map", run_folder)
    (line,) = [line for line in text.splitlines() if "covered" in line]
    assert "of the 16 driving turns of the hunting period on both flanks" in line
    assert "of 720 tooth pairs" in line and "extrapolated by the fitted orders" in line
    _, record = vttig_json("map", run_folder, "--out", tmp_path / "map.csv")
    coverage = record["coverage"]
    assert coverage["sentence"] in line
    assert coverage["turns"] == pytest.approx(16 * coverage["share"]) == pytest.approx(8, abs=0.1)
    (span,) = coverage["spans_deg"]
    assert span[1] - span[0] == pytest.approx(360 * coverage["turns"])
    assert span[0] >= 0 and span[1] <= 8 * 360
    for name in ("smallest", "largest"):
        inside = span[0] <= record[name]["driving_deg"] < span[1]
        assert record[name]["extrapolated"] is not inside
    shown = [
        line
        for line in text.splitlines()
        if line.rstrip().endswith("extrapolated") or ", extrapolated (" in line
    ]
    assert len(shown) == sum(record[name]["extrapolated"] for name in ("smallest", "largest")) > 0


def test_a_freed_ratio_leaves_no_hunting_period(vttig, vttig_json, tmp_path):
    """The map says what `export` says; with the ratio as given it names the period."""
    pair = write_pair(tmp_path / "pair.toml")
    for off, told in ((0.0, False), (1e-3, True)):
        log, run = tmp_path / f"{off}.csv", tmp_path / f"run_{off}"
        write_drive(log, delay_s=0.0)
        rows = np.genfromtxt(log, delimiter=",", names=True)
        names = rows.dtype.names or ()
        table = np.stack([rows[name] for name in names], axis=1)
        table[:, names.index("driven_deg")] *= 1 + off
        header = ",".join(names)
        np.savetxt(log, table, "%.9g", delimiter=",", header=header, comments="")
        assert vttig("fit", log, "--pair", pair, "--out", run, "--no-figures")[0] == 0
        _, text, _ = vttig("map", run)
        assert ("none: the shafts turn at" in text) is told
        assert ("until both shafts have made whole turns" in text) is not told
        _, record = vttig_json("map", run)
        jsonschema.validate(record, load_schema("vttig.map/1"))
        _, _, refusal = vttig("export", run, "--out", tmp_path / "x.csv", "--overwrite")
        assert (str(record["no_period"]) in refusal) is told


def test_step_span_and_constant_backlash_change_the_map(vttig_json, run_folder):
    _, plain = vttig_json("map", run_folder)
    assert vttig_json("map", run_folder, "--step-deg", "2")[1]["rows"] == plain["rows"] / 2
    assert vttig_json("map", run_folder, "--span-rev", "2")[1]["rows"] == 720
    moved = plain["constant_backlash_deg"] + 0.01
    shifted = vttig_json("map", run_folder, "--constant-backlash-deg", moved)[1]
    before, after = (r["smallest"]["backlash_deg"] for r in (plain, shifted))
    assert after - before == pytest.approx(0.01, abs=1e-5)


def test_a_span_beyond_any_memory_is_refused(vttig, run_folder):
    code, _, err = vttig("map", run_folder, "--span-rev", "1e9")
    assert code == 2 and "rows" in err


def test_one_flank_needs_the_constant_backlash(vttig, vttig_json, one_flank_folder):
    code, _, err = vttig("map", one_flank_folder)
    assert code == 4
    assert "--constant-backlash-deg" in err
    code, record = vttig_json("map", one_flank_folder, "--constant-backlash-deg", "0.038")
    assert code == 0
    assert record["conditional_on"] == ["perfect_encoders"]


def test_one_flank_is_said_before_anything_is_read(vttig, tmp_path):
    (tmp_path / "fit.json").write_text('{"flanks": ["A"]}')
    assert vttig("map", tmp_path)[0] == 4
    (tmp_path / "fit.json").write_text('{"flanks": ["A", "B"]}')
    assert vttig("map", tmp_path)[0] == 2


def test_a_long_hunting_period_is_cut_and_said(vttig, run_folder):
    code, _, err = vttig("map", run_folder, "--step-deg", "0.01")
    assert code == 0
    assert "200000 rows" in err
    assert "--span-rev 16" in err


def test_bad_calls_end_in_one_sentence(vttig, run_folder, monkeypatch):
    for arguments, code, words in (
        (["map", "nothing"], 2, "vttig fit LOG"),
        (["map", "run", "--step-deg", "0"], 2, "--step-deg"),
        (["map", "run", "--step-deg", "1e9"], 2, "--step-deg"),
        (["map", "run", "--step-deg", "nan"], 2, "not a finite number"),
        (["map", "run", "--span-rev", "inf"], 2, "not a finite number"),
        (["map", "run", "--constant-backlash-deg", "nan"], 2, "not a finite number"),
        (["map", "run", "--out", "run/fit.json"], 3, "of the run itself"),
    ):
        monkeypatch.chdir(run_folder.parent)
        found, out, err = vttig(*arguments)
        assert found == code
        assert out == ""
        assert words in err


def test_a_damaged_fit_is_refused(vttig, run_folder, tmp_path):
    for name in ("fit.json", "run.toml"):
        (tmp_path / name).write_bytes((run_folder / name).read_bytes())
    code, _, err = vttig("map", tmp_path)
    assert (code, "summary.npz" in err) == (2, True)
    (tmp_path / "summary.npz").write_bytes((run_folder / "summary.npz").read_bytes()[:1000])
    code, _, err = vttig("map", tmp_path)
    assert code == 3
    assert "damaged" in err

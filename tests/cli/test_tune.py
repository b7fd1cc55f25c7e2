from pathlib import Path

import pytest

from tests.cli.commands import write_sweep
from vttig_jax.control.scenario.spec import load_sweep_spec

SWEEP = """
pair = "pair.toml"
plant = "play"
controller = "predictive"
[eccentricities]
{rig}
[map]
constant_backlash_deg = 0.0383
[motion]
dwell_s = 0.1
ramp_s = 0.2
[sweep]
"motion.reversal_deg" = {{ from = 200, to = 360, num = 4 }}
"""
MARGIN = "judgement.margin_mm"


@pytest.fixture
def sweep(tmp_path) -> Path:
    return write_sweep(tmp_path, SWEEP)


@pytest.mark.portable
def test_it_tunes_and_writes_a_sweep_that_runs(vttig, found, sweep):
    out = sweep.parent / "tuned.toml"
    record = found("tune", sweep, "--free", MARGIN, "--out", out, "-q")
    assert record["improved"] and record["notes"] == []
    # The map has 0.0003° more than there is: 0.0040 mm.
    value = record["values"][MARGIN]["after"]
    assert value == pytest.approx(0.0040, abs=1.5e-3)
    assert record["after"]["cost_deg"] < record["before"]["cost_deg"]
    spec = load_sweep_spec(out)
    assert spec.judgement.margin_mm == value and spec.sweep == load_sweep_spec(sweep).sweep
    mean = found("sweep", out, "-q")["groups"][0]["residual_gap_deg"]["mean"]
    assert mean == pytest.approx(record["after"]["gap_mean_deg"], rel=1e-9)
    assert vttig("tune", sweep, "--free", MARGIN, "--out", out)[0] == 2


@pytest.mark.slow
def test_limits_weight_and_objective_reach_the_search(vttig, found, sweep):
    before = set(sweep.parent.iterdir())
    code, text, err = vttig("tune", sweep, "--free", f"{MARGIN}=0.006:0.02")
    assert (code, err) == (0, "") and set(sweep.parent.iterdir()) == before
    assert "confirmed by the full simulation" in text and "0.006" in text
    assert "ends at its limit" in text
    options = ("--interference-weight", "0", "--objective", "worst")
    record = found("tune", sweep, "--free", MARGIN, *options, "-q")
    assert record["objective"] == "worst" and record["interference_weight"] == 0
    assert record["values"][MARGIN]["after"] < 0.004  # what interferes costs nothing


def test_bad_calls_and_files_are_one_sentence(refused, sweep, monkeypatch):
    monkeypatch.chdir(sweep.parent)
    for options, words in (
        ("--free judgement.margn_mm", "did you mean"),
        ("--free judgement.observer", "is none of"),
        ("--free judgement.threshold_rad_s2", "none of predictive"),
        (f"--free {MARGIN}=1", "key=low:high"),
        (f"--free {MARGIN}=1:0", "must be a range around its value 0.01"),
        (f"--free {MARGIN}=nan:1", "must be a range around its value 0.01"),
        ("--interference-weight -1", "interference-weight"),
        ("--objective best", "objective"),
        ("--overwrite", "--overwrite without --out"),
        ("--out tuned.txt", "ends with .toml"),
        ("--out elsewhere/tuned.toml", "relative to its folder"),
        ("--out sweep.toml", "already exists"),
    ):
        refused(2, words, "tune", sweep, *options.split())
    text = sweep.read_text()
    for old, new, words in (
        ('"predictive"', '"none"', "nothing to tune"),
        ('"motion.reversal_deg" = { from = 200, to = 360, num = 4 }', "", "names no axis"),
        ('"motion.reversal_deg"', '"motion.reversl_deg"', "no key of a scenario"),
        ("from = 200, to = 360, num = 4", "from = 20, to = 30, num = 4", "lies inside the ramps"),
        ("pair.toml", "other.toml", "there is no file"),
    ):
        sweep.write_text(text.replace(old, new))
        refused(3, words, "tune", sweep)

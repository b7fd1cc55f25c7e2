"""A fit from one command without a pair file, and what `inspect` says to copy."""

import re
import shlex

import numpy as np
import pytest

from tests.logs.rig_log import GAP_DEG, angles_deg, csv
from vttig_jax.logs import read_log

T, X, Y = angles_deg(turns=10)  # on fewer turns, a fit searches for the orders that enter
COUNTS = 90000


@pytest.fixture
def log(tmp_path):
    """A log with German names, and one in counts without names."""
    path = tmp_path / "log.csv"
    path.write_text(csv("Zeit [s],Motorwinkel [°],Abtriebswinkel [°]", T, X, Y))
    counts = [np.rint(one / 360 * COUNTS).astype(int) for one in (Y, X)]
    (tmp_path / "counts.csv").write_text(csv("t,e1,e2", T, *counts))
    return path


def test_the_gap_in_one_command(vttig_json, log):
    code, found = vttig_json("fit", log, "--ratio", "16:9", "--delay", "off")
    assert code == 0
    gap = found["parameters"]["constant_backlash_deg"]
    assert gap["value"] == pytest.approx(GAP_DEG, abs=1e-4)
    teeth = vttig_json("fit", log, "--teeth", "45/80", "--delay", "off")[1]
    assert teeth["parameters"] == found["parameters"]


def test_what_was_guessed_and_the_ratio_in_words(vttig, log):
    code, out, err = vttig("fit", log, "--ratio", "16:9", "--delay", "off")
    assert code == 0
    assert "the driving shaft turns 16 times while the driven shaft turns 9 times" in out
    for role in ("time", "driving", "driven"):
        assert f"--column {role}=NAME changes it" in err
    assert vttig("fit", log, "--ratio", "16:9", "--delay", "off", "-q")[2] == ""


def test_counts_without_names(vttig_json, log):
    path = log.parent / "counts.csv"
    stated = ["--ratio", "16:9", "--counts", f"{COUNTS},{COUNTS}", "--delay", "off"]
    gap = vttig_json("fit", path, *stated)[1]["parameters"]["constant_backlash_deg"]
    assert gap["value"] == pytest.approx(GAP_DEG, abs=5e-4)
    spec = read_log(path, ratio="16:9", counts=COUNTS).spec
    assert spec is not None and (spec.log.driving, spec.log.driven) == ("e2", "e1")


def test_inspect_prints_a_command_that_gives_the_same_fit(vttig_json, log):
    first = vttig_json("fit", log, "--ratio", "16:9", "--delay", "off")[1]
    for stated in (["--ratio", "16:9"], []):
        command = vttig_json("inspect", log, *stated)[1]["fit_command"]
        assert command.startswith("vttig fit ") and "--ratio 16:9" in command
        again = vttig_json(*shlex.split(command)[1:], "--delay", "off")[1]
        assert again["parameters"] == first["parameters"]


def test_the_written_pair_file_says_the_same(vttig, vttig_json, log, tmp_path):
    path = tmp_path / "counts.csv"
    pair = tmp_path / "pair.toml"
    stated = ["--ratio", "16:9", "--counts", f"{COUNTS},{COUNTS}", "--write-pair", pair]
    first = vttig_json("fit", path, *stated, "--delay", "off")[1]
    second = vttig_json("fit", path, "--pair", pair, "--delay", "off")[1]
    assert first["parameters"] == second["parameters"]
    assert "_scale" not in pair.read_text()  # keys at their default are left out
    code, _, err = vttig("inspect", path, *stated)
    assert code == 2 and "this file exists" in err
    assert vttig("inspect", path, "--write-pair", tmp_path / "new.toml")[0] == 2


def test_explain_columns_fits_nothing(vttig, vttig_json, log, monkeypatch):
    from vttig_jax.cli.verbs import fit

    monkeypatch.setattr(fit, "perform", None)
    code, out, _ = vttig("fit", log, "--ratio", "16:9", "--explain-columns")
    assert code == 0 and "Motorwinkel [°]" in out
    assert "--column driving=NAME changes it" in " ".join(out.split())
    found = vttig_json("fit", log, "--ratio", "16:9", "--explain-columns")[1]
    assert [one["role"] for one in found["columns"]] == ["time", "driving", "driven"]
    assert vttig_json("inspect", log, "--ratio", "16:9", "--explain-columns")[1] == found


def test_a_run_folder_repeats_without_the_options(vttig_json, log, tmp_path):
    out = tmp_path / "run"
    first = ["fit", log, "--ratio", "16:9", "--delay", "off", "--out", out, "--no-figures"]
    assert vttig_json(*first)[1] == vttig_json("fit", "--run", out)[1]


def test_an_inverted_encoder(vttig, vttig_json, log):
    log.write_text(csv("Zeit [s],Motorwinkel [°],Abtriebswinkel [°]", T, X, -Y))
    code, _, err = vttig("fit", log, "--ratio", "16:9", "--delay", "off")
    assert code == 3 and "--invert driven" in err and "driving if" in err
    code, _, err = vttig("fit", log, "--ratio", "16:9", "--driving-scale", "-1")
    assert code == 2 and "invert" in err
    stated = ["fit", log, "--ratio", "16:9", "--delay", "off", "--invert", "driven"]
    gap = vttig_json(*stated)[1]["parameters"]["constant_backlash_deg"]
    assert gap["value"] == pytest.approx(GAP_DEG, abs=1e-4)


@pytest.mark.parametrize("stated", [(), ("--ratio", "16:9")])
def test_inspect_prints_the_command_for_an_inverted_encoder(vttig, log, stated):
    log.write_text(csv("Zeit [s],Motorwinkel [°],Abtriebswinkel [°]", T, X, -Y))
    command = vttig("inspect", log, *stated)[1].splitlines()[-1]
    assert "--ratio 16:9 --invert driven" in command
    code, out, _ = vttig("inspect", *shlex.split(command)[2:])
    (seen,) = re.findall(r"^ratio +(\S+) ", out, re.MULTILINE)
    assert code == 0 and float(seen) == pytest.approx(0.5625, abs=1e-5)


def test_inspect_prints_no_command_that_a_fit_refuses(vttig, log):
    told = " ".join(vttig("inspect", log, "--ratio", "9:16")[1].split())
    assert "the inverse" in told and "to fit it" not in told


def test_a_clock_turns_the_driving_shaft(vttig_json, tmp_path):
    time = np.arange(4000) * 2.0
    error = 5.0 * np.sin(2 * np.pi * time / 479 + 0.3)
    path = tmp_path / "guide.csv"
    path.write_text(csv("time_s,transmission_error_arcsec", time, error))
    code, found = vttig_json("fit", path, "--ratio", "180:1", "--driving-rpm", "60/479")
    amplitude = found["parameters"]["driving_amplitude_arcsec"]
    assert code in (0, 4) and amplitude["value"] == pytest.approx(5.0, rel=1e-3)
    other = vttig_json("fit", path, "--ratio", "180:1", "--driving-rpm", "60/450")[1]
    seen = other.get("parameters", {}).get("driving_amplitude_arcsec", {}).get("value")
    assert seen is None or abs(seen - 5.0) > 1


def test_increments_are_summed(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(csv("time_s,driving_deg,driven_deg", T, np.diff(X, prepend=0.0), Y))
    from vttig_jax.pair import parse_pair_spec

    table = {"drive": {"ratio": "16:9"}, "log": {"driving_increments": True}}
    log = read_log(path, parse_pair_spec(table))
    np.testing.assert_allclose(np.degrees(log.driving_angle), X - X[0], atol=1e-3)


def test_a_pair_file_and_statements_exclude_each_other(vttig, log, tmp_path):
    pair = tmp_path / "pair.toml"
    pair.write_text('[drive]\nratio = "16:9"\n')
    code, _, err = vttig("fit", log, "--pair", pair, "--ratio", "16:9")
    assert code == 2 and "leave out --pair" in err
    assert vttig("fit", "--run", tmp_path, "--ratio", "16:9")[0] == 2


def test_logs_that_are_read_in_different_ways(vttig, log, tmp_path):
    other = tmp_path / "other.csv"
    other.write_text(csv("time_s,motor_deg,load_deg", T, X, Y))
    code, _, err = vttig("fit", log, other, "--ratio", "16:9")
    assert code == 3 and "other.csv" in err and "--column" in err


def test_control_codes_of_a_file_do_not_reach_the_terminal(vttig, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(csv("time_s,motor\x1b[31m_deg,load_deg", T, X, Y))
    _, out, err = vttig("inspect", path)
    assert "\x1b" not in out + err and "motor" in out


def test_the_same_from_python(vttig_json, log):
    import vttig_jax

    vttig_jax.enable_x64()
    read = vttig_jax.read_log(log, ratio="16:9")
    found = vttig_jax.fit(read, delay="off").to_json()
    assert (
        found["parameters"]
        == vttig_json("fit", log, "--ratio", "16:9", "--delay", "off")[1]["parameters"]
    )
    drive = vttig_jax.Drive(read.ratio)
    again = read_log(log, drive, columns={"time": "Zeit", "driving": "#2", "driven": "#3"})
    with pytest.raises(ValueError, match="`pair` must be given"):
        vttig_jax.fit(again)

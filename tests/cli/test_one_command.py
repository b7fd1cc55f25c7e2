"""A drive that is stated by options in place of a pair file, in the verbs that take one."""

import re
import shlex
import tomllib
from csv import DictReader

import numpy as np
import pytest

import vttig_jax
from tests.logs.rig_log import GAP_DEG, angles_deg, csv
from vttig_jax.cli.verbs import fit
from vttig_jax.cli.verbs.demo import log_csv
from vttig_jax.logs import read_log
from vttig_jax.pair import parse_pair_spec
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig

T, X, Y = angles_deg(turns=10)  # on fewer turns, a fit searches for the orders that enter
COUNTS = 90000
HEAD = "Zeit [s],Motorwinkel [°],Abtriebswinkel [°]"
RATIO, OFF = ("--ratio", "16:9"), ("--delay", "off")


@pytest.fixture
def log(tmp_path):
    """A log with German names."""
    path = tmp_path / "log.csv"
    path.write_text(csv(HEAD, T, X, Y))
    return path


@pytest.fixture
def counts(tmp_path) -> tuple:
    """A log in counts without names, the driven shaft first, and what states it."""
    path = tmp_path / "counts.csv"
    columns = [np.rint(one / 360 * COUNTS).astype(int) for one in (Y, X)]
    path.write_text(csv("t,e1,e2", T, *columns))
    return path, *RATIO, "--counts", f"{COUNTS},{COUNTS}"


@pytest.fixture
def parameters(found):
    """Function that returns the parameters of a fit without a delay."""
    return lambda *arguments: found("fit", *arguments, *OFF)["parameters"]


def gap(parameters: dict, near: float = 1e-4) -> bool:
    return parameters["constant_backlash_deg"]["value"] == pytest.approx(GAP_DEG, abs=near)


def test_the_gap_in_one_command(parameters, vttig, found, log, tmp_path):
    fitted = parameters(log, *RATIO)
    assert gap(fitted)
    assert parameters(log, "--teeth", "45/80") == fitted
    read = vttig_jax.read_log(log, ratio="16:9")
    assert vttig_jax.fit(read, delay="off").to_json()["parameters"] == fitted
    for stated in (RATIO, ()):  # `inspect` prints a command that gives the same fit
        command = found("inspect", log, *stated)["fit_command"]
        assert command.startswith("vttig fit ") and "--ratio 16:9" in command
        assert parameters(*shlex.split(command)[2:]) == fitted
    code, out, err = vttig("fit", log, *RATIO, *OFF)
    assert code == 0
    assert "the driving shaft turns 16 times while the driven shaft turns 9 times" in out
    for role in ("time", "driving", "driven"):
        assert f"--column {role}=NAME changes it" in err
    assert vttig("fit", log, *RATIO, *OFF, "-q")[2] == ""
    run = ("--out", tmp_path / "run", "--no-figures")
    assert found("fit", log, *RATIO, *OFF, *run) == found("fit", "--run", tmp_path / "run")


def test_counts_without_names_and_the_written_pair_file(parameters, refused, counts, tmp_path):
    pair = tmp_path / "pair.toml"
    first = parameters(*counts, "--write-pair", pair)
    assert gap(first, 5e-4) and parameters(counts[0], "--pair", pair) == first
    assert "_scale" not in pair.read_text()  # keys at their default are left out
    refused(2, "this file exists", "inspect", *counts, "--write-pair", pair, "-q")
    refused(2, "ratio", "inspect", counts[0], "--write-pair", tmp_path / "new.toml")
    spec = read_log(counts[0], ratio="16:9", counts=COUNTS).spec
    assert spec is not None and (spec.log.driving, spec.log.driven) == ("e2", "e1")


def test_explain_columns_fits_nothing(told, found, log, monkeypatch):
    monkeypatch.setattr(fit, "perform", None)
    call = (log, *RATIO, "--explain-columns")
    out = " ".join(told("fit", *call).split())
    assert "Motorwinkel [°]" in out and "--column driving=NAME changes it" in out
    record = found("fit", *call)
    assert [one["role"] for one in record["columns"]] == ["time", "driving", "driven"]
    assert found("inspect", *call) == record


def test_an_inverted_encoder(refused, told, parameters, log):
    log.write_text(csv(HEAD, T, X, -Y))
    assert "driving if" in refused(3, "--invert driven", "fit", log, *RATIO, *OFF, "-q")
    refused(2, "invert", "fit", log, *RATIO, "--driving-scale", "-1")
    assert gap(parameters(log, *RATIO, "--invert", "driven"))
    for stated in ((), RATIO):
        command = told("inspect", log, *stated).splitlines()[-1]
        assert "--ratio 16:9 --invert driven" in command
        out = told("inspect", *shlex.split(command)[2:])
        (seen,) = re.findall(r"^ratio +(\S+) ", out, re.MULTILINE)
        assert float(seen) == pytest.approx(0.5625, abs=1e-5)


def test_inspect_prints_no_command_that_a_fit_refuses(vttig, log):
    said = " ".join(vttig("inspect", log, "--ratio", "9:16")[1].split())
    assert "the inverse" in said and "to fit it" not in said


def test_a_clock_turns_the_driving_shaft(vttig_json, tmp_path):
    time = np.arange(4000) * 2.0
    error = 5.0 * np.sin(2 * np.pi * time / 479 + 0.3)
    path = tmp_path / "guide.csv"
    path.write_text(csv("time_s,transmission_error_arcsec", time, error))

    def amplitude(rpm: str) -> float | None:
        _, record = vttig_json("fit", path, "--ratio", "180:1", "--driving-rpm", rpm)
        return record.get("parameters", {}).get("driving_amplitude_arcsec", {}).get("value")

    assert amplitude("60/479") == pytest.approx(5.0, rel=1e-3)
    other = amplitude("60/450")
    assert other is None or abs(other - 5.0) > 1


def test_increments_are_summed(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(csv("time_s,driving_deg,driven_deg", T, np.diff(X, prepend=0.0), Y))
    table = {"drive": {"ratio": "16:9"}, "log": {"driving_increments": True}}
    log = read_log(path, parse_pair_spec(table))
    np.testing.assert_allclose(np.degrees(log.driving_angle), X - X[0], atol=1e-3)


def test_refusals(vttig, refused, log, tmp_path):
    pair, other = tmp_path / "pair.toml", tmp_path / "other.csv"
    pair.write_text('[drive]\nratio = "16:9"\n')
    refused(2, "leave out --pair", "fit", log, "--pair", pair, *RATIO)
    refused(2, "--ratio", "fit", "--run", tmp_path, *RATIO)
    # Logs that are read in different ways.
    other.write_text(csv("time_s,motor_deg,load_deg", T, X, Y))
    assert "other.csv" in refused(3, "--column", "fit", log, other, *RATIO)
    drive = vttig_jax.Drive(vttig_jax.read_log(log, ratio="16:9").ratio)
    again = read_log(log, drive, columns={"time": "Zeit", "driving": "#2", "driven": "#3"})
    with pytest.raises(ValueError, match="`pair` must be given"):
        vttig_jax.fit(again)
    # Control codes of a file do not reach the terminal.
    other.write_text(csv("time_s,motor\x1b[31m_deg,load_deg", T, X, Y))
    _, out, err = vttig("inspect", other)
    assert "\x1b" not in out + err and "motor" in out


# Other verbs.

PLAN = ("plan", "--turns", "21", "--rate-hz", "1987", "--noise-std-deg", "0.002")


@pytest.mark.slow  # two samplings; what `sample` reads is also in its --explain-columns
def test_draws_of_a_stated_drive_are_those_of_its_pair_file(vttig, log):
    folder, pair = log.parent, log.parent / "pair.toml"
    options = ("--steps", "40", "--no-figures", *OFF)
    stated = ("sample", log, *RATIO, "--write-pair", pair, "--out", folder / "a", *options)
    code, _, err = vttig(*stated)
    assert code == 5 and "--column driving=NAME changes it" in err
    assert vttig("sample", log, "--pair", pair, "--out", folder / "b", *options, "-q")[0] == 5
    one, two = (tomllib.loads((folder / name / "run.toml").read_text()) for name in "ab")
    assert one["pair_file"] == two["pair_file"] and one["pair_file"]["drive"]["ratio"] == "16:9"
    assert one["run"] == two["run"]


def test_a_scale_is_that_of_the_pair_file(vttig, found, told, log, tmp_path):
    """A driving column that is divided by the ratio already, as controllers log a motor."""
    pair, fit = tmp_path / "pair.toml", ("fit", log)
    log.write_text(csv(HEAD, T, 9 / 16 * X, Y))
    code, _, err = vttig(*fit, *RATIO)
    assert code in (2, 3) and err
    assert vttig(*fit, *RATIO, "--column", "driving=#2", "--column", "driven=#3")[0] == 3
    stated = (*RATIO, "--driving-scale", "16/9")
    one = found(*fit, *stated, *OFF, "--write-pair", pair)
    assert tomllib.loads(pair.read_text())["log"]["driving_scale"] == "16/9"
    assert found(*fit, "--pair", pair, *OFF) == one
    assert "--driving-scale 16/9" in told("inspect", log, *stated)
    assert vttig(*fit, "--pair", pair, "--driven-scale", "2")[0] == 2
    assert vttig(*fit, *RATIO, "--driven-scale", "two")[0] == 2


def test_an_error_curve_does_not_tell_which_way_a_number_is_meant(vttig, log):
    head = "time_s,driving_deg,transmission_error_arcsec"
    log.write_text(csv(head, T, X, 3600 * (Y - 9 / 16 * X)))
    assert vttig("fit", log, "--ratio", "0.5625")[0] == 2
    for meant in ("16:9", "9/16"):
        assert vttig("fit", log, "--ratio", meant, *OFF)[0] in (0, 4)


def test_sample_explains_columns_and_writes_nothing(told, refused, log, run_folder):
    """Also beside an older result; without a log it refuses options of one."""
    before = {path: path.stat().st_mtime_ns for path in run_folder.rglob("*")}
    for out in (log.parent / "run", run_folder):
        assert "Motorwinkel" in told("sample", log, *RATIO, "--out", out, "--explain-columns")
    assert not (log.parent / "run").exists()
    assert {path: path.stat().st_mtime_ns for path in run_folder.rglob("*")} == before
    for option in (RATIO, ("--unit", "deg"), ("--explain-columns",)):
        said = refused(2, "without LOG", "sample", "--out", run_folder, *option)
        assert option[0] in said


@pytest.mark.slow
def test_a_batch_of_a_stated_drive(refused, told, found, tmp_path):
    rig = paper_rig(0, PassMotion(speed_rpm=240.0, reversal_deg=3600.0))
    _, *rows = log_csv(rig.log(0)).splitlines()
    exchanged = [",".join(row.split(",")[k] for k in (0, 2, 1)) for row in rows]
    one, two, pair = (tmp_path / name for name in ("one.csv", "two.csv", "pair.toml"))
    for path, lines in ((one, rows), (two, exchanged)):
        path.write_text("\n".join(["t,e1,e2", *lines, ""]))
    stated, out, again = (
        (*RATIO, "--counts", "90000"),
        tmp_path / "fits.csv",
        tmp_path / "again.csv",
    )
    record = found("fit-many", one, two, *stated, "--csv", out)
    assert record["fitted"] == 1
    assert "read in another way" in record["failed"][0]["reason"]
    told("inspect", one, *stated, "--write-pair", pair)
    found("fit-many", one, "--pair", pair, "--csv", again)
    first, second = (next(DictReader(path.open())) for path in (out, again))
    assert first == second and first["code"] == "ok"
    assert "e1" in told("fit-many", one, "--explain-columns", *stated)
    refused(2, "one log", "fit-many", one, two, *stated, "--explain-columns")
    refused(2, "leave out", "fit-many", one, "--pair", pair, *RATIO)
    refused(2, "--ratio 64:23", "fit-many", one)


def test_a_batch_begins_with_the_first_log_that_is_read(vttig_json, found, log):
    broken, other = log.parent / "broken.csv", log.parent / "other.csv"
    broken.write_text("Zeit [s],Motorwinkel [°]\n0,1\n")
    other.write_text(csv("time_s,motor_deg,load_deg", T, X, Y))
    record = found("fit-many", broken, log, other, *RATIO)
    failed = {one["log"]: one["code"] for one in record["failed"]}
    assert record["fitted"] == 1 and failed == dict.fromkeys(map(str, (broken, other)), "refused")
    code, record = vttig_json("fit-many", broken, *RATIO)
    assert code == 3 and str(broken) in record["where"]


def test_a_plan_of_a_stated_drive(refused, found, tmp_path):
    path = tmp_path / "pair.toml"
    path.write_text(
        '[drive]\nratio = "16:9"\n[driving]\nencoder = { counts_per_rev = 9000 }\n'
        "[driven]\nencoder = { counts_per_rev = 9000 }\n"
    )
    counts, teeth = ("--counts", "9000"), ("--teeth", "45/80")
    stated = found(*PLAN, *RATIO, *counts)
    assert stated == found(*PLAN, "--pair", path)
    assert stated["parameters"] == found(*PLAN, *teeth, *counts)["parameters"]
    assert stated["parameters"] != found(*PLAN, *RATIO)["parameters"]
    refused(2, "leave out", *PLAN, "--pair", path, *RATIO)
    refused(2, "--ratio 64:23", *PLAN)
    refused(2, "No such option", *PLAN, *RATIO, "--unit", "deg")
    refused(2, "both state the ratio", *PLAN, *RATIO, *teeth)


def test_a_log_in_place_of_a_run_folder(refused, log):
    for verb, *more in (
        ("map",),
        ("locate", "--driving-deg", "1", "--driven-deg", "1"),
        ("export", "--out", log.parent / "x.h"),
    ):
        refused(3, "vttig fit log.csv --ratio 64:23 --out run", verb, log, *more)

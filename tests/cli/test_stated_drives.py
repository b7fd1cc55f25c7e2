"""The verbs that read logs, and `plan`, take a drive by options as `fit` does."""

import csv
import tomllib

import pytest

from tests.logs.rig_log import angles_deg
from tests.logs.rig_log import csv as table
from vttig_jax.cli.verbs.demo import log_csv
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig

T, X, Y = angles_deg()
RATIO = ("--ratio", "16:9")
PLAN = ("plan", "--turns", "21", "--rate-hz", "1987", "--noise-std-deg", "0.002")


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(table("Zeit [s],Motorwinkel [°],Abtriebswinkel [°]", T, X, Y))
    return path


@pytest.mark.slow  # two samplings; what `sample` reads is also in its --explain-columns
def test_draws_of_a_stated_drive_are_those_of_its_pair_file(vttig, log):
    folder = log.parent
    options = ("--steps", "40", "--no-figures", "--delay", "off")
    pair = folder / "pair.toml"
    code, _, err = vttig(
        "sample", log, *RATIO, "--write-pair", pair, "--out", folder / "a", *options
    )
    assert code == 5 and "--column driving=NAME changes it" in err
    assert vttig("sample", log, "--pair", pair, "--out", folder / "b", *options, "-q")[0] == 5
    one, two = (tomllib.loads((folder / name / "run.toml").read_text()) for name in "ab")
    assert one["pair_file"] == two["pair_file"] and one["pair_file"]["drive"]["ratio"] == "16:9"
    assert one["run"] == two["run"]


def test_a_scale_is_that_of_the_pair_file(vttig, vttig_json, tmp_path):
    """A driving column that is divided by the ratio already, as controllers log a motor."""
    scaled, pair = tmp_path / "scaled.csv", tmp_path / "pair.toml"
    scaled.write_text(table("Zeit [s],Motorwinkel [°],Abtriebswinkel [°]", T, 9 / 16 * X, Y))
    code, _, err = vttig("fit", scaled, *RATIO)
    assert code in (2, 3) and err
    named = ("--column", "driving=#2", "--column", "driven=#3")
    assert vttig("fit", scaled, *RATIO, *named)[0] == 3
    stated = (*RATIO, "--driving-scale", "16/9", "--delay", "off")
    code, one = vttig_json("fit", scaled, *stated, "--write-pair", pair)
    assert code == 0 and tomllib.loads(pair.read_text())["log"]["driving_scale"] == "16/9"
    assert vttig_json("fit", scaled, "--pair", pair, "--delay", "off") == (0, one)
    assert "--driving-scale 16/9" in vttig("inspect", scaled, *stated[:4])[1]
    assert vttig("fit", scaled, "--pair", pair, "--driven-scale", "2")[0] == 2
    assert vttig("fit", scaled, *RATIO, "--driven-scale", "two")[0] == 2


def test_an_error_curve_does_not_tell_which_way_a_number_is_meant(vttig, tmp_path):
    curve = tmp_path / "curve.csv"
    head = "time_s,driving_deg,transmission_error_arcsec"
    curve.write_text(table(head, T, X, 3600 * (Y - 9 / 16 * X)))
    assert vttig("fit", curve, "--ratio", "0.5625")[0] == 2
    for meant in ("16:9", "9/16"):
        assert vttig("fit", curve, "--ratio", meant, "--delay", "off")[0] in (0, 4)


def test_sample_explains_columns_and_writes_nothing(vttig, log):
    code, out, _ = vttig("sample", log, *RATIO, "--out", log.parent / "run", "--explain-columns")
    assert code == 0 and "Motorwinkel" in out and not (log.parent / "run").exists()


def test_sample_explains_columns_beside_an_older_result(vttig, log, run_folder):
    before = {path: path.stat().st_mtime_ns for path in run_folder.rglob("*")}
    code, out, _ = vttig("sample", log, *RATIO, "--out", run_folder, "--explain-columns")
    assert code == 0 and "Motorwinkel" in out
    assert {path: path.stat().st_mtime_ns for path in run_folder.rglob("*")} == before


@pytest.mark.parametrize("option", [RATIO, ("--unit", "deg"), ("--explain-columns",)])
def test_sample_without_a_log_refuses_them(vttig, run_folder, option):
    code, _, err = vttig("sample", "--out", run_folder, *option)
    assert code == 2 and option[0] in err and "without LOG" in err


@pytest.mark.slow
def test_a_batch_of_a_stated_drive(vttig, vttig_json, log):
    folder = log.parent
    rig = paper_rig(0, PassMotion(speed_rpm=240.0, reversal_deg=3600.0))
    _, *rows = log_csv(rig.log(0)).splitlines()
    exchanged = [",".join(row.split(",")[k] for k in (0, 2, 1)) for row in rows]
    for name, lines in (("one.csv", rows), ("two.csv", exchanged)):
        (folder / name).write_text("\n".join(["t,e1,e2", *lines, ""]))
    stated = (*RATIO, "--counts", "90000")
    logs, out = [folder / "one.csv", folder / "two.csv"], folder / "fits.csv"
    code, record = vttig_json("fit-many", *logs, *stated, "--csv", out)
    assert code == 0 and record["fitted"] == 1
    assert "read in another way" in record["failed"][0]["reason"]
    pair = folder / "pair.toml"
    assert vttig("inspect", logs[0], *stated, "--write-pair", pair)[0] == 0
    again = folder / "again.csv"
    assert vttig_json("fit-many", logs[0], "--pair", pair, "--csv", again)[0] == 0
    first, second = (next(csv.DictReader(path.open())) for path in (out, again))
    assert first == second and first["code"] == "ok"
    assert vttig("fit-many", logs[0], "--explain-columns", *stated)[1].count("e1") > 0
    code, _, err = vttig("fit-many", *logs, *stated, "--explain-columns")
    assert code == 2 and "one log" in err
    assert vttig("fit-many", logs[0], "--pair", pair, *RATIO)[0] == 2
    code, _, err = vttig("fit-many", logs[0])
    assert code == 2 and "--ratio 64:23" in err


def test_a_batch_begins_with_the_first_log_that_is_read(vttig_json, log):
    broken = log.parent / "broken.csv"
    broken.write_text("Zeit [s],Motorwinkel [°]\n0,1\n")
    code, record = vttig_json("fit-many", broken, log, *RATIO)
    failed = {one["log"]: one["code"] for one in record["failed"]}
    assert code == 0 and record["fitted"] == 1 and failed == {str(broken): "refused"}
    code, record = vttig_json("fit-many", broken, *RATIO)
    assert code == 3 and str(broken) in record["where"]


def test_a_plan_of_a_stated_drive(vttig, vttig_json, tmp_path):
    path = tmp_path / "pair.toml"
    path.write_text(
        '[drive]\nratio = "16:9"\n[driving]\nencoder = { counts_per_rev = 9000 }\n'
        "[driven]\nencoder = { counts_per_rev = 9000 }\n"
    )
    code, stated = vttig_json(*PLAN, *RATIO, "--counts", "9000")
    assert code == 0 and stated == vttig_json(*PLAN, "--pair", path)[1]
    assert (
        stated["parameters"]
        == vttig_json(*PLAN, "--teeth", "45/80", "--counts", "9000")[1]["parameters"]
    )
    assert stated["parameters"] != vttig_json(*PLAN, *RATIO)[1]["parameters"]
    for refused, words in (
        (("--pair", path, *RATIO), "leave out"),
        ((), "--ratio 64:23"),
        ((*RATIO, "--unit", "deg"), "No such option"),
        ((*RATIO, "--teeth", "45/80"), "both state the ratio"),
    ):
        code, _, err = vttig(*PLAN, *refused)
        assert code == 2 and words in err and err.count("\n") == 1


@pytest.mark.parametrize("verb", ["map", "locate", "export"])
def test_a_log_in_place_of_a_run_folder(vttig, log, verb):
    readings = {
        "locate": ("--driving-deg", "1", "--driven-deg", "1"),
        "export": ("--out", log.parent / "x.h"),
    }
    code, _, err = vttig(verb, log, *readings.get(verb, ()))
    assert code == 3 and "vttig fit log.csv --ratio 64:23 --out run" in err

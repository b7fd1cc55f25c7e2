import shutil
import tomllib

import numpy as np
import pytest

from tests.cli.commands import fit_into


@pytest.fixture
def call(rig_folder) -> tuple:
    return ("fit", rig_folder / "log.csv", "--pair", rig_folder / "pair.toml")


@pytest.mark.portable
def test_prints_parameters_with_errors_and_writes_nothing(
    vttig, found, call, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    code, out, err = vttig(*call)
    assert (code, err) == (0, "") and list(tmp_path.iterdir()) == []
    names = ("driving_eccentricity_mm", "constant_backlash_deg", "delay_s")
    assert all(name in out for name in names)
    record = found(*call)
    assert (record["schema"], record["outcome"]) == ("vttig.fit/1", "ok")
    assert record["flanks"] == ["A", "B"]
    samples = record["samples"]
    assert samples["used"] == samples["forward"] + samples["backward"]
    assert samples["read"] == samples["used"] + samples["masked"]
    for name, true in (("driving_eccentricity_mm", 0.0226), ("constant_backlash_deg", 0.038)):
        one = record["parameters"][name]
        assert abs(one["value"] - true) < 4 * one["std"]
        assert one["low95"] < one["value"] < one["high95"]


def test_run_folder_holds_what_the_next_steps_need(rig_folder, run_folder):
    assert {p.name for p in run_folder.iterdir()} == {"fit.json", "summary.npz", "run.toml"}
    run = tomllib.loads((run_folder / "run.toml").read_text())
    assert run["schema"] == "vttig.run/1"
    (log,) = run["data"]["logs"]  # relative to the folder
    assert log.startswith("..") and (run_folder / log).resolve() == rig_folder / "log.csv"
    assert [len(digest) for digest in run["data"]["sha256"]] == [64]
    assert run["pair_file"]["driving"]["teeth"] == 45
    assert {"vttig-jax", "jax", "scipy"} <= set(run["versions"])
    with np.load(run_folder / "summary.npz", allow_pickle=False) as arrays:
        assert arrays["covariance"].shape == (len(arrays["names"]),) * 2


def test_figures_are_written_unless_left_out(told, call, tmp_path):
    out, figures = tmp_path / "run", tmp_path / "run" / "figures"
    told(*call, "--out", out)
    pictures = {p.name for p in figures.iterdir()}
    assert pictures >= {"backlash_map.png", "orders.png", "te_fit.png"}
    told(*call, "--out", out, "--overwrite", "--no-figures")
    assert list(figures.iterdir()) == []  # those of the older fit


@pytest.mark.portable
def test_an_existing_result_is_refused_and_kept(refused, vttig, told, call, run_folder, tmp_path):
    copied = shutil.copytree(run_folder, tmp_path / "run")
    options = ("--out", copied, "--no-figures", "--flank", "A")
    before = (copied / "fit.json").read_bytes()
    refused(2, "--overwrite", *call, *options)
    assert (copied / "fit.json").read_bytes() == before
    told("map", copied, "--out", copied / "map.csv")
    told(*call, *options, "--overwrite")
    assert not (copied / "map.csv").exists()
    assert (copied / "fit.json").read_bytes() != before
    # It is refused before anything is read.
    missing = ("fit", tmp_path / "no.csv", "--ratio", "1:2")
    assert vttig(*missing, "--out", copied)[0] == 2
    assert vttig(*missing, "--out", tmp_path / "new")[0] == 3


def test_a_result_may_stand_beside_other_files_and_replaces_none(refused, rig_folder, tmp_path):
    folder = shutil.copytree(rig_folder, tmp_path / "thesis")
    log, pair, picture = folder / "log.csv", folder / "pair.toml", folder / "figures/te_fit.png"
    picture.parent.mkdir()
    picture.write_text("mine")
    refused(2, "te_fit.png: already exists", "fit", log, "--pair", pair, "--out", folder)
    assert picture.read_text() == "mine" and not (folder / "fit.json").exists()
    picture.rename(folder / "thesis.png")
    before = {path: path.read_bytes() for path in folder.glob("*.*")}
    fit_into(folder, log, pair)
    assert (folder / "fit.json").exists()
    assert {path: path.read_bytes() for path in before} == before


def test_require_fails_only_for_what_is_undetermined(vttig, told, refused, call):
    arguments = (*call, "--require", "constant_backlash_deg")
    told(*arguments)
    code, out, err = vttig(*arguments, "--flank", "A")
    assert code == 4 and "driving_eccentricity_mm" in out
    assert "constant_backlash_deg is required but undetermined: one direction" in err
    refused(2, "there are driving_eccentricity_mm", *call, "--require", "backlash")


def test_bad_calls_end_in_one_sentence(refused, rig_folder, monkeypatch):
    monkeypatch.chdir(rig_folder)
    for arguments, code, words in (
        ("", 2, "LOG is missing"),
        ("log.csv", 2, "the ratio of the drive is missing"),
        ("absent.csv --pair pair.toml", 3, "absent.csv"),
        ("log.csv --pair absent.toml", 3, "absent.toml: no such file"),
        ("log.csv --pair pair.toml --column driving", 2, "ROLE=NAME"),
        ("log.csv --pair pair.toml --flank C", 2, "--flank"),
        ("log.csv --run run", 2, "--run repeats a run as it was"),
        ("--run nothing", 2, "no such run"),
        (". --pair pair.toml", 3, "folder"),
    ):
        refused(code, words, "fit", *arguments.split())


@pytest.mark.portable
def test_bad_logs_write_nothing(vttig, refused, call, rig_folder, tmp_path):
    head, *rows = (rig_folder / "log.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    log = tmp_path / "damaged.csv"
    bad = ("fit", log, *call[2:], "--out", tmp_path / "o")
    for words, lines in (
        ("header", []),
        ("line 51", [*rows[:49], rows[49].replace(",", ",x", 1), *rows[50:]]),
        ("ratio", [f"{t},{d},{d}" for t, d, _ in cells]),
        ("swapped", [f"{t},{b},{a}" for t, a, b in cells]),
    ):
        log.write_text("\n".join([head, *lines, ""]))
        refused(3, words, *bad)
        assert not (tmp_path / "o").exists()
    # A log that tells nothing is printed, and is no answer.
    log.write_text("\n".join([head, *rows[:400], ""]))
    code, out, err = vttig(*bad)
    assert code == 4 and "not determined" in out and "determines no parameter" in err

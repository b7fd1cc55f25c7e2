import json
import shutil
import tomllib

import numpy as np
import pytest


def fit_arguments(folder, *more):
    return ["fit", folder / "log.csv", "--pair", folder / "pair.toml", *more]


def test_prints_parameters_with_errors_and_writes_nothing(vttig, rig_folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = vttig(*fit_arguments(rig_folder))
    assert code == 0
    assert "driving_eccentricity_mm" in out
    assert "constant_backlash_deg" in out
    assert "delay_s" in out
    assert err == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.portable
def test_json_is_one_valid_object(vttig_json, rig_folder):
    code, record = vttig_json(*fit_arguments(rig_folder))
    assert code == 0
    assert record["schema"] == "vttig.fit/1"
    assert record["outcome"] == "ok"
    assert record["flanks"] == ["A", "B"]
    samples = record["samples"]
    assert samples["used"] == samples["forward"] + samples["backward"]
    assert samples["read"] == samples["used"] + samples["masked"]
    truth = {"driving_eccentricity_mm": 0.0226, "constant_backlash_deg": 0.038}
    for name, true in truth.items():
        found = record["parameters"][name]
        assert abs(found["value"] - true) < 4 * found["std"]
        assert found["low95"] < found["value"] < found["high95"]


def test_perfect_encoders_are_a_condition(vttig_json, rig_folder, run_folder):
    code, record = vttig_json(*fit_arguments(rig_folder), "--perfect-encoders")
    assert code == 0 and record["flanks"] == ["A", "B"]
    assert record["conditional_on"] == ["perfect_encoders"]
    assert json.loads((run_folder / "fit.json").read_text())["conditional_on"] == []


def test_column_decimal_and_sample_rate_reach_the_reader(
    vttig_json, rig_folder, run_folder, tmp_path
):
    lines = (rig_folder / "log.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    renamed = tmp_path / "renamed.csv"
    body = [f"{float(a) / 90000:.9f};{float(b) / 90000:.9f}".replace(".", ",") for _, a, b in rows]
    renamed.write_text("\n".join(["motor_rev;table_rev", *body]))
    names = ["--column", "driving=motor_rev", "--column", "driven=table_rev"]
    pair = ["--pair", rig_folder / "pair.toml", "--decimal", ",", "--sample-rate", "1987"]
    plain = json.loads((run_folder / "fit.json").read_text())
    code, record = vttig_json("fit", renamed, *pair, *names)
    assert code == 0
    for name in ("driving_eccentricity_mm", "constant_backlash_deg"):
        first, second = (r["parameters"][name]["value"] for r in (plain, record))
        assert second == pytest.approx(first, rel=1e-3)
    code, known = vttig_json("fit", renamed, *pair)  # the names say which shafts they are of
    assert (code, known["parameters"]) == (0, record["parameters"])


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


def test_figures_are_written_unless_left_out(vttig, rig_folder, tmp_path):
    code, *_ = vttig(*fit_arguments(rig_folder), "--out", tmp_path / "run")
    assert code == 0
    pictures = {p.name for p in (tmp_path / "run" / "figures").iterdir()}
    assert pictures >= {"backlash_map.png", "orders.png", "te_fit.png"}
    again = fit_arguments(rig_folder, "--out", tmp_path / "run", "--overwrite", "--no-figures")
    assert vttig(*again)[0] == 0
    assert list((tmp_path / "run" / "figures").iterdir()) == []  # those of the older fit


@pytest.mark.portable
def test_run_toml_repeats_the_run_bit_for_bit(vttig_json, run_folder):
    code, record = vttig_json("fit", "--run", run_folder / "run.toml")
    assert code == 0
    before = json.loads((run_folder / "fit.json").read_text())
    assert record["parameters"] == before["parameters"]
    assert record["orders"] == before["orders"]


def test_a_changed_log_is_not_repeated(vttig, rig_folder, run_folder, tmp_path):
    run = shutil.copytree(run_folder, tmp_path / run_folder.relative_to(run_folder.parents[1]))
    shutil.copytree(rig_folder, tmp_path / rig_folder.name)  # as the run names it
    with (tmp_path / rig_folder.name / "log.csv").open("a") as log:
        log.write("99,1,1\n")
    code, _, err = vttig("fit", "--run", run)
    assert code == 3
    assert "has changed since the run" in err


def test_an_existing_result_is_refused_and_kept(
    vttig, vttig_json, rig_folder, run_folder, tmp_path
):
    out = shutil.copytree(run_folder, tmp_path / "run")
    options = ["--out", out, "--no-figures"]
    before = (out / "fit.json").read_bytes()
    code, record = vttig_json(*fit_arguments(rig_folder), *options, "--flank", "A")
    assert code == 2
    assert record["schema"] == "vttig.error/1"
    assert "--overwrite" in record["message"]
    assert (out / "fit.json").read_bytes() == before
    assert vttig("map", out, "--out", out / "map.csv")[0] == 0
    code, *_ = vttig(*fit_arguments(rig_folder), *options, "--flank", "A", "--overwrite")
    assert code == 0
    assert not (out / "map.csv").exists()
    assert (out / "fit.json").read_bytes() != before


@pytest.mark.portable
def test_an_existing_result_is_refused_before_anything_is_read(vttig, run_folder, tmp_path):
    missing = ("fit", tmp_path / "no.csv", "--ratio", "1:2")
    assert vttig(*missing, "--out", run_folder)[0] == 2
    assert vttig(*missing, "--out", tmp_path / "run")[0] == 3


def test_require_fails_only_for_what_is_undetermined(vttig, rig_folder):
    arguments = fit_arguments(rig_folder, "--require", "constant_backlash_deg")
    assert vttig(*arguments)[0] == 0
    code, out, err = vttig(*arguments, "--flank", "A")
    assert code == 4
    assert "driving_eccentricity_mm" in out
    assert "constant_backlash_deg is required but undetermined: one direction" in err
    code, _, err = vttig(*fit_arguments(rig_folder), "--require", "backlash")
    assert code == 2
    assert "there are driving_eccentricity_mm" in err


def test_bad_calls_end_in_one_sentence(vttig, vttig_json, rig_folder, monkeypatch):
    for arguments, code, words in (
        (["fit"], 2, "LOG is missing"),
        (["fit", "log.csv"], 2, "the ratio of the drive is missing"),
        (["fit", "absent.csv", "--pair", "pair.toml"], 3, "absent.csv"),
        (["fit", "log.csv", "--pair", "absent.toml"], 3, "absent.toml: no such file"),
        (["fit", "log.csv", "--pair", "pair.toml", "--column", "driving"], 2, "ROLE=NAME"),
        (["fit", "log.csv", "--pair", "pair.toml", "--flank", "C"], 2, "--flank"),
        (["fit", "log.csv", "--run", "run"], 2, "--run repeats a run as it was"),
        (["fit", "--run", "nothing"], 2, "no such run"),
        (["fit", ".", "--pair", "pair.toml"], 3, "folder"),
    ):
        monkeypatch.chdir(rig_folder)
        found, out, err = vttig(*arguments)
        assert found == code
        assert out == ""
        assert words in err
        assert err.count("\n") == 1
        assert "Traceback" not in err
        found, record = vttig_json(*arguments)
        assert (found, record["exit"]) == (code, code)


@pytest.mark.portable
def test_bad_logs_end_in_one_sentence(vttig, rig_folder, tmp_path):
    for damage, code, words in (
        (lambda rows: rows[:1], 3, "header"),
        (lambda rows: [row.rsplit(",", 1)[0] for row in rows], 3, "driven"),
        (lambda rows: [*rows[:50], rows[50].replace(",", ",x", 1), *rows[51:]], 3, "line 51"),
        (lambda rows: [rows[0], *(",".join((t, d, d)) for t, d, _ in split(rows))], 3, "ratio"),
        (
            lambda rows: [rows[0], *(",".join((t, d, "7")) for t, d, _ in split(rows))],
            3,
            "constant",
        ),
        (lambda rows: [rows[0], *(",".join((t, b, a)) for t, a, b in split(rows))], 3, "swapped"),
        (lambda rows: [rows[0], *reversed(rows[1:])], 3, "backwards"),
    ):
        rows = (rig_folder / "log.csv").read_text().splitlines()
        path = tmp_path / "damaged.csv"
        path.write_text("\n".join(damage(rows)) + "\n")
        found, out, err = vttig(
            "fit", path, "--pair", rig_folder / "pair.toml", "--out", tmp_path / "o"
        )
        assert found == code, err
        assert out == ""
        assert words in err
        assert err.count("\n") == 1
        assert not (tmp_path / "o").exists()


def test_a_log_that_tells_nothing_is_printed_and_no_answer(vttig, rig_folder, tmp_path):
    rows = (rig_folder / "log.csv").read_text().splitlines()
    path = tmp_path / "short.csv"
    path.write_text("\n".join(rows[:400]) + "\n")
    code, out, err = vttig("fit", path, "--pair", rig_folder / "pair.toml")
    assert code == 4 and "not determined" in out and "determines no parameter" in err


def split(rows):
    return (row.split(",") for row in rows[1:])

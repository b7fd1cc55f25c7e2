"""`vttig accuracy`: a run in the terms of standards."""

import json
import shutil

import numpy as np
import pytest

from vttig_jax.identify.archive import arrays_digest


@pytest.mark.portable
def test_a_run(vttig, vttig_json, run_folder):
    code, record = vttig_json("accuracy", run_folder)
    assert code == 0 and {row["period"] for row in record["single_flank"]} == {
        "driving shaft",
        "driven shaft",
        "pair",
    }
    assert record["axis"]["numbers"]["A"] is None
    code, text, _ = vttig("accuracy", run_folder)
    assert code == 0 and "not a conformity statement" in text
    size = record["single_flank"][0]["F_is"]["value_arcsec"]
    assert f"{size:.4g}" in text


def test_a_report_shows_it(vttig, vttig_json, run_folder, tmp_path):
    _, record = vttig_json("accuracy", run_folder)
    code, report = vttig_json("report", run_folder, "--out", tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text("utf-8")
    assert code == 0 and "accuracy" in report["sections"]
    assert f"{record['single_flank'][0]['F_is']['value_arcsec']:.4g}" in page


def test_a_run_of_an_older_version(vttig, vttig_json, run_folder, tmp_path):
    run = shutil.copytree(run_folder, tmp_path / "run")
    with np.load(run / "summary.npz") as arrays:
        kept = {name: arrays[name] for name in arrays if not name.startswith("measured_")}
    np.savez(run / "summary.npz", allow_pickle=False, **kept)
    fit = json.loads((run / "fit.json").read_text())
    fit["arrays"] = arrays_digest({name: kept[name] for name in kept if name != "run"})
    (run / "fit.json").write_text(json.dumps(fit))
    code, out, err = vttig("accuracy", run)
    assert code == 4 and out == "" and "older version" in err
    code, report = vttig_json("report", run, "--out", tmp_path / "r.html")
    assert code == 0 and "accuracy" not in report["sections"]

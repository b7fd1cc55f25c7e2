"""`vttig accuracy`: a run in the terms of standards."""

import json
import shutil

import numpy as np
import pytest

from vttig_jax.identify.archive import arrays_digest


@pytest.mark.portable
def test_a_run_and_its_report(told, found, run_folder, tmp_path):
    record = found("accuracy", run_folder)
    periods = {row["period"] for row in record["single_flank"]}
    assert periods == {"driving shaft", "driven shaft", "pair"}
    assert record["axis"]["numbers"]["A"] is None
    size = f"{record['single_flank'][0]['F_is']['value_arcsec']:.4g}"
    text = told("accuracy", run_folder)
    assert "not a conformity statement" in text and size in text
    assert "accuracy" in found("report", run_folder, "--out", tmp_path / "r.html")["sections"]
    assert size in (tmp_path / "r.html").read_text("utf-8")


def test_a_run_of_an_older_version(refused, found, run_folder, tmp_path):
    run = shutil.copytree(run_folder, tmp_path / "run")
    with np.load(run / "summary.npz") as arrays:
        kept = {name: arrays[name] for name in arrays if not name.startswith("measured_")}
    np.savez(run / "summary.npz", allow_pickle=False, **kept)
    fit = json.loads((run / "fit.json").read_text())
    fit["arrays"] = arrays_digest({name: kept[name] for name in kept if name != "run"})
    (run / "fit.json").write_text(json.dumps(fit))
    refused(4, "older version", "accuracy", run)
    assert "accuracy" not in found("report", run, "--out", tmp_path / "r.html")["sections"]

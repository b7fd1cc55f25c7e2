import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import tomli_w

from tests.control.texts import RIG
from vttig_jax import enable_x64
from vttig_jax.control.simulation.case import METRICS
from vttig_jax.identify.archive import read_fit
from vttig_jax.pair.gear_pair import pair_from_spec, spec_of
from vttig_jax.pair.pair_file import spec_table
from vttig_jax.posterior.sampler import read_posterior
from vttig_jax.rig.paper import paper_pair
from vttig_jax.runs.maps import fitted_rig
from vttig_jax.runs.run_file import read_run

SWEEP = """
pair = "pair.toml"
[eccentricities]
{rig}
[motion]
dwell_s = 0.2
ramp_s = 0.2
[sweep]
"motion.reversal_deg" = {{ from = 200, to = 360, num = 5 }}
"controller" = ["none", "predictive"]
"""


@pytest.fixture
def sweep(tmp_path) -> Path:
    (tmp_path / "pair.toml").write_text(tomli_w.dumps(spec_table(spec_of(paper_pair()))))
    path = tmp_path / "sweep.toml"
    path.write_text(SWEEP.format(rig=tomli_w.dumps(RIG)))
    return path


def test_without_a_folder_it_prints_and_writes_nothing(vttig, vttig_json, sweep):
    before = set(sweep.parent.iterdir())
    code, out, err = vttig("sweep", sweep)
    assert code == 0 and err.startswith("to run: 10 cases, ") and err.count("\n") == 1
    assert "10: 5 motion.reversal_deg, 2 controller" in out and "predictive      5" in out
    code, record = vttig_json("sweep", sweep, "-q")
    assert code == 0 and record["cases"] == 10 and record["table"] is None
    assert {"cases", "lane_steps", "run_s", "compile_s", "devices"} <= set(record)
    assert record["outcomes"] == {"ok": 10} and set(sweep.parent.iterdir()) == before


@pytest.mark.portable
def test_a_folder_gets_the_table_and_a_picture(vttig, sweep, tmp_path):
    out = tmp_path / "swept"
    code, text, _ = vttig("sweep", sweep, "--out", out, "--devices", 1)
    assert code == 0 and "sweep.parquet" in text
    assert {path.name for path in out.iterdir()} == {"sweep.parquet", "sweep.json", "figures"}
    table = pq.read_table(out / "sweep.parquet")
    axes = ["motion.reversal_deg", "controller"]
    assert table.column_names == ["case", *axes, *METRICS, "outcome"]
    assert (out / "figures" / "sweep.png").read_bytes().startswith(b"\x89PNG")
    assert vttig("sweep", sweep, "--out", out)[0] == 2
    assert vttig("sweep", sweep, "--out", out, "--overwrite", "--no-figures")[0] == 0


def test_a_command_with_resume_is_repeated(vttig, vttig_json, sweep, tmp_path):
    """It starts, goes on with the parts that are there, and prints what is complete."""
    out = tmp_path / "swept"
    again = ("sweep", sweep, "--out", out, "--resume", "-q")
    code, started = vttig_json(*again)
    assert code == 0 and started["lane_steps"] > 0
    table, picture = out / "sweep.parquet", out / "figures" / "sweep.png"
    before, rows = table.stat().st_mtime_ns, pq.read_table(table)
    picture.unlink()
    code, complete = vttig_json(*again)
    assert code == 0 and complete["lane_steps"] == complete["devices"] == 0
    assert complete["pair"] == started["pair"]
    assert complete["outcomes"] == started["outcomes"] and complete["axes"] == started["axes"]
    assert table.stat().st_mtime_ns == before and picture.exists()
    # As a kill leaves it: the header, and no block.
    table.unlink()
    code, goes_on = vttig_json(*again)
    assert code == 0 and goes_on["lane_steps"] == started["lane_steps"]
    assert pq.read_table(table).equals(rows)


def test_a_complete_table_of_another_sweep_is_refused(vttig, sweep, tmp_path):
    out = tmp_path / "swept"
    assert vttig("sweep", sweep, "--out", out, "--no-figures", "-q")[0] == 0
    before = (out / "sweep.parquet").read_bytes()
    sweep.write_text(sweep.read_text().replace("num = 5", "num = 4"))
    code, text, err = vttig("sweep", sweep, "--out", out, "--resume", "-q")
    assert (code, text) == (3, "") and "another sweep: scenario differ" in err
    assert (out / "sweep.parquet").read_bytes() == before


@pytest.mark.slow
def test_rigs_of_a_posterior(vttig, vttig_json, sampled_folder, tmp_path):
    path = tmp_path / "sweep.toml"
    text = SWEEP.format(rig="").replace("[eccentricities]\n", "").replace("pair.toml", "rig.toml")
    run = f'rig = {{ from = "{sampled_folder}", draws = 3, seed = 1 }}\n'
    path.write_text(run + text)
    (tmp_path / "rig.toml").write_text(tomli_w.dumps(spec_table(spec_of(paper_pair()))))
    out = tmp_path / "swept"
    code, record = vttig_json("sweep", path, "--out", out, "-q")
    assert code == 0 and record["cases"] == 30 and record["axes"][0] == "draw"
    rows = pq.read_table(out / "sweep.parquet").to_pydict()
    assert rows["draw"] == [0] * 10 + [1] * 10 + [2] * 10
    header = json.loads((out / "sweep.json").read_text())
    assert header["scenario"]["rig"] == {"from": str(sampled_folder), "draws": 3, "seed": 1}
    # The map the controller has is not that of the rigs: what it leaves differs from draw to draw.
    left = np.array(rows["residual_gap_deg"])[np.array(rows["controller"]) == "predictive"]
    assert np.ptp(left.reshape(3, 5), axis=0).min() > 1e-6


def test_the_posterior_comes_before_the_fit(sampled_folder):
    enable_x64()
    posterior = read_posterior(
        sampled_folder / "posterior.h5",
        read_fit(sampled_folder, pair_from_spec(read_run(sampled_folder).spec)),
    )
    found = fitted_rig(sampled_folder, sampled_folder / "no pair")
    assert found.driving_mm == posterior.eccentricities().driving_mm
    assert found.driving_mm != posterior.fit.eccentricities().driving_mm


def test_a_run_without_draws(vttig, run_folder, tmp_path):
    path = tmp_path / "sweep.toml"
    text = SWEEP.format(rig="").replace("[eccentricities]\n", "")
    path.write_text(f'rig = {{ from = "{run_folder}" }}\n' + text)
    (tmp_path / "pair.toml").write_text(tomli_w.dumps(spec_table(spec_of(paper_pair()))))
    code, out, err = vttig("sweep", path)
    assert (code, out) == (3, "") and "`vttig sample " in err and err.count("\n") == 1


def test_bad_files_are_one_sentence(vttig, sweep, monkeypatch):
    text = sweep.read_text()
    for old, new, code, words in (
        ("motion.reversal_deg", "motion.reversl_deg", 3, "no key of a scenario"),
        ("num = 5", "num = 10000000", 3, "of memory, but 0.1 GB are free"),
        ("pair.toml", "other.toml", 3, "there is no file"),
        ('controller" = ["none", "predictive"]', 'inertia.driven_kgm2" = [-1.0]', 3, "driven_kgm2"),
        ("[sweep]", "[swep]", 3, "swep"),
        ("to = 360", "to = 1e99", 3, "sweep"),
        ("num = 5", "num = 10000000000", 3, "sweep"),
    ):
        monkeypatch.setattr("vttig_jax.control.sweeps.sweep.free_bytes", lambda: 10**8)
        sweep.write_text(text.replace(old, new))
        found, out, err = vttig("sweep", sweep)
        assert (found, out) == (code, "") and words in err and err.count("\n") == 1


def test_wrong_options_are_usage_errors(vttig, sweep, monkeypatch):
    for options in (
        ["--resume"],
        ["--overwrite"],
        ["--no-figures"],
        ["--out", "swept", "--resume", "--overwrite"],
        ["--devices", "0"],
        ["--devices", "4000"],
    ):
        monkeypatch.chdir(sweep.parent)
        code, out, err = vttig("sweep", sweep, *options)
        assert (code, out) == (2, "") and err.count("\n") == 1
        assert not (sweep.parent / "swept").exists()

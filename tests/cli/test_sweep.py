import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import tomli_w

from tests.cli.commands import write_sweep
from vttig_jax import enable_x64
from vttig_jax.control.simulation.case import METRICS
from vttig_jax.identify.archive import read_fit
from vttig_jax.pair.gear_pair import pair_from_spec
from vttig_jax.posterior.sampler import read_posterior
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
    return write_sweep(tmp_path, SWEEP)


@pytest.fixture
def of_a_run(sweep):
    """Function that writes the sweep with the rig of a run folder."""

    def write(run: Path, **more: int) -> Path:
        rig = tomli_w.dumps({"rig": {"from": str(run), **more}})
        text = SWEEP.format(rig="").replace("[eccentricities]\n", rig)
        sweep.write_text(text)
        return sweep

    return write


def test_without_a_folder_it_prints_and_writes_nothing(vttig, found, sweep):
    before = set(sweep.parent.iterdir())
    code, out, err = vttig("sweep", sweep)
    assert code == 0 and err.startswith("to run: 10 cases, ") and err.count("\n") == 1
    assert "10: 5 motion.reversal_deg, 2 controller" in out and "predictive      5" in out
    record = found("sweep", sweep, "-q")
    assert record["cases"] == 10 and record["table"] is None
    assert {"cases", "lane_steps", "run_s", "compile_s", "devices"} <= set(record)
    assert record["outcomes"] == {"ok": 10} and set(sweep.parent.iterdir()) == before


@pytest.mark.portable
def test_a_folder_gets_the_table_and_a_picture(vttig, told, sweep, tmp_path):
    out, picture = tmp_path / "swept", tmp_path / "swept" / "figures" / "sweep.png"
    assert "sweep.parquet" in told("sweep", sweep, "--out", out, "--devices", 1)
    assert {path.name for path in out.iterdir()} == {"sweep.parquet", "sweep.json", "figures"}
    axes = ["motion.reversal_deg", "controller"]
    table = pq.read_table(out / "sweep.parquet")
    assert table.column_names == ["case", *axes, *METRICS, "outcome"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert vttig("sweep", sweep, "--out", out)[0] == 2
    picture.unlink()
    told("sweep", sweep, "--out", out, "--overwrite", "--no-figures")
    assert not picture.exists()


def test_a_command_with_resume_is_repeated(found, refused, sweep, tmp_path):
    """Complete, it computes nothing and draws a missing picture; `runs` has what else happens."""
    out = tmp_path / "swept"
    again, picture = ("sweep", sweep, "--out", out, "--resume", "-q"), out / "figures" / "sweep.png"
    started = found(*again)
    picture.unlink()
    complete = found(*again)
    assert started["lane_steps"] > 0 == complete["lane_steps"] == complete["devices"]
    assert all(complete[key] == started[key] for key in ("pair", "outcomes", "axes"))
    assert picture.exists()
    rows = (out / "sweep.parquet").read_bytes()
    sweep.write_text(sweep.read_text().replace("num = 5", "num = 4"))
    refused(3, "another sweep: scenario differ", *again)
    assert (out / "sweep.parquet").read_bytes() == rows


@pytest.mark.slow
def test_rigs_of_a_posterior(found, of_a_run, sampled_folder, tmp_path):
    out = tmp_path / "swept"
    record = found("sweep", of_a_run(sampled_folder, draws=3, seed=1), "--out", out, "-q")
    assert record["cases"] == 30 and record["axes"][0] == "draw"
    rows = pq.read_table(out / "sweep.parquet").to_pydict()
    assert rows["draw"] == [0] * 10 + [1] * 10 + [2] * 10
    header = json.loads((out / "sweep.json").read_text())
    assert header["scenario"]["rig"] == {"from": str(sampled_folder), "draws": 3, "seed": 1}
    # The map the controller has is not that of the rigs: what it leaves differs from draw to draw.
    left = np.array(rows["residual_gap_deg"])[np.array(rows["controller"]) == "predictive"]
    assert np.ptp(left.reshape(3, 5), axis=0).min() > 1e-6


def test_the_posterior_comes_before_the_fit(sampled_folder):
    enable_x64()
    fit = read_fit(sampled_folder, pair_from_spec(read_run(sampled_folder).spec))
    posterior = read_posterior(sampled_folder / "posterior.h5", fit)
    rig = fitted_rig(sampled_folder, sampled_folder / "no pair")
    assert rig.driving_mm == posterior.eccentricities().driving_mm
    assert rig.driving_mm != posterior.fit.eccentricities().driving_mm


def test_bad_files_are_one_sentence(refused, of_a_run, run_folder, sweep, monkeypatch):
    monkeypatch.setattr("vttig_jax.control.sweeps.sweep.free_bytes", lambda: 10**8)
    text = sweep.read_text()
    for old, new, words in (
        ("motion.reversal_deg", "motion.reversl_deg", "no key of a scenario"),
        ("num = 5", "num = 10000000", "of memory, but 0.1 GB are free"),
        ("pair.toml", "other.toml", "there is no file"),
        ('controller" = ["none", "predictive"]', 'inertia.driven_kgm2" = [-1.0]', "driven_kgm2"),
        ("[sweep]", "[swep]", "swep"),
        ("to = 360", "to = 1e99", "sweep"),
        ("num = 5", "num = 10000000000", "sweep"),
    ):
        sweep.write_text(text.replace(old, new))
        refused(3, words, "sweep", sweep)
    refused(3, "`vttig sample ", "sweep", of_a_run(run_folder))  # without draws


def test_wrong_options_are_usage_errors(refused, sweep, monkeypatch):
    monkeypatch.chdir(sweep.parent)
    for options in (
        "--resume",
        "--overwrite",
        "--no-figures",
        "--out swept --resume --overwrite",
        "--devices 0",
        "--devices 4000",
    ):
        refused(2, "", "sweep", sweep, *options.split())
        assert not (sweep.parent / "swept").exists()

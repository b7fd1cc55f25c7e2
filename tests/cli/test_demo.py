import json
from pathlib import Path

import pytest

from tests.guides.printed import differences

STEPS = "60"
"""Far from converged, but quick."""


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    from vttig_jax.cli.main import main

    out = tmp_path_factory.mktemp("demo") / "demo"
    assert main(["demo", "--out", str(out), "--quiet", "--steps", STEPS]) == 0
    return out


def test_leaves_a_folder_the_other_verbs_go_on_with(demo, vttig_json):
    assert {p.name for p in demo.iterdir()} == {
        "log.csv",
        "pair.toml",
        "run.toml",
        "fit.json",
        "summary.npz",
        "map.csv",
        "map.json",
        "posterior.h5",
        "posterior.json",
        "figures",
        "report.html",
    }
    assert {p.name for p in (demo / "figures").iterdir()} >= {"te_fit.png", "band.png"}
    before = json.loads((demo / "fit.json").read_text())
    code, record = vttig_json("fit", "--run", demo)
    assert code == 0
    for name, parameter in before["parameters"].items():
        again, value = record["parameters"][name]["value"], parameter["value"]
        near = 1e-3 * (parameter["std"] or 0.0)  # time stamps are written to 0.1 µs
        assert again == (value and pytest.approx(value, rel=1e-6, abs=near))
    code, again = vttig_json("map", demo)
    saved = json.loads((demo / "map.json").read_text())
    assert again["smallest"] == saved["smallest"]


@pytest.mark.slow
@pytest.mark.portable
def test_prints_the_truth_beside_the_fit_of_another_seed(demo, vttig):
    code, out, err = vttig("demo", "--seed", "3", "--steps", STEPS)
    assert code == 0
    assert "never published" in out
    row = next(line for line in out.splitlines() if line.startswith("driven_eccentricity_mm"))
    _, truth, found, std, off, low, _, high, unit = row.split()
    assert float(low) < float(found) < float(high)
    assert (float(truth), unit) == (0.0273, "mm")
    assert (float(found) - float(truth)) / float(std) == pytest.approx(float(off), abs=0.6)
    assert "map with all orders" in out and "95 % band of the whole map" in out
    assert "converged: no" in out
    assert err == ""
    name = "constant_backlash_deg"
    row = next(line for line in out.splitlines() if line.startswith(name))
    first = json.loads((demo / "fit.json").read_text())["parameters"][name]["value"]
    assert abs(float(row.split()[2]) - first) > 1e-5  # six digits are printed


def test_the_readme_shows_the_fit_of_its_log(demo, vttig, monkeypatch):
    text = (Path(__file__).parents[2] / "README.md").read_text("utf-8")
    command = text.partition("```sh\nvttig fit demo/log.csv")[2].partition("\n")[0]
    shown = text.partition(command)[2].partition("```\n\n```\n")[2].partition("\n```")[0]
    monkeypatch.chdir(demo.parent)
    code, out, _ = vttig("fit", "demo/log.csv", *command.split())
    assert code == 0 and "constant_backlash_deg" in shown
    assert differences(shown, out) == []


def test_an_existing_demo_is_refused(demo, vttig):
    before = (demo / "fit.json").read_bytes()
    code, _, err = vttig("demo", "--out", demo)
    assert code == 2
    assert "--overwrite" in err
    assert (demo / "fit.json").read_bytes() == before

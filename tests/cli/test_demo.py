import json

import pytest

from vttig_jax.cli.main import main

STEPS = "40"
"""Far from converged, but quick."""


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "demo"
    assert main(["demo", "--out", str(out), "--quiet", "--steps", STEPS]) == 0
    return out


def test_leaves_a_folder_the_other_verbs_go_on_with(demo, found):
    assert {p.name for p in demo.iterdir()} == {
        *("log.csv", "pair.toml", "run.toml", "fit.json", "summary.npz", "map.csv", "map.json"),
        *("posterior.h5", "posterior.json", "figures", "report.html"),
    }
    assert {p.name for p in (demo / "figures").iterdir()} >= {"te_fit.png", "band.png"}
    before = json.loads((demo / "fit.json").read_text())["parameters"]
    parameters = found("fit", "--run", demo)["parameters"]
    for name, parameter in before.items():
        again, value = parameters[name]["value"], parameter["value"]
        near = 1e-3 * (parameter["std"] or 0.0)  # time stamps are written to 0.1 µs
        assert again == (value and pytest.approx(value, rel=1e-6, abs=near))
    saved = json.loads((demo / "map.json").read_text())
    assert found("map", demo)["smallest"] == saved["smallest"]


@pytest.mark.slow
@pytest.mark.portable
def test_prints_the_truth_beside_the_fit_of_another_seed(demo, vttig):
    code, out, err = vttig("demo", "--seed", "3", "--steps", STEPS)
    assert (code, err) == (0, "")
    words = ("never published", "map with all orders", "95 % band of the whole map")
    assert all(one in out for one in (*words, "converged: no"))
    rows = {line.partition(" ")[0]: line.split()[1:] for line in out.splitlines()}
    truth, value, std, off, low, _, high, unit = rows["driven_eccentricity_mm"]
    assert float(low) < float(value) < float(high)
    assert (float(truth), unit) == (0.0273, "mm")
    assert (float(value) - float(truth)) / float(std) == pytest.approx(float(off), abs=0.6)
    name = "constant_backlash_deg"
    first = json.loads((demo / "fit.json").read_text())["parameters"][name]["value"]
    assert abs(float(rows[name][1]) - first) > 1e-5  # six digits are printed


def test_an_existing_demo_or_log_is_refused_and_kept(demo, refused, tmp_path):
    before = (demo / "fit.json").read_bytes()
    refused(2, "--overwrite", "demo", "--out", demo)
    assert (demo / "fit.json").read_bytes() == before
    (tmp_path / "log.csv").write_text("mine")
    refused(2, "log.csv: already exists", "demo", "--out", tmp_path)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("log.csv", "mine")]

"""The lower edge of the band as the map that a controller gets: simulated, swept and exported."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vttig_jax
from vttig_jax.base.errors import ScenarioError
from vttig_jax.cli.main import main

TURN_DEG = 300.0
EDGES = ("low95", "low95_simultaneous")
MOTION = {"reversal_deg": TURN_DEG, "dwell_s": 0.1, "ramp_s": 0.2}


@pytest.fixture(scope="module")
def sampled(run_folder, tmp_path_factory) -> Path:
    """A run folder with draws, too few to converge."""
    out = Path(shutil.copytree(run_folder, tmp_path_factory.mktemp("sampled") / "run"))
    assert main(["sample", "--out", str(out), "--steps", "60", "--no-figures"]) == 5
    return out


@pytest.fixture(scope="module")
def rows(sampled):
    """The columns of `vttig map`."""
    out = sampled / "for_tests.csv"
    assert main(["map", str(sampled), "--out", str(out), "--step-deg", "0.5"]) == 0
    return np.genfromtxt(out, delimiter=",", names=True)


def left_deg(sampled, believed, gap) -> Any:
    """The gap left at the turn by a controller with this map."""
    scenario = {"motion": MOTION, "controller": "predictive", "controller_gap": gap}
    run = vttig_jax.simulate(scenario, plant_map=sampled, controller_map=believed)
    assert ("low95" in str(run)) is (gap != "mean")
    return run.metrics["residual_gap_deg"]


def test_the_controller_leaves_the_half_width_of_the_band(sampled, rows):
    at = np.flatnonzero(rows["driving_deg"] == TURN_DEG)[0]
    for believed in (sampled, sampled / "for_tests.csv"):
        mean = left_deg(sampled, believed, "mean")
        for edge in EDGES:
            more = left_deg(sampled, believed, edge) - mean
            width = rows["backlash_deg"][at] - rows[f"{edge}_deg"][at]
            assert more == pytest.approx(width, rel=0.01) and width > 1e-4


def test_a_sweep_has_it_as_an_axis(sampled):
    """Without a margin, the mean closes too far in half of the draws, the edge in 2.5 % of them."""
    table = {"rig": {"from": str(sampled), "draws": 200}, "controller": "predictive"}
    table |= {
        "motion": MOTION,
        "judgement": {"margin_mm": 0.0},
        "sweep": {"controller_gap": ["mean", *EDGES]},
    }
    columns = vttig_jax.sweep(table).columns
    found = [
        np.mean(columns["interference_mm"][columns["controller_gap"] == gap] > 1e-4)
        for gap in ("mean", *EDGES)
    ]
    assert found[0] > 0.3 and 0.06 > found[1] >= found[2]


def test_exported_harmonics_are_nowhere_above_the_edge(vttig_json, sampled, rows, tmp_path):
    for edge in EDGES:
        path = tmp_path / f"{edge}.json"
        code, record = vttig_json("export", sampled, "--out", path, "--gap", edge)
        assert code == 0 and record == json.loads(path.read_text()) and record["gap"] == edge
        angle = np.radians(rows["driving_deg"])
        gap = np.full(len(angle), record["constant_rad"])
        for one in record["harmonics"]:
            phase = (one["driving_order"] + one["driven_order"] * record["ratio_value"]) * angle
            gap += one["cos_rad"] * np.cos(phase) + one["sin_rad"] * np.sin(phase)
        room = rows[f"{edge}_deg"] - np.degrees(gap)
        assert -5e-5 < room.min() < 1e-5  # the edge was read at other angles
        assert record["lowered_deg"] == pytest.approx(
            np.max(rows["backlash_deg"] - rows[f"{edge}_deg"]), rel=0.01
        )


def test_the_header_says_so(vttig, sampled, tmp_path):
    texts = []
    for arguments in ((), ("--gap", "low95")):
        path = tmp_path / "gap.h"
        assert vttig("export", sampled, "--out", path, "--overwrite", *arguments)[0] == 0
        texts.append(path.read_text())
    assert "low95" not in texts[0] and "low95" in texts[1]


def test_what_has_no_band_is_refused(vttig, run_folder, sampled, tmp_path):
    model = vttig_jax.open_run(sampled).fit
    for believed in (run_folder, model):
        with pytest.raises(ScenarioError, match="draws"):
            left_deg(sampled, believed, "low95")
    rig = dict.fromkeys(("driving_mm", "driving_phase_deg", "driven_mm"), 0.0)
    rig |= {"driven_phase_deg": 0.0, "constant_backlash_deg": 0.04}
    scenario = {"pair": "p", "eccentricities": rig, "controller_gap": "low95", "motion": MOTION}
    with pytest.raises(ScenarioError, match="have no band"):
        vttig_jax.simulate(scenario, vttig_jax.open_run(sampled).pair)
    plain = tmp_path / "plain.csv"
    assert vttig("map", run_folder, "--quantity", "error", "--out", plain)[0] == 0
    with pytest.raises(ScenarioError, match="low95_deg"):
        left_deg(sampled, plain, "low95")
    export = ("export", run_folder, "--out", tmp_path / "x.json", "--gap", "low95")
    assert vttig(*export)[0] == 2
    assert vttig(*export, "--constant-backlash-deg", "0.04")[0] == 2

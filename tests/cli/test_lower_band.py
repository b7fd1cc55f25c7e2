"""The lower edge of the band as the map that a controller gets: simulated, swept and exported."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vttig_jax
from tests.cli.commands import table_of
from tests.control.texts import MINIMAL
from vttig_jax.base.errors import ScenarioError
from vttig_jax.cli.main import main

TURN_DEG = 300.0
EDGES = ("low95", "low95_simultaneous")
GAPS = ("mean", *EDGES)
MOTION = {"reversal_deg": TURN_DEG, "dwell_s": 0.1, "ramp_s": 0.2}


@pytest.fixture(scope="module")
def table(sampled_folder, tmp_path_factory) -> Path:
    """The file of `vttig map`."""
    out = tmp_path_factory.mktemp("map") / "map.csv"
    assert main(["map", str(sampled_folder), "--out", str(out), "--step-deg", "0.5"]) == 0
    return out


@pytest.fixture(scope="module")
def rows(table):
    return table_of(table)


def left_deg(sampled, believed, gap) -> Any:
    """The gap left at the turn by a controller with this map."""
    scenario = {"motion": MOTION, "controller": "predictive", "controller_gap": gap}
    run = vttig_jax.simulate(scenario, plant_map=sampled, controller_map=believed)
    assert ("low95" in str(run)) is (gap != "mean")
    return run.metrics["residual_gap_deg"]


def widths(rows) -> dict[str, float]:
    """Of the band below the map at the turn, by its edge."""
    at = np.flatnonzero(rows["driving_deg"] == TURN_DEG)[0]
    found = {edge: rows["backlash_deg"][at] - rows[f"{edge}_deg"][at] for edge in EDGES}
    assert min(found.values()) > 1e-4
    return found


@pytest.mark.slow
def test_the_controller_leaves_the_half_width_of_the_band(sampled_folder, rows, table):
    mean = left_deg(sampled_folder, table, "mean")
    for edge, width in widths(rows).items():
        assert left_deg(sampled_folder, table, edge) - mean == pytest.approx(width, rel=0.01)


@pytest.mark.slow
def test_a_sweep_has_it_as_an_axis(sampled_folder, rows):
    """In every draw of the rig the edge leaves more than the mean, by the half width."""
    columns = vttig_jax.sweep(
        {
            "rig": {"from": str(sampled_folder), "draws": 5},
            "controller": "predictive",
            "motion": MOTION,
            "judgement": {"margin_mm": 0.05},  # so that no gap is closed altogether
            "sweep": {"controller_gap": [*GAPS]},
        }
    ).columns
    left = {gap: columns["residual_gap_deg"][columns["controller_gap"] == gap] for gap in GAPS}
    assert len(left["mean"]) == 5 and np.ptp(left["mean"]) > 1e-5
    for edge, width in widths(rows).items():
        np.testing.assert_allclose(left[edge] - left["mean"], width, rtol=0.01)


@pytest.mark.slow
def test_exported_harmonics_are_nowhere_above_the_edge(found, sampled_folder, rows, tmp_path):
    for edge in EDGES:
        path = tmp_path / f"{edge}.json"
        record = found("export", sampled_folder, "--out", path, "--gap", edge)
        assert record == json.loads(path.read_text()) and record["gap"] == edge
        angle = np.radians(rows["driving_deg"])
        gap = np.full(len(angle), record["constant_rad"])
        for one in record["harmonics"]:
            phase = (one["driving_order"] + one["driven_order"] * record["ratio_value"]) * angle
            gap += one["cos_rad"] * np.cos(phase) + one["sin_rad"] * np.sin(phase)
        room = rows[f"{edge}_deg"] - np.degrees(gap)
        assert -5e-5 < room.min() < 1e-5  # the edge was read at other angles
        lowered = np.max(rows["backlash_deg"] - rows[f"{edge}_deg"])
        assert record["lowered_deg"] == pytest.approx(lowered, rel=0.01)


def test_the_header_says_so(told, sampled_folder, tmp_path):
    for number, arguments in enumerate(((), ("--gap", "low95"))):
        path = tmp_path / f"{number}.h"
        told("export", sampled_folder, "--out", path, *arguments)
        assert ("low95" in path.read_text()) is bool(arguments)


def test_what_has_no_band_is_refused(vttig, run_folder, sampled_folder, tmp_path):
    model = vttig_jax.open_run(sampled_folder).fit
    for believed in (run_folder, model):
        with pytest.raises(ScenarioError, match="draws"):
            left_deg(sampled_folder, believed, "low95")
    scenario = {**MINIMAL, "controller_gap": "low95", "motion": MOTION}
    with pytest.raises(ScenarioError, match="have no band"):
        vttig_jax.simulate(scenario, vttig_jax.open_run(sampled_folder).pair)
    plain = tmp_path / "plain.csv"
    assert vttig("map", run_folder, "--quantity", "error", "--out", plain)[0] == 0
    with pytest.raises(ScenarioError, match="low95_deg"):
        left_deg(sampled_folder, plain, "low95")
    export = ("export", run_folder, "--out", tmp_path / "x.json", "--gap", "low95")
    assert vttig(*export)[0] == 2
    assert vttig(*export, "--constant-backlash-deg", "0.04")[0] == 2

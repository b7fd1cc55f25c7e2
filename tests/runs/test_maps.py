"""Maps of a simulation: run folders, map files, models and functions; and what is no map."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import vttig_jax
from tests.cli.drive import write_drive, write_pair
from vttig_jax.base.errors import ScenarioError
from vttig_jax.identify.identification import fit
from vttig_jax.identify.result import Fit
from vttig_jax.kinematics import BacklashMap, closed_model
from vttig_jax.logs.read import read_log
from vttig_jax.pair.gear_pair import Gear, GearPair, load_pair
from vttig_jax.pair.schema import HarmonicOrders
from vttig_jax.rig import paper_eccentricities, paper_pair

PAIR = paper_pair()
MOTION = {"reversal_deg": 300.0, "dwell_s": 0.1, "ramp_s": 0.2}
ANGLES = jnp.linspace(0.0, 5.0, 101)


def simulated(plant_map: Any, pair: Any = PAIR, **given: Any) -> Any:
    scenario = {"motion": MOTION, "controller": "none", **given}
    return vttig_jax.simulate(scenario, pair, plant_map=plant_map)


@pytest.fixture(scope="module")
def run_folder(quick_fit: Fit, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "run"
    quick_fit.save(folder, figures=False)
    return folder


@pytest.fixture(scope="module")
def model(quick_fit: Fit) -> Any:
    return vttig_jax.backlash_map(quick_fit).model


def write_map(path: Path, model: Any, degrees: np.ndarray, *columns: str) -> Path:
    """A CSV of these columns in degrees."""
    angle = np.radians(degrees)
    values = {"driving_deg": degrees, "backlash_deg": np.degrees(model.backlash(angle))}
    values |= {
        f"te_{flank.lower()}_deg": np.degrees(model.transmission_error(angle, flank))
        for flank in "AB"
    }
    table = np.stack([values[name] for name in ("driving_deg", *columns)], axis=1)
    header = ",".join(("driving_deg", *columns))
    np.savetxt(path, table, "%.15g", ",", header=header, comments="")
    return path


WHOLE = np.arange(0.0, 16 * 360.0, 0.5)
BOTH = ("te_a_deg", "te_b_deg", "backlash_deg")


def assert_flanks(run: Any, model: Any, atol: float) -> None:
    """The plant of a run has the flanks of the model."""
    flanks = run.case.bounds.at(ANGLES)
    for flank, found in (("A", flanks.lower), ("B", flanks.upper)):
        known = model.transmission_error(ANGLES, flank)
        np.testing.assert_allclose(found, known, rtol=0, atol=atol)


def test_a_run_folder_a_fit_and_a_map_are_the_same_flanks(run_folder, quick_fit, model):
    """Of the fit, with its mesh orders: 2.4e-7 of their amplitudes, which are 5e-5 rad."""
    grid = BacklashMap(model, None, PAIR)
    runs = [simulated(source) for source in (run_folder, quick_fit, grid, model)]
    for run in runs:
        assert_flanks(run, model, 1e-10)
        assert run.metrics == runs[0].metrics
    assert_flanks(vttig_jax.simulate(run_folder), model, 1e-10)
    with pytest.raises(AssertionError):
        assert_flanks(runs[0], closed_model(PAIR, paper_eccentricities()), 1e-10)


@pytest.mark.slow
def test_a_file_of_both_flanks(tmp_path, model):
    run = simulated(write_map(tmp_path / "map.csv", model, WHOLE, *BOTH))
    assert run.case.bounds.periodic
    assert_flanks(run, model, 1e-8)
    part = write_map(tmp_path / "part.csv", model, WHOLE[: 2 * 360], *BOTH[:2])
    again = simulated(part)
    assert not again.case.bounds.periodic
    assert again.metrics["jump_deg"] == pytest.approx(run.metrics["jump_deg"], abs=1e-7)


def test_a_file_of_the_backlash_alone_has_a_perfect_first_flank(tmp_path, model):
    run = simulated(write_map(tmp_path / "map.csv", model, WHOLE, "backlash_deg"))
    flanks = run.case.bounds.at(ANGLES)
    assert not np.any(flanks.lower)
    np.testing.assert_allclose(flanks.upper, model.backlash(ANGLES), rtol=0, atol=1e-8)


def test_the_controller_has_a_map_of_its_own(tmp_path, model):
    """A function of the user whose gap is 0.01° too small leaves so much of it."""

    def less(angle, flank):
        return model.transmission_error(angle, flank) - np.radians(0.01) * (flank == "B")

    options = {"plant_map": model, "controller_map": less}
    scenario = {"motion": MOTION, "controller": "predictive"}
    left: Any = vttig_jax.simulate(scenario, PAIR, **options).metrics
    right: Any = vttig_jax.simulate(scenario, PAIR, plant_map=model).metrics
    assert left["residual_gap_deg"] - right["residual_gap_deg"] == pytest.approx(0.01, abs=1e-5)


OTHER_GEARS = GearPair(
    Gear(44, 3.0, 3.0), Gear(80, 3.0, 3.0), module_mm=2.0, pressure_angles_deg=20.0
)
CSV = "driving_deg,te_a_deg,te_b_deg\n"
FILES: dict[str, str] = {
    "columns": "driving_deg,gap\n0,1\n1,1\n2,1\n3,1\n",
    "rows": CSV + "0,0,1\n1,0,1\n",
    "cells": CSV + "0,0,1\n1,,1\n2,0,1\n3,0,1\n",
    "steps": CSV + "0,0,1\n1,0,1\n2,0,1\n4,0,1\n",
    "short": CSV + "".join(f"{angle},0,1\n" for angle in range(-90, 200)),
    "empty": "",
    "arcsec": CSV + "".join(f"{angle},0,{100 + angle}\n" for angle in range(-90, 400)),
    "crossing": CSV + "".join(f"{angle},0,{0.1 - 0.001 * angle}\n" for angle in range(-90, 400)),
}


def test_what_is_no_map_is_one_sentence(tmp_path):
    for name, words in (
        ("missing", "no map can be read here"),
        ("columns", "but this file has driving_deg, gap"),
        ("rows", "here are 2 rows"),
        ("cells", "empty cells"),
        ("steps", "even, rising steps"),
        ("short", "covers -90.00° … 199.00°"),
        ("empty", "no map can be read here"),
        ("arcsec", "more than 90° apart"),
        ("crossing", "before flank A"),
    ):
        path = tmp_path / f"{name}.csv"
        if name in FILES:
            path.write_text(FILES[name])
        with pytest.raises(ScenarioError, match=words) as caught:
            simulated(path)
        assert "\n" not in str(caught.value) and "map" in str(caught.value)


def test_the_controller_may_believe_another_constant(model):
    """[map] shifts the gap of a named map as a whole; nothing else of it means anything there."""
    scenario = {"motion": MOTION, "controller": "predictive"}
    mean = float(np.degrees(np.mean(model.backlash(np.radians(WHOLE)))))
    left: Any = [
        vttig_jax.simulate(scenario | {"map": own}, PAIR, plant_map=model).metrics
        for own in ({}, {"constant_backlash_deg": mean - 0.003})
    ]
    more = left[1]["residual_gap_deg"] - left[0]["residual_gap_deg"]
    assert more == pytest.approx(0.003, abs=1e-5)
    with pytest.raises(ScenarioError, match="eccentricities of"):
        vttig_jax.simulate(scenario | {"map": {"driving_mm": 0.1}}, PAIR, plant_map=model)


def test_a_constant_of_a_run_needs_a_run():
    rig = dict.fromkeys(("driving_mm", "driving_phase_deg", "driven_mm"), 0.0)
    rig |= {"driven_phase_deg": 0.0, "constant_backlash_deg": 0.04}
    with pytest.raises(ScenarioError, match="none is named"):
        vttig_jax.simulate({"pair": "p", "eccentricities": rig, "constant_backlash_deg": 0.1}, PAIR)


def test_flanks_in_the_wrong_order_are_refused_for_the_controller_too(model):
    def swapped(angle, flank):
        return model.transmission_error(angle, "A" if flank == "B" else "B")

    scenario = {"motion": MOTION, "controller": "predictive"}
    with pytest.raises(ScenarioError, match="on the average"):
        vttig_jax.simulate(scenario, PAIR, plant_map=model, controller_map=swapped)


def test_the_map_of_other_gears_is_refused(run_folder):
    with pytest.raises(ScenarioError, match="not the gears of the run") as caught:
        simulated(run_folder, OTHER_GEARS)
    assert "teeth 44/80 here, 45/80 there" in str(caught.value)


def test_a_sweep_needs_draws(run_folder):
    table = {"rig": {"from": str(run_folder)}, "motion": MOTION, "sweep": {"seed": [0, 1]}}
    with pytest.raises(ScenarioError, match="vttig sample"):
        vttig_jax.sweep(table)


@pytest.fixture(scope="module")
def drive_folder(tmp_path_factory) -> Path:
    """A run folder of a drive 1 : 2 without gears, whose gap is 100″."""
    folder = tmp_path_factory.mktemp("drive")
    pair = load_pair(write_pair(folder / "pair.toml"))
    log = read_log(write_drive(folder / "log.csv"), pair)
    fit(log, pair, orders=HarmonicOrders(mesh_orders=0)).save(folder / "run", figures=False)
    return folder


def test_a_drive_without_gears_runs_with_its_fit(drive_folder):
    run = vttig_jax.simulate(drive_folder / "run")  # a run folder is a scenario
    assert run.outcome == "ok" and run.controller == "none"
    assert run.metrics["jump_deg"] == pytest.approx(100 / 3600, abs=3 / 3600)
    makes_up = simulated(drive_folder / "run", None, controller="feedforward", plant="play")
    plain = simulated(drive_folder / "run", None, plant="play")
    assert makes_up.metrics["lost_motion_deg"] < 0.01 * plain.metrics["lost_motion_deg"]
    with pytest.raises(ScenarioError, match="this drive has no gears"):
        simulated(drive_folder / "run", None, controller="predictive")


def test_a_log_of_one_direction_needs_a_backlash(drive_folder):
    """Flank A of such a log and a stated gap."""
    pair = load_pair(drive_folder / "pair.toml")
    header, *rows = (drive_folder / "log.csv").read_text().splitlines()
    path = drive_folder / "forward.csv"
    path.write_text("\n".join([header, *(row for row in rows if float(row.split(",")[0]) < 8.0)]))
    one = fit(read_log(path, pair), pair, orders=HarmonicOrders(mesh_orders=0))
    one.save(drive_folder / "one", figures=False)
    with pytest.raises(ScenarioError, match="constant_backlash_deg"):
        simulated(drive_folder / "one", None)
    run = simulated(drive_folder / "one", None, constant_backlash_deg=0.02)
    assert run.metrics["jump_deg"] == pytest.approx(0.02, rel=1e-3)

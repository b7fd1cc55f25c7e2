"""Maps of a simulation: run folders, map files, models and functions; and what is no map."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import vttig_jax
from tests.cli.drive import write_drive, write_pair
from tests.control.texts import MINIMAL
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
    values = {"driving_deg": angle, "backlash_deg": model.backlash(angle)}
    values |= {f"te_{f.lower()}_deg": model.transmission_error(angle, f) for f in "AB"}
    names = ("driving_deg", *columns)
    table = np.degrees(np.stack([values[name] for name in names], axis=1))
    np.savetxt(path, table, "%.15g", ",", header=",".join(names), comments="")
    return path


WHOLE = np.arange(0.0, 16 * 360.0, 0.5)
BOTH = ("te_a_deg", "te_b_deg", "backlash_deg")


def assert_flanks(run: Any, model: Any, atol: float) -> None:
    """The plant of a run has the flanks of the model."""
    flanks = run.case.bounds.at(ANGLES)
    for flank, seen in (("A", flanks.lower), ("B", flanks.upper)):
        known = model.transmission_error(ANGLES, flank)
        np.testing.assert_allclose(seen, known, rtol=0, atol=atol)


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


def test_what_is_no_map_is_one_sentence(tmp_path):
    def te(rows) -> str:
        return "driving_deg,te_a_deg,te_b_deg\n" + "".join(f"{a},0,{b}\n" for a, b in rows)

    path, whole = tmp_path / "map.csv", range(-90, 400)
    for text, words in (
        (None, "no map can be read here"),
        ("", "no map can be read here"),
        ("driving_deg,gap\n0,1\n1,1\n2,1\n3,1\n", "but this file has driving_deg, gap"),
        (te([(0, 1), (1, 1)]), "here are 2 rows"),
        (te([(0, 1), (1, ""), (2, 1), (3, 1)]), "empty cells"),
        (te([(0, 1), (1, 1), (2, 1), (4, 1)]), "even, rising steps"),
        (te((angle, 1) for angle in range(-90, 200)), "covers -90.00° … 199.00°"),
        (te((angle, 100 + angle) for angle in whole), "more than 90° apart"),
        (te((angle, 0.1 - 0.001 * angle) for angle in whole), "before flank A"),
    ):
        if text is not None:
            path.write_text(text)
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


def test_maps_that_do_not_belong_to_the_scenario(run_folder, model):
    predictive = {"motion": MOTION, "controller": "predictive"}
    stated = {**MINIMAL, "constant_backlash_deg": 0.1}
    drawn = {"rig": {"from": str(run_folder)}, "motion": MOTION, "sweep": {"seed": [0, 1]}}

    def swapped(angle, flank):
        return model.transmission_error(angle, "A" if flank == "B" else "B")

    maps: Any = {"plant_map": model, "controller_map": swapped}
    own = predictive | {"map": {"driving_mm": 0.1}}
    for words, run in (
        ("eccentricities of", lambda: vttig_jax.simulate(own, PAIR, plant_map=model)),
        ("none is named", lambda: vttig_jax.simulate(stated, PAIR)),
        ("on the average", lambda: vttig_jax.simulate(predictive, PAIR, **maps)),
        ("teeth 44/80 here, 45/80 there", lambda: simulated(run_folder, OTHER_GEARS)),
        ("vttig sample", lambda: vttig_jax.sweep(drawn)),
    ):
        with pytest.raises(ScenarioError, match=words):
            run()


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

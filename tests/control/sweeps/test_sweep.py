"""Sweeps against `simulate`, case by case."""

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from msgspec import structs

import vttig_jax
from tests.control.scenarios import PAIR, SHORT, HoldShift, spec_of
from tests.control.sweep_files import (
    AXES,
    CONTROLLERS,
    assert_close,
    drawn,
    small_blocks,
    sweep_spec,
)
from vttig_jax.base.errors import ScenarioError
from vttig_jax.control import Maps, simulate, sweep
from vttig_jax.control.simulation.case import METRICS
from vttig_jax.control.simulation.result import Simulation
from vttig_jax.control.sweeps import sweep as sweep_work
from vttig_jax.control.sweeps.sweep import SweepCases, SweepWork
from vttig_jax.control.sweeps.table import SweepTable
from vttig_jax.kinematics import closed_model
from vttig_jax.rig.paper import paper_eccentricities

RIG = paper_eccentricities()


@pytest.fixture(scope="module")
def told() -> list[tuple[Any, ...]]:
    """What was announced of the sweep, and then its progress."""
    return []


@pytest.fixture(scope="module")
def table(told) -> SweepTable:
    told_of: Any = lambda *now: told.append(now)  # noqa: E731
    return sweep(sweep_spec(), PAIR, announce=told_of, progress=told_of)


def test_the_estimate_is_told_before_the_first_block(table, told):
    (text, lane_steps), *done = told
    assert lane_steps == pytest.approx(table.lane_steps, rel=0.01)
    assert "12 cases" in text and done[-1][1] == table.lane_steps


def assert_same(table: SweepTable, number: int, run: Simulation) -> None:
    """A row is what `simulate` says of its case."""
    seen = {name: values[number].item() for name, values in table.columns.items()}
    assert seen["case"] == number and seen["outcome"] == run.outcome
    for name in METRICS:
        expected: Any = np.nan if run.metrics[name] is None else run.metrics[name]
        np.testing.assert_allclose(seen[name], expected, rtol=0, atol=1e-9, err_msg=name)


def test_every_row_is_what_simulate_says_and_the_first_axis_is_the_slowest(table):
    cases = SweepCases(sweep_spec(), PAIR)
    runs = [simulate(cases.spec_of(number), PAIR) for number in range(len(cases))]
    for number, run in enumerate(runs):
        assert_same(table, number, run)
    assert table.lane_steps == sum(run.to_json()["samples"] for run in runs)  # no filled lanes
    expected = itertools.product(AXES["motion.reversal_deg"], AXES["controller"])
    seen = zip(table.columns["motion.reversal_deg"], table.columns["controller"], strict=True)
    assert list(seen) == list(expected)
    assert list(table.columns) == ["case", *AXES, *METRICS, "outcome"]


def test_zipped_axes_advance_together():
    axes = {"motion.ramp_s": [0.1, 0.2], "controller": ["none", "predictive"], "seed": [0, 1]}
    cases = SweepCases(sweep_spec(axes | {"zip": [["motion.ramp_s", "seed"]]}), PAIR)
    columns = cases.columns(range(len(cases)))
    seen = zip(*(columns[name].tolist() for name in cases.axes), strict=True)
    assert list(seen) == [
        (0.1, "none", 0),
        (0.1, "predictive", 0),
        (0.2, "none", 1),
        (0.2, "predictive", 1),
    ]


def test_a_case_that_cannot_run_stops_nothing(table):
    axes = {**AXES, "motion.reversal_deg": [200.0, 10.0, 300.0, 360.0]}
    found = sweep(sweep_spec(axes), PAIR)
    bad = found.columns["motion.reversal_deg"] == 10.0
    assert set(found.columns["outcome"][bad]) == {"refused"}
    assert all(np.isnan(found.columns[name][bad]).all() for name in METRICS)
    good = ~bad & (found.columns["motion.reversal_deg"] != 250.0)
    for name in METRICS:
        assert_close(found.columns[name][good], table.columns[name][good])
    assert found.outcomes["refused"] == bad.sum() == 3
    assert [case for case, _ in found.refusals] == [3]  # 4 and 5 for the same reason
    assert "10 lies inside the ramps" in found.refusals[0][1] and "refused" in str(found)


def test_where_no_case_can_run_the_first_says_why():
    with pytest.raises(ScenarioError, match="lies inside the ramps"):
        sweep(sweep_spec({"motion.reversal_deg": [1.0, 2.0]}), PAIR)


@pytest.mark.portable
def test_blocks_and_lanes_leave_no_trace(table, monkeypatch):
    small_blocks(1, monkeypatch)
    monkeypatch.setattr(sweep_work, "LANES", 8)
    found = sweep(sweep_spec(), PAIR)
    assert list(found.columns) == list(table.columns)
    for name, values in table.columns.items():
        assert_close(found.columns[name], values)


def test_each_draw_is_a_plant_of_its_own_and_controllers_have_the_map_they_are_given():
    one, wrong = (replace(RIG, constant_backlash_deg=gap) for gap in (0.038, 0.036))
    axes = {"motion.reversal_deg": [200.0, 300.0]}
    spec = sweep_spec(axes, controller="predictive", rig={"from": "RUN"})
    other = replace(RIG, constant_backlash_deg=0.039)
    right, less = (sweep(spec, PAIR, maps=drawn(map_, one, other)) for map_ in (one, wrong))
    assert right.axes == ("draw", *axes)
    np.testing.assert_array_equal(right.columns["draw"], [0, 0, 1, 1])
    left, more = (table.columns["residual_gap_deg"] for table in (right, less))
    np.testing.assert_allclose(more - left, 0.002, atol=1e-6)
    np.testing.assert_allclose(left[2:] - left[:2], 0.001, atol=1e-6)


@pytest.mark.slow
def test_the_backlash_that_is_believed_of_a_map_is_an_axis():
    believed = [0.030, 0.038, 0.046]
    axis = {"map.constant_backlash_deg": believed}
    spec = sweep_spec(axis, controller="predictive", plant_map="RUN", eccentricities=None)
    plant = closed_model(PAIR, RIG)
    found = sweep(spec, PAIR, maps=Maps({"RUN": plant}))
    for number, gap in enumerate(believed):
        one = spec_of(SHORT, {"controller": "predictive", "map.constant_backlash_deg": gap})
        one = structs.replace(one, plant_map="RUN", eccentricities=None)
        assert_same(found, number, simulate(one, PAIR, maps=Maps({"RUN": plant})))
    assert np.ptp(found.columns["residual_gap_deg"]) > 0.005


def test_a_map_is_read_with_one_backlash():
    with pytest.raises(ScenarioError, match=r"sweep map\.constant_backlash_deg"):
        sweep_spec({"constant_backlash_deg": [0.03, 0.04]}, plant_map="RUN")


def test_cases_without_a_gap_are_refused():
    """As many cases as above, so that the compiled program is shared."""
    gaps = {"eccentricities.constant_backlash_deg": [0.001, 0.037, 0.038, 0.039]}
    found = sweep(sweep_spec(gaps, controller="none"), PAIR)
    assert found.columns["outcome"].tolist() == ["refused", "ok", "ok", "ok"]


def test_a_controller_of_your_own():
    axes = {"motion.reversal_deg": [300.0, 360.0]}
    found = sweep(sweep_spec(axes), PAIR, controller=HoldShift(0.1))
    np.testing.assert_allclose(found.columns["actuator_travel_mm"], 0.1, atol=1e-9)
    with pytest.raises(ScenarioError, match="controller of your own"):
        sweep(sweep_spec(), PAIR, controller=HoldShift(0.1))


def test_new_values_compile_nothing():
    def swept(first: float) -> SweepTable:
        axes = {"motion.reversal_deg": [first, 300.0], "judgement.margin_mm": [0.0, 0.1 * first]}
        return sweep(sweep_spec(axes), PAIR)

    first, second = swept(200.0), swept(222.0)
    assert second.compile_s == 0.0 < first.compile_s or first.compile_s == second.compile_s == 0.0
    assert not np.array_equal(first.columns["jump_deg"], second.columns["jump_deg"])


ELASTIC = {"plant": "elastic", "sampling.plant_hz": 4000.0, "flanks": "closed"}
SWITCHES: dict[str, list[Any]] = {
    "motion.kind": ["trapezoid", "s_curve"],
    "driving_encoder.noise_arcsec": [0.0, 1.0],
    "actuator.force_limit_N": [0.0, 5.0],
    "friction.stribeck_Nm": [0.0, 0.05],
    "actuator.delay_s": [0.0, 0.003],
    "sampling.plant_hz": [0.0, 2000.0],
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "axes", "every"),
    [
        ({}, SWITCHES, 9),
        (ELASTIC, {"mesh.damping_ratio": [0.1, 0.5], "actuator.delay_s": [0.002, 0.003]}, 1),
        ({"plant": "play", "judgement.observer": "difference"}, {"seed": [0, 3]}, 1),
    ],
)
def test_numbers_that_switch_a_part_on_are_axes_like_others(settings, axes, every):
    """Noise, a force limit or a static friction of zero beside others; plant steps, a queue."""
    # Angles of a ramp are halves of counts at many samples of 1 ms; with this error they are not.
    both = {f"{name}_encoder.amplitude_arcsec": 5.0 for name in ("driving", "driven")}
    both |= {f"{name}_encoder.phase_deg": 60.0 for name in ("driving", "driven")}
    given = {"controller": "predictive", **both, **settings}
    spec = sweep_spec(axes, **{name.replace(".", "__"): value for name, value in given.items()})
    table, cases = sweep(spec, PAIR), SweepCases(spec, PAIR)
    for number in range(0, len(cases), every):
        assert_same(table, number, simulate(cases.spec_of(number), PAIR))


@pytest.mark.parametrize("given", [{"resume": True}, {"overwrite": True}])
def test_what_is_for_a_folder_needs_one(given):
    with pytest.raises(ValueError, match="`out` must name a folder"):
        vttig_jax.sweep(sweep_spec(), PAIR, **given)


def test_a_run_folder_is_read_by_its_own_room():
    spec = sweep_spec(rig={"from": "RUN"})
    with pytest.raises(ScenarioError, match="here give its flank model as `maps`"):
        sweep(spec, PAIR)


def test_groups_are_those_of_the_texts(table):
    names = [name for name, _ in table.groups()]
    assert names == list(CONTROLLERS)
    found = table.to_json()["groups"]
    assert [group["cases"] for group in found] == [1] * 12  # the file lists its turns
    shares = {name: [g["interfering_share"] for g in found if name in g["name"]] for name in names}
    assert max(shares["none"] + shares["predictive"]) == 0.0 < max(shares["acceleration"])
    text = str(table)
    assert "12: 4 motion.reversal_deg, 3 controller" in text and "-0.0000" not in text


@pytest.mark.parametrize(("dwell_s", "cases"), [(0.1, 2048), (400.0, 256), (1e5, 64)])
def test_long_runs_come_in_small_blocks(dwell_s, cases):
    """What an interruption loses is bounded by time, not by cases."""
    spec = sweep_spec({"motion.reversal_deg": [200.0, 250.0]}, motion__dwell_s=dwell_s)
    work = SweepWork(SweepCases(spec, PAIR))
    assert work.block_size == cases

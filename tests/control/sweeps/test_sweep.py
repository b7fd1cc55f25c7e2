"""Sweeps against `simulate`, case by case."""

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest
from msgspec import structs

import vttig_jax
from tests.control.scenarios import PAIR, SHORT, spec_of
from tests.control.sweep_files import (
    AXES,
    CONTROLLERS,
    assert_close,
    drawn,
    small_blocks,
    sweep_spec,
)
from vttig_jax.base.errors import InputError, ScenarioError
from vttig_jax.control import Maps, sweep
from vttig_jax.control.controllers.controller import Controller
from vttig_jax.control.simulation.case import METRICS
from vttig_jax.control.sweeps import sweep as sweep_work
from vttig_jax.control.sweeps.sweep import SweepCases, SweepWork, lanes_for
from vttig_jax.control.sweeps.table import SweepTable
from vttig_jax.kinematics import closed_model
from vttig_jax.pair.gear_pair import Eccentricities
from vttig_jax.rig.paper import paper_eccentricities


@pytest.fixture(scope="module")
def table() -> SweepTable:
    return vttig_jax.sweep(sweep_spec(), PAIR)


def row(table: SweepTable, case: int) -> dict[str, Any]:
    return {name: values[case].item() for name, values in table.columns.items()}


def assert_as_simulated(table: SweepTable, cases: SweepCases, number: int) -> None:
    """A row is what `simulate` says of its case."""
    assert_same(table, number, vttig_jax.simulate(cases.spec_of(number), PAIR).metrics)


def assert_same(table: SweepTable, number: int, found: dict[str, Any]) -> None:
    seen = row(table, number)
    assert seen["case"] == number and seen["outcome"] == found["outcome"]
    for name in METRICS:
        expected = np.nan if found[name] is None else found[name]
        np.testing.assert_allclose(seen[name], expected, rtol=0, atol=1e-9, err_msg=name)


def test_every_row_is_what_simulate_says(table):
    cases = SweepCases(sweep_spec(), PAIR)
    runs = [vttig_jax.simulate(cases.spec_of(number), PAIR) for number in range(len(cases))]
    for number, run in enumerate(runs):
        assert_same(table, number, run.metrics)
    assert table.lane_steps == sum(run.to_json()["samples"] for run in runs)  # no filled lanes
    with pytest.raises(AssertionError):  # the check can fail
        assert_as_simulated(table, SweepCases(sweep_spec(motion__speed_rpm=55.0), PAIR), 4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "axes"),
    [
        (
            {"plant": "play", "controller": "none", "motion__event": "aborted"},
            {"motion.ramp_s": [0.1, 0.12]},
        ),
        (
            {"plant": "elastic", "sampling__plant_hz": 4000.0, "flanks": "closed"},
            {"mesh.damping_ratio": [0.1, 0.5], "actuator.delay_s": [0.002, 0.003]},
        ),
        (
            {
                "plant": "play",
                "judgement__observer": "difference",
                "motion__kind": "s_curve",
                # Angles of a ramp are halves of counts at many samples of 1 ms; these are not.
                "driving_encoder__amplitude_arcsec": 5.0,
                "driving_encoder__phase_deg": 60.0,
                "driven_encoder__amplitude_arcsec": 5.0,
                "driven_encoder__phase_deg": 60.0,
            },
            {"seed": [0, 3], "driving_encoder.noise_arcsec": [0.0, 20.0]},
        ),
    ],
)
def test_other_options_are_those_of_simulate_too(settings, axes):
    spec = sweep_spec(axes, **settings)
    table, cases = vttig_jax.sweep(spec, PAIR), SweepCases(spec, PAIR)
    for number in range(len(cases)):
        assert_as_simulated(table, cases, number)


def test_axes_combine_with_the_first_one_slowest(table):
    expected = itertools.product(AXES["motion.reversal_deg"], AXES["controller"])
    seen = zip(table.columns["motion.reversal_deg"], table.columns["controller"], strict=True)
    assert list(seen) == list(expected)
    assert table.axes == tuple(AXES)
    assert list(table.columns) == ["case", *AXES, *METRICS, "outcome"]


def test_zipped_axes_advance_together():
    axes = {"motion.ramp_s": [0.1, 0.2], "controller": ["none", "predictive"], "seed": [0, 1]}
    cases = SweepCases(sweep_spec(axes | {"zip": [["motion.ramp_s", "seed"]]}), PAIR)
    seen = [tuple(cases.values(number).values()) for number in range(len(cases))]
    assert seen == [
        (0.1, "none", 0),
        (0.1, "predictive", 0),
        (0.2, "none", 1),
        (0.2, "predictive", 1),
    ]


def test_a_case_that_cannot_run_stops_nothing(table):
    axes = {**AXES, "motion.reversal_deg": [200.0, 10.0, 300.0, 360.0]}
    found = vttig_jax.sweep(sweep_spec(axes), PAIR)
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
        vttig_jax.sweep(sweep_spec({"motion.reversal_deg": [1.0, 2.0]}), PAIR)


@pytest.mark.portable
def test_blocks_and_lanes_leave_no_trace(table, monkeypatch):
    small_blocks(1, monkeypatch)
    monkeypatch.setattr(sweep_work, "LANES", 8)
    found = vttig_jax.sweep(sweep_spec(), PAIR)
    assert list(found.columns) == list(table.columns)
    for name, values in table.columns.items():
        assert_close(found.columns[name], values)


TURNS = {"motion.reversal_deg": [200.0, 300.0]}


OTHER = Eccentricities(0.01, 20.0, 0.02, 100.0, 0.05)


@pytest.mark.slow
def test_drawn_maps_run_through_all_other_cases():
    """Each draw is a plant of its own, and all controllers have the one map of the run."""
    spec = sweep_spec(TURNS, controller="predictive", rig={"from": "RUN"})
    maps = drawn(paper_eccentricities(), paper_eccentricities(), OTHER)
    found = sweep(spec, PAIR, maps=maps)
    assert found.axes == ("draw", *TURNS)
    np.testing.assert_array_equal(found.columns["draw"], [0, 0, 1, 1])
    for number, rig in enumerate((paper_eccentricities(),) * 2 + (OTHER,) * 2):
        turn = TURNS["motion.reversal_deg"][number % 2]
        one = spec_of(SHORT, {"controller": "predictive", "motion.reversal_deg": turn})
        plant = closed_model(PAIR, rig)
        run = vttig_jax.simulate(one, PAIR, plant_map=plant, controller_map=maps.named["RUN"])
        assert_same(found, number, run.metrics)


def test_controllers_have_the_map_they_are_given():
    one = paper_eccentricities()
    wrong = dataclasses.replace(one, constant_backlash_deg=0.036)
    spec = sweep_spec(TURNS, controller="predictive", rig={"from": "RUN"})
    left = [
        sweep(spec, PAIR, maps=drawn(believed, one)).columns["residual_gap_deg"]
        for believed in (one, wrong)
    ]
    np.testing.assert_allclose(left[1] - left[0], 0.002, atol=1e-6)


@pytest.mark.slow
def test_the_backlash_that_is_believed_of_a_map_is_an_axis():
    believed = [0.030, 0.038, 0.046]
    axis = {"map.constant_backlash_deg": believed}
    spec = sweep_spec(axis, controller="predictive", plant_map="RUN", eccentricities=None)
    plant = closed_model(PAIR, paper_eccentricities())
    found = sweep(spec, PAIR, maps=Maps({"RUN": plant}))
    for number, gap in enumerate(believed):
        one = spec_of(SHORT, {"controller": "predictive", "map.constant_backlash_deg": gap})
        one = structs.replace(one, plant_map="RUN", eccentricities=None)
        run = vttig_jax.control.simulate(one, PAIR, maps=Maps({"RUN": plant}))
        assert_same(found, number, run.metrics)
    assert np.ptp(found.columns["residual_gap_deg"]) > 0.005


def test_a_map_is_read_with_one_backlash():
    with pytest.raises(ScenarioError, match=r"sweep map\.constant_backlash_deg"):
        sweep_spec({"constant_backlash_deg": [0.03, 0.04]}, plant_map="RUN")


def test_cases_without_a_gap_are_refused():
    spec = sweep_spec({"eccentricities.constant_backlash_deg": [0.001, 0.038]}, controller="none")
    found = sweep(spec, PAIR)
    assert found.columns["outcome"].tolist() == ["refused", "ok"]


def test_a_controller_of_your_own():
    class Half(Controller):
        shift_mm: float

        def start(self):
            return ()

        def step(self, state, seen):
            import jax.numpy as jnp

            return state, jnp.where(seen.time > 0.5, self.shift_mm, 0.0)

    axes = {"motion.reversal_deg": [300.0, 360.0]}
    found = vttig_jax.sweep(sweep_spec(axes), PAIR, controller=Half(0.1))
    np.testing.assert_allclose(found.columns["actuator_travel_mm"], 0.1, atol=1e-9)
    with pytest.raises(ScenarioError, match="controller of your own"):
        vttig_jax.sweep(sweep_spec(), PAIR, controller=Half(0.1))


def test_new_values_compile_nothing():
    def swept(first: float) -> SweepTable:
        axes = {"motion.reversal_deg": [first, 300.0], "judgement.margin_mm": [0.0, 0.1 * first]}
        return vttig_jax.sweep(sweep_spec(axes), PAIR)

    first, second = swept(200.0), swept(222.0)
    assert second.compile_s == 0.0 < first.compile_s or first.compile_s == second.compile_s == 0.0
    assert not np.array_equal(first.columns["jump_deg"], second.columns["jump_deg"])


@pytest.mark.slow
def test_numbers_that_switch_a_part_on_are_axes_like_others():
    """Noise, a force limit or a static friction of zero beside others; plant steps, a queue."""
    axes = {
        "motion.kind": ["trapezoid", "s_curve"],
        "driving_encoder.noise_arcsec": [0.0, 1.0],
        "actuator.force_limit_N": [0.0, 5.0],
        "friction.stribeck_Nm": [0.0, 0.05],
        "actuator.delay_s": [0.0, 0.003],
        "sampling.plant_hz": [0.0, 2000.0],
    }
    spec = sweep_spec(axes, controller="predictive")
    table, cases = vttig_jax.sweep(spec, PAIR), SweepCases(spec, PAIR)
    for number in range(0, len(cases), 9):
        assert_as_simulated(table, cases, number)


@pytest.mark.parametrize(
    ("cases", "devices", "lanes"), [(1, 1, 8), (9, 1, 16), (17, 2, 16), (9, 2, 8)]
)
def test_lanes_are_powers_of_two_that_occupy_all_devices(cases, devices, lanes):
    assert lanes_for(cases, devices) == lanes
    assert lanes_for(10**9, devices) == 512


# What is too large.


def test_a_sweep_larger_than_memory_is_refused_before_it_begins():
    axes = {
        "motion.reversal_deg": {"from": 200, "to": 300, "num": 10**7},
        "motion.ramp_s": {"from": 0.1, "to": 0.2, "num": 10**4},
    }
    with pytest.raises(InputError, match=r"100000000000 cases need .* GB are free"):
        vttig_jax.sweep(sweep_spec(axes), PAIR)


def test_the_estimate_is_told_before_the_first_block():
    told: list[Any] = []
    done: list[tuple[float, ...]] = []
    table = vttig_jax.sweep(
        sweep_spec(),
        PAIR,
        announce=lambda *size: told.append(size),
        progress=lambda *now: done.append((len(told), *now)),
    )
    ((text, lane_steps),) = told
    assert lane_steps == pytest.approx(table.lane_steps, rel=0.01)
    assert "12 cases" in text
    assert {now[0] for now in done} == {1} and done[-1][1] == table.lane_steps


# Wrong arguments.


@pytest.mark.parametrize("given", [{"resume": True}, {"overwrite": True}])
def test_what_is_for_a_folder_needs_one(given):
    with pytest.raises(ValueError, match="`out` must name a folder"):
        vttig_jax.sweep(sweep_spec(), PAIR, **given)


def test_more_devices_than_there_are():
    with pytest.raises(ValueError, match=r"`devices` must be 1 … \d+.*prepare_cpu"):
        vttig_jax.sweep(sweep_spec(), PAIR, devices=1000)


def test_a_scenario_without_axes_is_no_sweep():
    with pytest.raises(ScenarioError, match="names its axes"):
        vttig_jax.sweep(spec_of(), PAIR)


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

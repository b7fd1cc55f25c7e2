"""Controllers that have to find out in which turn of the hunting period they are."""

import math

import equinox as eqx
import numpy as np
import pytest

from tests.control.scenarios import PAIR, SHORT, case_of, spec_of
from tests.control.sweep_files import sweep_spec
from vttig_jax.base.units import DEG, REV
from vttig_jax.control import Scenario, recorded, simulate, sweep
from vttig_jax.control.simulation.prepare import located_turns
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.rig.paper import paper_eccentricities


def run(controller="predictive", turn="unknown", counts=90_000):
    """22.5° lie between the turns of the paper's pair."""
    settings = {"controller": controller, "judgement.turn": turn}
    return simulate(spec_of(SHORT, settings, {"driven_encoder.counts_per_rev": counts}), PAIR)


@pytest.mark.parametrize("controller", ["acceleration", "predictive", "feedforward"])
def test_without_a_turn_no_controller_starts(controller):
    found, idle = run(controller), run("none")
    assert found.outcome == "unlocated" and idle.outcome == "ok"
    assert found.metrics["actuator_travel_mm"] == 0.0
    assert found.metrics["jump_deg"] == idle.metrics["jump_deg"]


def test_one_reading_of_both_shafts_is_as_good_as_a_reference_unless_its_counts_are_too_coarse():
    known, located = run(turn="known", counts=900), run(turn="located", counts=900)
    assert located.outcome == "ok" and located.metrics == known.metrics
    assert run(turn="located", counts=12).outcome == "unlocated"


@pytest.mark.slow
def test_a_sweep_says_it_case_by_case():
    spec = sweep_spec({"judgement.turn": ["known", "located", "unknown"]}, controller="predictive")
    assert sweep(spec, PAIR).columns["outcome"].tolist() == ["ok", "ok", "unlocated"]


def error(turn: int, slipped_deg: float) -> int | None:
    """By how many turns the location is wrong if the driven encoder slipped by an angle."""
    case, off = case_of(spec_of(SHORT, {"flanks": "closed"}), PAIR), slipped_deg * DEG
    bounds = eqx.tree_at(lambda one: one.offset, case.bounds, replace_fn=lambda o: o + off)
    model = exact_model(PAIR, paper_eccentricities())
    motion = recorded(np.array([0.0, 1.0]), turn * REV + np.array([1.0, 2.0]))
    return located_turns(Scenario(PAIR, motion=motion, plant_map=bounds, controller_map=model))


@pytest.mark.parametrize("turn", [0, 3, 15, 16, 21])
def test_it_is_right_wherever_the_run_starts(turn):
    assert error(turn, 0.0) == 0


def test_a_driven_encoder_that_slipped_leads_to_the_map_of_another_turn_or_to_none():
    # After 22.5° the driven shaft is where it is one turn of sixteen later.
    off = error(0, 22.5)
    assert off not in (0, None)
    assert math.remainder(45 / 80 * off * 360.0 - 22.5, 360.0) == pytest.approx(0.0, abs=1e-9)
    assert error(0, 11.25) is None

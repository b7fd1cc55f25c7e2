"""Controllers that have to find out in which turn of the hunting period they are."""

import math

import equinox as eqx
import pytest

import vttig_jax
from tests.control.scenarios import PAIR, SHORT, case_of, spec_of
from vttig_jax.base.units import DEG, REV
from vttig_jax.control.controllers.turn_location import turn_error
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.rig.paper import paper_eccentricities

AHEAD = {"controller": "predictive"}


def run(**values):
    dotted = {name.replace("__", "."): value for name, value in values.items()}
    return vttig_jax.simulate(spec_of({**SHORT, **AHEAD, **dotted}), PAIR)


@pytest.mark.slow
def test_one_reading_of_both_shafts_is_as_good_as_a_reference():
    known, located = run(), run(judgement__turn="located")
    assert located.outcome == "ok" and located.metrics == known.metrics


@pytest.mark.parametrize("controller", ["acceleration", "predictive", "feedforward"])
def test_without_a_turn_no_controller_starts(controller):
    found = run(judgement__turn="unknown", controller=controller)
    idle = run(controller="none")
    assert found.outcome == "unlocated" and "refuses to start" in found.remarks[-1]
    assert found.metrics["actuator_travel_mm"] == 0.0
    assert found.metrics["jump_deg"] == idle.metrics["jump_deg"]
    assert run(judgement__turn="unknown", controller="none").outcome == "ok"


def test_encoders_too_coarse_to_tell_the_turns_apart():
    """22.5° between the turns of the paper's pair: one of 12 counts is 30°, one of 900 is 0.4°."""
    coarse = {"judgement__turn": "located", "driven_encoder__counts_per_rev": 12}
    assert run(**coarse).outcome == "unlocated"
    assert run(**coarse | {"driven_encoder__counts_per_rev": 900}).outcome == "ok"


@pytest.mark.slow
def test_a_sweep_says_it_case_by_case():
    from tests.control.sweep_files import sweep_spec

    axes = {"judgement.turn": ["known", "located", "unknown"]}
    spec = sweep_spec(axes, controller="predictive")
    assert vttig_jax.sweep(spec, PAIR).columns["outcome"].tolist() == ["ok", "ok", "unlocated"]


def parts():
    case = case_of(spec_of(SHORT, {"flanks": "closed"}), PAIR)
    sensors = case.driving_encoder, case.driven_encoder
    return exact_model(PAIR, paper_eccentricities()), case.bounds, sensors


def slipped(bounds, degrees: float):
    """Flanks whose driven encoder slipped."""
    return eqx.tree_at(lambda one: one.offset, bounds, bounds.offset + degrees * DEG)


@pytest.mark.parametrize("turn", [0, 3, 15, 16, 21])
def test_it_is_right_wherever_the_run_starts(turn):
    model, bounds, sensors = parts()
    assert turn_error(PAIR, model, bounds, sensors, turn * REV + 1.0, 0) == 0


def test_a_driven_encoder_that_slipped_by_a_turn_leads_to_the_wrong_map():
    """What is certain may be wrong: the map is then the one of the turn that was found."""
    model, bounds, sensors = parts()
    # 22.5° is where the driven shaft is one turn of sixteen later.
    off = turn_error(PAIR, model, slipped(bounds, 22.5), sensors, 1.0, 0)
    assert off not in (0, None)
    step = math.remainder(45 / 80 * off * 360.0 - 22.5, 360.0)
    assert step == pytest.approx(0.0, abs=1e-9)


def test_readings_that_fit_no_turn_are_refused():
    model, bounds, sensors = parts()
    assert turn_error(PAIR, model, slipped(bounds, 11.25), sensors, 1.0, 0) is None

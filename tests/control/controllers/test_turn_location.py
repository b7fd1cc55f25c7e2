"""Controllers that have to find out in which turn of the hunting period they are."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from vttig_jax.control.plants.flank_bounds import bounds_of

import vttig_jax
from tests.control.scenarios import PAIR, SHORT, spec_of
from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.control.controllers.turn_location import turn_error
from vttig_jax.control.simulation.build import Builder, case_of
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.rig.paper import paper_eccentricities

AHEAD = {"controller": "predictive"}
ANGLES = jnp.linspace(-40.0, 130.0, 57)


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
    assert found.outcome == "unlocated" and "refuses to start" in found.remarks[0]
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
    spec = spec_of(SHORT)
    case = case_of(spec, PAIR)
    sensors = case.driving_sensor, case.driven_sensor
    return exact_model(PAIR, paper_eccentricities()), case.bounds, sensors


@pytest.mark.parametrize("turn", [0, 3, 15, 16, 21])
def test_it_is_right_wherever_the_run_starts(turn):
    model, bounds, sensors = parts()
    assert turn_error(PAIR, model, bounds, sensors, turn * REV + 1.0, 0) == 0


def test_a_driven_encoder_that_slipped_by_a_turn_leads_to_the_wrong_map():
    """What is certain may be wrong: the map is then the one of the turn that was found."""
    model, _, sensors = parts()
    slipped = bounds_of(model, PAIR.taper / PAIR.reference_radii[1])
    moved = slipped.offset + 22.5 * DEG  # where the driven shaft is one turn of sixteen later
    wrong = type(slipped)(
        slipped.ratio, moved, slipped.cosine, slipped.sine, slipped.closing, slipped.terms
    )
    off = turn_error(PAIR, model, wrong, sensors, 1.0, 0)
    assert off not in (0, None)
    step = math.remainder(45 / 80 * off * 360.0 - 22.5, 360.0)
    assert step == pytest.approx(0.0, abs=1e-9)


def test_readings_that_fit_no_turn_are_refused():
    model, bounds, sensors = parts()
    half = type(bounds)(
        bounds.ratio, bounds.offset + 11.25 * DEG, bounds.cosine, bounds.sine, bounds.closing,
        bounds.terms,
    )  # fmt: skip
    assert turn_error(PAIR, model, half, sensors, 1.0, 0) is None


@pytest.mark.parametrize("turns", [-3, 0, 1, 16])
def test_flanks_some_turns_later(turns):
    bounds = Builder(PAIR).case(spec_of()).bounds
    later, direct = bounds.turned(turns).at(ANGLES), bounds.at(ANGLES + turns * REV)
    for found, expected in zip(jax.tree.leaves(later), jax.tree.leaves(direct), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15 * abs(turns) + 1e-15)
    assert turns % 16 == 0 or not np.allclose(
        bounds.turned(turns).gap(ANGLES), bounds.gap(ANGLES), atol=ARCSEC
    )

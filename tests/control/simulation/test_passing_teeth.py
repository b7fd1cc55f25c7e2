"""The predictive controller with a map that has teeth: it closes by gaps that it can open again."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

from vttig_jax.control import (
    Predictive,
    Reversal,
    Scenario,
    build_case,
    parse_scenario_spec,
    run,
)
from vttig_jax.control.simulation.build import Maps
from vttig_jax.kinematics.flank_table import tabulate_flanks
from vttig_jax.rig import paper_rig

RIG = paper_rig()
MODEL: Any = RIG.flank_model()
MAPS = {"rig": MODEL, "file": tabulate_flanks(MODEL, RIG.pair.hunting_turns, per_turn=360)}
MARGIN_DEG = 0.01 * 0.0751  # judgement.margin_mm times backlash per displacement


def case(reversal_deg, believed="rig", **changes):
    motion = {"reversal_deg": reversal_deg, "dwell_s": 0.1, **changes.pop("motion", {})}
    table = {"pair": "pair.toml", "plant_map": "rig", "controller_map": believed, "motion": motion}
    spec = parse_scenario_spec({**table, "controller": "predictive", **changes})
    return build_case(spec, RIG.pair, maps=Maps(MAPS))


SLOW = {"actuator": {"speed_mm_s": 5.0, "acceleration_mm_s2": 200.0}}


@pytest.mark.parametrize(("believed", "changes"), [("rig", {}), ("file", {}), ("rig", SLOW)])
def test_teeth_that_pass_quickly_are_not_closed_too_far(believed, changes):
    one = case(1153.9, believed, **changes)
    careless = eqx.tree_at(lambda c: c.retreat, one, None)
    found, before = (run(each).metrics for each in (one, careless))
    assert found["interference_mm"] < 1e-4 and before["interference_mm"] > 0.005
    assert found["residual_gap_deg"] < 1.05 * MARGIN_DEG


def test_with_a_quick_actuator_the_teeth_change_nothing():
    quick = {"speed_mm_s": 1e4, "acceleration_mm_s2": 1e7}
    one = case(1153.9, actuator=quick)
    careless = eqx.tree_at(lambda c: c.retreat, one, None)
    gaps = [float(run(each).metrics["residual_gap_deg"]) for each in (one, careless)]
    assert gaps[0] == pytest.approx(gaps[1], abs=1e-12)


def test_objects_with_a_traced_map_look_at_the_teeth_too():
    def metrics(more):
        waves = MODEL.orders.cosine
        model = eqx.tree_at(lambda m: m.orders.cosine, MODEL, jnp.asarray(waves) * (1 + more))
        motion = Reversal(reversal_deg=1153.9, dwell_s=0.1)
        scenario = Scenario(RIG.pair, motion=motion, controller=Predictive(), plant_map=model)
        return run(scenario).metrics

    found, filed = jax.jit(metrics)(0.0), run(case(1153.9)).metrics
    for name in ("residual_gap_deg", "interference_mm", "actuator_travel_mm"):
        assert float(found[name]) == pytest.approx(float(filed[name]), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("believed", ["exact", "closed"])
def test_a_map_without_teeth_needs_no_look_at_them(believed):
    rig = {"driving_mm": 0.0226, "driving_phase_deg": 49.5, "driven_mm": 0.0273}
    rig |= {"driven_phase_deg": 79.3, "constant_backlash_deg": 0.038}
    table = {"pair": "pair.toml", "eccentricities": rig, "flanks": believed}
    spec = parse_scenario_spec({**table, "controller": "predictive"})
    assert build_case(spec, RIG.pair).retreat is None

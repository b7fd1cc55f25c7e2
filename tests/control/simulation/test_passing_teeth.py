"""The predictive controller with a map that has teeth: it closes by gaps that it can open again."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.control.texts import MINIMAL
from vttig_jax.control import (
    Predictive,
    Reversal,
    Scenario,
    build_case,
    parse_scenario_spec,
    run,
)
from vttig_jax.control.simulation.prepare import Maps
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


@pytest.mark.parametrize(
    ("believed", "changes"),
    [
        ("rig", {}),
        *[pytest.param(*one, marks=pytest.mark.slow) for one in (("file", {}), ("rig", SLOW))],
    ],
)
def test_teeth_that_pass_quickly_are_not_closed_too_far(believed, changes):
    one = case(1153.9, believed, **changes)
    careless = eqx.tree_at(lambda c: c.retreat, one, None)
    found, before = (run(each).metrics for each in (one, careless))
    assert found["interference_mm"] < 1e-4 and before["interference_mm"] > 0.005
    assert found["residual_gap_deg"] < 1.05 * MARGIN_DEG


def test_the_table_holds_the_least_displacement_ahead_less_what_the_actuator_can_do():
    one, generator = case(1153.9), np.random.default_rng(0)
    retreat: Any = one.retreat
    angle = generator.uniform(0.0, 100.0, 200)
    speed = 10 ** generator.uniform(-2.0, 1.2, 200) * generator.choice([-1.0, 1.0], 200)
    ahead = np.linspace(0.0, 2 * np.pi / RIG.pair.driving.teeth, 1000)
    place = angle[:, None] + np.sign(speed)[:, None] * ahead
    closed = np.asarray(one.believed.closed_at(one.believed.gap(jnp.asarray(place))))
    half = np.maximum(ahead / np.abs(speed)[:, None] - float(one.lead_s), 0.0) / 2
    most, quickest = 20.0, 2000.0  # mm/s and mm/s^2 of the actuator
    moved = np.where(
        half < 2 * most / quickest, quickest * half**2 / 4, most * (half - most / quickest)
    )
    found = jax.vmap(retreat.at)(jnp.asarray(angle), jnp.asarray(speed))
    off = np.asarray(found) - (closed + moved).min(axis=1)
    assert np.abs(off).max() < 0.006 and np.abs(off).mean() < 0.001  # mm, of waves of 0.1 mm
    still = np.asarray(jax.vmap(retreat.at)(jnp.asarray(angle), jnp.zeros(200))) - closed[:, 0]
    assert np.all(still > -1e-5) and still.max() < 0.0012


def test_with_a_quick_actuator_the_teeth_change_nothing():
    quick = {"speed_mm_s": 1e4, "acceleration_mm_s2": 1e7}
    one = case(1153.9, actuator=quick)
    careless = eqx.tree_at(lambda c: c.retreat, one, None)
    gaps = [float(run(each).metrics["residual_gap_deg"]) for each in (one, careless)]
    assert gaps[0] == pytest.approx(gaps[1], abs=1e-12)


@pytest.mark.slow
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
    table = {**MINIMAL, "flanks": believed, "controller": "predictive"}
    spec = parse_scenario_spec(table)
    assert build_case(spec, RIG.pair).retreat is None

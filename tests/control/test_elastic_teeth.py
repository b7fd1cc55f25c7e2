"""Elastic teeth against DOP853 of the same law, the tabled restitution, and energy."""

import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.control.followed import Still, follow, shafts_at
from tests.oracles.elastic_contact import Contact, integrate
from tests.oracles.flank_formulas import closed
from tests.oracles.trapezoid_corners import Corners
from vttig_jax.base.units import ARCSEC
from vttig_jax.control.bounds import bounds_of
from vttig_jax.control.elastic_teeth import ElasticPlant, largest_step, mesh_stiffness
from vttig_jax.control.pieces import trapezoid
from vttig_jax.control.plant import FREE, ON_A, ON_B, Drag
from vttig_jax.kinematics.closed import closed_model
from vttig_jax.pair.eccentricities import Eccentricities
from vttig_jax.rig.paper import paper_pair

STIFFNESS, INERTIA, COULOMB = 2.3e6, 0.01, 0.1
BEGIN, END, SAMPLE = 0.98, 2.1, 1e-3
"""s: from steady motion over the turn at 1.6 s to steady motion backwards."""


@pytest.fixture(scope="module")
def rig():
    pair = paper_pair()
    model = closed_model(pair, Eccentricities(0.0226, 49.5, 0.0273, 79.3, 0.038))
    bounds = bounds_of(model, pair.taper / pair.reference_radii[1])
    return bounds, trapezoid(60.0, 360.0, 0.1, 0.5)


@pytest.fixture(scope="module")
def contact() -> Contact:
    speed = 2 * math.pi
    corners = Corners(
        [0, 0.5, 1.0, 1.5, 1.6, 2.1, 2.6, 3.1], [0, speed, speed, 0, 0, -speed, -speed, 0]
    )
    damping = 2 * 0.1 * math.sqrt(STIFFNESS * INERTIA)
    return Contact(closed(), corners, 0.5625, INERTIA, STIFFNESS, damping, COULOMB)


@pytest.fixture(scope="module")
def reference(contact) -> np.ndarray:
    return integrate(contact, contact.resting(BEGIN), np.arange(BEGIN, END, SAMPLE)).offset


def deviation_arcsec(rig, contact, reference, step: float, damping_ratio: float = 0.1) -> float:
    """Largest over the reversal, of the driven shaft."""
    bounds, motion = rig
    plant = ElasticPlant(Drag(INERTIA, COULOMB), STIFFNESS, damping_ratio)
    offset, drift = contact.resting(BEGIN)
    start = shafts_at(motion, bounds, BEGIN, offset, drift, ON_A)
    each = round(SAMPLE / step)
    count = each * (len(reference) - 1)
    shafts, _ = follow(plant, motion, bounds, start, BEGIN, step, count, each)
    return float(np.abs(np.asarray(shafts.offset) - reference[1:]).max() / ARCSEC)


@pytest.mark.parametrize(("step", "bound"), [(5e-5, 5.0), (2e-5, 0.5), (5e-6, 0.5)])
def test_one_reversal_is_that_of_dop853(rig, contact, reference, step, bound):
    assert deviation_arcsec(rig, contact, reference, step) < bound


def test_smaller_steps_come_closer(rig, contact, reference):
    """Of second order through the impacts, where the torque has a kink."""
    coarse, fine = (deviation_arcsec(rig, contact, reference, step) for step in (5e-5, 2.5e-6))
    assert coarse > 40 * fine


def test_another_damping_is_seen(rig, contact, reference):
    assert deviation_arcsec(rig, contact, reference, 5e-6, damping_ratio=0.2) > 5.0


RESTITUTION = {0.02: 0.941, 0.05: 0.863, 0.1: 0.759, 0.2: 0.614, 0.3: 0.520, 0.5: 0.404, 0.7: 0.333}
"""Of one impact under this law, physics of the mesh."""


def thrown_back(damping_ratio: float, stiffness: float, steps: int = 400) -> float:
    """Speed after an impact on a wall at rest over the speed before."""
    walls, motion = Still(0.0, 1.0).bounds(), trapezoid(1.0, 90.0, 1.0, 0.5)
    plant = ElasticPlant(Drag(INERTIA), stiffness, damping_ratio)
    begin = float(motion.turn_s) - 0.9  # stands still
    start = shafts_at(motion, walls, begin, 1e-9, -1e-3, FREE)
    step = 2 * math.pi / math.sqrt(stiffness / INERTIA) / 100
    shafts, touches = follow(plant, motion, walls, start, begin, step, steps)
    assert touches.side[np.flatnonzero(touches.side)[0]] == ON_A
    return float(shafts.drift[-1]) / 1e-3


@pytest.mark.parametrize(("damping_ratio", "restitution"), RESTITUTION.items())
def test_it_throws_back_as_tabled(damping_ratio, restitution):
    assert thrown_back(damping_ratio, STIFFNESS) == pytest.approx(restitution, abs=2e-3)


def test_restitution_depends_on_the_damping_ratio_alone():
    soft, stiff = (thrown_back(0.1, stiffness) for stiffness in (1e4, 1e9))
    assert soft == pytest.approx(stiff, abs=1e-5)


@given(
    damping_ratio=st.floats(0.1, 3.0),
    share=st.floats(0.05, 1.0),
    depth=st.floats(-1.0, 1.0),
    speed=st.floats(-1.0, 1.0),
)
def test_a_mesh_without_drive_gains_no_energy(damping_ratio, share, depth, speed):
    """Any step up to the longest: what it loses it loses for good."""
    walls, motion = Still(-1e-4, 1e-4).bounds(), trapezoid(1.0, 90.0, 1.0, 0.5)
    plant = ElasticPlant(Drag(INERTIA, 1e-6, 1e-6), STIFFNESS, damping_ratio)
    step = share * largest_step(STIFFNESS, damping_ratio, INERTIA)
    begin = float(motion.turn_s) - 0.9
    start = shafts_at(motion, walls, begin, 2e-4 * depth, speed, FREE)
    shafts, _ = follow(plant, motion, walls, start, begin, step, 300)
    places = np.append(2e-4 * depth, shafts.offset), np.append(speed, shafts.drift)
    pressed = np.maximum(np.abs(places[0]) - 1e-4, 0.0)
    energy = 0.5 * INERTIA * places[1] ** 2 + 0.5 * STIFFNESS * pressed**2
    # A step across the kink of the torque may add a little before the next one takes it again.
    assert energy.max() <= 1.05 * energy[0] + 1e-12
    assert energy[-1] <= (1 + 1e-9) * energy[0]


def test_a_step_twice_as_long_as_allowed_gains_energy():
    walls, motion = Still(-1e-4, 1e-4).bounds(), trapezoid(1.0, 90.0, 1.0, 0.5)
    plant = ElasticPlant(Drag(INERTIA, 1e-6, 1e-6), STIFFNESS, 0.1)
    begin, step = float(motion.turn_s) - 0.9, 2.5 * largest_step(STIFFNESS, 0.1, INERTIA)
    gained = []
    for speed in np.linspace(0.5, 1.0, 40):
        start = shafts_at(motion, walls, begin, 0.0, speed, FREE)
        shafts, _ = follow(plant, motion, walls, start, begin, step, 300)
        pressed = np.maximum(np.abs(shafts.offset) - 1e-4, 0.0)
        energy = 0.5 * INERTIA * shafts.drift**2 + 0.5 * STIFFNESS * pressed**2
        gained.append(energy.max() / (0.5 * INERTIA * speed**2))
    assert max(gained) > 1.2


def test_it_never_pulls():
    plant = ElasticPlant(Drag(INERTIA), STIFFNESS, 50.0)
    depths, rates = np.meshgrid(np.linspace(-1e-5, 1e-5, 21), np.linspace(-1.0, 1.0, 21))
    torque = np.asarray(plant.push(jnp.asarray(depths), jnp.asarray(rates)))
    assert torque.min() == 0.0 and np.all(torque[depths <= 0] == 0)
    assert np.all(torque <= 2 * STIFFNESS * np.maximum(depths, 0) * (1 + 1e-12))


def test_stiffness_of_the_paper():
    assert mesh_stiffness(20.0, 20.0, 75.18) == pytest.approx(2.26e6, rel=1e-3)


def test_the_longest_step_shrinks_with_stiffness_and_damping():
    base = largest_step(STIFFNESS, 0.1, INERTIA)
    assert largest_step(4 * STIFFNESS, 0.1, INERTIA) == pytest.approx(base / 2)
    assert largest_step(STIFFNESS, 3.0, INERTIA) < base


def test_touches_both_flanks(rig, contact):
    """The crossing is met at flank B, with the gap there."""
    bounds, motion = rig
    plant = ElasticPlant(Drag(INERTIA, COULOMB), STIFFNESS, 0.1)
    offset, drift = contact.resting(BEGIN)
    start = shafts_at(motion, bounds, BEGIN, offset, drift, ON_A)
    _, touches = follow(plant, motion, bounds, start, BEGIN, 2e-5, 40_000)
    first = np.flatnonzero(touches.side == ON_B)[0]
    gap = float(bounds.gap(jnp.asarray(touches.angle[first])))
    assert touches.gap[first] == pytest.approx(gap, abs=1e-12)
    walls = replace(contact).walls
    assert gap == pytest.approx(
        walls[1](touches.angle[first])[0] - walls[0](touches.angle[first])[0], abs=1e-12
    )

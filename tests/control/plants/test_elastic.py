"""Elastic teeth against DOP853 of the same law, rigid teeth, and what a mesh may do with energy."""

import itertools
import math
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.control.followed import Still, at_rest, follow, shafts_at, shafts_of, told_of
from tests.control.parts import elastic, rigid, trapezoid
from tests.oracles.elastic_contact import Contact, Path, integrate
from tests.oracles.flank_formulas import PAPER, closed
from tests.oracles.trapezoid_corners import Corners
from vttig_jax.base.units import ARCSEC
from vttig_jax.control.plants.elastic import largest_step, mesh_stiffness
from vttig_jax.control.plants.plant import FREE, ON_A, ON_B, Drag, Slide

SPEED = 2 * math.pi
STIFFNESS, RATIO, INERTIA, COULOMB = 2.3e6, 0.1, 0.01, 0.05
SAMPLE = 1e-3
TURN = 2.0
"""s: 60 rpm to 540°, where the shaft turns without standing still."""

CORNERS = Corners([0, 0.5, 1.5, 2, 2.5, 3.5, 4], [0, SPEED, SPEED, 0, -SPEED, -SPEED, 0])
DWELL = Corners([0, 0.5, 1.5, 2, 2.05, 2.55, 3.55], [0, SPEED, SPEED, 0, 0, -SPEED, -SPEED])
"""The same with 0.05 s of standstill, where friction holds the driven shaft."""


def contact(motion: Corners, stiffness=STIFFNESS, damping_ratio=RATIO, **values: Any) -> Contact:
    damping = 2 * damping_ratio * math.sqrt(stiffness * INERTIA)
    drag: dict[str, Any] = {"coulomb": COULOMB} | values
    return Contact(closed(), motion, PAPER.ratio, INERTIA, stiffness, damping, **drag)


def sampled(begin: float, end: float) -> np.ndarray:
    return begin + SAMPLE * np.arange(round((end - begin) / SAMPLE) + 1)


@pytest.fixture(scope="module")
def reversal() -> Path:
    """One reversal ± 0.5 s: seconds of DOP853, for all tests of this file."""
    oracle, times = contact(CORNERS), sampled(TURN - 0.5, TURN + 0.5)
    return integrate(oracle, oracle.resting(times[0]), times)


def run(bounds, oracle: Contact, times: np.ndarray, step: float, plant=None):
    """Shafts at the times of the oracle, from steady contact on flank A; touches of all steps."""
    dwell = 0.05 if oracle.motion is DWELL else 0.0
    motion = trapezoid(60.0, 540.0, dwell, 0.5)
    start = shafts_at(motion, bounds, times[0], *oracle.resting(times[0]), ON_A)
    if plant is None:
        drag = Drag(INERTIA, oracle.coulomb, oracle.viscous, load=oracle.load)
        ratio = oracle.damping / (2 * math.sqrt(oracle.stiffness * INERTIA))
        plant = elastic(drag, oracle.stiffness, ratio)
    each = round(SAMPLE / step)
    return follow(plant, motion, bounds, start, times[0], step, each * (len(times) - 1), each)


def arcsec(shafts, path: Path, every: int = 1) -> float:
    """Largest difference at the samples of a run that may be shorter than the path."""
    expected = path.offset[every::every][: len(shafts.offset)]
    return float(np.abs(shafts.offset - expected).max() / ARCSEC)


def test_one_reversal_is_that_of_dop853(bounds, reversal):
    """In arcsec; the steps are 15, 1.5 and 0.15 radians of the contact's oscillation."""
    oracle, found = contact(CORNERS), []
    for step, end, bound in ((1e-3, 0.5, 0.01), (1e-4, 0.5, 0.002), (1e-5, -0.36, 1e-5)):
        shafts, _ = run(bounds, oracle, sampled(TURN - 0.5, TURN + end), step)
        assert arcsec(shafts, reversal) < bound
        found.append(np.abs(shafts.offset[:140] - reversal.offset[1:141]).max())
    # Over the first five impacts the error falls with the step, at least in proportion.
    assert found[0] > 5 * found[1] > 25 * found[2]
    # At 5 ms, 75 radians a step, an impact takes less than a tenth of a step.
    begin, plant = TURN - 0.5, elastic(Drag(INERTIA, COULOMB), STIFFNESS, RATIO)
    motion = trapezoid(60.0, 540.0, 0.0, 0.5)
    start = shafts_at(motion, bounds, begin, *oracle.resting(begin), ON_A)
    shafts, _ = follow(plant, motion, bounds, start, begin, 5e-3, 200)
    assert arcsec(shafts, reversal, every=5) < 1.0


def test_impacts_are_located(bounds, reversal):
    times = sampled(TURN - 0.5, TURN + 0.5)
    shafts, touches = run(bounds, contact(CORNERS), times, SAMPLE)
    entries = [
        time
        for (_, before), (time, mode) in itertools.pairwise(reversal.pieces)
        if mode.b == "stiff" and before.b == "free"
    ]
    met = np.flatnonzero(touches.side)
    assert np.all(touches.side[met] == ON_B)
    for place, time in zip(met[:8], entries[:8], strict=True):
        assert times[place] <= time <= times[place + 1]
        assert touches.angle[place] == pytest.approx(CORNERS.at(time)[0], abs=1e-5)
        low, high = (wall(float(touches.angle[place]))[0] for wall in closed())
        assert touches.gap[place] == pytest.approx(high - low, abs=1e-12)
    first = touches.angle[met[0]]
    assert first == pytest.approx(CORNERS.at(entries[0])[0], abs=1e-8)
    depth = np.maximum(shafts.flanks.lower - shafts.offset, shafts.offset - shafts.flanks.upper)
    np.testing.assert_array_equal(shafts.side != FREE, depth > 0)


def test_standstill_load_and_viscous_friction(bounds):
    """Friction takes over in the dwell and gives way after it."""
    oracle = contact(DWELL, viscous=5e-3, load=0.02)
    times = sampled(TURN - 0.12, TURN + 0.13)
    path = integrate(oracle, oracle.resting(times[0]), times)
    assert any(mode.slip == 0 for _, mode in path.pieces)
    for step, bound in ((1e-3, 0.2), (1e-4, 0.1)):
        shafts, _ = run(bounds, oracle, times, step)
        assert arcsec(shafts, path) < bound
    without = replace(oracle, load=0.0)
    assert arcsec(run(bounds, without, times, SAMPLE)[0], path) > 1.0


def test_rigid_teeth_are_the_limit_of_growing_stiffness(bounds):
    times = sampled(TURN - 0.5, TURN + 0.5)
    limit, _ = run(bounds, contact(CORNERS), times, SAMPLE, rigid(Drag(INERTIA, COULOMB), 0.759))
    found = []
    for stiffness in (1e4, 1e6, 1e8, 1e10):
        shafts, _ = run(bounds, contact(CORNERS, stiffness), times, SAMPLE)
        found.append(np.abs(shafts.offset - limit.offset).max() / ARCSEC)
    assert found[0] > 5 * found[1] > 5 * found[2]
    # What is left is the third digit of the restitution.
    assert found[3] < 1.0


@given(
    damping_ratio=st.sampled_from([0.0, 0.02, 0.3, 1.0, 3.0]) | st.floats(0.0, 100.0),
    stiffness=st.sampled_from([1e3, 1e5, 2.3e6, 1e9]),
    step=st.sampled_from([1e-6, 3e-5, 2e-4, 1e-3, 5e-3]),
    width=st.sampled_from([0.0, 1e-6, 6e-4, 1e-2]),
    place=st.floats(-0.2, 1.2),
    speed=st.floats(-1.0, 1.0),
)
def test_a_mesh_without_drive_gains_no_energy(damping_ratio, stiffness, step, width, place, speed):
    """The driving shaft stands still: kinetic energy and that of both springs never grow."""
    plant = elastic(Drag(INERTIA), stiffness, damping_ratio)
    offset = width * place + 1e-6 * (place - 0.5)
    walls = Still(0.0, width).bounds()
    shafts, _ = at_rest(plant, walls, (offset, speed, FREE), step, 256)
    energy = 0.5 * INERTIA * np.append(speed, shafts.drift) ** 2
    for inside in (lambda x: -x, lambda x: x - width):
        depth = np.maximum(inside(np.append(offset, shafts.offset)), 0.0)
        energy += 0.5 * stiffness * depth**2
    assert np.all(np.diff(energy) <= 1e-7 * energy[0] + 1e-24)
    if damping_ratio == 0 and width == 1e-2 and step <= 2e-4 and energy[0] > 1e-9:
        assert energy[-1] > 0.999 * energy[0]


def test_stiffness_of_the_paper_and_the_longest_step():
    metres = 20.0e9 * 20.0e-3 * 75.18e-3**2  # 20 N/(mm µm) = 20e9 N/m²
    assert mesh_stiffness(20.0, 20.0, 75.18) == pytest.approx(metres, rel=1e-12)
    base = largest_step(STIFFNESS, RATIO, INERTIA)
    assert math.pi < base / math.sqrt(INERTIA / STIFFNESS) < 2 * math.pi  # it outlasts a contact
    assert largest_step(4 * STIFFNESS, RATIO, INERTIA) == pytest.approx(base / 2)
    assert largest_step(STIFFNESS, 3.0, INERTIA) < base


# While the driving shaft stands still: friction, the wedge, a gap forced shut.


def test_friction_holds_a_shaft_that_a_flank_presses():
    """Less than its torque does not move it, more does."""
    plant, walls = elastic(Drag(INERTIA, 0.05), STIFFNESS, RATIO), Still(0.0, 1e-3).bounds()
    for torque, stays in ((0.049, True), (0.06, False)):
        pressed = -torque / STIFFNESS
        shafts, touches = at_rest(plant, walls, (pressed, 0.0, ON_A), SAMPLE, 256)
        moved = np.abs(shafts.offset - pressed).max()
        assert (moved < 1e-12) == stays
        assert not np.any(touches.side)


@pytest.mark.parametrize("sense", [-1, 1])
def test_the_wedge_takes_a_flank_away_or_presses_the_shaft_on(sense):
    """s moves flank A at 0.01 rad/s, away from the shaft that it presses, or with it."""
    walls, plant = Still(0.0, 1.0).bounds(), elastic(Drag(INERTIA, COULOMB), STIFFNESS, RATIO)
    pressed = 0.04 / STIFFNESS if sense < 0 else 0.0
    shafts, still = shafts_of(walls, offset=-pressed, side=ON_A), told_of(0.0, 0.0)
    step = eqx.filter_jit(lambda a, b: plant.step(a, still, b, walls, jnp.asarray(SAMPLE)))
    for number in range(1, 60):
        ends = np.array([1e-5 * (number - 1), 1e-5 * number, 0.01, 0.01])
        shafts, _ = step(shafts, Slide(*jnp.asarray(sense * ends)))
    if sense < 0:  # friction that held it does not turn it: it stays but for the spring's way back
        assert float(shafts.side) == FREE and abs(float(shafts.drift)) < 1e-12
        assert abs(float(shafts.offset) + pressed) < 1e-12
    else:
        assert float(shafts.drift) == pytest.approx(0.01, abs=1e-9)
        assert float(shafts.offset) == pytest.approx(59e-5 - COULOMB / STIFFNESS, abs=1e-12)


def test_a_gap_forced_shut_holds_the_shaft_between_both_springs():
    """A load tips the balance, by as much as both springs give way together."""
    overlap, load = 2e-6, 0.5
    walls, start = Still(0.0, -overlap).bounds(), (0.0, 0.0, ON_A)
    for torque in (0.0, load, -load):
        plant = elastic(Drag(INERTIA, load=torque), STIFFNESS, RATIO)
        shafts, touches = at_rest(plant, walls, start, SAMPLE, 256)
        expected = -0.5 * overlap - torque / (2 * STIFFNESS)
        np.testing.assert_allclose(shafts.offset, expected, rtol=0, atol=1e-15)
        assert np.all(shafts.side == ON_A) and np.all(touches.side == ON_B)
    pulled = elastic(Drag(INERTIA, load=10.0), STIFFNESS, RATIO)
    shafts, _ = at_rest(pulled, walls, start, SAMPLE, 256)
    # On flank A alone: the other one has come free.
    np.testing.assert_allclose(shafts.offset, -10.0 / STIFFNESS, rtol=1e-12)

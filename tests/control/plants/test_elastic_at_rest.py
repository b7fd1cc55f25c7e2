"""Elastic teeth while the driving shaft stands still: friction, the wedge, a gap forced shut."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from tests.control.followed import Still, follow, shafts_at
from tests.control.parts import elastic, trapezoid
from vttig_jax.control.plants.plant import FREE, ON_A, ON_B, Drag, Slide

STIFFNESS, RATIO, INERTIA, COULOMB = 2.3e6, 0.1, 0.01, 0.05
SAMPLE, REST = 1e-3, 2.02


def test_friction_holds_a_shaft_that_a_flank_presses():
    """Less than its torque does not move it, more does."""
    walls, motion = Still(0.0, 1e-3).bounds(), trapezoid(60.0, 540.0, 9.0, 0.5)
    plant = elastic(Drag(INERTIA, 0.05), STIFFNESS, RATIO)
    for torque, stays in ((0.049, True), (0.06, False)):
        start = shafts_at(motion, walls, REST, -torque / STIFFNESS, 0.0, ON_A)
        shafts, touches = follow(plant, motion, walls, start, REST, SAMPLE, 256)
        moved = np.abs(shafts.offset - start.offset).max()
        assert (moved < 1e-12) == stays
        assert not np.any(touches.side)


@pytest.mark.parametrize("sense", [-1, 1])
def test_the_wedge_takes_a_flank_away_or_presses_the_shaft_on(sense):
    """s moves flank A at 0.01 rad/s, away from the shaft that it presses, or with it."""
    walls, motion = Still(0.0, 1.0).bounds(), trapezoid(60.0, 540.0, 9.0, 0.5)
    plant = elastic(Drag(INERTIA, COULOMB), STIFFNESS, RATIO)
    pressed = 0.04 / STIFFNESS if sense < 0 else 0.0
    shafts = shafts_at(motion, walls, REST, -pressed, 0.0, ON_A)
    step = eqx.filter_jit(lambda a, b, c: plant.step(a, b, c, walls, jnp.asarray(SAMPLE)))
    for number in range(1, 60):
        ends = np.array([1e-5 * (number - 1), 1e-5 * number, 0.01, 0.01])
        shafts, _ = step(
            shafts, motion.at(REST + SAMPLE * number), Slide(*jnp.asarray(sense * ends))
        )
    if sense < 0:  # friction that held it does not turn it: it stays but for the spring's way back
        assert float(shafts.side) == FREE and abs(float(shafts.drift)) < 1e-12
        assert abs(float(shafts.offset) + pressed) < 1e-12
    else:
        assert float(shafts.drift) == pytest.approx(0.01, abs=1e-9)
        assert float(shafts.offset) == pytest.approx(59e-5 - COULOMB / STIFFNESS, abs=1e-12)


def test_a_gap_forced_shut_holds_the_shaft_between_both_springs():
    """A load tips the balance, by as much as both springs give way together."""
    overlap, load = 2e-6, 0.5
    walls, motion = Still(0.0, -overlap).bounds(), trapezoid(60.0, 540.0, 9.0, 0.5)
    start = shafts_at(motion, walls, REST, 0.0, 0.0, ON_A)
    for torque in (0.0, load, -load):
        plant = elastic(Drag(INERTIA, load=torque), STIFFNESS, RATIO)
        shafts, touches = follow(plant, motion, walls, start, REST, SAMPLE, 256)
        expected = -0.5 * overlap - torque / (2 * STIFFNESS)
        np.testing.assert_allclose(shafts.offset, expected, rtol=0, atol=1e-15)
        assert np.all(shafts.side == ON_A) and np.all(touches.side == ON_B)
    pulled = elastic(Drag(INERTIA, load=10.0), STIFFNESS, RATIO)
    shafts, _ = follow(pulled, motion, walls, start, REST, SAMPLE, 256)
    # On flank A alone: the other one has come free.
    np.testing.assert_allclose(shafts.offset, -10.0 / STIFFNESS, rtol=1e-12)

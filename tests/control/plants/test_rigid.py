"""Rigid teeth against event-driven bouncing, impacts worked out by hand, and friction."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.control.followed import OPEN, Still, at_rest, follow, shafts_at
from tests.control.parts import rigid
from tests.oracles.flank_formulas import PAPER, closed
from tests.oracles.rigid_bouncing import Flown, Rig, fly
from tests.oracles.trapezoid_corners import Corners
from vttig_jax.base.units import ARCSEC
from vttig_jax.control.plants.plant import FREE, ON_A, ON_B, Drag

SPEED = 2 * math.pi
CORNERS = Corners([0, 0.5, 1.5, 2, 2.1, 2.6, 3.6, 4.1], [0, SPEED, SPEED, 0, 0, -SPEED, -SPEED, 0])
INERTIA, COULOMB = 0.01, 0.05
BEGIN, END, SAMPLE = 1.45, 2.55, 1e-3
"""From steady motion over the turn into the way back."""


def flown(restitution: float) -> Flown:
    """The oracle from steady contact on flank A."""
    times = BEGIN + SAMPLE * np.arange(round((END - BEGIN) / SAMPLE) + 1)
    oracle = Rig(closed(), CORNERS, PAPER.ratio, INERTIA, COULOMB, restitution)
    return fly(oracle, oracle.wall(0, BEGIN), times, 0)


def followed(rig, restitution: float, step: float = SAMPLE):
    bounds, motion = rig
    angle, speed, _ = CORNERS.at(BEGIN)
    error, slope = closed()[0](angle)
    start = shafts_at(motion, bounds, BEGIN, error, slope * speed, ON_A)
    each, samples = round(SAMPLE / step), round((END - BEGIN) / SAMPLE)
    plant = rigid(Drag(INERTIA, COULOMB), restitution)
    return follow(plant, motion, bounds, start, BEGIN, step, each * samples, each)


@pytest.mark.parametrize(("restitution", "bound"), [(0.0, 1e-6), (0.3, 1e-6), (0.9, 1.5)])
def test_one_reversal_is_that_of_the_event_driven_oracle(rig, restitution, bound):
    """In arcsec at 1 ms. With 0.9 it still bounces when the motion stands still.

    A shaft that friction stops within a step is stopped evenly over all of it, so that the error
    of what bounces then falls with the step.
    """
    reference = flown(restitution)
    (shafts, touches), (fine, _) = (followed(rig, restitution, step) for step in (1e-3, 1e-4))
    for found, most in ((shafts, bound), (fine, max(0.2 * bound, 1e-6))):
        assert np.abs(found.offset - reference.offset[1:]).max() / ARCSEC < most
    met = np.flatnonzero(touches.side)[: {0.0: 1, 0.3: 2, 0.9: 6}[restitution]]
    for place, (time, flank, _) in zip(met, reference.impacts[: len(met)], strict=True):
        assert touches.side[place] == (ON_A, ON_B)[flank]
        assert touches.angle[place] == pytest.approx(CORNERS.at(time)[0], abs=1e-6)
        low, high = (wall(float(touches.angle[place]))[0] for wall in closed())
        assert touches.gap[place] == pytest.approx(high - low, abs=1e-12)
    if restitution == 0:
        assert np.all(shafts.side[met[0] :] == ON_B)


def ball(speed: float, restitution: float, width: float, time: float) -> tuple[float, float]:
    """Place and speed of a ball that leaves the lower of two walls at rest `width` apart."""
    place, sense = 0.0, 1.0
    while speed > 0 and width / speed <= time:
        time -= width / speed
        place, sense, speed = width - place, -sense, speed * restitution
    return place + sense * speed * time, sense * speed


@given(
    restitution=st.sampled_from([0.0, 0.3, 0.9, 1.0]),
    speed=st.floats(0.05, 2.0),
    place=st.integers(0, 99),
)
@example(restitution=0.3, speed=2.0, place=5)  # the impact falls on the end of a step
@example(restitution=0.9, speed=1.0, place=12)
def test_between_walls_at_rest_it_is_a_ball(restitution, speed, place):
    walls, plant = Still(0.0, 0.01).bounds(), rigid(Drag(INERTIA), restitution)
    shafts, _ = at_rest(plant, walls, (0.0, speed, FREE), SAMPLE, 100)
    expected, rate = ball(speed, restitution, 0.01, (place + 1) * SAMPLE)
    assert shafts.offset[place] == pytest.approx(expected, abs=1e-12)
    assert shafts.drift[place] == pytest.approx(rate, abs=1e-12)


@pytest.mark.slow
def test_gradients_are_those_of_differences_in_flight_and_through_an_impact(rig):
    bounds, motion = rig

    def after(begin, above, drift):
        """x a step later."""
        start = shafts_at(motion, bounds, begin, 0.0, 0.0, FREE)
        start = replace(start, offset=start.flanks.lower + above, drift=drift)
        plant, ahead = rigid(Drag(INERTIA, COULOMB), 0.3), motion.at(begin + SAMPLE)
        return plant.step(start, ahead, OPEN, bounds, jnp.asarray(SAMPLE))[0].offset

    # Flight, impact on A, flight, impact on B.
    cases = np.array([[0.3, 1e-4, 0.02], [0.3, 1e-5, -0.05], [2.4, 4e-4, 0.01], [2.4, 2e-4, 0.6]])
    batch = jax.jit(jax.vmap(after))
    slopes = jax.jit(jax.vmap(jax.grad(after, argnums=(1, 2))))(*cases.T)
    for place, step in ((1, 1e-7), (2, 1e-5)):
        ahead, behind = (
            np.asarray(batch(*(cases + s * step * np.eye(3)[place]).T)) for s in (1, -1)
        )
        differences = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(slopes[place - 1], differences, rtol=1e-5, atol=1e-9)
    assert slopes[0][0] == pytest.approx(1.0) and slopes[0][1] < 0.0  # thrown back: later, less far

"""Rigid teeth against event-driven bouncing, impacts worked out by hand, and friction."""

import math
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.control.followed import OPEN, Still, follow, shafts_at
from tests.control.parts import rigid, trapezoid
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


def times() -> np.ndarray:
    return BEGIN + SAMPLE * np.arange(round((END - BEGIN) / SAMPLE) + 1)


def flown(restitution: float, coulomb: float = COULOMB) -> Flown:
    """The oracle from steady contact on flank A."""
    oracle = Rig(closed(), CORNERS, PAPER.ratio, INERTIA, coulomb, restitution)
    return fly(oracle, oracle.wall(0, BEGIN), times(), 0)


def followed(rig, restitution: float, step: float, coulomb: float = COULOMB):
    bounds, motion = rig
    angle, speed, _ = CORNERS.at(BEGIN)
    error, slope = closed()[0](angle)
    start = shafts_at(motion, bounds, BEGIN, error, slope * speed, ON_A)
    each = round(SAMPLE / step)
    plant = rigid(Drag(INERTIA, coulomb), restitution)
    return follow(plant, motion, bounds, start, BEGIN, step, each * (len(times()) - 1), each)


@pytest.mark.parametrize(("restitution", "bound"), [(0.0, 1e-6), (0.3, 1e-6), (0.9, 1.5)])
def test_one_reversal_is_that_of_the_event_driven_oracle(rig, restitution, bound):
    """In arcsec at 1 ms. With 0.9 it still bounces when the motion stands still.

    A shaft that friction stops within a step is stopped evenly over all of it, so that the error
    of what bounces then falls with the step.
    """
    reference = flown(restitution).offset[1:]
    found = [
        np.abs(followed(rig, restitution, step)[0].offset - reference).max() / ARCSEC
        for step in (1e-3, 1e-4)
    ]
    assert found[0] < bound
    assert found[1] < max(0.2 * bound, 1e-6)


def test_a_wrong_restitution_is_seen(rig):
    shafts, _ = followed(rig, 0.3, 1e-3)
    assert np.abs(shafts.offset - flown(0.31).offset[1:]).max() > 0.5 * ARCSEC
    assert np.abs(shafts.offset - flown(0.3, 0.051).offset[1:]).max() > 0.5 * ARCSEC


@pytest.mark.parametrize("restitution", [0.3, 0.9])
def test_the_first_impacts_are_located(rig, restitution):
    reference = flown(restitution).impacts
    _, touches = followed(rig, restitution, 1e-3)
    met = np.flatnonzero(touches.side)
    count = 2 if restitution == 0.3 else 6
    for place, (time, flank, _) in list(zip(met, reference, strict=False))[:count]:
        assert touches.side[place] == (ON_A, ON_B)[flank]
        assert touches.angle[place] == pytest.approx(CORNERS.at(time)[0], abs=1e-6)
        low, high = (wall(float(touches.angle[place]))[0] for wall in closed())
        assert touches.gap[place] == pytest.approx(high - low, abs=1e-12)


def test_without_restitution_the_first_impact_is_the_only_one(rig):
    shafts, touches = followed(rig, 0.0, 1e-3)
    met = np.flatnonzero(touches.side)
    assert touches.side[met[0]] == ON_B
    first = flown(0.0).impacts[0]
    assert touches.angle[met[0]] == pytest.approx(CORNERS.at(first[0])[0], abs=1e-9)
    assert np.all(shafts.side[met[0] :] == ON_B)


REST = 2.05
"""s: the driving shaft stands still."""


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
    walls, motion = Still(0.0, 0.01).bounds(), trapezoid(60.0, 540.0, 0.5, 0.5)
    start = shafts_at(motion, walls, REST, 0.0, speed, FREE)
    plant = rigid(Drag(INERTIA), restitution)
    shafts, _ = follow(plant, motion, walls, start, REST, SAMPLE, 100)
    expected, rate = ball(speed, restitution, 0.01, (place + 1) * SAMPLE)
    assert shafts.offset[place] == pytest.approx(expected, abs=1e-12)
    assert shafts.drift[place] == pytest.approx(rate, abs=1e-12)


def test_the_ball_tells_restitutions_apart():
    assert abs(ball(1.0, 0.3, 0.01, 0.1)[0] - ball(1.0, 0.301, 0.01, 0.1)[0]) > 1e-6


def test_an_impact_at_constant_driving_speed():
    """The wall moves with i ω₁: the driven shaft leaves it with i ω₁ (1 + ε) more than it lost."""
    walls, motion = Still(0.0, 0.02).bounds(), trapezoid(60.0, 540.0, 0.1, 0.5)
    restitution, gap = 0.5, 0.015
    # At rest 0.015 rad ahead of flank A, which comes with 2π rad/s (the ratio is 1).
    start = shafts_at(motion, walls, 0.7, gap, -SPEED, FREE)
    plant = rigid(Drag(INERTIA), restitution)
    shafts, touches = follow(plant, motion, walls, start, 0.7, SAMPLE, 5)
    meets = gap / SPEED
    place = int(meets / SAMPLE)
    np.testing.assert_array_equal(np.flatnonzero(touches.side), [place])
    assert touches.angle[place] == pytest.approx(CORNERS.at(0.7 + meets)[0], abs=1e-12)
    assert touches.gap[place] == pytest.approx(0.02, abs=1e-15)
    drift = np.where(np.arange(5) < place, -SPEED, restitution * SPEED)
    np.testing.assert_allclose(shafts.drift, drift, atol=1e-12)
    after = restitution * SPEED * (SAMPLE * (place + 1) - meets)
    assert shafts.offset[place] == pytest.approx(after, abs=1e-13)


@given(
    speed=st.floats(-1.0, 1.0).filter(lambda v: abs(v) > 1e-6),
    coulomb=st.floats(0.01, 1.0),
    viscous=st.floats(0.0, 0.1),
    stribeck=st.floats(0.0, 0.5),
)
def test_friction_stops_it_and_never_turns_it(speed, coulomb, viscous, stribeck):
    walls, motion = Still(-10.0, 10.0).bounds(), trapezoid(60.0, 540.0, 1.5, 0.5)
    start = shafts_at(motion, walls, REST, 0.0, speed, FREE)
    plant = rigid(Drag(INERTIA, coulomb, viscous, stribeck), 0.5)
    steps = int(abs(speed) * INERTIA / coulomb / SAMPLE) + 3
    shafts, _ = follow(plant, motion, walls, start, REST, SAMPLE, 1010)
    drift = shafts.drift * np.sign(speed)
    assert np.all(drift >= -1e-15) and np.all(np.diff(drift) <= 1e-15)
    assert np.all(np.abs(drift[min(steps, 1009) :]) < 1e-12)
    if viscous == 0 and stribeck == 0:
        way = speed * abs(speed) * INERTIA / (2 * coulomb)
        assert shafts.offset[-1] == pytest.approx(way, abs=abs(speed) * SAMPLE)


def test_without_friction_it_is_not_stopped():
    walls, motion = Still(-10.0, 10.0).bounds(), trapezoid(60.0, 540.0, 1.5, 0.5)
    start = shafts_at(motion, walls, REST, 0.0, 0.5, FREE)
    shafts, _ = follow(rigid(Drag(INERTIA), 0.5), motion, walls, start, REST, SAMPLE, 1000)
    assert shafts.offset[-1] == pytest.approx(0.5, abs=1e-12)


def _after(rig, restitution):
    """x a step later, as a function of time, place above flank A, and rate."""
    bounds, motion = rig

    @eqx.filter_jit
    def after(begin, above, drift):
        start = shafts_at(motion, bounds, begin, 0.0, 0.0, FREE)
        start = replace(start, offset=start.flanks.lower + above, drift=drift)
        ahead = motion.at(begin + SAMPLE)
        plant = rigid(Drag(INERTIA, COULOMB), restitution)
        return plant.step(start, ahead, OPEN, bounds, jnp.asarray(SAMPLE))[0].offset

    return after


CASES = np.array([[0.3, 1e-4, 0.02], [0.3, 1e-5, -0.05], [2.4, 4e-4, 0.01], [2.4, 2e-4, 0.6]])
"""Flight, impact on A, flight, impact on B."""


def test_one_step_is_the_same_compiled_and_batched(rig):
    after = _after(rig, 0.3)
    with jax.disable_jit():
        single = [float(after(*jnp.asarray(case))) for case in CASES]
    batch = jax.vmap(after)(*jnp.asarray(CASES).T)
    np.testing.assert_allclose(batch, single, rtol=0, atol=1e-15)
    assert np.ptp(single) > 1e-4


def test_gradients_are_those_of_differences_in_flight_and_through_an_impact(rig):
    after = _after(rig, 0.3)
    slopes = jax.vmap(jax.grad(after, argnums=(1, 2)))(*jnp.asarray(CASES).T)
    for place, step in ((1, 1e-7), (2, 1e-5)):
        ahead, behind = (CASES + sense * step * np.eye(3)[place] for sense in (1, -1))
        both = (
            np.array([after(*jnp.asarray(case)) for case in cases]) for cases in (ahead, behind)
        )
        differences = np.subtract(*both) / (2 * step)
        np.testing.assert_allclose(slopes[place - 1], differences, rtol=1e-5, atol=1e-9)
    assert np.asarray(slopes[0])[0] == pytest.approx(1.0)
    assert np.asarray(slopes[0])[1] < 0.0  # thrown back: later met, less far

"""Play against the closed form of the play operator, and the flank it meets against brentq."""

import math
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from tests.control.followed import OPEN, Still, follow, shafts_at
from tests.control.parts import trapezoid
from tests.oracles.flank_formulas import PAPER, closed
from tests.oracles.play_operator import by_samples, by_turns
from tests.oracles.trapezoid_corners import Corners
from vttig_jax.control.plants.plant import FREE, ON_A, ON_B, Play, Slide

SPEED = 2 * math.pi
TURN = math.radians(540.0)
CORNERS = Corners([0, 0.5, 1.5, 2, 2.1, 2.6, 3.6, 4.1], [0, SPEED, SPEED, 0, 0, -SPEED, -SPEED, 0])
"""60 rpm to 540° and back, ramps of 0.5 s, 0.1 s of standstill."""
WALLS = closed()
STEP = 1e-3


def run(rig, step: float, above: float = 0.0, end: float = 4.1):
    """From rest at zero, `above` flank A by that."""
    bounds, motion = rig
    start = shafts_at(motion, bounds, 0.0, WALLS[0](0.0)[0] + above, 0.0, FREE if above else ON_A)
    steps = round(end / step)
    shafts, touches = follow(Play(), motion, bounds, start, 0.0, step, steps)
    return step * np.arange(1, steps + 1), shafts, touches


@pytest.mark.parametrize("above", [0.0, 2e-4])
@pytest.mark.parametrize("step", [1e-3, 2.5e-2])
def test_it_is_the_closed_form_at_the_samples(rig, step, above):
    """x from the turns of the motion alone."""
    time, shafts, _ = run(rig, step, above)
    begin = WALLS[0](0.0)[0] + above
    angles = np.array([CORNERS.at(float(t))[0] for t in time])
    turned = [
        by_turns(WALLS, PAPER.ratio, [0.0] if t <= 2.0 else [0.0, TURN], angle, begin)
        for t, angle in zip(time, angles, strict=True)
    ]
    expected = np.array(turned) - PAPER.ratio * angles
    np.testing.assert_allclose(shafts.offset, expected, rtol=0, atol=2e-14)


def root(flank: int, held: float, low: float, high: float) -> float:
    """Driving angle at which a flank meets the driven shaft, which stands at an angle."""
    off = lambda angle: PAPER.ratio * angle + WALLS[flank](angle)[0] - held  # noqa: E731
    return float(np.asarray(brentq(off, low, high, xtol=1e-15)))


@pytest.mark.parametrize(("step", "above"), [(1e-3, 0.0), (1e-2, 0.0), (1e-3, 2e-4)])
def test_a_flank_is_met_where_brentq_finds_it(rig, step, above):
    """Flank B after the turn; flank A first where the driving shaft has 2e-4 rad to take up."""
    _, shafts, touches = run(rig, step, above, end=1.0 if above else 4.1)
    (met,) = np.flatnonzero(touches.side)
    if above:
        angle = root(0, WALLS[0](0.0)[0] + above, 0, 0.01)
        assert np.all(shafts.side[met:] == ON_A) and np.all(shafts.side[:met] == FREE)
    else:
        angle = root(1, PAPER.ratio * TURN + WALLS[0](TURN)[0], TURN - 0.02, TURN)
        gap = WALLS[1](angle)[0] - WALLS[0](angle)[0]
        assert touches.gap[met] == pytest.approx(gap, abs=1e-9)
    assert touches.side[met] == (ON_A if above else ON_B)
    assert touches.angle[met] == pytest.approx(angle, abs=1e-9)


def test_the_wedge_closes_the_gap_and_takes_the_shaft_along(rig):
    """At rest; s moves flank A up by s tan β_L/R₂ and flank B down by s tan β_R/R₂."""
    bounds, motion = rig
    begin = 2.05
    low, high = (wall(TURN)[0] for wall in WALLS)
    start = shafts_at(motion, bounds, begin, low, 0.0, ON_A)
    mm = 0.9 * (high - low) / float(bounds.closing_sum)
    slide = Slide(*map(jnp.asarray, (0.0, mm, mm / STEP, mm / STEP)))
    ahead = motion.at(jnp.asarray(begin + STEP))
    shafts, touch = Play().step(start, ahead, slide, bounds, np.float64(STEP))
    assert float(shafts.offset) == pytest.approx(low + mm * float(bounds.closing[0]), abs=1e-14)
    assert float(shafts.side) == ON_A and float(touch.side) == FREE
    rate = float(bounds.closing[0]) * mm / STEP
    assert float(shafts.drift) == pytest.approx(rate, rel=1e-9)


walk = st.lists(st.integers(-64, 64).map(lambda n: n / 1024), min_size=30, max_size=30)


@eqx.filter_jit
def _walked(bounds, angles, offset):
    """x on a walk from angle to angle, a step each."""

    def one(shafts, angle):
        rate = (angle - shafts.angle) / STEP
        ahead = replace(trapezoid(60.0, 540.0, 0.1, 0.5).at(0.0), angle=angle, speed=rate)
        shafts, _ = Play().step(shafts, ahead, OPEN, bounds, jnp.asarray(STEP))
        return shafts, (shafts.offset, shafts.flanks)

    motion = trapezoid(60.0, 540.0, 0.1, 0.5)
    start = shafts_at(motion, bounds, 0.0, offset, 0.0, FREE)
    return jax.lax.scan(one, start, angles)[1]


@given(walk, st.integers(0, 64))
def test_any_walk_is_clipped_and_never_moved_without_a_push(rig, moves, place):
    bounds, _ = rig
    low, high = (wall(0.0)[0] for wall in WALLS)
    begin = low + (high - low) * place / 64
    angles = np.cumsum(moves)
    offset, flanks = _walked(bounds, jnp.asarray(angles), jnp.asarray(begin))
    expected = by_samples(WALLS, PAPER.ratio, angles, begin) - PAPER.ratio * angles
    np.testing.assert_allclose(offset, expected, rtol=0, atol=1e-14)
    assert np.all((offset >= flanks.lower) & (offset <= flanks.upper))


def test_pushed_by_a_flank_it_forgets_where_it_was_and_in_the_gap_it_does_not(rig):
    bounds, motion = rig

    def after(begin, offset):
        start = shafts_at(motion, bounds, begin, offset, 0.0, FREE)
        return (
            Play().step(start, motion.at(begin + STEP), OPEN, bounds, jnp.asarray(STEP))[0].offset
        )

    begins = jnp.asarray([0.3, 2.3, 2.0505])
    offsets = jnp.asarray([WALLS[0](CORNERS.at(float(t))[0])[0] + 1e-4 for t in begins])
    slopes = jax.jit(jax.vmap(jax.grad(after, argnums=1)))(begins, offsets)
    np.testing.assert_array_equal(slopes, [0.0, 0.0, 1.0])


def test_a_closed_gap_hands_over_where_the_motion_turns():
    walls, motion = Still(0.0, 0.0).bounds(), trapezoid(60.0, 540.0, 0.1, 0.5)
    start = shafts_at(motion, walls, 1.9, 0.0, 0.0, ON_A)
    shafts, touches = follow(Play(), motion, walls, start, 1.9, STEP, 300)
    assert np.all(shafts.offset == 0.0)
    backwards = shafts.speed < 0
    assert np.all(shafts.side[backwards] == ON_B) and np.all(shafts.side[:99] == ON_A)
    met = np.flatnonzero(touches.side == ON_B)
    assert np.all(touches.gap[met] == 0.0)
    np.testing.assert_allclose(touches.angle[met], TURN, rtol=0, atol=1e-4)

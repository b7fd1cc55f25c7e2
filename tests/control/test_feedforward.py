"""The jump of the motor: what it makes up for, what it leaves, and whom it needs."""

import itertools
from typing import Any, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import vttig_jax
from tests.control.parts import at
from tests.control.scenarios import CLOSING, INSTANT, PAIR, samples_of, simulated, spec_of
from tests.control.sweep_files import sweep_spec
from vttig_jax.base.errors import ScenarioError
from vttig_jax.base.units import DEG
from vttig_jax.control.controllers.controller import (
    Command,
    Controller,
    Feedforward,
    Measurement,
)
from vttig_jax.control.simulation.simulate import simulate
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.flank_table import FirstOrderBounds
from vttig_jax.rig.paper import paper_eccentricities

RATIO = 45 / 80
BASE = {"plant": "play", "motion.reversal_deg": 400.0, "motion.dwell_s": 0.1}
OURS = {**BASE, "controller": "feedforward"}
JUMPS = (0.02, 0.005, 0.001)


@pytest.fixture(scope="module")
def jumps() -> list[Any]:
    """The same reversal with jumps of `JUMPS`."""
    return [simulated(OURS, {"judgement.jump_s": jump_s}) for jump_s in JUMPS]


@pytest.fixture(scope="module")
def none() -> Any:
    return simulated(BASE, {"controller": "none"})


def flank(name: str, angle) -> np.ndarray:
    """TE by the exact kinematics, no harmonics."""
    return np.asarray(_flank(name, jnp.atleast_1d(angle)))


def _flank(name, angle):
    return exact_model(PAIR, paper_eccentricities()).transmission_error(angle, name)


def root(function, low: float, high: float) -> float:
    return float(np.asarray(brentq(function, low, high, xtol=1e-15)))


def test_after_the_jump_the_driven_shaft_is_where_the_old_flank_would_have_it(jumps, none):
    found = []
    for run, jump_s in zip((*jumps, none), (*JUMPS, 0.05), strict=True):
        samples, turn = samples_of(run), float(run.case.motion.turn_s)
        asked = at(run.case.motion, samples.time).angle
        driven = samples.error + RATIO * samples.driving
        error = np.abs(driven - RATIO * asked - flank("A", samples.driving))
        found.append(error[samples.time > turn + jump_s + 0.004])
        early = samples.time <= turn  # until then it is the motion itself
        np.testing.assert_allclose(samples.driving[early], asked[early], rtol=0, atol=1e-14)
    assert max(error.max() for error in found[:-1]) < 3e-9
    assert found[-1].min() > 0.005 * DEG  # all the backlash there is
    lost = [run.metrics["lost_motion_deg"] for run in (none, *jumps)]
    assert all(a > b > 0 for a, b in itertools.pairwise(lost)) and lost[0] > 1000 * lost[1]
    since = float(jumps[-1].accumulators.crossing_s) - float(none.case.motion.turn_s)
    assert 0.001 < since < 0.003  # told after one period, crossed within the next
    # Who moves no motor neither makes up nor throws.
    assert none.metrics["over_compensation_deg"] is none.metrics["thrown_back_deg"] is None


def test_the_jump_of_the_transmission_error_stays(jumps, none):
    for run in (*jumps, none):
        crossing = float(run.accumulators.crossing)
        gap = float((flank("B", crossing) - flank("A", crossing))[0])
        assert run.metrics["jump_deg"] * DEG == pytest.approx(gap, abs=1e-9)
        assert run.metrics["actuator_travel_mm"] == 0.0


def test_without_it_the_lost_motion_is_that_of_the_play_operator(none):
    """The driven shaft stands still until flank B is met, and follows that flank."""
    turn = 400.0 * DEG
    held = RATIO * turn + float(flank("A", turn)[0])
    crossing = root(
        lambda angle: RATIO * angle + float(flank("B", angle)[0]) - held, turn - 0.01, turn
    )
    time = samples_of(none).time[samples_of(none).time > float(none.case.motion.turn_s)]
    asked = at(none.case.motion, time)
    driven = np.minimum(held, RATIO * asked.angle + flank("B", asked.angle))
    lost = np.abs(driven - RATIO * asked.angle - flank("A", asked.angle))
    mean = np.average(lost, weights=np.abs(asked.speed))
    assert none.metrics["lost_motion_deg"] * DEG == pytest.approx(mean, abs=1e-9)
    braking = 2 * np.pi / 0.5  # the ramp back is as steep
    since = float(none.accumulators.crossing_s) - float(none.case.motion.turn_s)
    exactly = np.sqrt(2 * (turn - crossing) / braking)
    assert exactly <= since < exactly + 0.001  # the first sample after it


@pytest.mark.slow
@pytest.mark.parametrize("more", [-0.01, 0.004])
def test_the_sign_of_the_compensation_is_told(more):
    """Believed less true gap; only too much has a remark, in a run and in a sweep."""

    def believed(angle, name):
        return _flank(name, angle) + more * DEG * (name == "B")

    found = vttig_jax.simulate(spec_of(OURS), PAIR, controller_map=believed)
    assert found.metrics["over_compensation_deg"] == pytest.approx(more, abs=5e-5)
    assert len(found.remarks) == (more > 0)
    spec = sweep_spec({"seed": [0]}, **{k.replace(".", "__"): v for k, v in OURS.items()})
    table = vttig_jax.sweep(spec, PAIR, controller_map=believed)
    assert table.to_json()["groups"][0]["over_share"] == (more > 0)


def test_a_jump_that_throws_the_driven_shaft_back_is_told():
    """A quick jump hits it, and it flies on until its friction stops it."""
    found = [
        simulate(spec_of(OURS, {"plant": plant, "judgement.jump_s": jump_s}), PAIR)
        for plant, jump_s in (("rigid", 0.002), ("rigid", 0.05), ("play", 0.002))
    ]
    gap: Any = found[0].metrics["largest_jump_deg"]
    quick, slow, play = (cast(float, run.metrics["thrown_back_deg"]) / gap for run in found)
    assert quick > 0.8 and slow < 0.1 and play < 1e-6
    assert len(found[0].remarks) == 1 and found[1].remarks == ()


def test_a_jump_that_does_not_end_within_the_run_is_told():
    run = simulate(spec_of(OURS), PAIR)
    # It is no controller that misses a turn, and says what it is about.
    assert run.outcome == "ok" and run.remarks == ()
    assert "lost motion" in str(run) and "closing begins" not in str(run)
    rest = float(run.case.motion.duration_s) - float(run.case.motion.turn_s)
    for jump_s, remarks in ((1.1 * rest, 1), (0.9 * rest, 0)):
        found = simulate(spec_of(OURS, {"judgement.jump_s": jump_s}), PAIR)
        assert len(found.remarks) == remarks


def test_a_gap_that_is_closed_before_the_turn_is_crossed_at_once_and_a_slow_down_loses_nothing():
    run: Any = simulated(BASE, INSTANT, {"judgement.margin_mm": -1.0})
    slow = simulated(BASE, {"motion.event": "slow_down", "motion.reversal_deg": 600.0})
    # Both flanks touch: rounding tells which is met first, a sample earlier or later.
    assert float(run.accumulators.crossing_s) < float(run.case.motion.turn_s) + 0.001
    assert abs(run.metrics["residual_gap_deg"]) < 1e-12
    assert slow.metrics["lost_motion_deg"] is None


# The controller alone.

MEAN, SWING = 7e-4, 4e-4
BOUNDS = FirstOrderBounds(
    ratio=RATIO, offset=np.array([0.0, MEAN]), cosine=np.array([[0.0, 0.0], [SWING, 0.0]]),
    sine=np.zeros((2, 2)), closing=np.full(2, 0.5 * CLOSING),
)  # fmt: skip


def advances(speeds) -> np.ndarray:
    """What it asks for, period by period, of a motion with these speeds around 1 rad."""
    controller, found = Feedforward(0.004), []
    state, step = controller.start(), eqx.filter_jit(controller.step)
    for number, speed in enumerate(speeds):
        given_ = map(jnp.asarray, (number * 1e-3, 0.0, 0.0, 0.0, 0.0, 1.0, speed))
        state, command = step(state, Measurement(*given_, map=BOUNDS, delay=np.zeros(())))
        assert float(command.shift) == 0.0
        found.append(float(command.advance))
    return np.array(found)


def test_it_crosses_by_the_gap_once_the_motion_goes_back_and_returns_once_it_goes_on():
    back = advances([0.0, 1.0, 0.0, *[-1e-3] * 12])
    np.testing.assert_array_equal(back[:3], 0.0)
    shares = np.array([0.25, 0.5, 0.75, 1.0])
    ramp = shares**3 * (10 - 15 * shares + 6 * shares**2)
    # −j/i with j where the shaft then is, solved anew.
    whole = root(lambda a: a + (MEAN + SWING * np.cos(1.0 + a)) / RATIO, -0.01, 0.0)
    np.testing.assert_allclose(back[3:7], ramp * whole, atol=1e-6)
    np.testing.assert_allclose(back[-1], whole, atol=2e-9)
    again = advances([*[-1e-3] * 12, 0.0, 0.0, *[1e-3] * 12])
    np.testing.assert_allclose(again[12:14], again[11], atol=2e-9)  # a standstill has no sense
    assert again[-1] == 0.0
    assert np.all(advances([1.0, 0.0, -1e-12, 1e-12, -1e-12]) == 0.0)  # nor has its rounding


# A controller of somebody else.


class Back(Controller):
    """Runs behind by a fixed angle once told to go back."""

    advances = True
    closes = False

    def start(self):
        return ()

    def step(self, state, seen) -> Any:
        return state, Command(0.0, jnp.where(seen.reference_speed < 0, -1e-3, 0.0))


class Unannounced(Back):
    advances = False


class Lost(Unannounced):
    """Commands what is no number."""

    def step(self, state, seen):
        return state, jnp.nan * seen.driving


class Single(Unannounced):
    """Forgets its state."""

    def step(self, state, seen):
        return 1.0


@pytest.mark.slow
def test_anybody_may_move_the_motor():
    found = simulated(BASE, controller=Back())
    assert found.outcome == "ok"
    samples = samples_of(found)
    ahead = samples.driving - at(found.case.motion, samples.time).angle
    turn = float(found.case.motion.turn_s)
    assert np.abs(ahead[samples.time <= turn]).max() < 1e-12
    back = (samples.time > turn + 0.01) & (samples.time < found.case.motion.duration_s - 0.11)
    np.testing.assert_allclose(ahead[back], -1e-3, atol=1e-12)


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        (Unannounced(), r"must set `advances = True` .* Unannounced does not"),
        (Lost(), r"Lost commands NaN"),
        (Single(), r"state and a command .* Single returns float"),
    ],
)
def test_a_controller_that_errs_is_named(controller, words):
    with pytest.raises(ValueError, match=words):
        simulate(spec_of(BASE), PAIR, controller=controller)


def test_eccentricities_without_a_gap_are_refused():
    """Their flanks cross by 0.02° where both gears have their thick places."""
    spec = spec_of(BASE, {"eccentricities.constant_backlash_deg": 0.001})
    with pytest.raises(ScenarioError, match=r"eccentricities: flank B lies 0\.0\d+° before"):
        simulate(spec, PAIR)

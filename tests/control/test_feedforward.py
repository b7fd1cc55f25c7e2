"""The jump of the motor: what it makes up for, what it leaves, and whom it needs."""

import itertools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import vttig_jax
from tests.control.motion_points import at
from tests.control.scenarios import CLOSING, INSTANT, PAIR, Run, spec_of, together
from tests.control.sweep_files import sweep_spec
from vttig_jax.base.errors import ScenarioError
from vttig_jax.base.units import DEG
from vttig_jax.control.controllers.controller import (
    Command,
    Controller,
    Feedforward,
    Measurement,
    NoController,
)
from vttig_jax.control.simulation.case import metrics_of
from vttig_jax.control.simulation.simulate import simulate
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.flank_table import FirstOrderBounds
from vttig_jax.rig.paper import paper_eccentricities

RATIO = 45 / 80
BASE = {"plant": "play", "motion.reversal_deg": 400.0, "motion.dwell_s": 0.1}
JUMPS = (0.02, 0.005, 0.001)
ANGLES = np.linspace(0.0, 400.0 * DEG, 401)


@pytest.fixture(scope="module")
def jumps() -> list[Run]:
    """The same reversal with jumps of `JUMPS`."""
    ours = {**BASE, "controller": "feedforward"}
    return together([spec_of(ours, {"judgement.jump_s": jump_s}) for jump_s in JUMPS])


@pytest.fixture(scope="module")
def none() -> Run:
    return together([spec_of(BASE, {"controller": "none"})])[0]


def flank(name: str, angle) -> np.ndarray:
    """TE by the exact kinematics, no harmonics."""
    return np.asarray(_flank(name, jnp.atleast_1d(angle)))


def _flank(name, angle):
    return exact_model(PAIR, paper_eccentricities()).transmission_error(angle, name)


def root(function, low: float, high: float) -> float:
    return float(np.asarray(brentq(function, low, high, xtol=1e-15)))


def metrics(run: Run) -> dict[str, float]:
    return {name: float(v) for name, v in metrics_of(run.case, run.tally)[0].items()}


def error(run: Run) -> np.ndarray:
    """φ₂ − i φ_ref − TE_A(φ₁): where the driven shaft is against where flank A would have it."""
    s = run.samples
    asked = at(run.case.motion, s.time).angle
    driven = s.error + RATIO * s.driving
    return driven - RATIO * asked - flank("A", s.driving)


def test_after_the_jump_the_driven_shaft_is_where_the_old_flank_would_have_it(jumps, none):
    for run, jump_s in zip(jumps, JUMPS, strict=True):
        late = run.samples.time > float(run.case.motion.turn_s) + jump_s + 0.004
        assert np.abs(error(run)[late]).max() < 3e-9
    late = none.samples.time > float(none.case.motion.turn_s) + 0.05
    assert np.abs(error(none)[late]).min() > 0.005 * DEG  # all the backlash there is


def test_before_the_turn_it_is_the_motion_itself(jumps, none):
    early = none.samples.time <= float(none.case.motion.turn_s)
    for run in jumps:
        np.testing.assert_array_equal(run.samples.driving[early], none.samples.driving[early])


def test_the_jump_of_the_transmission_error_stays(jumps, none):
    for run in (*jumps, none):
        crossing = float(run.tally.crossing)
        gap = float((flank("B", crossing) - flank("A", crossing))[0])
        assert metrics(run)["jump_deg"] * DEG == pytest.approx(gap, abs=1e-9)
        assert metrics(run)["actuator_travel_mm"] == 0.0


def test_without_it_the_lost_motion_is_that_of_the_play_operator(none):
    """The driven shaft stands still until flank B is met, and follows that flank."""
    turn = 400.0 * DEG
    held = RATIO * turn + float(flank("A", turn)[0])
    crossing = root(
        lambda angle: RATIO * angle + float(flank("B", angle)[0]) - held, turn - 0.01, turn
    )
    time = none.samples.time[none.samples.time > float(none.case.motion.turn_s)]
    asked = at(none.case.motion, time)
    driven = np.minimum(held, RATIO * asked.angle + flank("B", asked.angle))
    lost = np.abs(driven - RATIO * asked.angle - flank("A", asked.angle))
    mean = np.average(lost, weights=np.abs(asked.speed))
    assert metrics(none)["lost_motion_deg"] * DEG == pytest.approx(mean, abs=1e-9)
    braking = 2 * np.pi / 0.5  # the ramp back is as steep
    since = float(none.tally.crossing_s) - float(none.case.motion.turn_s)
    exactly = np.sqrt(2 * (turn - crossing) / braking)
    assert exactly <= since < exactly + 0.001  # the first sample after it


def test_the_faster_the_jump_the_less_is_lost(jumps, none):
    lost = [metrics(run)["lost_motion_deg"] for run in (none, *jumps)]
    assert all(a > b > 0 for a, b in itertools.pairwise(lost)) and lost[0] > 1000 * lost[1]
    since = float(jumps[-1].tally.crossing_s) - float(none.case.motion.turn_s)
    assert 0.001 < since < 0.003  # told after one period, crossed within the next


def test_too_much_is_as_bad_as_too_little():
    """A map with ten times the gap moves the driven shaft as far beyond its flank."""

    def tenfold(angle, name):
        gap = _flank("B", angle) - _flank("A", angle)
        return _flank("A", angle) + 10 * gap * (name == "B")

    spec = spec_of(BASE, {"controller": "feedforward"})
    found: Any = [
        vttig_jax.simulate(spec, PAIR, controller_map=believed).metrics
        for believed in (None, tenfold)
    ]
    right, wrong = found
    mean_gap = float(np.mean(flank("B", ANGLES) - flank("A", ANGLES))) / DEG
    assert wrong["lost_motion_deg"] == pytest.approx(9 * mean_gap, rel=0.1)
    for name in ("lost_motion_deg", "output_error_deg", "output_error_rms_deg"):
        assert wrong[name] > 4 * right[name] > 0


@pytest.mark.slow
@pytest.mark.parametrize("more", [-0.01, 0.0, 0.004])
def test_the_sign_of_the_compensation_is_told(more):
    """Believed less true gap; only too much has a remark, in a run and in a sweep."""

    def believed(angle, name):
        return _flank(name, angle) + more * DEG * (name == "B")

    settings = {**BASE, "controller": "feedforward"}
    found = vttig_jax.simulate(spec_of(settings), PAIR, controller_map=believed)
    assert found.metrics["over_compensation_deg"] == pytest.approx(more, abs=5e-5)
    assert len(found.remarks) == (more > 0)
    spec = sweep_spec({"seed": [0]}, **{k.replace(".", "__"): v for k, v in settings.items()})
    table = vttig_jax.sweep(spec, PAIR, controller_map=believed)
    assert table.to_json()["groups"][0]["over_share"] == (more > 0)


def test_a_jump_that_throws_the_driven_shaft_back_is_told():
    """A quick jump hits it, and it flies on until its friction stops it."""
    rigid = {**BASE, "plant": "rigid", "controller": "feedforward"}
    quick, slow = (
        simulate(spec_of(rigid, {"judgement.jump_s": jump_s}), PAIR) for jump_s in (0.002, 0.05)
    )
    gap = found_number(quick, "largest_jump_deg")
    assert found_number(quick, "thrown_back_deg") > 0.8 * gap
    assert found_number(slow, "thrown_back_deg") < 0.1 * gap
    assert len(quick.remarks) == 1 and slow.remarks == ()
    play = simulate(spec_of(rigid, {"plant": "play", "judgement.jump_s": 0.002}), PAIR)
    assert found_number(play, "thrown_back_deg") < 1e-6 * gap


def test_a_jump_that_does_not_end_within_the_run_is_told():
    given_ = {**BASE, "controller": "feedforward"}
    run = simulate(spec_of(given_), PAIR)
    rest = float(run.case.motion.duration_s) - float(run.case.motion.turn_s)
    for jump_s, remarks in ((1.1 * rest, 1), (0.9 * rest, 0)):
        found = simulate(spec_of(given_, {"judgement.jump_s": jump_s}), PAIR)
        assert len(found.remarks) == remarks


def test_who_moves_no_motor_neither_makes_up_nor_throws(none):
    found = metrics(none)
    assert np.isnan(found["over_compensation_deg"]) and np.isnan(found["thrown_back_deg"])


def found_number(run: Any, name: str) -> float:
    return float(run.metrics[name])


def test_a_gap_that_is_closed_before_the_turn_is_crossed_at_once():
    given_ = {**BASE, **INSTANT, "judgement.margin_mm": -1.0}
    run = together([spec_of(given_, {"controller": "acceleration"})])[0]
    # Both flanks touch: rounding tells which is met first, a sample earlier or later.
    assert float(run.tally.crossing_s) < float(run.case.motion.turn_s) + 0.001
    assert abs(metrics(run)["residual_gap_deg"]) < 1e-12


def test_a_motion_that_never_turns_loses_nothing_that_could_be_named():
    slow = spec_of(BASE, {"motion.event": "slow_down", "motion.reversal_deg": 600.0})
    assert np.isnan(metrics(together([slow])[0])["lost_motion_deg"])


def test_it_is_no_controller_that_misses_a_turn_and_says_what_it_is_about():
    found = simulate(spec_of(BASE, {"controller": "feedforward"}), PAIR)
    assert found.outcome == "ok" and found.remarks == ()
    assert "lost motion" in str(found) and "closing begins" not in str(found)


# The controller alone.

MEAN, SWING = 7e-4, 4e-4
BOUNDS = FirstOrderBounds(
    ratio=RATIO, offset=np.array([0.0, MEAN]), cosine=np.array([[0.0, 0.0], [SWING, 0.0]]),
    sine=np.zeros((2, 2)), closing=np.full(2, 0.5 * CLOSING),
)  # fmt: skip


def advances(speeds, angle: float = 1.0, period: float = 1e-3, jump_s: float = 4e-3) -> np.ndarray:
    """What it asks for, period by period, of a motion with these speeds around an angle."""
    controller, state, found = Feedforward(jump_s), None, []
    state = controller.start()
    step = eqx.filter_jit(controller.step)
    for number, speed in enumerate(speeds):
        given_ = (number * period, 0.0, 0.0, 0.0, 0.0, angle, speed)
        state, command = step(
            state,
            Measurement(*(*map(jnp.asarray, given_), BOUNDS, np.zeros(()))),  # pyright: ignore[reportCallIssue]
        )
        assert float(command.shift) == 0.0
        found.append(float(command.advance))
    return np.array(found)


def whole(angle: float = 1.0) -> float:
    """−j/i with j where the shaft then is, solved anew."""
    return root(lambda a: a + (MEAN + SWING * np.cos(angle + a)) / RATIO, -0.01, 0.0)


def test_it_crosses_by_the_gap_once_the_motion_goes_back_and_returns_once_it_goes_on():
    back = advances([0.0, 1.0, 0.0, *[-1e-3] * 12])
    np.testing.assert_array_equal(back[:3], 0.0)
    shares = np.array([0.25, 0.5, 0.75, 1.0])
    ramp = shares**3 * (10 - 15 * shares + 6 * shares**2)
    np.testing.assert_allclose(back[3:7], ramp * whole(), atol=1e-6)
    np.testing.assert_allclose(back[-1], whole(), atol=2e-9)
    again = advances([*[-1e-3] * 12, 0.0, 0.0, *[1e-3] * 12])
    np.testing.assert_allclose(again[12:14], again[11], atol=2e-9)  # a standstill has no sense
    assert again[-1] == 0.0


def test_rounding_of_a_standstill_is_no_turn():
    assert np.all(advances([1.0, 0.0, -1e-12, 1e-12, -1e-12]) == 0.0)


# A controller of somebody else.


class Back(Controller):
    """Runs behind by a fixed angle once told to go back."""

    advances = True
    closes = False

    def start(self):
        return ()

    def step(self, state, seen):
        return state, Command(0.0, jnp.where(seen.reference_speed < 0, -1e-3, 0.0))


class Unannounced(Back):
    advances = False


class Plain(NoController):
    """Moves a motor that it says it moves, but asks for mm alone."""

    advances = True


@pytest.mark.slow
def test_anybody_may_move_the_motor():
    found = simulate(spec_of(BASE), PAIR, controller=Back(), trace_every=1)
    assert found.trace is not None and found.outcome == "ok"
    samples = found.trace
    ahead = samples.driving - at(found.case.motion, samples.time).angle
    turn = float(found.case.motion.turn_s)
    assert np.abs(ahead[samples.time <= turn]).max() < 1e-12
    back = (samples.time > turn + 0.01) & (samples.time < found.case.motion.duration_s - 0.11)
    np.testing.assert_allclose(ahead[back], -1e-3, atol=1e-12)
    assert simulate(spec_of(BASE), PAIR, controller=Plain()).outcome == "ok"


def test_who_moves_the_motor_has_to_say_so():
    with pytest.raises(ValueError, match=r"must set `advances = True` .* Unannounced does not"):
        simulate(spec_of(BASE), PAIR, controller=Unannounced())


class Lost(Back):
    """Commands what is no number."""

    advances = False

    def step(self, state, seen):
        return state, jnp.nan * seen.driving


class Single(Lost):
    """Forgets its state."""

    def step(self, state, seen) -> Any:
        return 1.0


@pytest.mark.parametrize(
    ("controller", "words"),
    [(Lost(), r"Lost commands NaN"), (Single(), r"state and a command .* Single returns float")],
)
def test_a_controller_that_errs_is_named(controller, words):
    with pytest.raises(ValueError, match=words):
        simulate(spec_of(BASE), PAIR, controller=controller)


def test_eccentricities_without_a_gap_are_refused():
    """Their flanks cross by 0.02° where both gears have their thick places."""
    spec = spec_of(BASE, {"eccentricities.constant_backlash_deg": 0.001})
    with pytest.raises(ScenarioError, match=r"eccentricities: flank B lies 0\.0\d+° before"):
        simulate(spec, PAIR)

"""Two shafts that move each other: scipy's solution, momentum, energy, friction that holds."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from benchmarks.compiler import fast_to_compile
from tests.control.driven import (
    RATIO,
    Start,
    Ways,
    drive_of,
    follow,
    followed,
    nothing,
    told_of,
    waves,
)
from tests.control.followed import Still
from tests.control.parts import elastic, rigid
from vttig_jax.control.hardware.servo import Servo, ServoDrive
from vttig_jax.control.motion.motion import MotionPoint
from vttig_jax.control.plants.plant import FREE, ON_A, ON_B, Drag, Play
from vttig_jax.kinematics.flank_table import FirstOrderBounds

DRIVING, DRIVEN = Drag(0.002, 0.05), Drag(0.01, 0.1, 0.02)
GAINS = (1.0, 20.0, 15.0)
SERVO = Servo(*GAINS, 5.0)
STIFFNESS, DAMPING = 2.0e4, 0.1
GEARS = waves()


def ramp(steps: int, step: float) -> MotionPoint:
    """Ever faster forwards, so that flank A carries."""
    time = np.arange(steps + 1) * step
    return told_of(10.0 * time**2 + time, 20.0 * time + 1.5)


def torques(told: MotionPoint, number: int, angle: Any, speed: Any, wound: Any, step: float):
    """Of the servo below its limit, and the integral after."""
    kp, ki, kv = GAINS
    error = told.speed[number] + kv * (told.angle[number] - angle) - speed
    return kp * error + ki * (wound + step * error), wound + step * error


def te(angle, bounds: FirstOrderBounds = GEARS, flank: int = 0) -> tuple[float, float, float]:
    """TE of a flank and its first two derivatives, from the coefficients."""
    cycles = np.array([1.0, float(bounds.ratio)])
    c, s = bounds.cosine[flank], bounds.sine[flank]
    cos, sin = np.cos(cycles * angle), np.sin(cycles * angle)
    return (
        float(bounds.offset[flank] + c @ cos + s @ sin),
        float(cycles * s @ cos - cycles * c @ sin),
        float(-(cycles**2 * c) @ cos - (cycles**2 * s) @ sin),
    )


def one_body(told: MotionPoint, step: float) -> np.ndarray:
    """φ₁ and ω₁ with the driven shaft on flank A, by Lagrange's equation of one coordinate."""
    inertia, heavy = float(DRIVEN.inertia), float(DRIVING.inertia)
    place, wound, found = np.array([0.0, 1.0]), 0.0, []
    for number in range(len(told.angle) - 1):
        torque, wound = torques(told, number, place[0], place[1], wound, step)

        def rates(_, y, torque=torque):
            _, slope, bend = te(y[0])
            k = RATIO + slope
            drag = 0.1 + 0.02 * k * y[1]
            force = torque - 0.05 - k * drag - k * bend * inertia * y[1] ** 2
            return [y[1], force / (heavy + k**2 * inertia)]

        place = solve_ivp(rates, (0, step), place, "DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        found.append(place)
    return np.array(found)


def on_a(speed: float = 1.0) -> Start:
    offset, slope, _ = te(0.0)
    return Start(0.0, speed, offset, slope * speed, ON_A)


@pytest.mark.parametrize("step", [1e-3, 2.5e-4])
def test_rigid_teeth_on_one_flank_are_the_one_body_that_scipy_moves(step):
    told = ramp(round(0.1 / step), step)
    drive = drive_of(SERVO, DRIVING, DRIVEN)
    ways = follow(drive, rigid(DRIVEN, 0.3), GEARS, on_a(), told, step)
    assert np.all(ways.side == ON_A)
    oracle = one_body(told, step)
    np.testing.assert_allclose(ways.angle, oracle[:, 0], atol=2e-3 * step)
    np.testing.assert_allclose(ways.speed, oracle[:, 1], atol=0.15 * step)
    np.testing.assert_allclose(ways.offset, ways.lower, atol=1e-17)
    assert oracle[-1, 0] > 0.15


def test_the_inertia_and_the_friction_of_the_driven_shaft_are_felt():
    told = ramp(100, 1e-3)
    found = [
        follow(drive_of(SERVO, DRIVING, driven), rigid(driven, 0.3), GEARS, on_a(), told, 1e-3)
        for driven in (DRIVEN, Drag(0.02, 0.1, 0.02), Drag(0.01, 0.2, 0.02))
    ]
    assert all(np.abs(found[0].angle - other.angle).max() > 1e-3 for other in found[1:])


def two_bodies(told: MotionPoint, step: float) -> np.ndarray:
    """φ₁, ω₁, φ₂, ω₂ with a spring and a damper on flank A between them."""
    inertia, heavy = float(DRIVEN.inertia), float(DRIVING.inertia)
    offset, slope, _ = te(0.0)
    place, wound, found = np.array([0.0, 1.0, offset, RATIO + slope]), 0.0, []
    for number in range(len(told.angle) - 1):
        torque, wound = torques(told, number, place[0], place[1], wound, step)

        def rates(_, y, torque=torque):
            offset, slope, _ = te(y[0])
            k = RATIO + slope
            depth, rate = RATIO * y[0] + offset - y[2], k * y[1] - y[3]
            m = heavy * inertia / (heavy + k**2 * inertia)
            spring = STIFFNESS * max(depth, 0.0)
            damper = 2 * DAMPING * np.sqrt(STIFFNESS * m) * rate
            force = spring + np.clip(damper, -spring, spring)
            driving = (torque - 0.05 - k * force) / heavy
            return [y[1], driving, y[3], (force - 0.1 - 0.02 * y[3]) / inertia]

        ends = solve_ivp(rates, (0, step), place, "DOP853", rtol=1e-10, atol=1e-13, max_step=1e-4)
        place = ends.y[:, -1]
        found.append(place)
    return np.array(found)


def test_elastic_teeth_on_one_flank_move_both_bodies_as_scipy_does():
    step = 2.5e-4
    told = ramp(160, step)
    plant = elastic(DRIVEN, STIFFNESS, DAMPING)
    ways = follow(drive_of(SERVO, DRIVING, DRIVEN), plant, GEARS, on_a(), told, step)
    oracle = two_bodies(told, step)
    np.testing.assert_allclose(ways.angle, oracle[:, 0], atol=6e-7)
    np.testing.assert_allclose(ways.offset + RATIO * ways.angle, oracle[:, 2], atol=6e-7)
    np.testing.assert_allclose(ways.speed, oracle[:, 1], atol=4e-3)
    depth = ways.lower - ways.offset
    assert depth.max() > 1.5e-5 and np.ptp(depth[:60]) > 5e-6  # it presses, and it rings


# Impacts.

UNIT = Still(-1e-3, 1e-3).bounds()


@pytest.mark.parametrize("side", [ON_A, ON_B])
@pytest.mark.parametrize("restitution", [0.0, 0.4, 1.0])
def test_an_impact_exchanges_momentum_with_restitution(side, restitution):
    """Closed form: two masses on a line, of the relative speed −ε is left."""
    driving, driven, step = Drag(0.002), Drag(0.01), 1e-3
    start = Start(0.0, 3.0 * -side, 0.0, 3.0 * side, FREE)  # the driven shaft stands
    plant = rigid(driven, restitution)
    ways = follow(drive_of(driving=driving, driven=driven), plant, UNIT, start, nothing(3), step)
    assert ways.touched[0] == side
    momentum = 0.002 * ways.speed + 0.01 * (ways.speed + ways.drift)
    np.testing.assert_allclose(momentum, 0.002 * 3.0 * -side, rtol=1e-12)
    assert ways.drift[0] == pytest.approx(-restitution * 3.0 * side, abs=1e-12)
    share = 1e-3 / 3e-3  # of the step until then
    centre = 0.002 / 0.012 * 3.0 * -side * step
    middle = (0.002 * ways.angle[0] + 0.01 * (ways.angle[0] + ways.offset[0])) / 0.012
    assert middle == pytest.approx(centre, rel=1e-9)
    back = side * (1e-3 - restitution * 3.0 * (1 - share) * step)
    assert ways.offset[0] == pytest.approx(back, abs=1e-12)


def test_elastic_teeth_bounce_with_the_tabled_restitution_of_the_effective_inertia():
    """e(ζ) = 0.759 at ζ = 0.1 whatever the inertias, and no momentum is lost."""
    for driving in (Drag(0.002), Drag(0.05)):
        start, drive = Start(0.0, -1.0, 0.0, 1.0, FREE), drive_of(driving=driving)
        plant = elastic(Drag(0.01), 2e6, 0.1)
        ways = follow(drive, plant, UNIT, start, nothing(12), 2e-4)
        assert ways.drift[-1] == pytest.approx(-0.759, abs=2e-3)
        momentum = float(driving.inertia) * ways.speed + 0.01 * (ways.speed + ways.drift)
        np.testing.assert_allclose(momentum, -float(driving.inertia), rtol=1e-12)


def test_a_driving_shaft_of_huge_inertia_is_a_prescribed_one():
    steps, step = 400, 2.5e-4
    time = np.arange(steps + 1) * step
    told = told_of(-2.0 * time, -2.0)
    start = Start(0.0, -2.0, te(0.0)[0], 2.0 * RATIO, FREE)  # thrown off flank A, at rest
    free = Drag(0.01)
    for plant, driven in (
        (rigid(DRIVEN, 0.3), DRIVEN),
        (elastic(free, STIFFNESS, DAMPING), free),
    ):
        heavy = drive_of(driving=Drag(1e9), driven=driven)
        found, expected = (
            follow(drive, plant, GEARS, start, told, step)
            for drive in (heavy, _Told(SERVO, DRIVING, DRIVEN))
        )
        assert (found.touched == ON_B).any()
        np.testing.assert_allclose(found.offset, expected.offset, atol=1e-9)


class _Told(ServoDrive):
    """A drive without a motor beside servos: the driving shaft is where it is told to be."""

    def step(self, motor, plant, shafts, target, *step):
        return motor, *plant.step(shafts, target, *step)


# Friction that holds.


@pytest.mark.parametrize("plant", [rigid(DRIVEN, 0.3), Play()])
def test_friction_of_both_shafts_holds_what_the_motor_pushes_against_it(plant):
    """Torque 0.08 N m: more than 0.05, less than 0.05 + 0.1 of a pair of ratio 1."""
    driven = Drag(0.0, 0.1) if isinstance(plant, Play) else Drag(0.01, 0.1)
    servo = Servo(1.0, 0.0, 0.0, 5.0)
    still = Still(0.0, 1e-3).bounds()
    moved, given_ = [], [(0.08, ON_A, 0.0), (0.2, ON_A, 0.0)]
    for torque, side, offset in [*given_, (0.08, FREE, 5e-4), (-0.08, ON_A, 0.0)]:
        told = told_of(np.zeros(21), torque)
        start = Start(0.0, 0.0, offset, 0.0, side)
        ways = follow(drive_of(servo, DRIVING, driven), plant, still, start, told, 1e-4)
        moved.append(float(ways.angle[-1]))
    assert moved[0] == 0.0
    assert moved[1] > 1e-6 and moved[2] > 1e-6 and moved[3] < -1e-6


def test_in_play_contact_costs_the_friction_of_the_driven_shaft_one_way_only():
    """Torque 0.3 N m for 20 steps, ratio 1: a = (T − friction)/J₁."""
    servo, still = Servo(1.0, 0.0, 0.0, 0.3), Still(0.0, 1.0).bounds()
    drive = drive_of(servo, DRIVING, Drag(0.0, 0.1))
    for sense, felt in ((1.0, 0.15), (-1.0, 0.05)):
        told = told_of(np.zeros(21), sense * 1e6)
        ways = follow(drive, Play(), still, Start(side=ON_A), told, 1e-3)
        assert ways.speed[-1] == pytest.approx(sense * (0.3 - felt) / 0.002 * 0.02, rel=1e-12)


def test_elastic_teeth_stay_pressed_at_rest():
    """Friction holds the spring; nothing creeps."""
    still = Still(0.0, 1e-3).bounds()
    depth = 0.04 / STIFFNESS
    start = Start(0.0, 0.0, -depth, 0.0, ON_A)
    driven = Drag(0.01, 0.1)
    drive, plant = drive_of(driving=DRIVING, driven=driven), elastic(driven, STIFFNESS, 0.1)
    ways = follow(drive, plant, still, start, nothing(400), 2.5e-4)
    np.testing.assert_allclose(ways.offset, -depth, rtol=1e-9)
    np.testing.assert_allclose(ways.angle, 0.0, atol=1e-15)


# Energy.

LANES, STEPS = 64, 400


@partial(jax.jit, **fast_to_compile())
def _many(case):
    """Energy after every step of lanes with one spring each; the first is that of the start."""

    def one(c):
        driving = Drag(c["driving"], c["friction"])
        driven = Drag(c["driven"], c["friction"])
        bounds = FirstOrderBounds(
            RATIO, jnp.stack([jnp.zeros(()), c["gap"]]), c["swing"] * c["cosine"],
            c["swing"] * c["sine"], jnp.ones(2),
        )  # fmt: skip
        first = bounds.at(jnp.zeros(()))
        offset = 0.5 * (first.lower + first.upper)
        start = Start(jnp.zeros(()), c["speed"], offset, c["drift"], FREE)
        told = MotionPoint(*[jnp.zeros(STEPS + 1)] * 3)
        drive = drive_of(driving=driving, driven=driven)
        plants = (
            rigid(driven, c["restitution"]),
            elastic(driven, c["stiffness"], c["damping"]),
        )
        ways = [followed(drive, plant, bounds, start, told, c["step"]) for plant in plants]
        return _energy(c, ways[0], 0.0), _energy(c, ways[1], c["stiffness"])

    return jax.vmap(one)(case)


def _energy(c, ways: Ways, stiffness):
    speed = jnp.append(c["speed"], ways.speed)
    turning = RATIO * speed + jnp.append(c["drift"], ways.drift)
    moving = 0.5 * (c["driving"] * speed**2 + c["driven"] * turning**2)
    depth = jnp.maximum(jnp.maximum(ways.lower - ways.offset, ways.offset - ways.upper), 0.0)
    return moving + jnp.append(0.0, 0.5 * stiffness * depth**2)


@pytest.mark.slow
@settings(deadline=None, max_examples=8)
@given(seed=st.integers(0, 2**31), still=st.booleans(), friction=st.sampled_from([0.0, 0.02]))
def test_two_shafts_left_to_themselves_never_gain_energy(seed, still, friction):
    rng = np.random.default_rng(seed)

    def between(low, high):
        return np.exp(rng.uniform(np.log(low), np.log(high), LANES))

    case = {
        "driving": between(1e-4, 0.1), "driven": between(1e-4, 0.1),
        "friction": np.full(LANES, friction), "gap": between(1e-3, 1e-2),
        "swing": np.full(LANES, 0.0 if still else 2e-4), "speed": rng.uniform(-10, 10, LANES),
        "drift": rng.uniform(-10, 10, LANES), "restitution": rng.uniform(0, 1, LANES),
        "damping": between(1e-3, 1.0), "step": between(1e-5, 1e-3),
        "cosine": rng.uniform(-1, 1, (LANES, 2, 2)), "sine": rng.uniform(-1, 1, (LANES, 2, 2)),
    }  # fmt: skip
    m = case["driving"] * case["driven"] / (case["driving"] + RATIO**2 * case["driven"])
    case["stiffness"] = m * (rng.uniform(0.2, 2.5, LANES) / case["step"]) ** 2
    for energy in map(np.asarray, _many(case)):
        start = energy[:, :1]
        # A step keeps the friction it began with: where an impact turns a shaft round inside it,
        # friction acts the wrong way for what is left of that step.
        quick = np.sqrt(2 * start / case["driving"][:, None])
        quick += np.sqrt(2 * start / case["driven"][:, None])
        kept = friction * quick * case["step"][:, None]
        assert np.all(np.diff(energy, axis=1) <= kept + 1e-12 * start)
        assert np.all(energy <= start * (1 + 1e-12))
        assert np.any(energy[:, -1:] < 0.9 * start)  # impacts take some


@pytest.mark.slow
@pytest.mark.parametrize("plant", [rigid(DRIVEN, 0.3), elastic(DRIVEN, 2.0e4, 0.1)])
def test_the_gradient_of_where_the_motor_takes_both_is_the_difference(plant):
    told = ramp(50, 2.5e-4)

    def end(gain):
        servo = Servo(gain, GAINS[1], GAINS[2], 5.0)
        drive = drive_of(servo, DRIVING, DRIVEN)
        return followed(drive, plant, GEARS, on_a(), told, jnp.asarray(2.5e-4)).angle[-1]

    slope = float(jax.jit(jax.grad(end))(1.0))
    high, low = (float(jax.jit(end)(1.0 + change)) for change in (1e-4, -1e-4))
    assert slope == pytest.approx((high - low) / 2e-4, rel=1e-5) and abs(slope) > 1e-5

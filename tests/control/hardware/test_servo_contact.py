"""Two shafts that move each other: scipy's solution, momentum, and friction that holds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.control.followed import (
    RATIO,
    Still,
    advanced,
    by_scipy,
    drive_of,
    shafts_of,
    told_of,
    turned,
    waves,
)
from tests.control.parts import elastic, rigid
from vttig_jax.control.hardware.servo import Servo
from vttig_jax.control.motion.motion import MotionPoint
from vttig_jax.control.plants.plant import FREE, ON_A, ON_B, Drag, Play, Shafts
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

    def rates(y, torque):
        _, slope, bend = te(y[0])
        k = RATIO + slope
        drag = 0.1 + 0.02 * k * y[1]
        force = torque - 0.05 - k * drag - k * bend * inertia * y[1] ** 2
        return [y[1], force / (heavy + k**2 * inertia)]

    return by_scipy(GAINS, told, step, [0.0, 1.0], rates, rtol=1e-11, atol=1e-13)


def on_a() -> Shafts:
    offset, slope, _ = te(0.0)
    return shafts_of(GEARS, 0.0, 1.0, offset, slope, ON_A)


@pytest.mark.parametrize("step", [1e-3, 2.5e-4])
def test_rigid_teeth_on_one_flank_are_the_one_body_that_scipy_moves(step):
    told = ramp(round(0.1 / step), step)
    drive = drive_of(SERVO, DRIVING, DRIVEN)
    ways, _ = turned(drive, rigid(DRIVEN, 0.3), GEARS, on_a(), told, step)
    assert np.all(ways.side == ON_A)
    oracle = one_body(told, step)
    np.testing.assert_allclose(ways.angle, oracle[:, 0], atol=2e-3 * step)
    np.testing.assert_allclose(ways.speed, oracle[:, 1], atol=0.15 * step)
    np.testing.assert_allclose(ways.offset, ways.flanks.lower, atol=1e-17)
    assert oracle[-1, 0] > 0.15


def two_bodies(told: MotionPoint, step: float) -> np.ndarray:
    """φ₁, ω₁, φ₂, ω₂ with a spring and a damper on flank A between them."""
    inertia, heavy = float(DRIVEN.inertia), float(DRIVING.inertia)

    def rates(y, torque):
        offset, slope, _ = te(y[0])
        k = RATIO + slope
        depth, rate = RATIO * y[0] + offset - y[2], k * y[1] - y[3]
        m = heavy * inertia / (heavy + k**2 * inertia)
        spring = STIFFNESS * max(depth, 0.0)
        damper = 2 * DAMPING * np.sqrt(STIFFNESS * m) * rate
        force = spring + np.clip(damper, -spring, spring)
        driving = (torque - 0.05 - k * force) / heavy
        return [y[1], driving, y[3], (force - 0.1 - 0.02 * y[3]) / inertia]

    offset, slope, _ = te(0.0)
    start = [0.0, 1.0, offset, RATIO + slope]
    return by_scipy(GAINS, told, step, start, rates, rtol=1e-10, atol=1e-13, max_step=1e-4)


def test_elastic_teeth_on_one_flank_move_both_bodies_as_scipy_does():
    step = 2.5e-4
    told = ramp(160, step)
    plant = elastic(DRIVEN, STIFFNESS, DAMPING)
    ways, _ = turned(drive_of(SERVO, DRIVING, DRIVEN), plant, GEARS, on_a(), told, step)
    oracle = two_bodies(told, step)
    np.testing.assert_allclose(ways.angle, oracle[:, 0], atol=6e-7)
    np.testing.assert_allclose(ways.offset + RATIO * ways.angle, oracle[:, 2], atol=6e-7)
    np.testing.assert_allclose(ways.speed, oracle[:, 1], atol=4e-3)
    depth = ways.flanks.lower - ways.offset
    assert depth.max() > 1.5e-5 and np.ptp(depth[:60]) > 5e-6  # it presses, and it rings


# Impacts.

UNIT = Still(-1e-3, 1e-3).bounds()
NOTHING = told_of(0.0, np.zeros(401))
"""For a servo that asks for no torque."""


@pytest.mark.parametrize("side", [ON_A, ON_B])
@pytest.mark.parametrize("restitution", [0.0, 0.4, 1.0])
def test_an_impact_exchanges_momentum_with_restitution(side, restitution):
    """Closed form: two masses on a line, of the relative speed −ε is left."""
    driving, driven, step = Drag(0.002), Drag(0.01), 1e-3
    start = shafts_of(UNIT, 0.0, 3.0 * -side, 0.0, 3.0 * side)  # the driven shaft stands
    plant = rigid(driven, restitution)
    drive = drive_of(driving=driving, driven=driven)
    ways, touches = turned(drive, plant, UNIT, start, NOTHING, step)
    assert touches.side[0] == side
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
        start, drive = shafts_of(UNIT, 0.0, -1.0, 0.0, 1.0), drive_of(driving=driving)
        plant = elastic(Drag(0.01), 2e6, 0.1)
        ways, _ = turned(drive, plant, UNIT, start, told_of(0.0, np.zeros(13)), 2e-4)
        assert ways.drift[-1] == pytest.approx(-0.759, abs=2e-3)
        momentum = float(driving.inertia) * ways.speed + 0.01 * (ways.speed + ways.drift)
        np.testing.assert_allclose(momentum, -float(driving.inertia), rtol=1e-12)


def test_a_driving_shaft_of_huge_inertia_is_a_prescribed_one():
    steps, step = 400, 2.5e-4
    time = np.arange(steps + 1) * step
    told = told_of(-2.0 * time, -2.0)
    start = shafts_of(GEARS, 0.0, -2.0, te(0.0)[0], 2.0 * RATIO)  # thrown off flank A, at rest
    free = Drag(0.01)
    for plant, driven in (
        (rigid(DRIVEN, 0.3), DRIVEN),
        (elastic(free, STIFFNESS, DAMPING), free),
    ):
        heavy = drive_of(driving=Drag(1e9), driven=driven)
        found, touches = turned(heavy, plant, GEARS, start, told, step)
        expected, _ = turned(None, plant, GEARS, start, told, step)
        assert (touches.side == ON_B).any()
        np.testing.assert_allclose(found.offset, expected.offset, atol=1e-9)


# Friction that holds.


@pytest.mark.parametrize("plant", [rigid(DRIVEN, 0.3), Play()])
def test_friction_of_both_shafts_holds_what_the_motor_pushes_against_it(plant):
    """Torque 0.08 N m: more than 0.05, less than 0.05 + 0.1 of a pair of ratio 1."""
    driven = Drag(0.0, 0.1) if isinstance(plant, Play) else Drag(0.01, 0.1)
    servo = Servo(1.0, 0.0, 0.0, 5.0)
    still = Still(0.0, 1e-3).bounds()
    moved = []
    pushes = (0.08, ON_A, 0.0), (0.2, ON_A, 0.0), (0.08, FREE, 5e-4), (-0.08, ON_A, 0.0)
    for torque, side, offset in pushes:
        told = told_of(np.zeros(21), torque)
        start = shafts_of(still, offset=offset, side=side)
        ways, _ = turned(drive_of(servo, DRIVING, driven), plant, still, start, told, 1e-4)
        moved.append(float(ways.angle[-1]))
    assert moved[0] == 0.0
    assert moved[1] > 1e-6 and moved[2] > 1e-6 and moved[3] < -1e-6


def test_in_play_contact_costs_the_friction_of_the_driven_shaft_one_way_only():
    """Torque 0.3 N m for 20 steps, ratio 1: a = (T − friction)/J₁."""
    servo, still = Servo(1.0, 0.0, 0.0, 0.3), Still(0.0, 1.0).bounds()
    drive = drive_of(servo, DRIVING, Drag(0.0, 0.1))
    for sense, felt in ((1.0, 0.15), (-1.0, 0.05)):
        told = told_of(np.zeros(21), sense * 1e6)
        ways, _ = turned(drive, Play(), still, shafts_of(still, side=ON_A), told, 1e-3)
        assert ways.speed[-1] == pytest.approx(sense * (0.3 - felt) / 0.002 * 0.02, rel=1e-12)


def test_elastic_teeth_stay_pressed_at_rest():
    """Friction holds the spring; nothing creeps."""
    still = Still(0.0, 1e-3).bounds()
    depth = 0.04 / STIFFNESS
    start = shafts_of(still, offset=-depth, side=ON_A)
    driven = Drag(0.01, 0.1)
    drive, plant = drive_of(driving=DRIVING, driven=driven), elastic(driven, STIFFNESS, 0.1)
    ways, _ = turned(drive, plant, still, start, NOTHING, 2.5e-4)
    np.testing.assert_allclose(ways.offset, -depth, rtol=1e-9)
    np.testing.assert_allclose(ways.angle, 0.0, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("plant", [rigid(DRIVEN, 0.3), elastic(DRIVEN, 2.0e4, 0.1)])
def test_the_gradient_of_where_the_motor_takes_both_is_the_difference(plant):
    told = ramp(50, 2.5e-4)

    def end(gain):
        servo = Servo(gain, GAINS[1], GAINS[2], 5.0)
        drive, step = drive_of(servo, DRIVING, DRIVEN), jnp.asarray(2.5e-4)
        first = told_of(told.angle[0], told.speed[0])
        rest = told_of(told.angle[1:], told.speed[1:])
        now = drive.start(first), on_a()
        return advanced(drive, plant, GEARS, now, rest, step)[0][1].angle

    slope = float(jax.jit(jax.grad(end))(1.0))
    high, low = (float(jax.jit(end)(1.0 + change)) for change in (1e-4, -1e-4))
    assert slope == pytest.approx((high - low) / 2e-4, rel=1e-5) and abs(slope) > 1e-5

"""The force along the axis, in closed form, and an actuator that is weaker than the teeth."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from tests.control.scenarios import INSTANT, PAIR, SHORT, HoldShift, case_of, spec_of
from vttig_jax.base.units import DEG
from vttig_jax.control.hardware.actuator import Thrust
from vttig_jax.control.plants.plant import FREE, ON_A, ON_B, Drag
from vttig_jax.control.simulation.result import Simulation
from vttig_jax.control.simulation.simulate import simulate

TAPER, RADIUS, RATIO = math.tan(3 * DEG), 0.080, 0.5625
HOLD = 0.2
"""mm; less than closes the gap anywhere on the way."""


def push(side: float, speed: float, gain: float = 0.0, friction: float = 0.0, **drag: Any):
    """(against, back) in N of a shaft of 0.01 kg m²."""
    thrust = Thrust(Drag(0.01, **drag), np.array([TAPER, 2 * TAPER]), friction, RADIUS, RATIO)
    found = thrust.at(*map(jnp.asarray, (side, speed, gain)))
    return float(found.closing_resistance), float(found.opening_force)


def test_the_flank_that_carries_pushes_with_its_torque_over_the_radius():
    force = 0.1 / RADIUS
    assert push(ON_A, 6.0, coulomb=0.1) == pytest.approx((force * TAPER, force * TAPER))
    assert push(ON_B, -6.0, coulomb=0.1) == pytest.approx((2 * force * TAPER, 2 * force * TAPER))
    assert push(FREE, 6.0, coulomb=0.1) == (0.0, 0.0)
    assert push(ON_B, 6.0, coulomb=0.1) == (0.0, 0.0)  # the other flank has all of it
    with_inertia = (0.1 + 0.01 * RATIO * 12.0 + 0.02 * RATIO * 6.0 + 0.03) / RADIUS * TAPER
    found = push(ON_A, 6.0, 12.0, coulomb=0.1, viscous=0.02, load=0.03)
    assert found == pytest.approx((with_inertia, with_inertia))


def test_friction_of_the_flanks_resists_both_ways_and_at_standstill_the_driven_shaft_too():
    against, back = push(ON_A, 6.0, friction=0.1, coulomb=0.1)
    assert against == pytest.approx(0.1 / RADIUS * (TAPER + 0.1))
    assert back == pytest.approx(0.1 / RADIUS * (TAPER - 0.1)) and back < 0
    held = push(ON_A, 0.0, coulomb=0.1, stribeck=0.05, load=0.2)
    assert held == pytest.approx((0.35 / RADIUS * TAPER, 0.05 / RADIUS * TAPER))
    assert push(ON_A, 0.0, coulomb=0.1)[1] == 0.0


# In a simulation: gear 2 is to be held half closed all along.

HELD = {**SHORT, **INSTANT, "plant": "play", "motion.ramp_s": 0.15, "load.torque_Nm": 0.05}
STEADY = (0.05 + 0.1) / RADIUS * TAPER
"""N of the flank at steady speed: load and friction of the driven shaft."""


def held(limit: float, **more: Any) -> Simulation:
    spec = spec_of(HELD, {"actuator.force_limit_N": limit}, more)
    return simulate(spec, PAIR, controller=HoldShift(HOLD), trace_every=1)


def reached(found: Simulation) -> np.ndarray:
    assert found.trace is not None
    return np.asarray(found.trace.reached)


def test_a_strong_actuator_does_what_one_without_limit_does_and_a_weak_one_says_so():
    strong, free, weak = held(1.01 * STEADY), held(0.0), held(0.99 * STEADY)
    np.testing.assert_array_equal(reached(strong), reached(free))
    assert strong.outcome == free.outcome == "ok" and reached(free)[-1] == HOLD
    assert weak.outcome == "force" and "actuator.force_limit_N = 0.0972" in weak.remarks[0]
    # At rest and while it is driven forwards the load and friction hold it; only the way back,
    # with the load against friction, lets it in.
    time = np.arange(len(reached(weak))) * 1e-3
    assert np.all(reached(weak)[time < float(weak.case.motion.turn_s)] == 0.0)
    assert reached(weak)[-1] > 0.0


# Without friction to hold the driven shaft, which costs this force at full speed.
LOOSE = {"load.torque_Nm": 0.0, "friction.coulomb_Nm": 0.0, "friction.viscous_Nms": 0.05}
FAST = 0.05 * RATIO * 2 * math.pi / RADIUS


def test_teeth_push_a_weak_actuator_out_once_the_drive_starts():
    """Closed at rest, without friction to hold the driven shaft, and pushed back by the ramp."""
    found, kept = (held(share * FAST * TAPER, **LOOSE) for share in (0.5, 1.1))
    steady = slice(400, 900)
    assert np.all(reached(kept)[steady] == HOLD) and kept.outcome == "ok"
    assert reached(found)[3] == HOLD and np.all(reached(found)[steady] < HOLD)
    assert found.outcome == "force"


def test_friction_of_the_flanks_keeps_a_weak_actuator_where_it_is():
    """It went in while the drive stood without torque; μ > tan β then holds it as it opens."""
    found = held(0.5 * FAST * (0.3 - TAPER), **LOOSE, **{"mesh.friction_coefficient": 0.3})
    assert np.all(reached(found)[3:900] == HOLD)  # neither in nor out


@pytest.mark.parametrize(("torque", "yields"), [(5.0, True), (1.0, False)])
def test_a_servo_pushes_a_strong_actuator_back_only_if_it_has_the_torque(torque, yields):
    """T/(i R₂) tan β against 2 N: 5 N m make 5.8 N, 1 N m makes 1.2 N."""
    given_ = {"servo.motor": "pi", "servo.torque_limit_Nm": torque, "actuator.force_limit_N": 2.0}
    assert bool(case_of(spec_of(given_), PAIR).actuator.back_drivable) is yields
    prescribed = {**given_, "servo.motor": "prescribed"}
    assert bool(case_of(spec_of(prescribed), PAIR).actuator.back_drivable)

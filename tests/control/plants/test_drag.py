"""Friction of a shaft: its law while it turns, and its standstill."""

import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.control.plants.plant import Drag

STEP = 1e-4
INERTIA = 0.01


def drag(**values: Any) -> Drag:
    return Drag(INERTIA, **values)


def gained(which: Drag, speed: float, torque: float = 0.0, step: float = STEP) -> float:
    return float(_gained(which, *map(jnp.asarray, (float(speed), float(torque), step))))


@eqx.filter_jit
def _gained(which, speed, torque, step):
    return which.acceleration(speed, torque, step)


def law(which: Any, speed: float, torque: float) -> float:
    """J dω/dt of a shaft that turns."""
    dry = which.coulomb + which.stribeck / (1 + (speed / which.stribeck_speed) ** 2)
    return float(
        torque - which.load - which.viscous * speed - math.copysign(1, speed) * dry
    )  # fmt: skip


_TORQUES = st.floats(0.0, 2.0)


@given(
    coulomb=_TORQUES, stribeck=_TORQUES, viscous=st.floats(0.0, 1.0), torque=st.floats(-5.0, 5.0),
    load=st.floats(-2.0, 2.0), speed=st.floats(0.5, 50.0), sense=st.sampled_from([1, -1]),
)  # fmt: skip
def test_a_shaft_that_turns_obeys_the_law_term_by_term(
    coulomb, stribeck, viscous, torque, load, speed, sense
):
    which = drag(
        coulomb=coulomb, stribeck=stribeck, stribeck_speed=0.3, viscous=viscous, load=load
    )  # fmt: skip
    found = gained(which, sense * speed, torque, step=1e-9)
    expected = law(which, sense * speed, torque) / INERTIA
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-6)


@given(torque=st.floats(-3.0, 3.0), load=st.floats(-3.0, 3.0))
def test_at_standstill_it_takes_any_torque_up_to_both_dry_terms(torque, load):
    which = drag(coulomb=0.5, stribeck=0.25, load=load)
    push = torque - load
    expected = math.copysign(max(abs(push) - 0.75, 0.0), push) / INERTIA
    assert gained(which, 0.0, torque) == pytest.approx(expected, abs=1e-10)


@given(
    coulomb=_TORQUES, stribeck=_TORQUES, viscous=st.floats(0.0, 1e3),
    speed=st.floats(-10.0, 10.0), step=st.floats(1e-6, 1e-2),
)  # fmt: skip
def test_friction_stops_a_shaft_at_most(coulomb, stribeck, viscous, speed, step):
    """Whatever the step: it neither turns the shaft round nor speeds it up."""
    which = drag(coulomb=coulomb, stribeck=stribeck, stribeck_speed=0.3, viscous=viscous)
    after = speed + step * gained(which, speed, step=step)
    assert abs(after) <= abs(speed) * (1 + 1e-12)
    assert after * speed >= -1e-12 * speed**2

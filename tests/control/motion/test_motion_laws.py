"""Motions keep the laws of all functions: as modules, and as functions of a scenario's numbers."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.control.parts import EVENTS, motion_of
from tests.laws import checks
from vttig_jax.control.motion.motion import PieceMotion, Sine
from vttig_jax.control.motion.recorded import recorded

CASES: list[Any] = [
    *[("s_curve", event) for event in EVENTS],
    ("trapezoid", "reversal"),  # the other events are laid out as those of the S-curve
    ("sine", "reversal"),
]
NUMBERS = tuple(np.asarray(x) for x in (60.0, 1080.0, 0.75, 0.5, 0.25, 0.1))
NAMES = ("speed_rpm", "reversal_deg", "dwell_s", "ramp_s", "slow_share", "stop_s")
TIMES = np.array([0.31, 0.72, 1.37])  # in three pieces of every motion below
ROWS = np.arange(9) * 0.2
each_case = pytest.mark.parametrize(("kind", "event"), CASES)


@eqx.filter_jit
def _mixed(time, motion):
    """All three quantities, so that one law covers them."""
    point = motion.at(time)
    return point.angle + 0.3 * point.speed + 0.1 * point.acceleration


def _small(jerky: bool) -> PieceMotion:
    """Five pieces, a standstill in the middle and one at the end."""
    return PieceMotion(
        start=np.array([0.0, 0.5, 0.9, 1.2, 1.9]),
        duration=np.array([0.5, 0.4, 0.3, 0.7, 0.1]),
        speed=np.array([1.0, 2.5, 0.0, -0.3, 0.0]),
        acceleration=np.array([3.0, -2.0, 0.0, 0.7, 0.0]),
        jerk=jerky * np.array([4.0, -7.0, 0.0, 2.0, 0.0]),
        duration_s=2.0,
        braking_s=0.5,
        turn_s=1.2,
        jerky=jerky,
    )


MODULES = {
    "straight": _small(False),
    "jerky": _small(True),
    "sine": Sine(60.0, 360.0),
    "recorded": recorded(ROWS, 3.0 * np.sin(ROWS) ** 2),
}
each_module = pytest.mark.parametrize("name", MODULES)


@each_module
def test_a_motion_keeps_every_law(name):
    arguments = (TIMES, MODULES[name])
    checks.check_derivatives(_mixed, arguments)
    if name != "recorded":  # a search one step at a time is slow; SciPy is its oracle
        checks.check_jit_is_eager(_mixed, arguments)
    if name != "straight":  # the jerky one without its cubic
        checks.check_double(_mixed, arguments)
        checks.check_vmap_is_loop(_mixed, arguments)
    corners = getattr(MODULES[name], "start", ROWS[:3])
    checks.check_finite_gradient(_mixed, (jnp.asarray(corners), MODULES[name]))


@each_case
def test_a_motion_differs_smoothly_with_every_number_of_a_scenario(kind, event):
    """Forward derivative through JAX against Richardson's central difference through NumPy."""

    def made(*numbers):
        """What is computed from the numbers; the rest of a motion is static."""
        found = vars(motion_of(kind, event, *numbers))
        return {name: value for name, value in found.items() if hasattr(value, "dtype")}

    primals = tuple(map(jnp.asarray, NUMBERS))
    for place in range(len(NAMES)):
        tangents = tuple(jnp.full_like(x, k == place) for k, x in enumerate(primals))
        _, slopes = jax.jvp(made, primals, tangents)  # not compiled: cheaper for one use

        def difference(step, place=place):
            moved = np.array(NUMBERS) * (1 + step * np.array([[1], [-1]]) * (np.arange(6) == place))
            above, below = (made(*end) for end in moved)
            return {key: (above[key] - below[key]) / (2 * step * NUMBERS[place]) for key in above}

        fine, coarse = difference(1e-4), difference(2e-4)
        for key, slope in slopes.items():
            assert np.all(np.isfinite(slope))
            expected = (4 * fine[key] - coarse[key]) / 3
            scale = max(1.0, np.abs(slope).max())
            np.testing.assert_allclose(slope, expected, rtol=0, atol=1e-8 * scale)


@pytest.mark.parametrize(("name", "value"), [("dwell_s", 0.0), ("reversal_deg", 180.0)])
def test_gradients_are_finite_where_a_stretch_vanishes(name, value):
    numbers = [value if other == name else x for other, x in zip(NAMES, NUMBERS, strict=True)]

    def angle(time, *numbers):
        return motion_of("trapezoid", "reversal", *numbers).at(time).angle

    slopes = jax.jit(jax.jacfwd(angle, argnums=tuple(range(7))))(1.0, *numbers)
    assert np.all(np.isfinite(slopes)) and np.any(slopes)

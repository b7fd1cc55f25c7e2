"""What is refused as a motion, and in which words."""

from typing import Any

import jax
import numpy as np
import pytest

from tests.control.parts import motion_of, trapezoid
from vttig_jax.control import Sine

pytestmark = pytest.mark.smoke

NUMBERS: dict[str, Any] = {
    "speed_rpm": 60.0,
    "reversal_deg": 1080.0,
    "dwell_s": 0.75,
    "ramp_s": 0.5,
    "slow_share": 0.25,
    "stop_s": 0.1,
}
WRONG = [
    ("reversal", "speed_rpm", 0.0),
    ("reversal", "speed_rpm", -60.0),
    ("reversal", "reversal_deg", 0.0),
    ("reversal", "dwell_s", -0.1),
    ("reversal", "ramp_s", 0.0),
    ("emergency_stop", "stop_s", 0.0),
    ("slow_down", "slow_share", 0.0),
    ("aborted", "slow_share", 1.0),
    *[("reversal", name, value) for name in ("speed_rpm", "ramp_s") for value in (np.nan, np.inf)],
]
LEAST = {
    "reversal": 180.0,
    "slow_down": 360 * (0.5 + 0.46875 + 0.1875),
    "aborted": 360 * (0.5 + 0.46875),
    "emergency_stop": 180.0,
}


@pytest.mark.parametrize(("event", "name", "value"), WRONG)
def test_a_number_out_of_range(event, name, value):
    with pytest.raises(ValueError, match=f"^Argument `{name}`"):
        motion_of("trapezoid", event, **{**NUMBERS, name: value})


@pytest.mark.parametrize("name", ["speed_rpm", "reversal_deg"])
def test_a_sine_checks_its_numbers(name):
    with pytest.raises(ValueError, match=f"^Argument `{name}`"):
        Sine(**{"speed_rpm": 60.0, "reversal_deg": 720.0, name: 0.0})


@pytest.mark.usefixtures("unchecked")
def test_an_unknown_shape_is_refused():
    with pytest.raises(ValueError, match="`shape`"):
        motion_of("square", "reversal", **NUMBERS)


@pytest.mark.usefixtures("unchecked")
def test_an_array_is_no_number():
    with pytest.raises(
        ValueError, match=r"`speed_rpm` must be one number, but its shape is \(2,\)"
    ):
        trapezoid(np.array([60.0, 50.0]), 1080.0, 1.0, 0.5)  # pyright: ignore


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("event", LEAST)
def test_a_reversal_inside_the_ramps(event: Any, sense):
    least = LEAST[event]
    numbers = {**NUMBERS, "reversal_deg": sense * least}
    motion = motion_of("trapezoid", event, **numbers)
    assert float(motion.at(motion.turn_s).angle) == pytest.approx(np.deg2rad(sense * least))
    numbers["reversal_deg"] = sense * (least - 0.01)
    with pytest.raises(ValueError, match=rf"^Argument `reversal_deg` must be .* {least:.10g}°"):
        motion_of("trapezoid", event, **numbers)


def test_a_long_emergency_stop_needs_room_too():
    numbers = {**NUMBERS, "reversal_deg": 269.0, "stop_s": 1.0}
    with pytest.raises(ValueError, match=r"must be at least 270°"):
        motion_of("s_curve", "emergency_stop", **numbers)


def test_known_numbers_are_checked_beside_traced_ones():
    def angle(speed_rpm, ramp_s):
        return trapezoid(speed_rpm, 1080.0, 0.5, ramp_s).at(1.0).angle

    assert np.isfinite(jax.jit(angle)(60.0, 0.5))
    with pytest.raises(ValueError, match="`ramp_s`"):
        jax.jit(angle, static_argnums=1)(60.0, 0.0)

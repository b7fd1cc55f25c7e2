"""What is refused as a motion, and in which words."""

from typing import Any

import jax
import numpy as np
import pytest

from vttig_jax.control.motion.profiles import motion_of, s_curve, trapezoid
from vttig_jax.control.scenario.spec import smallest_reversal_deg
from vttig_jax.control.scenario.tables import MotionTable

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
    ("speed_rpm", 0.0, "be positive, but is 0"),
    ("speed_rpm", -60.0, "be positive, but is -60"),
    ("reversal_deg", 0.0, "differ from zero, but is 0"),
    ("dwell_s", -0.1, "not be negative, but is -0.1"),
    ("ramp_s", 0.0, "be positive: without a ramp the acceleration is infinite, but is 0"),
    ("ramp_s", -0.5, "be positive"),
    ("stop_s", 0.0, "be positive: a sudden stop has infinite acceleration, but is 0"),
    ("slow_share", 0.0, "lie between 0 and 1, both excluded, but is 0"),
    ("slow_share", 1.0, "lie between 0 and 1, both excluded, but is 1"),
    *[(name, value, "be finite, but is") for name in NUMBERS for value in (np.nan, np.inf)],
]
LEAST = {
    "reversal": (180.0, "both ramps"),
    "slow_down": (360 * (0.5 + 0.46875 + 0.1875), "all ramps and the slow-down"),
    "aborted": (360 * (0.5 + 0.46875), "all ramps and the slow-down"),
    "emergency_stop": (180.0, "both ramps"),
}


@pytest.mark.parametrize(("name", "value", "words"), WRONG)
@pytest.mark.parametrize("kind", ["trapezoid", "sine"])
def test_a_number_out_of_range(name, value, words, kind: Any):
    with pytest.raises(ValueError, match=f"^Argument `{name}` must {words}"):
        motion_of(kind, "reversal", **{**NUMBERS, name: value})


@pytest.mark.parametrize("build", [trapezoid, s_curve])
def test_the_builders_check_by_themselves(build):
    build(60.0, 1080.0, 0.0, 0.5)
    with pytest.raises(ValueError, match="Argument `dwell_s` must not be negative"):
        build(60.0, 1080.0, -1.0, 0.5)


@pytest.mark.usefixtures("unchecked")
def test_the_builders_check_the_event():
    with pytest.raises(ValueError, match='Argument `event` must be "reversal", "slow_down", '):
        trapezoid(60.0, 1080.0, 1.0, 0.5, event="halt")  # pyright: ignore


@pytest.mark.usefixtures("unchecked")
def test_an_array_is_no_number():
    with pytest.raises(
        ValueError, match=r"`speed_rpm` must be one number, but its shape is \(2,\)"
    ):
        trapezoid(np.array([60.0, 50.0]), 1080.0, 1.0, 0.5)  # pyright: ignore


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("event", LEAST)
def test_a_reversal_inside_the_ramps(event: Any, sense):
    least, what = LEAST[event]
    numbers = {**NUMBERS, "reversal_deg": sense * least}
    motion = motion_of("trapezoid", event, **numbers)
    assert float(motion.at(motion.turn_s).angle) == pytest.approx(np.deg2rad(sense * least))
    numbers["reversal_deg"] = sense * (least - 0.01)
    words = rf"^Argument `reversal_deg` must be at least {least:.10g}° \({what}\) in either dire"
    with pytest.raises(ValueError, match=words):
        motion_of("trapezoid", event, **numbers)


def test_a_long_emergency_stop_needs_room_too():
    with pytest.raises(ValueError, match=r"must be at least 270° \(ramp and stop\)"):
        motion_of("s_curve", "emergency_stop", **{**NUMBERS, "reversal_deg": 269.0, "stop_s": 1.0})


@pytest.mark.parametrize("event", LEAST)
def test_the_scenario_asks_for_the_same_least_angle(event: Any):
    table = MotionTable(**NUMBERS, event=event)
    assert smallest_reversal_deg(table) == pytest.approx(LEAST[event][0], rel=1e-14)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("kind", "event", "words"),
    [
        (
            "square",
            "reversal",
            '`kind` must be "trapezoid", "s_curve" or "sine", but is \'square\'',
        ),
        ("recorded", "reversal", '`kind` must not be "recorded" here; `read_motion` makes'),
        ("sine", "aborted", "`event` must be \"reversal\" for a sine, but is 'aborted'"),
        ("s_curve", "halt", '"aborted" or "emergency_stop", but is \'halt\''),
    ],
)
def test_unknown_kinds_and_events(kind: Any, event: Any, words):
    with pytest.raises(ValueError, match=words):
        motion_of(kind, event, **NUMBERS)


def test_known_numbers_are_checked_beside_traced_ones():
    def angle(speed_rpm, ramp_s):
        return trapezoid(speed_rpm, 1080.0, 0.5, ramp_s).at(1.0).angle

    assert np.isfinite(jax.jit(angle)(60.0, 0.5))
    with pytest.raises(ValueError, match="`ramp_s` must be positive"):
        jax.jit(angle, static_argnums=1)(60.0, 0.0)

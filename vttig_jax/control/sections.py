"""What a drive does from start to end: ramps, steady running and standstills, event by event."""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from jax.typing import ArrayLike
from jaxtyping import Real

from ..base.arrays import float64, namespace
from ..base.units import DEG, REV
from .motion_limits import check_numbers, one_of, steady_time

Event = Literal["reversal", "slow_down", "aborted", "emergency_stop"]
Value = Real[ArrayLike, ""]

EVENTS = ("reversal", "slow_down", "aborted", "emergency_stop")


class Section(NamedTuple):
    """A stretch of the run at one speed, from one speed to another, or at rest; rad/s and s.

    `mark` says what begins with it, of the times a motion tells.
    """

    shape: Literal["steady", "ramp", "rest"]
    duration: Any
    speed: Any = 0.0
    end_speed: Any = 0.0
    mark: Literal["", "braking", "turn"] = ""


class _Drive(NamedTuple):
    """The numbers of a motion in rad and s."""

    speed: Any
    ramp: Any
    dwell: Any
    steady: Callable[[Any, str], Any]
    """Time at steady speed beside ramps that cover as much as so many seconds of it."""


def sections_of(
    event: Event,
    speed_rpm: Value,
    reversal_deg: Value,
    dwell_s: Value,
    ramp_s: Value,
    slow_share: Value,
    stop_s: Value,
) -> list[Section]:
    """Lay out the run of an event; see `pieces.trapezoid` for events, arguments and errors."""
    one_of(EVENTS, event=event)
    check_numbers(
        speed_rpm=speed_rpm,
        reversal_deg=reversal_deg,
        dwell_s=dwell_s,
        ramp_s=ramp_s,
        slow_share=slow_share,
        stop_s=stop_s,
    )
    dwell, ramp, share, stop = map(float64, (dwell_s, ramp_s, slow_share, stop_s))
    angle = float64(reversal_deg) * DEG
    rate = float64(speed_rpm) * (REV / 60.0)  # the speed without its sense

    def steady(ramps: Any, what: str) -> Any:
        return steady_time(reversal_deg, abs(angle), rate * ramps, rate, what)

    drive = _Drive(rate * namespace(angle).sign(angle), ramp, dwell, steady)
    if event == "slow_down":
        return _slowed(drive, share, dwell)
    if event == "aborted":
        there = _slowed(drive, share, None)
    elif event == "emergency_stop":
        there = _there(drive, stop, "ramp and stop")
    else:
        there = _there(drive, ramp, "both ramps")
    return there + _back(drive)


def _there(drive: _Drive, stop: Any, what: str) -> list[Section]:
    """The forward pass, with its own time for the stop."""
    return [
        Section("ramp", drive.ramp, 0.0, drive.speed),
        Section("steady", drive.steady(0.5 * (drive.ramp + stop), what), drive.speed),
        Section("ramp", stop, drive.speed, 0.0, "braking"),
        Section("rest", drive.dwell),
    ]


def _back(drive: _Drive) -> list[Section]:
    return [
        Section("ramp", drive.ramp, 0.0, -drive.speed, "turn"),
        Section("steady", drive.steady(drive.ramp, "both ramps"), -drive.speed),
        Section("ramp", drive.ramp, -drive.speed, 0.0),
        Section("rest", drive.dwell),
    ]


def _slowed(drive: _Drive, share: Any, kept: Any) -> list[Section]:
    """The forward pass with a slow-down half way, `kept` or (None) given up at once."""
    slow, slowing = share * drive.speed, drive.ramp * (1.0 - share)
    ramps = drive.ramp + slowing * (1.0 + share)  # two of each kind
    if kept is not None:
        ramps = ramps + share * kept
    half = Section("steady", 0.5 * drive.steady(ramps, "all ramps and the slow-down"), drive.speed)
    fall = Section("ramp", slowing, drive.speed, slow)
    down = Section("ramp", drive.ramp, drive.speed, 0.0)
    stay = []
    if kept is None:
        down = down._replace(mark="braking")
    else:
        fall, stay = fall._replace(mark="braking"), [Section("steady", kept, slow)]
    return [
        Section("ramp", drive.ramp, 0.0, drive.speed),
        half,
        fall,
        *stay,
        Section("ramp", slowing, slow, drive.speed),
        half,
        down,
        Section("rest", drive.dwell),
    ]

"""Commanded motions: trapezoids and S-curves with a reversal, a slow-down or a stop."""

from functools import partial
from typing import Any, ClassVar, Literal, NamedTuple, get_args

import equinox as eqx

from ...base.arrays import float64, namespace
from ...base.units import DEG, REV
from ..fields import Part, Quantity, is_known, number
from .piecewise import PieceMotion

Shape = Literal["trapezoid", "s_curve"]

SPEED_RPM = partial(
    number, 60.0, "steady speed of the driving shaft; sine: peak speed", "rpm", gt=0, le=1e6
)
REVERSAL_DEG = partial(
    number,
    7560.0,
    "driving angle of the turn; slow_down: end angle",
    "deg",
    signed=True,
    gt=0,
    le=1e9,
)
SLOW_SHARE = partial(
    number, 0.3, "slow_down, aborted: slow speed over steady speed", "1", gt=0, lt=1
)


_ROUNDING = 1e-12
"""Relative excess of the ramp angles over the reversal angle that is ignored as rounding error.

A chosen value."""


class Section(NamedTuple):
    """Section of a run: steady speed, ramp between two speeds, or standstill; rad/s and s.

    `speed` is that at the start. `mark` is "braking" or "turn" if `Motion.braking_s` or
    `Motion.turn_s` is the start of the section.
    """

    shape: Literal["steady", "ramp", "rest"]
    duration: Any
    speed: Any = 0.0
    end_speed: Any = 0.0
    mark: str = ""


class Reversal(Part):
    """Command: to `reversal_deg`, a standstill, back to 0, and a second standstill.

    The run includes every standstill, also the last. A negative `reversal_deg` gives the mirrored
    motion. The speed is a trapezoid over time. For the shape "s_curve" the acceleration of a ramp
    is a triangle over time, in the middle twice the constant acceleration of the trapezoid; times
    and angles are the same. Smaller changes of speed than from standstill to the steady speed take
    a proportional part of `ramp_s`. `braking_s` is the start of the deceleration before the turn.

    **Raises** `ValueError` for numbers out of range, and, where it is used, for a reversal inside
    the ramps. Traced values are not checked.

    **Example**
    ```python
    >>> import math, vttig_jax
    >>> from vttig_jax.control import Reversal
    >>> vttig_jax.enable_x64()
    >>> motion = Reversal(speed_rpm=60.0, reversal_deg=720.0, dwell_s=2.0, ramp_s=0.5).pieces
    >>> motion.braking_s.item(), motion.turn_s.item(), motion.duration_s.item()
    (2.0, 4.5, 9.0)
    >>> point = motion.at(2.25)
    >>> round(math.degrees(point.angle), 6), round(math.degrees(point.acceleration), 6)
    (697.5, -720.0)

    ```
    """

    event: ClassVar[str] = "reversal"

    speed_rpm: Quantity = SPEED_RPM()
    reversal_deg: Quantity = REVERSAL_DEG()
    dwell_s: Quantity = number(
        2.0, "standstill at both ends; slow_down: also time at slow speed", "s", ge=0, le=1e6
    )
    ramp_s: Quantity = number(0.5, "time between standstill and steady speed", "s", gt=0, le=1e6)
    shape: Shape = eqx.field(static=True, default="trapezoid", kw_only=True)

    def __check_init__(self) -> None:
        if self.shape not in get_args(Shape):
            raise ValueError(
                f"Argument `shape` must be one of {', '.join(get_args(Shape))}, but is"
                f" {self.shape!r}."
            )

    @property
    def pieces(self) -> PieceMotion:
        """The motion of the driving shaft; see `Motion`."""
        return _joined(self._sections(), jerky=self.shape == "s_curve")

    def _sections(self) -> list[Section]:
        speed, ramp = self._speed, self.ramp_s
        return [
            *self._forward(),
            Section("ramp", ramp, 0.0, -speed, "turn"),
            Section("steady", self._steady(ramp, "both ramps"), -speed),
            Section("ramp", ramp, -speed, 0.0),
            Section("rest", self.dwell_s),
        ]

    def _forward(self) -> list[Section]:
        return self._pass(self.ramp_s, "both ramps")

    def _pass(self, stop: Any, parts: str) -> list[Section]:
        """Return the sections of a pass that stops within the time `stop` (s); see `_steady`."""
        speed, ramp = self._speed, self.ramp_s
        return [
            Section("ramp", ramp, 0.0, speed),
            Section("steady", self._steady(0.5 * (ramp + stop), parts), speed),
            Section("ramp", stop, speed, 0.0, "braking"),
            Section("rest", self.dwell_s),
        ]

    @property
    def _speed(self) -> Any:
        """Steady speed with the sign of the reversal, rad/s."""
        rate, angle = self.speed_rpm * (REV / 60.0), self.reversal_deg * DEG
        return rate * namespace(angle).sign(angle)

    def _steady(self, ramps: Any, parts: str) -> Any:
        """Return the time at steady speed in a pass, s.

        `ramps` is the angle of all its ramps divided by the steady speed, s, and `parts` their
        description for the message of the `ValueError` for ramps that exceed the pass.
        """
        rate, distance = self.speed_rpm * (REV / 60.0), abs(self.reversal_deg * DEG)
        ramps = rate * ramps
        time = (distance - ramps) / rate
        if not is_known(time) or time >= 0:
            return time
        if distance < ramps * (1 - _ROUNDING):
            raise ValueError(
                f"Argument `reversal_deg` must be at least {float(ramps) / DEG:.10g}° ({parts}) in"
                f" either direction, but is {float(self.reversal_deg):.10g}°; increase it, reduce"
                " the speed or shorten the ramps."
            )
        return 0.0 * time


class SlowDown(Reversal):
    """Command: to `reversal_deg` with a slow-down half way, and a stop that never turns back.

    The speed falls to the share `slow_share`, stays there for `dwell_s` and rises again; the run
    ends with a standstill of `dwell_s`. `braking_s` is the start of the slow-down.
    """

    event: ClassVar[str] = "slow_down"

    slow_share: Quantity = SLOW_SHARE()

    def _sections(self) -> list[Section]:
        return _slow_pass(self, self.slow_share, self.dwell_s)


class AbortedStop(Reversal):
    """The slow-down of `SlowDown` without time at the slow speed, then the reversal."""

    event: ClassVar[str] = "aborted"

    slow_share: Quantity = SLOW_SHARE()

    def _forward(self) -> list[Section]:
        return _slow_pass(self, self.slow_share, None)


class EmergencyStop(Reversal):
    """The reversal, but the forward pass stops within `stop_s`."""

    event: ClassVar[str] = "emergency_stop"

    stop_s: Quantity = number(0.05, "emergency_stop: stopping time", "s", gt=0, le=1e6)

    def _forward(self) -> list[Section]:
        return self._pass(self.stop_s, "ramp and stop")


def _slow_pass(motion: Reversal, share: Any, slow_time: Any) -> list[Section]:
    """Return the sections of the forward pass with a slow-down half way.

    `share` is slow speed over steady speed, and `slow_time` the time at slow speed (s). If
    `slow_time` is None, the shaft accelerates again at once, and the stop counts as the braking.
    """
    speed, ramp = motion._speed, motion.ramp_s
    slow, slowing = share * speed, ramp * (1.0 - share)
    # Angle of two full ramps and of the two ramps between both speeds, over the steady speed.
    ramps = ramp + slowing * (1.0 + share)
    if slow_time is not None:
        ramps = ramps + share * slow_time
    half = Section("steady", 0.5 * motion._steady(ramps, "all ramps and the slow-down"), speed)
    marks = ("", "braking") if slow_time is None else ("braking", "")
    return [
        Section("ramp", ramp, 0.0, speed),
        half,
        Section("ramp", slowing, speed, slow, marks[0]),
        *([] if slow_time is None else [Section("steady", slow_time, slow)]),
        Section("ramp", slowing, slow, speed),
        half,
        Section("ramp", ramp, speed, 0.0, marks[1]),
        Section("rest", motion.dwell_s),
    ]


def _joined(sections: list[Section], *, jerky: bool) -> PieceMotion:
    """Return the motion that consists of consecutive sections; `jerky` for S-curve ramps."""
    clock: Any = float64(0.0)
    pieces: list[tuple[Any, ...]] = []
    pauses: list[int] = []
    marks: dict[str, Any] = {}
    for section in sections:
        if section.mark:
            marks[section.mark] = clock
        if section.shape == "rest":
            pauses.append(len(pieces) - 1)
            clock = clock + section.duration
            continue
        pieces.append((clock, *_piece(section, jerky)))
        clock = clock + section.duration
    xp = namespace(pieces)
    start, duration, speed, acceleration, jerk = map(xp.stack, zip(*pieces, strict=True))
    return PieceMotion(
        start=start,
        duration=duration,
        speed=speed,
        acceleration=acceleration,
        jerk=jerk,
        duration_s=clock,
        braking_s=marks.get("braking", clock),
        turn_s=marks.get("turn", clock),
        pauses=tuple(pauses),
        jerky=jerky,
    )


def _piece(section: Section, jerky: bool) -> tuple[Any, Any, Any, Any]:
    """Return duration, initial speed, initial acceleration and jerk of a section in motion."""
    duration = section.duration
    zero = 0.0 * duration  # an array of the same kind as the other values, with which it is stacked
    speed = section.speed + zero
    if section.shape == "steady":
        return duration, speed, zero, zero
    change = section.end_speed - section.speed
    if jerky:
        return duration, speed, zero, 4.0 * change / duration**2
    return duration, speed, change / duration, zero

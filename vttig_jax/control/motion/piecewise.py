"""Motions in pieces of constant or triangular acceleration, and their sequence of events."""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Real

from ...base.arrays import Number, Numbers, float64, namespace
from ...base.units import DEG, REV
from .limits import check_numbers, one_of, steady_time
from .motion import Motion, MotionPoint

Scalar = Float[Number, ""]
Pieces = Float[Numbers, " pieces"]


class _Piece(NamedTuple):
    """The piece a time lies in: where it starts and the numbers that hold from there on.

    At rest all but the angle are zero. The last two are None in a motion without jerk.
    """

    start: Any
    angle: Any
    speed: Any
    acceleration: Any
    jerk: Any
    half: Any


class PieceMotion(Motion):
    """Pieces one after the other, with standstills between; inside one, u seconds after its start,

        φ = φ_k + u (ω_k + u a_k/2) + j_k (u³ − 2w³)/6        w = max(u − T_k/2, 0)

    Its jerk is j_k in the first half of its duration T_k and −j_k in the second: a whole ramp of an
    S-curve is one piece. φ_k is the sum of what the pieces before cover, T (ω + T (a/2 + T j/8))
    each, so that no term grows with the time. Speed and acceleration are its derivatives.

    One piece is selected number by number and evaluated once. Selections are what a scan over many
    lanes does best; a sum over all pieces was five times slower with jerk.

    **Arguments** (arrays of shape (pieces,))
    - `start`, `duration`: of every piece in s. A piece starts when the one before it ends, or
      later if that one is among `pauses`.
    - `speed`, `acceleration`: at the start of the piece, rad/s and rad/s².
    - `jerk`: in the first half of the piece, rad/s³.
    - `duration_s`, `braking_s`, `turn_s`: see `Motion`.
    - `pauses`: the pieces after which the shaft stands still; it does after the last one anyway.
    - `jerky`: whether any jerk differs from zero; without it the cubic is left out.
    """

    start: Pieces = eqx.field(converter=float64)
    duration: Pieces = eqx.field(converter=float64)
    speed: Pieces = eqx.field(converter=float64)
    acceleration: Pieces = eqx.field(converter=float64)
    jerk: Pieces = eqx.field(converter=float64)
    duration_s: Scalar = eqx.field(converter=float64)
    braking_s: Scalar = eqx.field(converter=float64)
    turn_s: Scalar = eqx.field(converter=float64)
    pauses: tuple[int, ...] = eqx.field(static=True, default=())
    jerky: bool = eqx.field(static=True, default=True)

    def at(self, time: Real[ArrayLike, "*shape"]) -> MotionPoint:
        """Angle, speed and acceleration at times in s."""
        time = jnp.asarray(time, float)
        _, angle, speed, acceleration, jerk, half = piece = self._piece_at(time)
        since = time - piece.start
        angle = angle + since * (speed + since * (0.5 * acceleration))
        speed = speed + since * acceleration
        if self.jerky:
            late = jnp.maximum(since - half, 0.0)
            angle = angle + jerk * (since * since * since - 2.0 * (late * late * late)) / 6.0
            speed = speed + jerk * (0.5 * since * since - late * late)
            acceleration = acceleration + jerk * (since - 2.0 * late)
        return MotionPoint(angle, speed, acceleration)

    def _piece_at(self, time: Float[Array, "*shape"]) -> _Piece:
        """The piece that began last; a comparison for each, and one for each standstill.

        Where pieces meet, both are told apart by the same number: there is no instant between.
        """
        pieces = self.start.shape[0]
        angle: Any = jnp.zeros_like(time)
        zero = jnp.zeros_like(time)
        found = self._numbers(None, zero, zero)
        for place in range(pieces):
            start = self.start[place]
            found = _chosen(time >= start, self._numbers(place, start, angle), found)
            angle = angle + self._covered(place)
            if place + 1 == pieces or place in self.pauses:
                end = start + jnp.asarray(self.duration[place])
                found = _chosen(time >= end, self._numbers(None, end, angle), found)
        return found

    def _numbers(self, place: int | None, start: Any, angle: Any) -> _Piece:
        """Of a piece, or (None) of a standstill."""
        rest = place is None
        return _Piece(
            start,
            angle,
            speed=0.0 if rest else self.speed[place],
            acceleration=0.0 if rest else self.acceleration[place],
            jerk=None if not self.jerky else 0.0 if rest else self.jerk[place],
            half=None if not self.jerky else 0.0 if rest else 0.5 * self.duration[place],
        )

    def _covered(self, place: int) -> Any:
        """Angle that a piece covers, rad."""
        time, bend = self.duration[place], 0.5 * jnp.asarray(self.acceleration[place])
        if self.jerky:
            bend = bend + time * (0.125 * self.jerk[place])
        return time * (self.speed[place] + time * bend)


def _chosen(begun: Bool[Array, "*shape"], new: _Piece, old: _Piece) -> _Piece:
    return _Piece(
        *(
            None if later is None else jnp.where(begun, later, earlier)
            for later, earlier in zip(new, old, strict=True)
        )
    )


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

"""Motions of the driving shaft: angle, speed and acceleration at any time.

Commanded motions are trapezoids and S-curves with a reversal, a slow-down or a stop, in pieces of
constant or triangular acceleration, and a sine.
"""

from abc import abstractmethod
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ...base.arrays import Number, Numbers, float64, known, namespace
from ...base.numerics.sincos import sincos
from ...base.units import DEG, REV
from ..fields import Part, Quantity, number


class MotionPoint(eqx.Module):
    """Angle, speed and acceleration of the driving shaft at one time or at many.

    - `angle`: φ₁ in rad. - `speed`: dφ₁/dt in rad/s. - `acceleration`: d²φ₁/dt² in rad/s².
    """

    angle: Float[Array, "*shape"]
    speed: Float[Array, "*shape"]
    acceleration: Float[Array, "*shape"]


class Motion(Part):
    """Prescribed motion of the driving shaft; the gears have no effect on it.

    The shaft stands still before the time 0 and from `duration_s` on. JAX traces every number of a
    motion: new values need no compilation, and `vmap` runs a batch of motions.

    - `duration_s`: end of the run, s.
    - `braking_s`: start of the deceleration before the turn, s; in a motion that only slows down,
      start of the slow-down; `duration_s` without deceleration.
    - `turn_s`: time, s, when the shaft starts to move against its initial direction, after the
      standstill if there is one; `duration_s` without a turn.
    """

    if TYPE_CHECKING:  # a field of some motions, a property of others

        def __getattr__(self, name: str) -> Any: ...

    else:
        duration_s: eqx.AbstractVar[Float[Number, ""]]
        braking_s: eqx.AbstractVar[Float[Number, ""]]
        turn_s: eqx.AbstractVar[Float[Number, ""]]

    @property
    def pieces(self) -> "Motion":
        """The motion itself; commands such as `Reversal` make theirs here."""
        return self

    @abstractmethod
    def at(self, time: Real[ArrayLike, "*shape"]) -> MotionPoint:
        """Return angle, speed and acceleration at times in s.

        Where the acceleration is discontinuous, the value after the discontinuity is returned.
        """


Scalar = Float[Number, ""]
Pieces = Float[Numbers, " pieces"]


class PieceMotion(Motion):
    """Sequence of pieces, the last of which is a standstill without end.

    In piece k, u seconds after its start, the angle is

        φ = φ_k + u (ω_k + u a_k/2) + j_k (u³ − 2w³)/6        w = max(u − T_k/2, 0)

    The jerk is j_k in the first half of the duration T_k and −j_k in the second half, so a whole
    ramp of an S-curve is one piece. φ_k is the sum of the angles T (ω + T (a/2 + T j/8)) of all
    earlier pieces, so u stays small and loses no digits. Speed and acceleration are derivatives of
    φ.

    The coefficients of the active piece are selected first, and the polynomial is evaluated once.
    In a batch of runs this is faster than a sum over all pieces (five times with jerk).

    **Arguments** (arrays of shape (pieces,))
    - `start`, `duration`: times of every piece, s. A piece starts at the end of the one before it.
    - `speed`, `acceleration`: values at the start of the piece, rad/s and rad/s².
    - `jerk`: in the first half of the piece, rad/s³.
    - `duration_s`, `braking_s`, `turn_s`: see `Motion`.
    - `jerky`: whether any jerk differs from zero; if not, the cubic term is left out.
    """

    start: Pieces = eqx.field(converter=float64)
    duration: Pieces = eqx.field(converter=float64)
    speed: Pieces = eqx.field(converter=float64)
    acceleration: Pieces = eqx.field(converter=float64)
    jerk: Pieces = eqx.field(converter=float64)
    duration_s: Scalar = eqx.field(converter=float64)
    braking_s: Scalar = eqx.field(converter=float64)
    turn_s: Scalar = eqx.field(converter=float64)
    jerky: bool = eqx.field(static=True, default=True)

    def at(self, time: Real[ArrayLike, "*shape"]) -> MotionPoint:
        """Return angle, speed and acceleration at times in s.

        The piece that began last is active. The number of pieces that have begun is counted first,
        so XLA stores one array instead of the result of each comparison. A compiled loop that
        stores many results would not be vectorised.
        """
        time = jnp.asarray(time, float)
        angle: Any = jnp.zeros_like(time)
        rows = []
        for row in range(len(self.start)):
            duration, jerk = self.duration[row], self.jerk[row]
            rate, bend = self.speed[row], self.acceleration[row]
            ramp = (jerk, 0.5 * duration) if self.jerky else ()
            rows.append((self.start[row], angle, rate, bend, *ramp))
            bend = 0.5 * jnp.asarray(bend)
            if self.jerky:
                bend = bend + duration * (0.125 * jerk)
            angle = angle + duration * (rate + duration * bend)
        begun: Any = sum(jnp.where(time >= row[0], 1.0, 0.0) for row in rows)
        active: list[Any] = [jnp.zeros_like(time), jnp.zeros_like(time)] + [0.0] * (
            len(rows[0]) - 2
        )
        for place, row in enumerate(rows, 1):
            active = [jnp.where(begun >= place, *both) for both in zip(row, active, strict=True)]
        start, angle, speed, acceleration, *ramp = active
        since = time - start
        angle = angle + since * (speed + since * (0.5 * acceleration))
        speed = speed + since * acceleration
        if self.jerky:
            jerk, half = ramp
            late = jnp.maximum(since - half, 0.0)
            angle = angle + jerk * (since * since * since - 2.0 * (late * late * late)) / 6.0
            speed = speed + jerk * (0.5 * since * since - late * late)
            acceleration = acceleration + jerk * (since - 2.0 * late)
        return MotionPoint(angle, speed, acceleration)


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


_ROUNDING = 1e-12
"""Relative excess of the ramp angles over the reversal angle that is ignored as rounding error.

A chosen value."""


class Section(NamedTuple):
    """Section of a run: a ramp to another speed, or a steady speed or standstill; rad/s and s.

    `mark` is "braking" or "turn" if `Motion.braking_s` or `Motion.turn_s` is the start of the
    section; of several sections with the same mark, the last one counts.
    """

    duration: Any
    speed: Any = 0.0
    end_speed: Any = None
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
        if known(self) and not self.fits:
            raise ValueError(
                f"Argument `reversal_deg` must be at least {float(self.least_deg):.10g}° in either"
                f" direction, the angle of all ramps, but is {float(self.reversal_deg):.10g}°;"
                " increase it, reduce the speed or shorten the ramps."
            )
        return _joined(self._sections(), jerky=self.shape == "s_curve")

    @property
    def ramps_s(self) -> Any:
        """Angle of all ramps of one pass, divided by the steady speed, s.

        A ramp covers half the angle that the steady speed covers in the same time.
        """
        return self.ramp_s

    @property
    def least_deg(self) -> Any:
        """Smallest `reversal_deg`: the angle of all ramps of one pass."""
        return self.speed_rpm * 6.0 * self.ramps_s

    @property
    def fits(self) -> Any:
        """Whether `reversal_deg` lies outside the ramps."""
        return abs(self.reversal_deg) >= self.least_deg * (1 - _ROUNDING)

    def _sections(self) -> list[Section]:
        speed, ramp = self._speed, self.ramp_s
        return [
            *self._forward(),
            Section(ramp, 0.0, -speed, "turn"),
            Section(self._steady(ramp), -speed),
            Section(ramp, -speed, 0.0),
            Section(self.dwell_s),
        ]

    def _forward(self) -> list[Section]:
        return self._pass(self.ramp_s)

    def _pass(self, stop: Any) -> list[Section]:
        """Return the sections of a pass that stops within the time `stop` (s)."""
        speed, ramp = self._speed, self.ramp_s
        return [
            Section(ramp, 0.0, speed),
            Section(self._steady(0.5 * (ramp + stop)), speed),
            Section(stop, speed, 0.0, "braking"),
            Section(self.dwell_s),
        ]

    @property
    def _speed(self) -> Any:
        """Steady speed with the sign of the reversal, rad/s."""
        rate, angle = self.speed_rpm * (REV / 60.0), self.reversal_deg * DEG
        return rate * namespace(angle).sign(angle)

    def _steady(self, ramps: Any) -> Any:
        """Return the time at steady speed in a pass with these ramps, s; see `ramps_s`."""
        rate, distance = self.speed_rpm * (REV / 60.0), abs(self.reversal_deg * DEG)
        time = (distance - rate * ramps) / rate
        return time if not known(time) or time >= 0 else 0.0 * time


class AbortedStop(Reversal):
    """The reversal with a slow-down half way, after which the shaft accelerates again at once.

    The speed falls to the share `slow_share`. `braking_s` is the start of the stop.
    """

    event: ClassVar[str] = "aborted"

    slow_share: Quantity = number(
        0.3, "slow_down, aborted: slow speed over steady speed", "1", gt=0, lt=1
    )

    @property
    def ramps_s(self) -> Any:
        """See `Reversal.ramps_s`; the ramps between both speeds count too."""
        return self.ramp_s + self.ramp_s * (1.0 - self.slow_share) * (1.0 + self.slow_share)

    def _forward(self) -> list[Section]:
        speed, ramp = self._speed, self.ramp_s
        slow, slowing = self.slow_share * speed, ramp * (1.0 - self.slow_share)
        half = Section(0.5 * self._steady(self.ramps_s), speed)
        return [
            Section(ramp, 0.0, speed),
            half,
            Section(slowing, speed, slow, "braking"),
            Section(slowing, slow, speed),
            half,
            Section(ramp, speed, 0.0, "braking"),
            Section(self.dwell_s),
        ]


class SlowDown(AbortedStop):
    """Command: to `reversal_deg` with a slow-down half way, and a stop that never turns back.

    The speed falls to the share `slow_share`, stays there for `dwell_s` and rises again; the run
    ends with a standstill of `dwell_s`. `braking_s` is the start of the slow-down.
    """

    event: ClassVar[str] = "slow_down"

    @property
    def ramps_s(self) -> Any:
        """See `Reversal.ramps_s`; the time at the slow speed is included."""
        return super().ramps_s + self.slow_share * self.dwell_s

    def _sections(self) -> list[Section]:
        *falls, rises, half, stops, stands = self._forward()
        slow, stops = Section(self.dwell_s, falls[-1].end_speed), stops._replace(mark="")
        return [*falls, slow, rises, half, stops, stands]


class EmergencyStop(Reversal):
    """The reversal, but the forward pass stops within `stop_s`."""

    event: ClassVar[str] = "emergency_stop"

    stop_s: Quantity = number(0.05, "emergency_stop: stopping time", "s", gt=0, le=1e6)

    def _forward(self) -> list[Section]:
        return self._pass(self.stop_s)

    @property
    def ramps_s(self) -> Any:
        """See `Reversal.ramps_s`; the longer pass counts."""
        stop = self.stop_s
        return namespace(self.ramp_s, stop).maximum(self.ramp_s, 0.5 * (self.ramp_s + stop))


def _joined(sections: list[Section], *, jerky: bool) -> PieceMotion:
    """Return the motion that consists of consecutive sections; `jerky` for S-curve ramps."""
    clock: Any = float64(0.0)
    pieces: list[tuple[Any, ...]] = []
    marks: dict[str, Any] = {}
    for duration, speed, end_speed, mark in sections:
        marks |= {mark: clock}
        acceleration = jerk = zero = 0.0 * duration  # arrays of the same kind can be stacked
        if end_speed is not None and jerky:
            jerk = 4.0 * (end_speed - speed) / duration**2
        elif end_speed is not None:
            acceleration = (end_speed - speed) / duration
        pieces.append((clock, duration, speed + zero, acceleration, jerk))
        clock = clock + duration
    columns = map(namespace(pieces).stack, zip(*pieces, strict=True))
    return PieceMotion(
        *columns,
        duration_s=clock,
        braking_s=marks.get("braking", clock),
        turn_s=marks.get("turn", clock),
        jerky=jerky,
    )


class Sine(Motion):
    """Motion φ = A (1 − cos 2πft)/2 = A sin² πft of one period, from rest to rest.

    It goes to `reversal_deg`, A, and back, with the peak speed ω = πfA of `speed_rpm`; a negative A
    gives the mirrored motion. The speed is highest after a quarter of the period, where braking
    begins; the turn is at half the period. At both ends the speed is continuous, and the
    acceleration jumps by 2A(πf)². The motion has no ramps and no standstill.

    **Raises** `ValueError` for numbers out of range. Traced values are not checked.

    **Example**
    ```python
    >>> import math, vttig_jax
    >>> from vttig_jax.control import Sine
    >>> vttig_jax.enable_x64()
    >>> motion = Sine(speed_rpm=60.0, reversal_deg=720.0)
    >>> point = motion.at(motion.braking_s)
    >>> round(math.degrees(point.angle)), round(float(point.speed) / (2 * math.pi) * 60)
    (360, 60)

    ```
    """

    event: ClassVar[str] = "reversal"
    shape: ClassVar[str] = "sine"

    speed_rpm: Quantity = SPEED_RPM()
    reversal_deg: Quantity = REVERSAL_DEG()

    @property
    def duration_s(self) -> Any:
        """One period 1/f, s."""
        return np.pi * abs(self.reversal_deg * DEG) / (self.speed_rpm * (REV / 60.0))

    @property
    def braking_s(self) -> Any:
        """See `Motion`."""
        return 0.25 * self.duration_s

    @property
    def turn_s(self) -> Any:
        """See `Motion`."""
        return 0.5 * self.duration_s

    def at(self, time: Real[ArrayLike, "*shape"]) -> MotionPoint:
        """Return angle, speed and acceleration at times in s."""
        time = jnp.asarray(time, float)
        rate = np.pi / jnp.asarray(self.duration_s)
        size = jnp.asarray(self.reversal_deg * DEG)
        moves = (time >= 0.0) & (time < self.duration_s)
        sine, cosine = sincos(rate * jnp.where(moves, time, 0.0))
        return MotionPoint(
            angle=size * sine * sine,
            speed=2.0 * size * rate * sine * cosine,
            acceleration=jnp.where(
                moves, 2.0 * size * rate * rate * (cosine * cosine - sine * sine), 0.0
            ),
        )

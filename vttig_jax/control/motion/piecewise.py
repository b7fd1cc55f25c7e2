"""Motions in pieces of constant or triangular acceleration."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ...base.arrays import Number, Numbers, float64
from .motion import Motion, MotionPoint

Scalar = Float[Number, ""]
Pieces = Float[Numbers, " pieces"]


class _Piece(NamedTuple):
    """Piece of a motion, or standstill, that is active at a time; units rad and s.

    `angle` … `jerk` are its values at the time `start`, and `half` is half of its duration. At
    standstill all values except the angle are zero. In a motion without jerk, `jerk` and `half` are
    None.
    """

    start: Any
    angle: Any
    speed: Any
    acceleration: Any
    jerk: Any
    half: Any


class PieceMotion(Motion):
    """Sequence of pieces, with standstills between some of them.

    In piece k, u seconds after its start, the angle is

        φ = φ_k + u (ω_k + u a_k/2) + j_k (u³ − 2w³)/6        w = max(u − T_k/2, 0)

    The jerk is j_k in the first half of the duration T_k and −j_k in the second half, so a whole
    ramp of an S-curve is one piece. φ_k is the sum of the angles T (ω + T (a/2 + T j/8)) of all
    earlier pieces, so u stays small and loses no digits. Speed and acceleration are derivatives of
    φ.

    The coefficients of the active piece are selected first, and the polynomial is evaluated once.
    In a batch of runs this is faster than a sum over all pieces (five times with jerk).

    **Arguments** (arrays of shape (pieces,))
    - `start`, `duration`: times of every piece, s. A piece starts at the end of the one before it,
      or later if that one is among `pauses`.
    - `speed`, `acceleration`: values at the start of the piece, rad/s and rad/s².
    - `jerk`: in the first half of the piece, rad/s³.
    - `duration_s`, `braking_s`, `turn_s`: see `Motion`.
    - `pauses`: pieces followed by a standstill, besides the last piece.
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
    pauses: tuple[int, ...] = eqx.field(static=True, default=())
    jerky: bool = eqx.field(static=True, default=True)

    def at(self, time: Real[ArrayLike, "*shape"]) -> MotionPoint:
        """Return angle, speed and acceleration at times in s."""
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
        """Return the piece or standstill that is active at a time (s): the one that began last.

        A piece ends exactly where the next one starts, so there is no gap between them. The number
        of pieces that have begun is counted first, so XLA stores one array instead of the result of
        each comparison. A compiled loop that stores many results would not be vectorised.
        """
        pieces = self.start.shape[0]
        zero: Any = jnp.zeros_like(time)
        angle, edges, active = zero, list[Any](), self._values_of(None, zero, zero)
        values = list[_Piece]()
        for index in range(pieces):
            start = self.start[index]
            edges.append(start)
            values.append(self._values_of(index, start, angle))
            angle = angle + self._angle_of(index)
            if index + 1 == pieces or index in self.pauses:
                end = start + jnp.asarray(self.duration[index])
                edges.append(end)
                values.append(self._values_of(None, end, angle))
        begun: Any = sum(jnp.where(time >= edge, 1.0, 0.0) for edge in edges)
        for number, value in enumerate(values, 1):
            active = _Piece(
                *(
                    None if new is None else jnp.where(begun >= number, new, old)
                    for new, old in zip(value, active, strict=True)
                )
            )
        return active

    def _values_of(self, index: int | None, start: Any, angle: Any) -> _Piece:
        """Return the piece with number `index`, or a standstill if `index` is None.

        `start` (s) and `angle` (rad) are its start and the angle there.
        """
        rest = index is None
        return _Piece(
            start,
            angle,
            speed=0.0 if rest else self.speed[index],
            acceleration=0.0 if rest else self.acceleration[index],
            jerk=None if not self.jerky else 0.0 if rest else self.jerk[index],
            half=None if not self.jerky else 0.0 if rest else 0.5 * self.duration[index],
        )

    def _angle_of(self, index: int) -> Any:
        """Return the angle (rad) that a piece covers."""
        time, bend = self.duration[index], 0.5 * jnp.asarray(self.acceleration[index])
        if self.jerky:
            bend = bend + time * (0.125 * self.jerk[index])
        return time * (self.speed[index] + time * bend)

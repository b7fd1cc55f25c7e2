"""A motion that was recorded: a table of times and driving angles, made smooth."""

from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float, Real
from scipy.interpolate import CubicSpline

from ..base.arrays import Number, Numbers, float64
from ..base.units import DEG
from .landmarks import braking_of, turn_of
from .motion import Motion, MotionPoint
from .motion_table import read_columns

Scalar = Float[Number, ""]


class RecordedMotion(Motion):
    """A cubic spline through recorded angles; `recorded` makes it, `read_motion` from a file.

    The spline is found by SciPy when it is made. Its place in the table is found by bisection: new
    values in a table of the same length compile nothing.

    **Arguments**
    - `knots`: times in s, the first of them 0.
    - `coefficients`: (n − 1, 4): of u³, u², u and 1, u the time since the knot; rad and s.
    - `duration_s`, `braking_s`, `turn_s`: see `Motion`.
    """

    knots: Float[Numbers, " n"] = eqx.field(converter=float64)
    coefficients: Float[Numbers, "n-1 4"] = eqx.field(converter=float64)
    duration_s: Scalar = eqx.field(converter=float64)
    braking_s: Scalar = eqx.field(converter=float64)
    turn_s: Scalar = eqx.field(converter=float64)

    def at(self, time: Real[ArrayLike, "*shape"]) -> MotionPoint:
        """Angle, speed and acceleration at times in s."""
        time = jnp.asarray(time, float)
        knots = jnp.asarray(self.knots)
        inside = jnp.clip(time, 0.0, knots[-1])
        place = jnp.searchsorted(knots[1:-1], inside, side="right")
        since = inside - knots[place]
        a, b, c, d = jnp.moveaxis(jnp.asarray(self.coefficients)[place], -1, 0)
        moves = (time >= 0.0) & (time < knots[-1])
        return MotionPoint(
            angle=((a * since + b) * since + c) * since + d,
            speed=jnp.where(moves, (3.0 * a * since + 2.0 * b) * since + c, 0.0),
            acceleration=jnp.where(moves, 6.0 * a * since + 2.0 * b, 0.0),
        )


def recorded(time: Real[np.ndarray, " n"], driving_angle: Real[np.ndarray, " n"]) -> RecordedMotion:
    """The motion through driving angles in rad at times in s, evenly spaced or not.

    A cubic spline with continuous acceleration goes through every row. It is at rest at both ends,
    as the shaft is before and after; a recording that begins or ends in motion gains or loses its
    speed within a few rows there. Noise goes through as well: twice differentiated, one count of
    14.4″ at 1 kHz is 70 rad/s², so smooth a log first or thin it out.

    The run starts at the first time, which becomes 0. `turn_s` is the last row of the farthest
    angle before the shaft goes back by more than 1 % of the range of all angles, `braking_s` the
    last time before it with 98 % of the highest speed, the speeds averaged over a thousandth of the
    run; without a turn, the last time before the speed first falls below 90 %.

    **Raises** `ValueError` for arrays of different or less than two rows, numbers that are not
    finite, times that do not increase and angles that never change.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax.control.recorded_motion import recorded
    >>> vttig_jax.enable_x64()
    >>> motion = recorded(np.array([5.0, 6.0, 7.0]), np.array([0.0, 2.0, 0.0]))
    >>> motion.turn_s.item(), motion.duration_s.item()
    (1.0, 2.0)
    >>> motion.at(np.array([0.0, 0.5, 1.0])).angle.tolist()
    [0.0, 1.0, 2.0]

    ```
    """
    time, angle = np.asarray(time, np.float64), np.asarray(driving_angle, np.float64)
    _check_rows(time, angle)
    time = time - time[0]
    spline = CubicSpline(time, angle, bc_type="clamped")
    coefficients = spline.c.T.copy()
    coefficients[0, 2] = 0.0  # SciPy leaves a rounding of the speed at the start
    turn_s, sense = turn_of(time, angle)
    return RecordedMotion(
        knots=time,
        coefficients=coefficients,
        duration_s=time[-1],
        braking_s=braking_of(spline, turn_s, sense),
        turn_s=turn_s,
    )


def read_motion(path: str | Path) -> RecordedMotion:
    """The motion in a CSV file with the columns `time_s` and `driving_deg`; see `recorded`.

    The first line names the columns, which are separated by commas; others may stand beside the
    two. Empty lines and lines that begin with `#` are skipped.

    **Raises** `InputError` with file and line for a file that cannot be read, lacks a column or
    holds a row that is no row of a motion.
    """
    time, angle_deg = read_columns(path)
    return recorded(time, angle_deg * DEG)


def _check_rows(time: Float[np.ndarray, "..."], angle: Float[np.ndarray, "..."]) -> None:
    if time.ndim != 1 or time.shape != angle.shape:
        raise ValueError(
            "Argument `driving_angle` must have one angle for every time, but the shapes are"
            f" {angle.shape} and {time.shape}."
        )
    if len(time) < 2:
        raise ValueError(f"Argument `time` must have two rows or more, but has {len(time)}.")
    for name, values in (("time", time), ("driving_angle", angle)):
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0])
            raise ValueError(
                f"Argument `{name}` must be finite, but is {values[row]} in row {row}."
            )
    late = np.flatnonzero(np.diff(time) <= 0)
    if len(late):
        row = int(late[0]) + 1
        raise ValueError(
            f"Argument `time` must increase, but goes from {time[row - 1]:.10g} to"
            f" {time[row]:.10g} s in row {row}."
        )
    if np.ptp(angle) == 0:
        raise ValueError("Argument `driving_angle` must change, but the shaft never moves.")

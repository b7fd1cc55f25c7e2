"""Recorded motions: the CSV file, the spline through its rows, and the braking and turn times."""

from pathlib import Path
from typing import Final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float, Real
from scipy.interpolate import CubicSpline

from ...base.arrays import Number, Numbers, float64
from ...base.errors import InputError, LogError
from ...base.units import DEG
from ...logs.readers.delimited import find_table
from ...logs.readers.text import read_text
from ...pair.schema import LogLayout
from .motion import Motion, MotionPoint

BACK: Final = 0.01
"""Smallest backward angle that counts as a turn, as a fraction of the range of angles; chosen."""

FULL: Final = 0.98
"""Fraction of the highest speed; when the speed falls below it, braking begins; a chosen value."""

SLOW: Final = 0.9
"""Fraction of the highest speed below which a motion without turn counts as slowed down; chosen."""

_SAME_ANGLE: Final = 1e-9
"""Difference up to which angles count as equal, as a fraction of the range of angles; chosen."""

_AVERAGING: Final = 1e-3
"""Averaging time of a speed, as a fraction of the duration of the run; a chosen value."""

_STEPS: Final = 8
"""Number of overlapping mean speeds computed per averaging time; a chosen value."""


def turn_of(time: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the turn time (s) and the direction of the run before it, +1 or −1.

    Let a be the fraction `BACK` of the range of all angles. The direction is the one in which the
    angle first differs from its initial value by more than a. The shaft has turned when it moves
    back by more than a from its farthest angle so far, and the turn is the last row at that
    farthest angle. A smaller backward movement is play, noise or one encoder count. Without a turn,
    the time of the last row is returned. `time` is in s; `angle` may have any unit.
    """
    travel = angle - angle[0]
    threshold = BACK * np.ptp(angle)
    sense = float(np.sign(travel[np.flatnonzero(np.abs(travel) > threshold)[0]]))
    farthest = np.maximum.accumulate(sense * travel)
    back = np.flatnonzero(farthest - sense * travel > threshold)
    if not len(back):
        return float(time[-1]), sense
    top = farthest[back[0]] - _SAME_ANGLE * np.ptp(angle)
    return float(time[np.flatnonzero(sense * travel[: back[0]] >= top)[-1]]), sense


def braking_of(spline: CubicSpline, turn_s: float, sense: float) -> float:
    """Return the time (s) when the shaft leaves its highest speed.

    A speed is the mean over a thousandth of the run, to suppress single encoder counts, and its
    time is the middle of this interval. The function returns the time of the last speed before the
    turn that reaches the fraction `FULL` of the highest speed. Without a turn, only speeds before
    the first one below the fraction `SLOW` are considered. `sense` is the direction, 1 or −1.
    """
    end = float(spline.x[-1])
    edges = np.linspace(0.0, end, round(_STEPS / _AVERAGING) + 1)
    angle = sense * spline(edges)
    travel = angle[_STEPS:] - angle[:-_STEPS]
    middle = 0.5 * (edges[_STEPS:] + edges[:-_STEPS])
    travel = travel[middle <= turn_s]
    if not len(travel) or travel.max() <= 0:
        return turn_s
    highest = travel.max()
    if turn_s == end:
        first = int(np.argmax(travel >= FULL * highest))
        slow = np.flatnonzero(travel[first:] < SLOW * highest)
        travel = travel[: first + slow[0]] if len(slow) else travel
    return min(float(middle[np.flatnonzero(travel >= FULL * highest)[-1]]), turn_s)


COLUMNS: Final = ("time_s", "driving_deg")

SHORTEST_S: Final = 1e-9
"""Shortest time between two rows, s; a chosen value."""

LARGEST: Final = 1e12
"""Largest time (s) or angle (deg) in the file; for larger numbers double precision is too coarse.
"""


Scalar = Float[Number, ""]


class RecordedMotion(Motion):
    """Motion along a cubic spline through recorded angles; see `recorded` and `read_motion`.

    SciPy computes the spline once. Each evaluation finds its interval by bisection, so new values
    in a table of the same length need no compilation.

    **Arguments**
    - `knots`: times in s; the first is 0.
    - `coefficients`: coefficients of u³, u², u and 1 in every interval, where u is the time since
      its first knot; rad and s; shape (n − 1, 4).
    - `duration_s`, `braking_s`, `turn_s`: see `Motion`.
    """

    knots: Float[Numbers, " n"] = eqx.field(converter=float64)
    coefficients: Float[Numbers, "n-1 4"] = eqx.field(converter=float64)
    duration_s: Scalar = eqx.field(converter=float64)
    braking_s: Scalar = eqx.field(converter=float64)
    turn_s: Scalar = eqx.field(converter=float64)

    def at(self, time: Real[ArrayLike, "*shape"]) -> MotionPoint:
        """Return angle, speed and acceleration at times in s."""
        time = jnp.asarray(time, float)
        knots = jnp.asarray(self.knots)
        inside = jnp.clip(time, 0.0, knots[-1])
        index = jnp.searchsorted(knots[1:-1], inside, side="right")
        since = inside - knots[index]
        a, b, c, d = jnp.moveaxis(jnp.asarray(self.coefficients)[index], -1, 0)
        moves = (time >= 0.0) & (time < knots[-1])
        return MotionPoint(
            angle=((a * since + b) * since + c) * since + d,
            speed=jnp.where(moves, (3.0 * a * since + 2.0 * b) * since + c, 0.0),
            acceleration=jnp.where(moves, 6.0 * a * since + 2.0 * b, 0.0),
        )


def recorded(time: Real[np.ndarray, " n"], driving_angle: Real[np.ndarray, " n"]) -> RecordedMotion:
    """Return the motion through driving angles in rad at times in s, evenly spaced or not.

    A cubic spline with continuous acceleration passes through every row. Its speed is zero at both
    ends, as the shaft stands before and after the run. If the recording begins or ends in motion,
    the spline therefore reaches or loses its speed within a few rows. Noise is not removed: one
    encoder count of 14.4″ at 1 kHz, differentiated twice, gives 70 rad/s², so smooth a log or take
    fewer rows of it first.

    The first time becomes 0. `turn_s` is the last row at the farthest angle before the shaft moves
    back by more than 1 % of the range of angles. `braking_s` is the last time before `turn_s` with
    at least 98 % of the highest speed (means over a thousandth of the run). Without a turn, it is
    the last such time before the speed first falls below 90 %.

    **Raises** `ValueError` for arrays of different length or less than two rows, numbers that are
    not finite, times that do not increase and angles that never change.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax.control import recorded
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
    coefficients[0, 2] = 0.0  # SciPy leaves a rounding error of the initial speed
    turn_s, sense = turn_of(time, angle)
    return RecordedMotion(
        knots=time,
        coefficients=coefficients,
        duration_s=time[-1],
        braking_s=braking_of(spline, turn_s, sense),
        turn_s=turn_s,
    )


def read_motion(path: str | Path) -> RecordedMotion:
    """Read the motion in a CSV file with the columns `time_s` and `driving_deg`; see `recorded`.

    The first line has the names of the columns, separated by commas; other columns are ignored.
    Empty lines and lines that begin with `#` are skipped.

    **Raises** `InputError` with file and line for a file that cannot be read, lacks a column or
    has an invalid row.
    """
    source, header = str(path), ",".join(COLUMNS)
    text, _, _ = read_text(path, None)
    try:  # fields without a number become NaN, which is refused below
        table = find_table(text, source, LogLayout(delimiter=",", decimal=".", missing="skip"))
    except LogError as error:
        raise InputError(
            f"there is no table; write the header {header} and lines of numbers below it, separated"
            " by commas.",
            where=error.where,
        ) from None
    for name in COLUMNS:
        if (count := table.names.count(name)) != 1:
            raise InputError(
                f"the file has {count} columns `{name}` (the header has {', '.join(table.names)});"
                f" write the header {header}.",
                where=source,
            )
    places = [table.names.index(name) for name in COLUMNS]
    times, angles = (values.astype(float) for values in table.own_columns(places, keep_last=True))
    gaps = np.diff(times, prepend=-np.inf)
    for row, (line, fields) in enumerate(table.rows()):
        where = f"{source}: line {line}"
        for name, place, values in zip(COLUMNS, places, (times, angles), strict=True):
            if not abs(values[row]) <= LARGEST:
                seen = f"`{fields[place]}`" if any(fields[place : place + 1]) else "empty"
                raise InputError(
                    f"{name} is {seen}; write a number up to {LARGEST:g} with a decimal point, or"
                    " remove the row.",
                    where=where,
                )
        if gaps[row] < SHORTEST_S:
            raise InputError(
                f"time_s goes from {times[row - 1]} to {times[row]}; times must increase from row"
                f" to row by {SHORTEST_S:g} s or more, so remove the row or sort the file.",
                where=where,
            )
    if len(times) < 2:
        raise InputError("the file has one row; a motion needs two or more.", where=source)
    if np.ptp(angles) == 0:
        raise InputError(
            f"driving_deg is {angles[0]:.10g} in every row; a motion must move the shaft.",
            where=source,
        )
    return recorded(times, angles * DEG)


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
    descents = np.flatnonzero(np.diff(time) <= 0)
    if len(descents):
        row = int(descents[0]) + 1
        raise ValueError(
            f"Argument `time` must increase, but goes from {time[row - 1]:.10g} to"
            f" {time[row]:.10g} s in row {row}."
        )
    if np.ptp(angle) == 0:
        raise ValueError("Argument `driving_angle` must change, but the shaft never moves.")

"""A recorded motion: its CSV file, its smooth curve, and when it brakes and turns."""

import csv
import math
from collections.abc import Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import Final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float, Real
from scipy.interpolate import CubicSpline

from ...base.arrays import Number, Numbers, float64
from ...base.errors import InputError
from ...base.units import DEG
from .motion import Motion, MotionPoint

BACK: Final = 0.01
"""Share of the recorded range of angles that the shaft must go back to have turned."""

FULL: Final = 0.98
"""Share of the highest speed below which the shaft has begun to brake."""

SLOW: Final = 0.9
"""Share of the highest speed below which a motion that never turns back has slowed down."""

_TOUCHING: Final = 1e-9
"""Share of the range within which two angles are the same."""

_MEAN: Final = 1e-3
"""Share of the run over which a speed is averaged."""

_STEPS: Final = 8
"""Speeds for every time of averaging."""


def turn_of(time: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """When the shaft starts to move backwards, s, and the sense of the run before, +1 or −1.

    The sense is that in which the angle first leaves its start by `BACK` of the range of all
    angles. The shaft has turned where it comes back from its farthest angle so far by as much; it
    starts to move backwards at the last row of that farthest angle. Less is play, noise or a count
    to and fro. Without a turn it is the last time.
    """
    away = angle - angle[0]
    least = BACK * np.ptp(angle)
    sense = float(np.sign(away[np.flatnonzero(np.abs(away) > least)[0]]))
    farthest = np.maximum.accumulate(sense * away)
    back = np.flatnonzero(farthest - sense * away > least)
    if not len(back):
        return float(time[-1]), sense
    top = farthest[back[0]] - _TOUCHING * np.ptp(angle)
    return float(time[np.flatnonzero(sense * away[: back[0]] >= top)[-1]]), sense


def braking_of(spline: CubicSpline, turn_s: float, sense: float) -> float:
    """Until when the shaft ran at its highest speed, s.

    Speeds are means over a thousandth of the run, so that one count of an encoder is no speed. The
    middle of the last of them before the turn that reaches `FULL` of the highest is taken; without
    a turn, of the last before the speed first falls below `SLOW` of it.
    """
    end = float(spline.x[-1])
    edges = np.linspace(0.0, end, round(_STEPS / _MEAN) + 1)
    angle = sense * spline(edges)
    gained = angle[_STEPS:] - angle[:-_STEPS]
    middle = 0.5 * (edges[_STEPS:] + edges[:-_STEPS])
    gained = gained[middle <= turn_s]
    if not len(gained) or gained.max() <= 0:
        return turn_s
    highest = gained.max()
    if turn_s == end:
        first = int(np.argmax(gained >= FULL * highest))
        slow = np.flatnonzero(gained[first:] < SLOW * highest)
        gained = gained[: first + slow[0]] if len(slow) else gained
    return min(float(middle[np.flatnonzero(gained >= FULL * highest)[-1]]), turn_s)


COLUMNS: Final = ("time_s", "driving_deg")

SHORTEST_S: Final = 1e-9
"""Least time between two rows."""

LARGEST: Final = 1e12
"""Of a time or an angle in the file; beyond, neighbouring numbers are too far apart."""

_LIKE: Final = "it needs the columns time_s and driving_deg, separated by commas"


def read_columns(path: str | Path) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Times in s and driving angles in degrees, checked row by row.

    **Raises** `InputError` naming file, line and cure.
    """
    path = Path(path)
    rows = _rows(path)
    line, header = next(rows, (0, []))
    if not header:
        raise InputError(f"the file is empty; {_LIKE}.", where=str(path))
    places = [_place(header, name, path, line) for name in COLUMNS]
    found: list[tuple[float, float]] = []
    for line, fields in rows:
        where = f"{path}, line {line}"
        if len(fields) != len(header):
            raise InputError(
                f"{len(fields)} fields under {len(header)} column names; give every column one"
                " value, with a decimal point.",
                where=where,
            )
        time, angle = (
            _number(fields[place], name, where) for place, name in zip(places, COLUMNS, strict=True)
        )
        if found and time - found[-1][0] < SHORTEST_S:
            raise InputError(
                f"time_s goes from {found[-1][0]!r} to {time!r}; times must increase from row to"
                f" row, by {SHORTEST_S:g} s or more, so take the row out or sort the file.",
                where=where,
            )
        found.append((time, angle))
    if len(found) < 2:
        raise InputError(
            f"the number of rows is {len(found)}; a motion needs two or more.", where=str(path)
        )
    times, angles = np.array(found, np.float64).T
    if np.ptp(angles) == 0:
        raise InputError(
            f"driving_deg is {angles[0]:.10g} in every row; a motion must move the shaft.",
            where=str(path),
        )
    return times, angles


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Number and stripped fields of every line that is neither empty nor a remark."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, strict=True)
            for row in reader:
                fields = [field.strip() for field in row]
                if any(fields) and not fields[0].startswith("#"):
                    yield reader.line_num, fields
    except FileNotFoundError:
        raise InputError("no such file; check the path of the motion.", where=str(path)) from None
    except IsADirectoryError:
        raise InputError(
            "this is a folder; name the file of the motion in it.", where=str(path)
        ) from None
    except PermissionError:
        raise InputError(
            "no permission to read this file; change its access rights.", where=str(path)
        ) from None
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror or error}); check the path and the disk.",
            where=str(path),
        ) from None
    except UnicodeDecodeError:
        raise InputError(
            f"not text in UTF-8; save the motion as CSV: {_LIKE}.", where=str(path)
        ) from None
    except csv.Error as error:
        raise InputError(
            f"not a CSV file ({error}); save the motion as CSV: {_LIKE}.", where=str(path)
        ) from None


def _place(header: list[str], name: str, path: Path, line: int) -> int:
    """Where a column stands."""
    where = f"{path}, line {line}"
    count = header.count(name)
    if count > 1:
        raise InputError(f"{count} columns are named {name}; keep one of them.", where=where)
    if count == 1:
        return header.index(name)
    like = get_close_matches(name, header, n=1)
    shown = ", ".join(header[:8]) + (", …" if len(header) > 8 else "")
    cure = f"rename `{like[0]}` if it is meant" if like else _LIKE
    raise InputError(f"no column {name} among: {shown}; {cure}.", where=where)


def _number(field: str, name: str, where: str) -> float:
    try:
        value = float(field)
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST or "_" in field:
        seen = f"`{field}`" if field else "empty"
        raise InputError(
            f"{name} is {seen}; write a number up to {LARGEST:g} with a decimal point, or take the"
            " row out.",
            where=where,
        )
    return value


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

"""Error table of an axis: what a control adds to its command so that the axis stands where asked.

A motor turns the driving gear, the axis is the driven gear (or the driving one, for a drive whose
rate matters). At the command p the gears are at φ₁ = (p − z)/g, where g is the axis angle of a
radian of φ₁ and z its zero, and the axis stands at

    actual(p) = p + E(p),    E(p) = (g/i) (TE(φ₁) − m),

with the level m where the encoders read zero. The correction c solves actual(p + c) = p, so that
c = −E(p + c). E is that of flank A while φ₁ grows and of flank B while it falls: one correction for
each direction. A control interpolates linearly between the nodes of its table; they are the least
squares fit of c by such a polygon, not its values, which would leave more of short waves.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import solveh_banded

from ...base.errors import NoAnswerError, UsageError
from ...base.units import REV
from ...pair.gear_pair import Flank

Curve = Callable[[Float[np.ndarray, " n"]], np.ndarray]
"""TE over driving angles, rad; its result may have a further axis of draws."""

DIRECTIONS = ("forward", "reverse")

_PER_INTERVAL, _MOST_NODES = 16, 20_000
"""Points of the correction in an interval of the table, and most intervals (chosen)."""

_STEEPEST = 0.5
"""|dE/dp| above which positions are not told apart: the fixed point c = −E(p + c) would be lost."""


@dataclass(frozen=True)
class AxisError:
    """How far an axis stands from its command, by direction.

    **Arguments**
    - `errors`: flank → TE less its level, rad of the driven gear, at driving angles, rad. A further
      axis of the result holds draws.
    - `ratio`: i. - `gain`: axis angle of a radian of φ₁: i for the driven shaft, 1 for the driving
      one, negative if the axis counts the other way.
    - `zero`: position of the axis where φ₁ = 0 in the fit, rad.
    - `turns`: turns of the axis, from the zero, between which the control cannot tell.
    """

    errors: Mapping[Flank, Curve]
    ratio: float
    gain: float
    zero: float = 0.0
    turns: tuple[int, ...] = (0,)

    @property
    def directions(self) -> dict[str, Flank]:
        """Flank that carries in each direction of the axis, of those that were measured."""
        flanks: tuple[Flank, Flank] = ("A", "B") if self.gain > 0 else ("B", "A")
        both = zip(DIRECTIONS, flanks, strict=True)
        return {direction: flank for direction, flank in both if flank in self.errors}

    def at(self, flank: Flank, position: Float[np.ndarray, " n"], turn: int = 0) -> np.ndarray:
        """Return E at positions of the axis, rad, in one of its turns."""
        driving = (position + turn * REV - self.zero) / self.gain
        return self.gain / self.ratio * self.errors[flank](driving)

    def mean(self, flank: Flank, position: Float[np.ndarray, " n"]) -> np.ndarray:
        """Return E averaged over the turns that the control cannot tell apart, rad."""
        return np.mean([self.at(flank, position, turn) for turn in self.turns], axis=0)

    def correction(
        self, flank: Flank, position: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Return c at positions of the axis, rad.

        **Raises** `NoAnswerError` if E is so steep that the axis would stand still or turn back.
        """
        found = -self.mean(flank, position)
        near = 1e-4 * REV / 360
        slope = (self.mean(flank, position + near) - self.mean(flank, position - near)) / (2 * near)
        if np.max(np.abs(slope)) > _STEEPEST:
            raise NoAnswerError(
                f"the error changes by {np.max(np.abs(slope)):.2g}° in a degree of the axis, so"
                " that commands and positions are not one to one; fit fewer orders."
            )
        step = np.inf
        while True:
            last, found = found, -self.mean(flank, position + found)
            before, step = step, float(np.max(np.abs(found - last)))
            if step < 1e-13 or step >= 0.75 * before:  # far from zero, angles have fewer digits
                return found


@dataclass(frozen=True)
class Left:
    """What a direction shows over a travel: rms and largest magnitude of actual − command, rad."""

    rms: float
    peak: float


@dataclass(frozen=True)
class CorrectionTable:
    """Corrections at equidistant positions of an axis, rad; beyond its ends a table is held.

    **Arguments**
    - `positions`: shape (nodes,). - `values`: direction → corrections, shape (nodes,).
    """

    positions: Float[np.ndarray, " nodes"]
    values: dict[str, Float[np.ndarray, " nodes"]]

    def at(self, direction: str, position: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the correction that a control adds at positions, rad."""
        return np.interp(position, self.positions, self.values[direction])

    @property
    def steepest(self) -> float:
        """Largest change of a correction in a radian of the axis."""
        step = np.diff(self.positions)
        return max(float(np.max(np.abs(np.diff(one) / step))) for one in self.values.values())

    def in_float32(self) -> "CorrectionTable":
        """Return the table in degrees of single precision, as a control may hold it."""
        single = lambda angles: np.radians(np.float64(np.float32(np.degrees(angles))))  # noqa: E731
        return replace(
            self,
            positions=single(self.positions),
            values={name: single(one) for name, one in self.values.items()},
        )


def correction_table(error: AxisError, start: float, stop: float, step: float) -> CorrectionTable:
    """Return the table of an axis from `start` to `stop`, rad, with nodes `step` apart.

    **Raises** `UsageError` for a step that does not divide the span, `NoAnswerError` for an error
    that is too steep.
    """
    count = round((stop - start) / step)
    if count > _MOST_NODES:
        raise UsageError(f"{count} positions are more than {_MOST_NODES}; give a larger step.")
    if count < 1 or abs(count * step - (stop - start)) > 1e-9 * (stop - start):
        raise UsageError(
            f"a step of {math.degrees(step):.6g}° does not divide the table from"
            f" {math.degrees(start):.6g}° to {math.degrees(stop):.6g}°; choose"
            f" {math.degrees(stop - start) / max(count, 1):.10g}° or another whole part."
        )
    positions = start + (stop - start) / count * np.arange(count + 1)
    share = (np.arange(_PER_INTERVAL) + 0.5) / _PER_INTERVAL
    dense = (positions[:-1, None] + (stop - start) / count * share).ravel()
    values = {
        direction: _polygon(error.correction(flank, dense).reshape(count, -1), share)
        for direction, flank in error.directions.items()
    }
    return CorrectionTable(positions, values)


def _polygon(
    curve: Float[np.ndarray, "intervals points"], share: Float[np.ndarray, " points"]
) -> Float[np.ndarray, " nodes"]:
    """Return the corners of the polygon that is closest to a curve in the least squares sense."""
    before, after = 1 - share, share
    right = np.zeros(len(curve) + 1)
    right[:-1] += curve @ before
    right[1:] += curve @ after
    band = np.zeros((2, len(right)))
    band[0, :-1] += before @ before
    band[0, 1:] += after @ after
    band[1, :-1] = before @ after
    return solveh_banded(band, right, lower=True)


def left_over(
    error: AxisError,
    table: CorrectionTable | None,
    direction: str,
    position: Float[np.ndarray, " n"],
) -> np.ndarray:
    """Return actual − command at positions of every turn, rad, with a table or without one.

    **Returns** an array of shape (turns, n), or (turns, n, draws).
    """
    flank = error.directions[direction]
    added = np.zeros(len(position)) if table is None else table.at(direction, position)
    found = np.stack([error.at(flank, position + added, turn) for turn in error.turns])
    return found + added.reshape(-1, *(1,) * (found.ndim - 2))


def size(left: np.ndarray) -> Left:
    """Return rms and largest magnitude of what is left, over all turns and positions."""
    return Left(float(np.sqrt(np.mean(left**2))), float(np.max(np.abs(left))))

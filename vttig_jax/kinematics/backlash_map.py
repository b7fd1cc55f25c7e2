"""Backlash over the hunting period, its extremes and the safe axial displacement."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ..base.errors import PairError
from ..base.files.text_tables import key_values
from ..base.results import PlottedResult
from ..base.units import DEG, REV
from ..pair.gear_pair import Drive, GearPair
from .flank_model import FlankModel
from .hunting_coverage import HuntingCoverage

_CHUNK = 8192  # driving angles evaluated at once; a chosen value


def chunked(
    function: Callable[[np.ndarray], object], grid: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n ..."]:
    """Return `function(grid)` of an elementwise `function`, computed in chunks of 8192 points.

    The last chunk is padded to the same size. So the function is compiled once for grids of any
    length, and the memory for one chunk is sufficient.
    """
    values = []
    for start in range(0, len(grid), _CHUNK):
        chunk = grid[start : start + _CHUNK]
        padded = np.pad(chunk, (0, _CHUNK - len(chunk)), mode="edge")
        values.append(np.asarray(function(padded))[: len(chunk)])
    return np.concatenate(values) if values else np.empty(0)


# The settings of the search for extremes are chosen values.
_PER_PERIOD = 32  # grid points in one period of the highest order
_CANDIDATES = 64  # grid peaks that are refined
_ZOOMS = 6  # refinements, each by a factor of 16
_MOST_POINTS = 2**24  # upper limit of the number of grid points


@dataclass(frozen=True)
class Extreme:
    """Smallest or largest backlash and the driving angle at which it occurs, both in rad.

    `tooth_pair` holds the numbers of the driving and the driven tooth in mesh there. Teeth are
    counted from 1 in the order in which they come into mesh from φ = 0 on. It is None where the
    tooth counts are unknown.
    """

    backlash: float
    driving_angle: float
    tooth_pair: tuple[int, int] | None

    def __str__(self) -> str:
        place = f"{self.backlash / DEG:.5f}° at {self.driving_angle / DEG:.2f}°"
        if self.tooth_pair is None:
            return place
        return f"{place} (teeth {self.tooth_pair[0]} and {self.tooth_pair[1]})"


@dataclass(frozen=True)
class BacklashMap(PlottedResult):
    """Backlash j(φ₁) = TE_B − TE_A of a flank model over the hunting period.

    **Arguments**
    - `model`: flank model that is evaluated, usually the one with all fitted orders.
    - `first_order`: closed-form model for comparison, or None for a drive without geometry.
    - `pair`: gear pair or drive; it gives the hunting period and the conversion to millimetres.
    - `coverage`: part of the hunting period that was measured; None for a map that is not from
      logs, or whose logs are not known.
    - `no_period`: reason why no angle comes back after the hunting period of `pair`, or None.
    - `shift`: 95 % interval, rad, by which the whole map may be shifted because the logs leave a
      delay out of the gap; None if they do not.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Eccentricities, Gear, GearPair
    >>> from vttig_jax.kinematics import BacklashMap, exact_model
    >>> vttig_jax.enable_x64()
    >>> pair = GearPair(
    ...     Gear(45, 3, 3), Gear(80, 3, 3),
    ...     module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12,
    ... )
    >>> grid = BacklashMap(exact_model(pair, Eccentricities(0.02, 50, 0.03, 80, 0.04)), None, pair)
    >>> np.degrees(grid.at(np.radians(7560.0))).round(5).item()
    0.04865
    >>> print(grid.smallest)
    0.01386° at 2106.06° (teeth 39 and 24)

    ```
    """

    model: FlankModel
    first_order: FlankModel | None
    pair: GearPair | Drive
    coverage: HuntingCoverage | None = None
    no_period: str | None = None
    shift: tuple[float, float] | None = None

    def at(self, driving_angle: Real[ArrayLike, "*shape"]) -> Float[Array, "*shape"]:
        """Return the backlash, rad of the driven gear, at driving angles in rad."""
        return _backlash(self.model, jnp.asarray(driving_angle, float))

    def over(self, grid: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the backlash, rad, at a grid of any length of driving angles in rad."""
        return chunked(self.at, grid)

    def first_order_over(self, grid: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the backlash, rad, of `first_order` at driving angles in rad; NaN without it."""
        if (model := self.first_order) is None:
            return np.full(len(grid), np.nan)
        return chunked(lambda angles: _backlash(model, jnp.asarray(angles)), grid)

    @cached_property
    def smallest(self) -> Extreme:
        """Smallest backlash over the hunting period."""
        return self._extreme(-1.0)

    @cached_property
    def largest(self) -> Extreme:
        """Largest backlash over the hunting period."""
        return self._extreme(1.0)

    @property
    def safe_closing_mm(self) -> float:
        """Largest axial displacement, mm, at which the gears bind at no driving angle.

        It reduces the smallest backlash to zero: s = j_min R₂/(tan β_L + tan β_R). If the map may
        be shifted, j_min is the lower end of the interval of the smallest backlash. It is NaN for a
        drive, infinite for untapered gears, and zero or negative if the smallest backlash is
        already zero or negative.
        """
        if isinstance(self.pair, Drive):
            return float("nan")
        gap_mm = float(self.interval(self.smallest.backlash)[0]) * float(
            self.pair.reference_radii[1]
        )
        thinning = float(self.pair.thinning)
        return gap_mm / thinning if thinning else float("inf")

    def interval(
        self, backlash: Float[np.ndarray, "*shape"] | float
    ) -> tuple[Float[np.ndarray, "*shape"], Float[np.ndarray, "*shape"]]:
        """Return both ends of the 95 % interval of values of this map, rad, as `shift` gives them.

        No gap is negative, so that the interval of a positive backlash begins at zero or above.
        """
        value = np.asarray(backlash, float)
        low, high = self.shift or (0.0, 0.0)
        lower = np.maximum(value + low, np.minimum(value, 0.0))
        return np.asarray(lower), np.asarray(value + high)

    def is_extrapolated(self, extreme: Extreme) -> bool | None:
        """Return whether no log covers the angle of `extreme` on flank A or none does on flank B.

        The result is None if the coverage is unknown.
        """
        if self.coverage is None:
            return None
        return not bool(self.coverage.holds(np.array([extreme.driving_angle]))[0])

    def _extreme(self, sense: float) -> Extreme:
        """Return the largest (`sense` = 1) or the smallest (`sense` = −1) backlash.

        A grid over the hunting period is searched, and its 64 highest peaks are refined. One peak
        is not enough, because peaks of different turns differ by less than the grid resolves.
        """
        per_turn = _PER_PERIOD * math.ceil(max(self.model.highest_order, 1.0))
        width = REV / per_turn
        if self.pair.hunting_turns * per_turn > _MOST_POINTS:
            raise PairError(
                f"a hunting period of {self.pair.hunting_turns} turns is too long to search for the"
                ' smallest gap; give the ratio as a quotient of tooth numbers, such as "7/1798".',
                where="drive.ratio" if isinstance(self.pair, Drive) else "driven.teeth",
            )
        grid = np.arange(self.pair.hunting_turns * per_turn) * width
        height = sense * self.over(grid)
        peaks = np.flatnonzero((height >= np.roll(height, 1)) & (height >= np.roll(height, -1)))
        best = grid[peaks[np.argsort(-height[peaks], kind="stable")[:_CANDIDATES]]]
        for _ in range(_ZOOMS):
            angles = best[:, None] + width * np.linspace(-1, 1, 33)
            height = sense * self.over(angles.ravel()).reshape(angles.shape)
            best = np.take_along_axis(angles, height.argmax(axis=1)[:, None], axis=1)[:, 0]
            width /= 16
        winner = float(np.mod(best[height.max(axis=1).argmax()], self.pair.hunting_turns * REV))
        value = float(self.over(np.array([winner]))[0])  # one number would compile a program
        return Extreme(value, winner, self._tooth_pair(winner))

    def _tooth_pair(self, driving_angle: float) -> tuple[int, int] | None:
        if isinstance(self.pair, Drive):
            return None
        passed = int(np.floor(driving_angle / REV * self.pair.driving.teeth))
        return passed % self.pair.driving.teeth + 1, passed % self.pair.driven.teeth + 1

    def __str__(self) -> str:
        rows = [
            *self.coverage_rows,
            ("smallest", self._text(self.smallest)),
            ("largest", self._text(self.largest)),
        ]
        if isinstance(self.pair, GearPair) and float(self.pair.thinning):
            closing = self.safe_closing_mm
            none = "none, because the smallest backlash may already be zero"
            rows.append(("safe axial closing", f"{closing:.4f} mm" if closing > 0 else none))
        return key_values(rows, title="backlash map")

    @property
    def coverage_rows(self) -> list[tuple[str, str]]:
        """Rows (label, text) of a report: the hunting period and the measured part of it."""
        if self.no_period:
            return [("hunting period", f"none: {self.no_period}")]
        covered = [] if self.coverage is None else [("covered", str(self.coverage))]
        return [("hunting period", self.pair.hunting_period), *covered]

    def _text(self, extreme: Extreme) -> str:
        shown = f"{extreme}, extrapolated" if self.is_extrapolated(extreme) else str(extreme)
        if self.shift is None:
            return shown
        low, high = (float(end) / DEG for end in self.interval(extreme.backlash))
        return f"{shown} ({low:.5f}° … {high:.5f}° with the delay that the log leaves open)"


@eqx.filter_jit
def _backlash(model: FlankModel, driving_angle: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    return model.backlash(driving_angle)

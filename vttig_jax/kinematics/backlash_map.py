"""The backlash at every driving angle, its extremes, and the safe axial displacement."""

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
from ..base.units import DEG, REV
from ..pair.gear_pair import Drive, GearPair
from .flank_model import FlankModel

_CHUNK = 8192


def chunked(
    function: Callable[[np.ndarray], object], grid: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return `function(grid)` computed in chunks of one fixed size, the last one padded.

    Memory stays that of one chunk and grids of different length share one compilation.
    """
    pieces = []
    for start in range(0, len(grid), _CHUNK):
        piece = grid[start : start + _CHUNK]
        padded = np.pad(piece, (0, _CHUNK - len(piece)), mode="edge")
        pieces.append(np.asarray(function(padded))[: len(piece)])
    return np.concatenate(pieces) if pieces else np.empty(0)


_PER_PERIOD = 32
_CANDIDATES = 64
_ZOOMS = 6


_MOST_POINTS = 2**24
"""Of the grid on which extremes are searched."""


@dataclass(frozen=True)
class Extreme:
    """An extreme of the backlash: its value and where it is, in rad.

    `tooth_pair` counts the teeth of both gears from 1 in the order in which they come into mesh
    from φ = 0 on; None where the tooth counts are unknown.
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
class BacklashMap:
    """Backlash j(φ₁) = TE_B − TE_A of a flank model over the hunting period.

    **Arguments**
    - `model`: the order-complete flank model (or any other).
    - `first_order`: the closed form beside it, or None for a drive without geometry.
    - `pair`: the pair or drive, for the hunting period and for millimetres.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Eccentricities, Gear, GearPair
    >>> from vttig_jax.kinematics import BacklashMap
    >>> from vttig_jax.kinematics import exact_model
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

    def at(self, driving_angle: Real[ArrayLike, "*shape"]) -> Float[Array, "*shape"]:
        """Backlash at driving angles in rad: rad of the driven gear."""
        return _backlash(self.model, jnp.asarray(driving_angle, float))

    def over(self, grid: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Backlash over a grid of any length, rad; evaluated in chunks."""
        return chunked(self.at, grid)

    def first_order_over(self, grid: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """First-order backlash (21) + (22) over a grid, rad; NaN without gear geometry."""
        if (model := self.first_order) is None:
            return np.full(len(grid), np.nan)
        return chunked(lambda piece: _backlash(model, jnp.asarray(piece)), grid)

    @cached_property
    def smallest(self) -> Extreme:
        """The smallest gap over the hunting period."""
        return self._extreme(-1.0)

    @cached_property
    def largest(self) -> Extreme:
        """The largest gap over the hunting period."""
        return self._extreme(1.0)

    @property
    def safe_closing_mm(self) -> float:
        """Axial displacement that takes up the smallest gap and binds nowhere.

        s = j_min R₂/(tan β_L + tan β_R), mm. NaN for a drive, infinite for untapered gears, not
        positive where the gap already closes.
        """
        if isinstance(self.pair, Drive):
            return float("nan")
        gap_mm = self.smallest.backlash * float(self.pair.reference_radii[1])
        thinning = float(self.pair.thinning)
        return gap_mm / thinning if thinning else float("inf")

    def _extreme(self, sense: float) -> Extreme:
        """Grid search over the hunting period, then zooms around the best peaks of the grid.

        Peaks of different turns differ by less than the grid resolves, so many are refined.
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
            near = best[:, None] + width * np.linspace(-1, 1, 33)
            height = sense * self.over(near.ravel()).reshape(near.shape)
            best = np.take_along_axis(near, height.argmax(axis=1)[:, None], axis=1)[:, 0]
            width /= 16
        winner = float(np.mod(best[height.max(axis=1).argmax()], self.pair.hunting_turns * REV))
        return Extreme(float(self.at(winner)), winner, self._tooth_pair(winner))

    def _tooth_pair(self, driving_angle: float) -> tuple[int, int] | None:
        if isinstance(self.pair, Drive):
            return None
        passed = int(np.floor(driving_angle / REV * self.pair.driving.teeth))
        return passed % self.pair.driving.teeth + 1, passed % self.pair.driven.teeth + 1

    def __str__(self) -> str:
        rows = [
            ("hunting period", f"{self.pair.hunting_turns} driving turns"),
            ("smallest", str(self.smallest)),
            ("largest", str(self.largest)),
        ]
        if isinstance(self.pair, GearPair) and float(self.pair.thinning):
            rows.append(("safe axial closing", f"{self.safe_closing_mm:.4f} mm"))
        return key_values(rows, title="backlash map")


@eqx.filter_jit
def _backlash(model: FlankModel, driving_angle: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    return model.backlash(driving_angle)

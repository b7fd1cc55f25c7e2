"""Backlash over the hunting period, its extremes and the safe axial displacement."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial, reduce
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.arrays import Number, Numbers, known, namespace
from ..base.errors import PairError
from ..base.files.text_tables import key_values
from ..base.numerics.implicit import at_extreme, known_root
from ..base.results import PlottedResult
from ..base.units import DEG, REV
from ..pair.gear_pair import Drive, GearPair
from .flank_model import Angles, AnglesLike, FlankModel, highest_order
from .hunting_coverage import HuntingCoverage

Scalar = Float[Number, ""] | float

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
_ZOOM = 16  # grid points on each side of a place that is refined
_MOST_POINTS = 2**24  # upper limit of the number of grid points


class Extreme(eqx.Module):
    """Smallest or largest backlash and the driving angle at which it occurs, both in rad.

    `tooth_pair` holds the numbers of the driving and the driven tooth in mesh there. Teeth are
    counted from 1 in the order in which they come into mesh from φ = 0 on. It is None where the
    tooth counts are unknown.
    """

    backlash: Scalar
    driving_angle: Scalar
    tooth_pair: tuple[int | Array, int | Array] | None

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
    - `unknown`: reason why the smallest and the largest backlash over the hunting period are not
      known, where the logs tell only the gap over the angles covered; or None.
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
    unknown: str | None = None

    def at(self, driving_angle: AnglesLike) -> Angles:
        """Return the backlash, rad of the driven gear, at driving angles in rad.

        It can be jitted, batched and differentiated by the angle and by every number of the model,
        and so can `smallest`, `largest` and `safe_closing_mm`. The map is then made inside the
        function that is differentiated.

        **Example**
        ```python
        >>> import jax, vttig_jax
        >>> from vttig_jax import Eccentricities
        >>> from vttig_jax.kinematics import BacklashMap, exact_model
        >>> from vttig_jax.rig import paper_pair
        >>> vttig_jax.enable_x64()
        >>> def gap(eccentricity_mm):
        ...     rig = Eccentricities(eccentricity_mm, 50.0, 0.03, 80.0, 0.04)
        ...     return BacklashMap(exact_model(paper_pair(), rig), None, paper_pair())
        >>> at_one_rad = jax.grad(lambda e: gap(e).at(1.0))(0.02)
        >>> smallest = jax.grad(lambda e: gap(e).smallest.backlash)(0.02)
        >>> print(f"{at_one_rad:.5f} and {smallest:.5f} rad of the driven gear per mm")
        0.00272 and -0.00911 rad of the driven gear per mm
        >>> print(f"{jax.grad(lambda e: gap(e).safe_closing_mm)(0.02):.2f} mm of closing per mm")
        -6.96 mm of closing per mm

        ```
        """
        return _backlash(jnp.asarray(driving_angle, float), self.model)

    def over(self, grid: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the backlash, rad, at a grid of any length of driving angles in rad."""
        return chunked(self.at, grid)

    def first_order_over(self, grid: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the backlash, rad, of `first_order` at driving angles in rad; NaN without it."""
        if (model := self.first_order) is None:
            return np.full(len(grid), np.nan)
        return chunked(partial(_backlash, model=model), grid)

    @property
    def smallest(self) -> Extreme:
        """Smallest backlash over the hunting period.

        It is a pure function of the numbers of the model, which can be jitted, batched and
        differentiated to any order. A derivative holds where the backlash is smooth at its extreme.
        """
        return self._extreme(0)

    @property
    def largest(self) -> Extreme:
        """Largest backlash over the hunting period; like `smallest`, a pure function."""
        return self._extreme(1)

    @property
    def safe_closing_mm(self) -> Scalar:
        """Largest axial displacement, mm, at which the gears bind at no driving angle.

        It reduces the smallest backlash to zero: s = j_min R₂/(tan β_L + tan β_R). If the map may
        be shifted, j_min is the lower end of the interval of the smallest backlash. It is NaN for a
        drive, infinite for untapered gears, and zero or negative if the smallest backlash is
        already zero or negative.
        """
        if isinstance(self.pair, Drive):
            return math.nan
        gap_mm = self.interval(self.smallest.backlash)[0] * self.pair.reference_radii[1]
        thinning = self.pair.thinning
        return math.inf if known(thinning) and thinning == 0 else gap_mm / thinning

    def interval(
        self, backlash: Float[Numbers, "*shape"] | float
    ) -> tuple[Float[Numbers, "*shape"], Float[Numbers, "*shape"]]:
        """Return both ends of the 95 % interval of values of this map, rad, as `shift` gives them.

        No gap is negative, so that the interval of a positive backlash begins at zero or above.
        """
        xp = namespace(backlash)
        value = xp.asarray(backlash, float)
        low, high = self.shift or (0.0, 0.0)
        lower = xp.maximum(value + low, xp.minimum(value, 0.0))
        return xp.asarray(lower), xp.asarray(value + high)

    def is_extrapolated(self, extreme: Extreme) -> bool | None:
        """Return whether no log covers the angle of `extreme` on flank A or none does on flank B.

        The result is None if the coverage is unknown.
        """
        if self.coverage is None:
            return None
        return not bool(self.coverage.holds(np.array([extreme.driving_angle]))[0])

    def _extreme(self, side: int) -> Extreme:
        if _evaluates(self.model):
            backlash, angle = self._extremes[side]
            return Extreme(backlash, angle, self._tooth_pair(angle))
        place = jnp.asarray(_extremes(_constant(self.model), self._grid)[side, 1])
        angle = _stationary(place, self.model)
        backlash = at_extreme(_backlash, _stationary, place, self.model)
        return Extreme(backlash, angle, self._tooth_pair(angle))

    @cached_property
    def _extremes(self) -> list[tuple[float, float]]:
        """Smallest and largest backlash of a known model, and their driving angles, rad."""
        return [(float(gap), float(angle)) for gap, angle in _extremes(self.model, self._grid)]

    @property
    def _grid(self) -> tuple[int, int]:
        """Numbers of driving turns and of grid points in one turn."""
        turns = self.pair.hunting_turns
        per_turn = _PER_PERIOD * math.ceil(highest_order(self.model, float(self.pair.ratio)))
        if turns * per_turn > _MOST_POINTS:
            raise PairError(
                f"a hunting period of {turns} turns is too long to search for the smallest gap;"
                ' give the ratio as a quotient of tooth numbers, such as "7/1798".',
                where="drive.ratio" if isinstance(self.pair, Drive) else "driven.teeth",
            )
        return turns, per_turn

    def _tooth_pair(self, driving_angle: Scalar) -> tuple[int | Array, int | Array] | None:
        if isinstance(self.pair, Drive):
            return None
        driving, driven = self.pair.driving.teeth, self.pair.driven.teeth
        passed = driving_angle / REV * driving
        number = math.floor(passed) if known(passed) else jnp.floor(passed).astype(int)
        return number % driving + 1, number % driven + 1

    def __str__(self) -> str:
        rows = self.coverage_rows
        if self.unknown:
            return key_values([*rows, ("smallest gap", self.unknown)], title="backlash map")
        rows += [(name, self._text(getattr(self, name))) for name in ("smallest", "largest")]
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
def _backlash(driving_angle: Float[Numbers, "*shape"], model: FlankModel) -> Angles:
    return model.backlash(driving_angle)


def _slope(driving_angle: Angles, model: FlankModel) -> Angles:
    ones = jnp.ones_like(driving_angle)
    return jax.jvp(lambda angle: _backlash(angle, model), (driving_angle,), (ones,))[1]


@eqx.filter_jit
def _stationary(driving_angle: Float[Array, ""], model: FlankModel) -> Float[Array, ""]:
    """Return the angle of an extreme, rad, with its derivatives by the numbers of the model.

    The flat top hides half of the digits of the angle. The secant through the slopes on both sides
    gives them.
    """
    reach = np.finfo(float).eps ** (1 / 3)
    below, above = _slope(driving_angle + reach * np.array([-1.0, 1.0]), _constant(model))
    crosses = below * above < 0
    share = jnp.where(crosses, (above + below) / jnp.where(crosses, above - below, 1.0), 0.0)
    return known_root(_slope, driving_angle - reach * share, model)


def _evaluates(model: FlankModel) -> bool:
    """Return whether the model gives numbers: no number of it is traced, and no program is."""
    return known(model, jnp.zeros(()))


def _constant(model: FlankModel) -> FlankModel:
    """Return the model with arrays that are constant in every derivative."""
    arrays, rest = eqx.partition(model, eqx.is_array)
    return eqx.combine(jax.lax.stop_gradient(arrays), rest)


def _extremes(model: FlankModel, grid: tuple[int, int]) -> Float[Numbers, "side=2 gap_and_angle=2"]:
    """Return the smallest and the largest backlash and their driving angles, rad.

    `grid` holds the numbers of driving turns and of grid points in one turn. NumPy searches a model
    of known numbers, so that nothing but the model is compiled, and `jax.numpy` a traced one.
    """
    if not _evaluates(model):
        return _traced_extremes(model, grid)
    return _search(np, map, reduce, partial(chunked, partial(_backlash, model=model)), grid)


@eqx.filter_jit
def _traced_extremes(
    model: FlankModel, grid: tuple[int, int]
) -> Float[Numbers, "side=2 gap_and_angle=2"]:
    def fold(function, values, state):
        return jax.lax.scan(lambda state, value: (function(state, value), None), state, values)[0]

    return _search(jnp, jax.lax.map, fold, model.backlash, grid)


def _search(
    xp: Any,
    each: Callable[..., Any],
    fold: Callable[..., Any],
    backlash: Callable[[Any], Any],
    grid: tuple[int, int],
) -> Float[Numbers, "side=2 gap_and_angle=2"]:
    """Return `_extremes` of a function `backlash`, with the loops `each` (map) and `fold` (reduce).

    Each period of the grid gives its highest peak, estimated by the parabola through three points.
    The best peaks are refined, because peaks of different turns differ by less than the grid
    resolves. The refinement needs no slopes, so that it finds a kink too. It ends where the
    distance from the extreme changes the backlash by less than rounding.
    """
    turns, per_turn = grid
    width, periods = REV / per_turn, turns * per_turn // _PER_PERIOD
    at_once = min(_CHUNK // _PER_PERIOD - 1, periods)
    sense = xp.asarray([-1.0, 1.0])[:, None]
    zoom = xp.linspace(-1, 1, 2 * _ZOOM + 1)[None, None]

    def peaks(period: Any) -> Any:
        index = period * _PER_PERIOD + xp.arange(-1, at_once * _PER_PERIOD + 1)
        height = sense * backlash(index * width)[None]
        left, here, right = height[:, :-2], height[:, 1:-1], height[:, 2:]
        bend = 2 * here - left - right
        top = here + (right - left) ** 2 / (8 * xp.where(bend > 0, bend, xp.inf))
        top = xp.where((here >= left) & (here >= right), top, -xp.inf)
        top = top.reshape(2, at_once, _PER_PERIOD)
        highest = index[None, 1:-1:_PER_PERIOD] + top.argmax(axis=-1)
        return xp.stack([top.max(axis=-1), highest * width])

    def refined(best: Any, width: Any) -> Any:
        angle = best[1][..., None] + width * zoom
        height = sense[..., None] * backlash(angle.ravel()).reshape(angle.shape)
        top = height.argmax(axis=-1)[..., None]
        return xp.take_along_axis(xp.stack([height, angle]), top[None], axis=-1)[..., 0]

    found = xp.concatenate(list(each(peaks, xp.arange(0, periods, at_once))), axis=-1)
    kept = xp.argsort(-found[0], axis=-1)[:, : _CHUNK // (4 * _ZOOM + 2)]
    best = xp.take_along_axis(found, kept[None], axis=-1)
    zooms = math.ceil(-math.log(np.finfo(float).eps) / math.log(_ZOOM) / 2)
    best = fold(refined, width / _ZOOM ** xp.arange(zooms), best)
    best = xp.take_along_axis(best, best[0].argmax(axis=-1)[None, :, None], axis=-1)[..., 0]
    return xp.stack([sense[:, 0] * best[0], best[1] % (turns * REV)], axis=-1)

"""Gradient search for controller settings; smoothing becomes narrower from stage to stage.

The gradient uses forward mode, because a run has a handful of settings and thousands of periods;
reverse mode would store the state of every period.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import minimize
from scipy.special import logsumexp, softmax

from ...base.units import DEG
from ..simulation.case import Case
from ..simulation.settings import with_settings
from ..sweeps.case_leaves import CaseStructure, leaves_of
from .brake_window import Window, extent_of, run_window, window_of
from .free_keys import FreeKey

Objective = Literal["expected", "worst"]
OBJECTIVES: tuple[Objective, ...] = ("expected", "worst")

WIDTHS = (0.5, 0.25, 0.12, 0.05, 0.02, 0.005)
"""Relative widths of the comparisons, one per stage of the search: chosen values."""

_SHARE, _LEAST_MM = 0.1, 1e-4
"""Step of a displacement as a fraction of the displacement that closes the gap; smallest step, mm.

The step times the relative width is the width of the softplus. Chosen values."""
_TEMPERATURE = 0.5
"""Softmax temperature of the worst-case objective, as a fraction of the smoothing width: chosen."""
_FACTORS, _STEPS = (0.1, 0.3, 0.7, 1.4, 3.0, 10.0), (-3.0, -1.0, 1.0, 2.0, 4.0, 7.0)
"""Factors of a positive key, and steps of another key, that are tried around a point: chosen."""
_STARTS = 2
"""Number of points from which each stage follows the gradient: a chosen value."""
_OPTIONS: Mapping[str, Any] = {"options": {"maxiter": 25, "maxfun": 40}}
"""Limits of iterations and evaluations from each point: chosen values."""


class Stage(NamedTuple):
    """Result of one stage.

    - `width`: relative width of the comparisons. - `values`: values of the free keys.
    - `start_deg`, `end_deg`: smoothed objective at the best point of earlier stages and at the end.
    - `evaluations`: number of evaluations with gradient.
    """

    width: float
    values: tuple[float, ...]
    start_deg: float
    end_deg: float
    evaluations: int


class Search:
    """Search with the smoothed objective of some cases.

    **Arguments**
    - `cases`: cases in the search. - `keys`: free keys.
    - `objective`: mean or largest cost. - `weight`: weight of the interference.
    """

    def __init__(
        self, cases: Sequence[Case], keys: Sequence[FreeKey], objective: Objective, weight: float
    ) -> None:
        self.keys = tuple(keys)
        self.objective: Objective = objective
        self.weight = weight
        self._names = tuple(key.name for key in keys)
        self._stacks = stacked_windows(cases)
        sizes = [_mean_closing(stack) for stack in self._stacks]
        self.step_mm = max(_SHARE * float(np.median(np.concatenate(sizes))), _LEAST_MM)
        self._per_mm = float(np.asarray(self._stacks[0].closing).ravel()[0]) / DEG

    def costs(
        self, values: Sequence[float], width: float
    ) -> tuple[Float[np.ndarray, " cases"], Float[np.ndarray, "cases keys"]]:
        """Return the cost of every case (deg of backlash) and its gradient by `values` of the keys.

        `width` is the relative width of the comparisons.
        """
        settings = jnp.asarray(values, float)
        numbers = jnp.array([width, width * self.step_mm, self.weight])
        parts = [_costs(stack, settings, numbers, self._names) for stack in self._stacks]
        costs, slopes = zip(*(jax.tree.map(np.asarray, part) for part in parts), strict=True)
        return np.concatenate(costs), np.concatenate(slopes)

    def value_and_slopes(
        self, values: Sequence[float], width: float
    ) -> tuple[float, Float[np.ndarray, " keys"]]:
        """Return the objective and its gradient: the mean, or T ln Σ exp(cost/T) for the largest.

        T is the temperature. At the largest width the objective is always the mean, because the
        gradient of the largest cost would depend on a single case.
        """
        costs, slopes = self.costs(values, width)
        if self.objective == "expected" or width >= WIDTHS[0]:
            return float(costs.mean()), slopes.mean(axis=0)
        temperature = _TEMPERATURE * width * self.step_mm * self._per_mm
        return float(temperature * logsumexp(costs / temperature)), softmax(
            costs / temperature
        ) @ slopes

    def stages(self) -> Iterator[Stage]:
        """Yield the result of each stage; a stage starts at the best points of earlier stages.

        Each stage first tries larger changes of every single key, because gradients can vanish: a
        threshold above all decelerations has the gradient zero.
        """
        known = [np.zeros(len(self.keys))]
        ends = np.array([key.ends(self.step_mm) for key in self.keys])
        for width in WIDTHS:
            calls = 0

            def scaled(u: Any, width: float = width) -> tuple[float, Any]:
                nonlocal calls
                calls += 1
                value, slopes = self.value_and_slopes(self._values(u), width)
                inner = [key.slope(x, self.step_mm) for key, x in zip(self.keys, u, strict=True)]
                return value / self._unit, slopes * np.array(inner) / self._unit

            def evaluate(u: Any, scaled: Any = scaled) -> _Point:
                cost, slopes = scaled(u)
                if not (np.isfinite(cost) and np.all(np.isfinite(slopes))):
                    return _Point(np.inf, False, np.asarray(u))
                return _Point(cost, bool(np.any(slopes)), np.asarray(u))

            pool = [evaluate(u) for u in known]
            before = min(pool, key=_cost)
            pool += [evaluate(u) for u in self._neighbours((before.u, known[-1]), ends)]
            for start in sorted((point for point in pool if point.has_slope), key=_cost)[:_STARTS]:
                minimum = minimize(
                    scaled, start.u, jac=True, method="L-BFGS-B", bounds=ends, **_OPTIONS
                )
                if np.all(np.isfinite(minimum.x)) and np.isfinite(minimum.fun):
                    pool.append(_Point(float(minimum.fun), True, np.asarray(minimum.x)))
            after = min(pool, key=_cost)
            known = [after.u, *known]
            costs = before.cost * self._unit, after.cost * self._unit
            yield Stage(width, self._values(after.u), *costs, calls)

    def neighbours(self, values: Sequence[float]) -> list[tuple[float, ...]]:
        """Return copies of `values` in which one key is changed by one of the steps of a stage.

        A positive key is multiplied by one of `_FACTORS`. Another key is increased by one of
        `_STEPS`, in units of its own step. Copies outside the limits of the key are left out.
        """
        ends = np.array([key.ends(self.step_mm) for key in self.keys])
        u = [key.scaled(x, self.step_mm) for key, x in zip(self.keys, values, strict=True)]
        return [self._values(other) for other in self._neighbours([np.array(u)], ends)]

    @property
    def _unit(self) -> float:
        """Cost that the optimiser sees as 1: the backlash of one step, deg."""
        return self.step_mm * self._per_mm

    def _values(self, u: Sequence[float] | np.ndarray) -> tuple[float, ...]:
        return tuple(key.value(float(x), self.step_mm) for key, x in zip(self.keys, u, strict=True))

    def _neighbours(
        self, points: Sequence[Float[np.ndarray, " keys"]], ends: Float[np.ndarray, "keys 2"]
    ) -> list[Float[np.ndarray, " keys"]]:
        """Return new points, each of which differs from a given point in one key.

        The key is multiplied by each of `_FACTORS` if it is positive, or changed by each of
        `_STEPS`. Points and `ends` (least and largest value of each key) are scaled values, as from
        `FreeKey.scaled`. A point with a key outside its ends is left out.
        """
        neighbours: dict[tuple[float, ...], np.ndarray] = {}
        for point in points:
            for index, key in enumerate(self.keys):
                axis = np.eye(len(self.keys))[index]
                for step in map(math.log, _FACTORS) if key.positive else _STEPS:
                    if ends[index, 0] <= point[index] + step <= ends[index, 1]:
                        neighbours[tuple(point + step * axis)] = point + step * axis
        return list(neighbours.values())


class _Point(NamedTuple):
    """Evaluated point: cost, whether its gradient is not zero, and u of every key."""

    cost: float
    has_slope: bool
    u: Float[np.ndarray, " keys"]


def _cost(point: _Point) -> float:
    return point.cost


def stacked_windows(cases: Sequence[Case]) -> list[Window]:
    """Return the windows that are simulated during the search, one for each structure of cases.

    The `Window` of a case is the part of its motion around braking and turning back. Cases have one
    structure if their pytrees, with the controller classes, and their array shapes are equal. Their
    windows are stacked: the cases are the first axis of every array, and shorter windows are filled
    up to the length of the longest one.
    """
    groups: dict[CaseStructure, list[Case]] = {}
    for case in cases:
        groups.setdefault(leaves_of(case).structure, []).append(case)
    return [_stacked(group) for group in groups.values()]


def _stacked(cases: Sequence[Case]) -> Window:
    extents = [extent_of(case) for case in cases]
    longest = max(extent.periods for extent in extents)
    windows = [window_of(case, part, longest) for case, part in zip(cases, extents, strict=True)]
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(x) for x in leaves]), *windows)


def _mean_closing(stack: Window) -> Float[np.ndarray, " cases"]:
    """Return for every case the mean displacement that closes the gap over its window, mm."""
    counts = np.asarray(stack.counts)[..., None]
    return np.sum(np.where(counts, stack.closed, 0.0), axis=(1, 2)) / np.sum(
        counts * np.ones_like(stack.closed), axis=(1, 2)
    )


@eqx.filter_jit
def _costs(
    stack: Window,
    values: Float[Array, " keys"],
    numbers: Float[Array, "3"],
    names: tuple[str, ...],
) -> tuple[Float[Array, " cases"], Float[Array, "cases keys"]]:
    width, blur_mm, weight = numbers

    def cost_and_slopes(window: Window) -> tuple[Float[Array, ""], Float[Array, " keys"]]:
        def cost(values: Float[Array, " keys"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
            settings = dict(zip(names, values, strict=True))
            result = run_window(with_settings(window, settings), width, blur_mm)
            displacement = result.gap + weight * result.interference
            backlash = displacement * jnp.asarray(window.closing) / DEG
            return backlash, backlash

        slopes, value = jax.jacfwd(cost, has_aux=True)(values)
        return value, slopes

    return jax.vmap(cost_and_slopes)(stack)

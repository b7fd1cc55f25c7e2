"""The search for settings: slopes of smoothed runs, and a width that shrinks from stage to stage.

Slopes come by forward mode: a run has a handful of settings and thousands of periods, of which
reverse mode would keep every state.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import minimize
from scipy.special import logsumexp, softmax

from ...base.units import DEG, REV
from ..simulation.case import Case
from ..sweeps.batching import CaseLeaves, CaseStructure, numbers_of
from .brake_window import Window, extent_of, left_of, window_of
from .free_keys import FreeKey

Objective = Literal["expected", "worst"]
OBJECTIVES: tuple[Objective, ...] = ("expected", "worst")

WIDTHS = (0.5, 0.25, 0.12, 0.05, 0.02, 0.005)
"""Relative widths of the judgements, one stage of the search each."""

_SHARE = 0.1
"""Share of the gap that is a natural step of a displacement, and its blur at width 1."""
_LEAST_MM = 1e-4
_HEAT = 0.5
"""Of the blur, as backlash, at which the worst of all cases is weighed."""
_FACTORS, _STEPS = (0.1, 0.3, 0.7, 1.4, 3.0, 10.0), (-3.0, -1.0, 1.0, 2.0, 4.0, 7.0)
"""Where else than at the start and the best place each key is tried: times this, or plus steps."""
_STARTS = 2
"""Places from which the slopes are followed in every stage."""
_OPTIONS: Mapping[str, Any] = {"options": {"maxiter": 25, "maxfun": 40}}
"""Most that is done from each."""

_PLACES = {
    "judgement.bandwidth_hz": ("observer", "bandwidth_hz", 1.0),
    "judgement.threshold_rad_s2": ("controller", "threshold", 1.0),
    "judgement.least_rpm": ("controller", "least_speed", REV / 60.0),
    "judgement.horizon_s": ("controller", "horizon", 1.0),
    "judgement.margin_mm": ("controller", "margin", 1.0),
}
"""Part and field of a case, or of its window, that holds a key; and what its value is times."""


class Stage(NamedTuple):
    """Where one stage ended.

    - `width`: of its judgements. - `values`: of the free keys.
    - `start_deg`, `end_deg`: the smoothed objective at the best place known before, and at the end.
    - `evaluations`: of it with its slopes.
    """

    width: float
    values: tuple[float, ...]
    start_deg: float
    end_deg: float
    evaluations: int


class Search:
    """The smoothed objective of some cases.

    **Arguments**
    - `cases`: what is looked at. - `keys`: what is free.
    - `objective`: mean or largest cost. - `weight`: of the interference beside the gap left.
    """

    def __init__(
        self, cases: Sequence[Case], keys: Sequence[FreeKey], objective: Objective, weight: float
    ) -> None:
        self.keys = tuple(keys)
        self.objective: Objective = objective
        self.weight = weight
        self._names = tuple(key.name for key in keys)
        self._stacks = stacked_windows(cases)
        sizes = [_typical(stack) for stack in self._stacks]
        self.step_mm = max(_SHARE * float(np.median(np.concatenate(sizes))), _LEAST_MM)
        self._per_mm = float(np.asarray(self._stacks[0].closing).ravel()[0]) / DEG

    def costs(
        self, values: Sequence[float], width: float
    ) -> tuple[Float[np.ndarray, " cases"], Float[np.ndarray, "cases keys"]]:
        """Cost of every case in degrees of backlash, and its slopes with respect to the keys."""
        given = jnp.asarray(values, float)
        numbers = jnp.array([width, width * self.step_mm, self.weight])
        parts = [_costs(stack, given, numbers, self._names) for stack in self._stacks]
        costs, slopes = zip(*(jax.tree.map(np.asarray, part) for part in parts), strict=True)
        return np.concatenate(costs), np.concatenate(slopes)

    def value_and_slopes(
        self, values: Sequence[float], width: float
    ) -> tuple[float, Float[np.ndarray, " keys"]]:
        """The objective and its slopes: the mean, or T ln Σ exp(cost/T) for the largest.

        At the largest width it is the mean for both: the largest cost has the slopes of one case.
        """
        costs, slopes = self.costs(values, width)
        if self.objective == "expected" or width >= WIDTHS[0]:
            return float(costs.mean()), slopes.mean(axis=0)
        heat = _HEAT * width * self.step_mm * self._per_mm
        return float(heat * logsumexp(costs / heat)), softmax(costs / heat) @ slopes

    def stages(self) -> Iterator[Stage]:
        """Search with ever sharper judgements, each stage from the best places known so far.

        Before the slopes are followed, every key is tried on its own at some distance: a threshold
        above all decelerations has no slope.
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

            def looked(u: Any, scaled: Any = scaled) -> _Place:
                cost, slopes = scaled(u)
                if not (np.isfinite(cost) and np.all(np.isfinite(slopes))):
                    return _Place(np.inf, False, np.asarray(u))
                return _Place(cost, bool(np.any(slopes)), np.asarray(u))

            pool = [looked(u) for u in known]
            before = min(pool, key=_cost)
            pool += [looked(u) for u in self._around((before.u, known[-1]), ends)]
            for one in sorted((one for one in pool if one.slopes), key=_cost)[:_STARTS]:
                found = minimize(
                    scaled, one.u, jac=True, method="L-BFGS-B", bounds=ends, **_OPTIONS
                )
                if np.all(np.isfinite(found.x)) and np.isfinite(found.fun):
                    pool.append(_Place(float(found.fun), True, np.asarray(found.x)))
            after = min(pool, key=_cost)
            known = [after.u, *known]
            costs = before.cost * self._unit, after.cost * self._unit
            yield Stage(width, self._values(after.u), *costs, calls)

    def neighbours(self, values: Sequence[float]) -> list[tuple[float, ...]]:
        """Values where one key differs from those given, by the steps that every stage tries."""
        ends = np.array([key.ends(self.step_mm) for key in self.keys])
        place = [key.scaled(x, self.step_mm) for key, x in zip(self.keys, values, strict=True)]
        return [self._values(u) for u in self._around([np.array(place)], ends)]

    @property
    def _unit(self) -> float:
        """Cost that counts as 1, deg."""
        return self.step_mm * self._per_mm

    def _values(self, u: Sequence[float] | np.ndarray) -> tuple[float, ...]:
        return tuple(key.value(float(x), self.step_mm) for key, x in zip(self.keys, u, strict=True))

    def _around(
        self, places: Sequence[Float[np.ndarray, " keys"]], ends: Float[np.ndarray, "keys 2"]
    ) -> list[Float[np.ndarray, " keys"]]:
        """Other places where one key is another."""
        found: dict[tuple[float, ...], np.ndarray] = {}
        for place in places:
            for number, key in enumerate(self.keys):
                axis = np.eye(len(self.keys))[number]
                for one in map(math.log, _FACTORS) if key.positive else _STEPS:
                    if ends[number, 0] <= place[number] + one <= ends[number, 1]:
                        found[tuple(place + one * axis)] = place + one * axis
        return list(found.values())


class _Place(NamedTuple):
    """Somewhere that was looked at: cost, whether there are slopes, and u of every key."""

    cost: float
    slopes: bool
    u: Float[np.ndarray, " keys"]


def _cost(one: _Place) -> float:
    return one.cost


def stacked_windows(cases: Sequence[Case]) -> list[Window]:
    """The windows of cases, those of one program stacked along a first axis."""
    groups: dict[CaseStructure, list[tuple[Case, CaseLeaves]]] = {}
    for case in cases:
        numbers = numbers_of(case)
        groups.setdefault(numbers.program, []).append((case, numbers))
    return [_stacked([case for case, _ in group]) for group in groups.values()]


def _stacked(cases: Sequence[Case]) -> Window:
    extents = [extent_of(case) for case in cases]
    longest = max(extent.periods for extent in extents)
    windows = [window_of(case, one, longest) for case, one in zip(cases, extents, strict=True)]
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(x) for x in leaves]), *windows)


def _typical(stack: Window) -> Float[np.ndarray, " cases"]:
    """Displacement that closes the gap of every case, on average over its window, mm."""
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

    def one(window: Window) -> tuple[Float[Array, ""], Float[Array, " keys"]]:
        def cost(values: Float[Array, " keys"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
            left = left_of(with_settings(window, names, values), width, blur_mm)
            both = left.gap + weight * left.interference
            found = both * jnp.asarray(window.closing) / DEG
            return found, found

        slopes, value = jax.jacfwd(cost, has_aux=True)(values)
        return value, slopes

    return jax.vmap(one)(stack)


def with_settings(whole: Any, names: Sequence[str], values: Any) -> Any:
    """A case, or its window, with other values of some keys."""
    for name, value in zip(names, values, strict=True):
        part, field, factor = _PLACES[name]
        new = replace(getattr(whole, part), **{field: value * factor})
        whole = replace(whole, **{part: new})
    return whole

"""Tuning of the settings of a controller by a search with steps that shrink."""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from msgspec import Meta
from scipy.optimize import differential_evolution, minimize

from ...base.errors import ScenarioError
from ...base.files.text_tables import key_values, text_table
from ...base.files.toml_io import Key, did_you_mean
from ...base.results import TextResult
from ...base.runtime import require_x64
from ...base.units import DEG
from ...pair.gear_pair import Drive, GearPair
from ..scenario import spec as specs
from ..scenario.spec import ECCENTRICITIES, KEYS, ScenarioSpec
from ..simulation.case import NEAR_MM
from ..simulation.prepare import Maps
from ..sweeps.sweep import SweepWork, cases_of
from ..sweeps.table import REFUSED, Rows

Objective = Literal["expected", "worst"]
Limits = Mapping[str, tuple[float, float]]

_BOTH = ("judgement.bandwidth_hz", "judgement.least_rpm", "judgement.margin_mm")
SETTINGS: Mapping[str, tuple[str, ...]] = {
    "acceleration": ("judgement.threshold_rad_s2", *_BOTH),
    "predictive": ("judgement.horizon_s", *_BOTH),
    "feedforward": ("map.constant_backlash_deg", "judgement.jump_s"),
}
"""Controller → its numeric settings."""

REACH = 1000.0
"""Largest factor by which the search changes a positive number from its start; a chosen value."""

_METRICS = (
    *("residual_gap_deg", "interference_mm", "actuator_travel_mm"),
    *("lost_motion_deg", "thrown_back_deg"),
)
"""Metrics of which a score has means and maxima."""


Values = tuple[float, ...]
"""Values of the free keys."""

STEPS = (1.0, -0.4, 0.15)
"""Sizes of the simplex, one per stage of the search: chosen values; see `FreeKey.moved`."""

MOST = 25
"""Most simulations of a stage for each key; a chosen value."""

DRAWN, PLACES, GENERATIONS = 32, 16, 40
"""Largest number of cases in the search for the place where the simplex begins, its places for each
key, and its generations; chosen values."""

SEARCHED = 256
"""Largest number of cases in the search, a chosen value; all cases judge its end."""

_ENDINGS = {
    "missed": "the controller does not close before the turn",
    "slow": "the actuator is still moving when the motion turns",
    "stroke": "the controller commands more than actuator.stroke_mm",
}
"""Outcomes that tuning may cause, and their meaning."""

_TRAVEL_RATIO = 2.0
"""Ratio of the actuator's travel after and before tuning above which a note is written: chosen."""

_LEAST_GAIN = 1e-3
"""Least relative gain of the objective for which a key is changed: a chosen value."""


@dataclass(frozen=True)
class FreeKey:
    """Tuned number.

    **Arguments**
    - `name`, `unit`: name and unit of the key. - `start`: value in the scenario.
    - `low`, `high`: bounds of the number. - `positive`: whether the number must be above 0.
    """

    name: str
    unit: str
    start: float
    low: float
    high: float
    positive: bool

    def moved(self, value: float, step: float, size: float) -> float:
        """Return a value one step on, within the bounds.

        A number that must be positive is multiplied by exp(step), any other grows by step · size.
        """
        free = value * math.exp(step) if self.positive else value + step * size
        return min(max(free, self.low), self.high)

    def at_limit(self, value: float) -> bool:
        """Return whether a value lies at a bound."""
        near = 1e-6 * (self.high - self.low if not self.positive else value)
        return value - self.low < near or self.high - value < near


@dataclass(frozen=True)
class Score:
    """Score of some settings over all cases, from the full simulation.

    **Arguments**
    - `cost_deg`: objective, the mean or largest value of residual gap + weight · interference, both
      as backlash in degrees of the driven gear.
    - `gap_mean_deg`, `gap_high95_deg`, `gap_max_deg`: mean, 95 % quantile and maximum of the
      backlash at the turn; NaN where no case turns.
    - `interfering_share`, `interference_mean_mm`, `interference_max_mm`: share of the cases that
      interfere, mean and maximum of the interference, mm.
    - `travel_mean_mm`: mean travel of the actuator, mm; no part of the objective.
    - `lost_mean_deg`, `lost_max_deg`, `thrown_max_deg`: mean and maximum of the lost motion, and
      maximum of `thrown_back_deg`, of a controller that moves the motor.
    - `outcomes`: number of cases by outcome, most frequent first.
    """

    cost_deg: float
    gap_mean_deg: float
    gap_high95_deg: float
    gap_max_deg: float
    interfering_share: float
    interference_mean_mm: float
    interference_max_mm: float
    travel_mean_mm: float
    lost_mean_deg: float
    lost_max_deg: float
    thrown_max_deg: float
    outcomes: dict[str, int]

    @property
    def bound(self) -> int:
        """Number of cases with a blocked drive."""
        return self.outcomes.get("bound", 0)

    @property
    def rank(self) -> tuple[int, float]:
        """Rank, the lower the better: number of cases with a blocked drive, then the objective."""
        return self.bound, self.cost_deg


@dataclass(frozen=True)
class Tuned(TextResult):
    """Settings of a controller, tuned over the cases of a sweep.

    **Arguments**
    - `spec`: the sweep with the tuned values. - `pair`: name of the gears.
    - `keys`: free keys with starts and bounds. - `values`: tuned value of each key.
    - `before`, `after`: scores of the start and of the result over all `cases`.
    - `objective`, `interference_weight`: definition of the objective.
    - `cases`, `searched`: number of all cases, and of those in the search.
    - `notes`: important remarks, one sentence each.
    """

    spec: ScenarioSpec
    pair: str
    keys: tuple[FreeKey, ...]
    values: dict[str, float]
    before: Score
    after: Score
    objective: Objective
    interference_weight: float
    cases: int
    searched: int
    notes: tuple[str, ...] = ()

    @property
    def improved(self) -> bool:
        """Whether the full simulation confirms that the values are better than the start."""
        return self.after.rank < self.before.rank

    def to_json(self) -> dict[str, Any]:
        """Return the object of schema `vttig.tune/1`."""
        return {
            "schema": "vttig.tune/1",
            "pair": self.pair,
            "controller": self.spec.controller,
            "objective": self.objective,
            "interference_weight": self.interference_weight,
            "cases": self.cases,
            "searched": self.searched,
            "improved": self.improved,
            "values": {
                key.name: {
                    "before": key.start,
                    "after": self.values[key.name],
                    "unit": key.unit,
                    "low": key.low,
                    "high": key.high,
                    "at_limit": key.at_limit(self.values[key.name]),
                }
                for key in self.keys
            },
            "before": vars(self.before),
            "after": vars(self.after),
            "notes": list(self.notes),
            "scenario": specs.spec_table(self.spec),
        }

    def __str__(self) -> str:
        searched = "" if self.searched == self.cases else f", searched over {self.searched} of them"
        kind = {"expected": "mean", "worst": "largest"}[self.objective]
        cost = f"{self.before.cost_deg:.5f}° → {self.after.cost_deg:.5f}°"
        verdict = "the full simulation found nothing better"
        if self.improved:
            verdict = f"confirmed by the full simulation, {cost}"
        of = "lost motion"
        if self.spec.controller != "feedforward":
            of = f"gap left + {self.interference_weight:g} × interference"
        head = [
            ("tuned", f"controller {self.spec.controller}, {self.cases} cases{searched}"),
            ("objective", f"{kind} of {of}"),
            ("result", verdict),
        ]
        rows = [
            (f"{key.name} [{key.unit}]", f"{key.start:.6g}", f"{self.values[key.name]:.4g}")
            for key in self.keys
        ]
        rows += _scores(self)
        lines = [key_values(head, title=self.pair), "", text_table(rows, ["", "before", "after"])]
        if self.notes:
            lines += ["", "notes:", *(f"  {note}" for note in self.notes)]
        return "\n".join(lines)


def _scores(tuned: Tuned) -> list[tuple[Any, ...]]:
    scores = tuned.before, tuned.after
    rows = [
        ("objective [deg]", "cost_deg", ".5f", 1.0),
        ("gap left: mean [deg]", "gap_mean_deg", ".5f", 1.0),
        ("  95 % below [deg]", "gap_high95_deg", ".5f", 1.0),
        ("  most [deg]", "gap_max_deg", ".5f", 1.0),
        ("interfere [%]", "interfering_share", ".1f", 100.0),
        ("  by at most [mm]", "interference_max_mm", ".4f", 1.0),
        ("actuator travel: mean [mm]", "travel_mean_mm", ".3f", 1.0),
    ]
    if tuned.spec.controller == "feedforward":
        rows = [
            rows[0],
            ("lost motion: mean [deg]", "lost_mean_deg", ".5f", 1.0),
            ("  most [deg]", "lost_max_deg", ".5f", 1.0),
            ("thrown back: most [deg]", "thrown_max_deg", ".5f", 1.0),
        ]
    table = [
        (name, *[_number(factor * getattr(score, field), form) for score in scores])
        for name, field, form, factor in rows
    ]
    counts = [", ".join(f"{n} {name}" for name, n in one.outcomes.items()) for one in scores]
    return [*table, ("outcomes", *counts)]


def _number(value: float, form: str) -> str:
    return "–" if np.isnan(value) else format(value, f"z{form}")  # z: no −0


def tune(
    spec: ScenarioSpec,
    pair: GearPair | Drive | None = None,
    *,
    folder: str | Path | None = None,
    maps: Maps = Maps(),
    free: Sequence[str] | None = None,
    limits: Limits | None = None,
    objective: Objective = "expected",
    interference_weight: float = 10.0,
    progress: Callable[[int, int], None] | None = None,
) -> Tuned:
    """Tune the settings of a controller for all cases of a sweep.

    The function minimises the mean, or the largest value, over the cases of

        residual gap + weight · interference

    Both terms are backlash in degrees of the driven gear; an interference of s mm counts as the
    backlash that a displacement by s removes. With the weight w, w degrees of residual gap cost as
    much as one degree of interference. With an uncertain map, the fraction 1/(1 + w) of the rigs
    therefore interferes at the best margin. For `feedforward`, which moves no gear, it minimises
    the lost motion, in which too much compensation costs as much as too little.

    With several keys a differential evolution over a sample of the cases finds where to begin. A
    simplex that shrinks from stage to stage then follows the objective. Every value that is tried
    is judged by the simulation of the cases as `vttig_jax.sweep` has it, with counts, motor and
    everything else; of many cases a sample is searched, and all of them judge the result. Values
    that are not better than the start are rejected, and a setting that gains less than a thousandth
    stays.

    **Arguments**
    - `spec`, `pair`, `folder`, `maps`: as for `vttig_jax.sweep`; the axes define the
      cases, and `controller` is no axis.
    - `free`: dotted keys, by default all numeric settings of the controller; for `feedforward`
      `map.constant_backlash_deg`, which starts at that of [eccentricities] or has to be given.
    - `limits`: key → (lowest, highest) value; by default the bounds of the key, and factors of 1000
      and 1/1000 of its start.
    - `objective`: "expected" or "worst". - `interference_weight`: at least 0.
    - `progress`: is called with the numbers of finished and of all stages.

    **Raises** `ScenarioError` and `PairError` as `sweep` does, and for a controller without
    settings; `ValueError` for keys that cannot be tuned and without 64-bit floats.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.control import parse_scenario_spec
    >>> from vttig_jax.rig import paper_pair
    >>> vttig_jax.enable_x64()
    >>> rig = {"driving_mm": 0.0226, "driving_phase_deg": 49.5, "driven_mm": 0.0273}
    >>> rig |= {"driven_phase_deg": 79.3, "constant_backlash_deg": 0.038}
    >>> axes = {"motion.reversal_deg": [360.0, 540.0]}
    >>> motion = {"dwell_s": 0.1, "ramp_s": 0.2}
    >>> scenario = {"pair": "pair.toml", "eccentricities": rig, "motion": motion}
    >>> spec = parse_scenario_spec(scenario | {"controller": "predictive", "sweep": axes})
    >>> tuned = vttig_jax.tune(spec, paper_pair(), free=["judgement.margin_mm"])
    >>> tuned.improved, abs(tuned.values["judgement.margin_mm"]) < 1e-3
    (True, True)

    ```
    """
    require_x64("tune")
    if objective not in get_args(Objective):
        raise ValueError(
            f'Argument `objective` must be "expected" or "worst", but is {objective!r}.'
        )
    if not (math.isfinite(interference_weight) and interference_weight >= 0):
        raise ValueError(
            f"Argument `interference_weight` must be at least 0, but is {interference_weight!r}."
        )
    cases = cases_of(spec, pair, folder, maps=maps)
    keys = free_keys(spec, free, limits)
    numbers = np.arange(len(cases))
    judge = _Judge(SweepWork(cases), keys, objective, interference_weight, numbers)
    best, searched = judge.start, judge.sampled(SEARCHED)
    if len(keys) > 1:  # the search may begin far away, where several settings fit each other
        best = searched.better(best, _far(judge.sampled(DRAWN), best))
    for finished, step in enumerate(STEPS, 1):
        best = _stage(searched, best, step)
        if progress is not None:
            progress(finished, len(STEPS))
    best = judge.better(judge.start, _without_small_gains(judge, best))
    before, after = judge.score(judge.start), judge.score(best)
    values = {key.name: value for key, value in zip(keys, best, strict=True)}
    return Tuned(
        spec=specs.with_numbers(spec, values),
        pair=cases.pair.name,
        keys=keys,
        values=values,
        before=before,
        after=after,
        objective=objective,
        interference_weight=interference_weight,
        cases=len(numbers),
        searched=len(searched.numbers),
        notes=tuple(_notes(before, after, keys, values)),
    )


def free_keys(
    spec: ScenarioSpec, free: Sequence[str] | None = None, limits: Limits | None = None
) -> tuple[FreeKey, ...]:
    """Return the keys to tune, by default all numeric settings of the controller.

    **Raises** `ScenarioError` for a controller without settings and for several controllers;
    `ValueError` for no key, for a key that appears twice, is unknown, takes no number, is no
    setting of this controller or an axis of the sweep, and for limits without its value.
    """
    axes = () if spec.sweep is None else tuple(spec.sweep.axes)
    if "controller" in axes:
        raise ScenarioError(
            "is an axis, but settings are tuned for one controller; write it at the top of the file"
            " instead.",
            where="sweep.controller",
        )
    if spec.controller not in SETTINGS:
        raise ScenarioError(
            f'"{spec.controller}" has nothing to tune; choose one of {", ".join(SETTINGS)}.',
            where="controller",
        )
    settings = SETTINGS[spec.controller]
    if isinstance(free, str):
        raise ValueError(f"Argument `free` must be a list of keys, but is one text: {free!r}.")
    default = settings[:1] if spec.controller == "feedforward" else settings
    names = [name for name in default if name not in axes] if free is None else list(free)
    if not names:
        raise ValueError(f"Argument `free` must name a key to tune: {', '.join(settings)}.")
    bounds = dict(limits or {})
    for name in names:
        if name not in settings:
            hint = did_you_mean(name, settings, f"it is set by {', '.join(settings)}.")
            raise ValueError(
                f"Argument `free` must name settings that take a number, but `{name}` is none of"
                f" {spec.controller}; {hint}"
            )
        if name in axes:
            raise ValueError(
                f"Argument `free` must name keys that the sweep does not vary, but `{name}` is an"
                " axis of the sweep; remove one of them."
            )
        if names.count(name) > 1:
            raise ValueError(f"Argument `free` must name `{name}` once, but does so twice.")
        if _start(spec, name) is None:
            raise ValueError(
                f"Argument `free` names `{name}`, but the scenario has no start for it: write its"
                " value, because the gap of a map has no number of its own."
            )
    if fixed := [name for name in bounds if name not in names]:
        raise ValueError(
            f"Argument `limits` must be for keys that are free, but `{fixed[0]}` is not; free are"
            f" {', '.join(names)}."
        )
    return tuple(_free(KEYS[name], _start(spec, name), bounds.get(name)) for name in names)


def _start(spec: ScenarioSpec, name: str) -> Any:
    """Return the value of a key in the scenario, or None; a gap in [map] starts at the true one."""
    table, _, field = name.rpartition(".")
    value = getattr(getattr(spec, table), field)
    if value is None and specs.believed_map(spec) == ECCENTRICITIES:
        value = getattr(spec.eccentricities, field)
    return value


def _free(key: Key, start: float, limits: tuple[float, float] | None) -> FreeKey:
    # A key without a default is a union with None, inside of which the annotation stands.
    parts = [part for kind in (key.kind, *get_args(key.kind)) for part in get_args(kind)]
    meta = next(part for part in parts if isinstance(part, Meta))
    positive = meta.gt is not None and meta.gt >= 0
    low, high = float(meta.gt if meta.ge is None else meta.ge), float(meta.le)  # type: ignore[arg-type]
    if limits is not None:
        first, last = limits
        inside = (low < first if positive else low <= first) and last <= high
        if not (inside and first <= start <= last and first < last):
            raise ValueError(
                f"Argument `limits` of `{key.name}` must be a range around its value {start:g}"
                f" within {low:g} … {high:g}, but is {first:g} … {last:g}."
            )
        low, high = float(first), float(last)
    elif positive:
        low, high = max(low, start / REACH), min(high, start * REACH)
    return FreeKey(name=key.name, unit=key.unit, start=start, low=low, high=high, positive=positive)


def _far(judge: "_Judge", best: Values) -> Values:
    """Return the best values of a differential evolution (R. Storn, K. Price, 1997).

    All places of a generation are simulated side by side.
    """
    size, draw = len(best), np.random.default_rng(0)
    found: Any = differential_evolution(
        lambda steps: judge.costs_around(best, steps.T),
        [(-math.log(REACH), math.log(REACH))] * size,
        init=2 * STEPS[0] * draw.normal(size=(PLACES * size, size)),  # type: ignore[arg-type]
        maxiter=GENERATIONS,
        tol=0.0,
        atol=_LEAST_GAIN * _LEAST_GAIN * judge.score(best).cost_deg,
        polish=False,
        seed=draw,  # type: ignore[call-arg]  # named `rng` from scipy 1.15 on
        updating="deferred",
        vectorized=True,
    )
    return judge.moved(best, found.x)


def _stage(judge: "_Judge", best: Values, step: float) -> Values:
    """Search with a simplex of this size around the best values (J. Nelder, R. Mead, 1965)."""
    size = len(best)
    simplex = step * np.vstack([np.zeros(size), np.eye(size)])
    options = {
        "initial_simplex": simplex,
        "maxfev": MOST * size,
        "xatol": 0.1 * abs(step),
        "fatol": _LEAST_GAIN * judge.score(best).cost_deg,
    }
    found = minimize(
        lambda steps: judge.costs_around(best, [steps])[0],
        simplex[0],
        method="Nelder-Mead",
        options=options,
    )
    return judge.better(best, judge.moved(best, found.x))


def _without_small_gains(judge: "_Judge", best: Values) -> Values:
    """Return `best` with every key reset to its start if the key gains less than `_LEAST_GAIN`.

    A key is reset only if the values stay better than the start.
    """
    first, tuned = judge.score(judge.start), judge.score(best)
    while True:
        for index, start in enumerate(judge.start):
            reset = (*best[:index], start, *best[index + 1 :])
            if reset in (best, judge.start):
                continue
            score = judge.score(reset)
            near = score.cost_deg <= tuned.cost_deg * (1 + _LEAST_GAIN)
            if near and score.bound <= tuned.bound and score.rank < first.rank:
                best = reset
                break
        else:
            return best


@dataclass(eq=False)
class _Judge:
    """Scores of values of the keys, by the simulation of some cases of a sweep; each is kept."""

    work: SweepWork
    keys: tuple[FreeKey, ...]
    objective: Objective
    weight: float
    numbers: np.ndarray

    def __post_init__(self) -> None:
        self.cases, self.start = self.work.cases, tuple(key.start for key in self.keys)
        self._scores: dict[Values, Score] = {}
        self._first = self._rows([self.start])

    def score(self, values: Values) -> Score:
        """Return the score of the given values of the keys."""
        return self.scores([values])[0]

    def scores(self, places: Sequence[Values]) -> list[Score]:
        """Return the score of each of the given places, simulated side by side."""
        new = [values for values in dict.fromkeys(places) if values not in self._scores]
        rows, count = self._rows(new) if new else {}, len(self.numbers)
        for index, values in enumerate(new):
            part = slice(index * count, (index + 1) * count)
            self._scores[values] = self._score({name: x[part] for name, x in rows.items()})
        return [self._scores[values] for values in places]

    def costs_around(self, values: Values, steps: Any) -> list[float]:
        """Return the cost of the values so many steps on; ∞ where more drives block than there."""
        most = self.score(values).bound
        scores = self.scores([self.moved(values, one) for one in steps])
        return [score.cost_deg if score.bound <= most else math.inf for score in scores]

    def better(self, *places: Values) -> Values:
        """Return the best of some values, the first of equals."""
        return min(places, key=lambda values: self.score(values).rank)

    def moved(self, values: Values, steps: Any) -> Values:
        """Return the values so many steps on; see `FreeKey.moved`.

        A step of a displacement is a tenth of what closes the gap at the start: the displacement of
        the actuator and the gap left.
        """
        left = self._first["residual_gap_deg"] * DEG / self.cases.closing
        closed = np.nanmean(np.nan_to_num(left) + 0.5 * self._first["actuator_travel_mm"])
        shift = max(0.1 * float(closed), NEAR_MM)
        return tuple(
            key.moved(value, float(step), shift if key.unit == "mm" else key.start)
            for key, value, step in zip(self.keys, values, steps, strict=True)
        )

    def sampled(self, most: int) -> "_Judge":
        """Return a judge of a sample of at most so many cases, drawn without replacement.

        For the objective "worst", half of the sample are the cases with the highest cost at start.
        """
        costs = self._costs(self._first)
        numbers = np.flatnonzero(~np.isnan(costs))
        if len(numbers) <= most:
            return self
        worst = np.argsort(-costs[numbers])[: most // 2]
        first = numbers[worst] if self.objective == "worst" else numbers[:0]
        others = np.setdiff1d(numbers, first)
        drawn = np.random.default_rng(0).choice(others, most - len(first), replace=False)
        numbers = np.sort(np.concatenate([first, drawn]))
        return replace(self, numbers=numbers)

    def _rows(self, places: Sequence[Values]) -> Rows:
        """Return the rows of all cases at the first place, then at the second …"""
        columns = np.repeat(np.asarray(places), len(self.numbers), axis=0).T
        named = dict(zip((key.name for key in self.keys), columns, strict=True))
        return self.work.rows(np.tile(self.numbers, len(places)).tolist(), settings=named)

    def _costs(self, rows: Rows) -> np.ndarray:
        """Return the cost of every case in degrees of backlash: gap left + weight · interference.

        If the controller moves the motor, it is the lost motion. It is infinite for a blocked drive
        and NaN for a refused case.
        """
        if self.cases.spec.controller == "feedforward":
            costs = np.nan_to_num(rows["lost_motion_deg"])
        else:
            over = rows["interference_mm"] * self.cases.closing / DEG
            costs = np.nan_to_num(rows["residual_gap_deg"]) + self.weight * over
        costs = np.where(rows["outcome"] == "bound", np.inf, costs)
        return np.where(rows["outcome"] == REFUSED, np.nan, costs)

    def _score(self, rows: Rows) -> Score:
        costs = self._costs(rows)
        costs = costs[np.isfinite(costs)]
        gap, over, travel, lost, thrown = (_spread(rows[name]) for name in _METRICS)
        interferes = rows["interference_mm"][~np.isnan(rows["interference_mm"])] > NEAR_MM
        cost = (np.max if self.objective == "worst" else np.mean)(costs) if len(costs) else np.inf
        return Score(
            cost_deg=float(cost),
            gap_mean_deg=gap[0],
            gap_high95_deg=gap[1],
            gap_max_deg=gap[2],
            interfering_share=float(interferes.mean()) if len(interferes) else np.nan,
            interference_mean_mm=over[0],
            interference_max_mm=over[2],
            travel_mean_mm=travel[0],
            lost_mean_deg=lost[0],
            lost_max_deg=lost[2],
            thrown_max_deg=thrown[2],
            outcomes=dict(Counter(rows["outcome"].tolist()).most_common()),
        )


def _spread(values: np.ndarray) -> tuple[float, float, float]:
    """Return the mean, the 95 % quantile and the maximum; NaN without values."""
    known = values[~np.isnan(values)]
    if not len(known):
        return np.nan, np.nan, np.nan
    return float(known.mean()), float(np.quantile(known, 0.95)), float(known.max())


def _notes(
    before: Score, after: Score, keys: Sequence[FreeKey], values: Mapping[str, float]
) -> list[str]:
    notes: list[str] = []
    if not after.rank < before.rank:
        notes.append("The full simulation found no better values, so they stay as they were.")
    notes += [
        f"{key.name} ends at its limit, {values[key.name]:.4g}."
        for key in keys
        if key.at_limit(values[key.name])
    ]
    if after.bound:
        notes.append(
            f"In {after.bound} cases the drive still blocks; the objective does not include them."
        )
    total = sum(after.outcomes.values())
    for name, meaning in _ENDINGS.items():
        cases, earlier = (one.outcomes.get(name, 0) for one in (after, before))
        if name == "missed" and cases == total > earlier:
            notes.append(
                "The best controller never closes, because the interference of closing costs more"
                " than the gap; choose another controller or a smaller interference weight."
            )
        elif cases > earlier:
            notes.append(
                f"In {cases} of {total} cases {meaning} ({name}), before tuning in {earlier}."
            )
    if after.travel_mean_mm > _TRAVEL_RATIO * max(before.travel_mean_mm, NEAR_MM):
        notes.append(
            f"The actuator travels {after.travel_mean_mm:.3g} mm per run, before tuning"
            f" {before.travel_mean_mm:.3g}: the controller closes and opens while the shaft runs,"
            " which the objective does not include; limit the settings that detect braking."
        )
    if after.thrown_max_deg > 0.5 * max(after.lost_max_deg, after.gap_max_deg):
        notes.append(
            f"The motor throws the driven shaft back by up to {after.thrown_max_deg:.5f}°, which"
            " the lost motion hardly contains; choose a longer judgement.jump_s."
        )
    return notes

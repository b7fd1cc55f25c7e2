"""Result of a tuning, with scores of the full simulation before and after it."""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ...base.files.text_tables import key_values, text_table
from ...base.results import TextResult
from ..scenario.spec import ScenarioSpec, spec_table

Objective = Literal["expected", "worst"]


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
            "scenario": spec_table(self.spec),
        }

    def __str__(self) -> str:
        return _text(self)


def _text(tuned: Tuned) -> str:
    searched = "" if tuned.searched == tuned.cases else f", searched over {tuned.searched} of them"
    kind = {"expected": "mean", "worst": "largest"}[tuned.objective]
    cost = f"{tuned.before.cost_deg:.5f}° → {tuned.after.cost_deg:.5f}°"
    verdict = "the full simulation found nothing better"
    if tuned.improved:
        verdict = f"confirmed by the full simulation, {cost}"
    of = "lost motion"
    if tuned.spec.controller != "feedforward":
        of = f"gap left + {tuned.interference_weight:g} × interference"
    head = [
        ("tuned", f"controller {tuned.spec.controller}, {tuned.cases} cases{searched}"),
        ("objective", f"{kind} of {of}"),
        ("result", verdict),
    ]
    rows = [
        (f"{key.name} [{key.unit}]", f"{key.start:.6g}", f"{tuned.values[key.name]:.4g}")
        for key in tuned.keys
    ]
    rows += _scores(tuned)
    lines = [key_values(head, title=tuned.pair), "", text_table(rows, ["", "before", "after"])]
    if tuned.notes:
        lines += ["", "notes:", *(f"  {note}" for note in tuned.notes)]
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

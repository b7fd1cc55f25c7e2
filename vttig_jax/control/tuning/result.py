"""What tuning found, before and after, as the hard judgement has it."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...base.files.text_tables import key_values, text_table
from ...base.units import DEG
from ..scenario.spec import ScenarioSpec, spec_table
from ..simulation.metrics import NEAR_MM
from ..sweeps.blocks import REFUSED, Rows
from .free_keys import FreeKey
from .search import Objective, Stage

_NOTHING = (np.nan, np.nan, np.nan)


@dataclass(frozen=True)
class Score:
    """What some settings come to over all cases, by the hard judgement.

    **Arguments**
    - `cost_deg`: the objective, mean or largest of gap left + weight · interference, the latter as
      the backlash it stands for, in degrees of the driven gear.
    - `gap_mean_deg`, `gap_high95_deg`, `gap_max_deg`: backlash left at the turn: mean, the value
      that 95 % of the cases stay below, most; NaN where no case turns.
    - `interfering_share`: of the cases. - `interference_mean_mm`, `interference_max_mm`.
    - `travel_mean_mm`: way of the actuator to and fro; no part of the objective.
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
    outcomes: dict[str, int]

    @property
    def rank(self) -> tuple[int, float]:
        """Less is better: first drives that stand, then the objective of the others."""
        return self.outcomes.get("bound", 0), self.cost_deg


def costs_of(rows: Rows, weight: float, closing: float) -> np.ndarray:
    """Cost of every case in degrees; infinite for a drive that stood, NaN for a refused case.

    **Arguments**
    - `closing`: rad of backlash that a mm of axial displacement takes up.
    """
    gap = np.where(np.isnan(rows["residual_gap_deg"]), 0.0, rows["residual_gap_deg"])
    costs = gap + weight * rows["interference_mm"] * closing / DEG
    costs = np.where(rows["outcome"] == "bound", np.inf, costs)
    return np.where(rows["outcome"] == REFUSED, np.nan, costs)


def score_of(rows: Rows, objective: Objective, weight: float, closing: float) -> Score:
    """The score of a sweep; `rows` as of `SweepWork.run`, the rest as of `costs_of`."""
    costs = costs_of(rows, weight, closing)
    costs = costs[np.isfinite(costs)]
    gap = rows["residual_gap_deg"][~np.isnan(rows["residual_gap_deg"])]
    over = rows["interference_mm"][~np.isnan(rows["interference_mm"])]
    way = rows["actuator_travel_mm"][~np.isnan(rows["actuator_travel_mm"])]
    worst = objective == "worst"
    cost = np.inf if not len(costs) else costs.max() if worst else costs.mean()
    mean, high, most = (gap.mean(), np.quantile(gap, 0.95), gap.max()) if len(gap) else _NOTHING
    share, average, farthest = _NOTHING
    if len(over):
        share, average, farthest = np.mean(over > NEAR_MM), over.mean(), over.max()
    return Score(
        cost_deg=float(cost),
        gap_mean_deg=float(mean),
        gap_high95_deg=float(high),
        gap_max_deg=float(most),
        interfering_share=float(share),
        interference_mean_mm=float(average),
        interference_max_mm=float(farthest),
        travel_mean_mm=float(way.mean()) if len(way) else np.nan,
        outcomes=dict(Counter(rows["outcome"].tolist()).most_common()),
    )


@dataclass(frozen=True)
class Tuned:
    """Settings of a controller, tuned over the cases of a sweep.

    **Arguments**
    - `spec`: the sweep with the values in it. - `pair`: name of the gears.
    - `keys`: what was free, with starts and bounds. - `values`: what it is now, by key.
    - `before`, `after`: scores of both by the hard judgement, over all `cases`.
    - `objective`, `interference_weight`: what was minimised.
    - `cases`, `searched`: how many there are, and how many of them the search looked at.
    - `stages`: of the search. - `notes`: what a reader must not overlook, in sentences.
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
    stages: tuple[Stage, ...]
    notes: tuple[str, ...] = ()

    @property
    def improved(self) -> bool:
        """Whether the hard judgement confirms that the values are better than those before."""
        return self.after.rank < self.before.rank

    def to_json(self) -> dict[str, Any]:
        """The object of schema `vttig.tune/1`."""
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
            "stages": [
                stage._asdict() | {"values": dict(zip(self.values, stage.values, strict=True))}
                for stage in self.stages
            ],
            "notes": list(self.notes),
            "scenario": spec_table(self.spec),
        }

    def __str__(self) -> str:
        return _text(self)


def _text(tuned: Tuned) -> str:
    searched = "" if tuned.searched == tuned.cases else f", searched over {tuned.searched} of them"
    kind = {"expected": "mean", "worst": "largest"}[tuned.objective]
    cost = f"{tuned.before.cost_deg:.5f}° → {tuned.after.cost_deg:.5f}°"
    verdict = "the hard judgement found nothing better"
    if tuned.improved:
        verdict = f"confirmed by the hard judgement, {cost}"
    head = [
        ("tuned", f"controller {tuned.spec.controller}, {tuned.cases} cases{searched}"),
        ("objective", f"{kind} of gap left + {tuned.interference_weight:g} × interference"),
        ("result", verdict),
    ]
    settings = [
        ((key.name, key.unit), f"{key.start:.6g}", f"{tuned.values[key.name]:.4g}")
        for key in tuned.keys
    ]
    rows = [(_named(*name), before, after) for name, before, after in [*settings, *_scores(tuned)]]
    lines = [key_values(head, title=tuned.pair), "", text_table(rows, ["", "before", "after"])]
    if tuned.notes:
        lines += ["", "notes:", *(f"  {note}" for note in tuned.notes)]
    return "\n".join(lines)


def _named(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _scores(tuned: Tuned) -> list[tuple[Any, ...]]:
    one, other = tuned.before, tuned.after
    rows = [
        (("objective", "deg"), "cost_deg", ".5f", 1.0),
        (("gap left: mean", "deg"), "gap_mean_deg", ".5f", 1.0),
        (("  95 % below", "deg"), "gap_high95_deg", ".5f", 1.0),
        (("  most", "deg"), "gap_max_deg", ".5f", 1.0),
        (("interfere", "%"), "interfering_share", ".1f", 100.0),
        (("  by at most", "mm"), "interference_max_mm", ".4f", 1.0),
        (("actuator travel: mean", "mm"), "travel_mean_mm", ".3f", 1.0),
    ]
    found = [
        (name, *[_number(factor * getattr(score, field), form) for score in (one, other)])
        for name, field, form, factor in rows
    ]
    return [*found, (("outcomes", ""), *map(_counted, (one, other)))]


def _counted(score: Score) -> str:
    return ", ".join(f"{count} {name}" for name, count in score.outcomes.items())


def _number(value: float, form: str) -> str:
    return "–" if np.isnan(value) else format(round(value, int(form[1:-1])) + 0.0, form)  # no −0

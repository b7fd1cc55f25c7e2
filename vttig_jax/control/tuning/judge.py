"""Evaluation of settings by full simulation of all cases with the original controller."""

import dataclasses
from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
from msgspec.structs import replace

from ...base.errors import InputError
from ..scenario.spec import ScenarioSpec
from ..simulation.case import Case
from ..simulation.settings import with_settings
from ..sweeps.batching import BatchRunner
from ..sweeps.blocks import Rows, SweepWork
from ..sweeps.case_leaves import CaseLeaves, leaves_of
from ..sweeps.cases import Recipe, SweepCases
from .free_keys import FreeKey
from .result import Score, costs_of, score_of
from .search import WIDTHS, Objective, Stage

SEARCHED = 256
"""Largest number of cases in the search, a chosen value; the full simulation has all cases."""


class Judge:
    """Evaluation of values of the tuned keys by full simulation of all cases; scores are cached.

    The arguments are the inputs of the sweep, the tuned keys, and the objective with its weight of
    the interference.
    """

    def __init__(
        self, recipe: Recipe, keys: tuple[FreeKey, ...], objective: Objective, weight: float
    ) -> None:
        self.recipe = recipe
        self.keys = keys
        self.objective: Objective = objective
        self.weight = weight
        self.cases = recipe.cases()
        self.closing = self.cases.closing
        self._scores: dict[tuple[float, ...], Score] = {}
        self.start = tuple(key.start for key in keys)
        self.moves = recipe.spec.controller == "feedforward"
        self.costs = costs_of(self._rows(self.start), weight, self.closing, self.moves)

    def score(self, values: tuple[float, ...]) -> Score:
        """Return the score of the given values of the keys over all cases of the sweep."""
        if values not in self._scores:
            self._scores[values] = self._score_rows(self._rows(values))
        return self._scores[values]

    def compass(self) -> Iterator[Stage]:
        """Yield the stages of a search without slopes, for a controller that moves the motor.

        Every key is changed by a share of its value, up and down, as long as a score improves; the
        share shrinks from stage to stage.
        """
        best = self.start
        for width in WIDTHS:
            before, calls, tried = self.score(best), 0, None
            while tried != best:
                tried = best
                for index, key in enumerate(self.keys):
                    for factor in (1 - width, 1 + width):
                        value = min(max(best[index] * factor, key.low), key.high)
                        other = (*best[:index], value, *best[index + 1 :])
                        calls += 1
                        if self.score(other).rank < self.score(best).rank:
                            best = other
            yield Stage(width, best, before.cost_deg, self.score(best).cost_deg, calls)

    def search_cases(self) -> list[Case]:
        """Return the cases for the search: all, or a sample without replacement.

        For the objective "worst", half of the sample are the cases with the highest cost at the
        start values.
        """
        numbers = np.flatnonzero(~np.isnan(self.costs))
        if len(numbers) > SEARCHED:
            worst = np.argsort(-self.costs[numbers])[: SEARCHED // 2]
            first = numbers[worst] if self.objective == "worst" else numbers[:0]
            others = np.setdiff1d(numbers, first)
            drawn = np.random.default_rng(0).choice(others, SEARCHED - len(first), replace=False)
            numbers = np.sort(np.concatenate([first, drawn]))
        cases = [self.cases.case(int(number)) for number in numbers]
        return [case for case in cases if isinstance(case, Case)]

    def _rows(self, values: tuple[float, ...]) -> Rows:
        if self.moves:  # the gap of a map is no number of the built controller
            spec = with_keys(self.recipe.spec, self.keys, values)
            cases = dataclasses.replace(self.recipe, spec=spec).cases()
        else:
            cases = _WithSettings(self.recipe, self.cases, self.keys, values)
        work = SweepWork(cases, _runner())
        blocks = [rows for _, rows in work.run_blocks(range(work.blocks), lambda steps: None)]
        rows = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
        self._scores.setdefault(values, self._score_rows(rows))
        return rows

    def _score_rows(self, rows: Rows) -> Score:
        return score_of(rows, self.objective, self.weight, self.closing, self.moves)


class _WithSettings(SweepCases):
    """Cases of a sweep with other values of some keys, derived from the cases in `built`."""

    def __init__(
        self,
        recipe: Recipe,
        built: SweepCases,
        keys: Sequence[FreeKey],
        values: Sequence[float],
    ) -> None:
        super().__init__(with_keys(recipe.spec, keys, values), recipe.pair, maps=recipe.maps)
        self._built = built
        names = [key.name for key in keys]
        self._settings = dict(zip(names, map(np.asarray, values), strict=True))

    def case(self, number: int) -> Case | InputError:
        """See `SweepCases.case`."""
        case = self._built.case(number)
        return case if isinstance(case, InputError) else with_settings(case, self._settings)

    def leaves(self, number: int) -> CaseLeaves | InputError:
        """See `SweepCases.leaves`."""
        case = self.case(number)
        return case if isinstance(case, InputError) else leaves_of(case)


@lru_cache
def _runner() -> BatchRunner:
    """Return a cached runner on all devices."""
    return BatchRunner()


def with_keys(spec: ScenarioSpec, keys: Sequence[FreeKey], values: Sequence[float]) -> ScenarioSpec:
    """Return the sweep with the given values of the keys."""
    for key, value in zip(keys, values, strict=True):
        table, _, field = key.name.rpartition(".")
        spec = replace(spec, **{table: replace(getattr(spec, table), **{field: value})})
    return spec

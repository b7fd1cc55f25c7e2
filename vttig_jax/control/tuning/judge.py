"""The hard judgement of settings: every case of a sweep, as `vttig_jax.sweep` runs it."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from msgspec.structs import replace

from ...base.errors import InputError
from ..scenario.spec import ScenarioSpec
from ..simulation.case import Case
from ..sweeps.batching import BatchRunner
from ..sweeps.blocks import Rows, SweepWork
from ..sweeps.cases import Recipe, SweepCases
from .free_keys import FreeKey
from .result import Score, costs_of, score_of
from .search import Objective, with_settings

SEARCHED = 256
"""Most cases that the search looks at; the hard judgement has all."""


class Judge:
    """The hard judgement: runs all cases with some values of the keys; what it ran it remembers."""

    def __init__(
        self, recipe: Recipe, keys: tuple[FreeKey, ...], objective: Objective, weight: float
    ) -> None:
        self.recipe = recipe
        self.keys = keys
        self.objective: Objective = objective
        self.weight = weight
        pair = recipe.pair
        self.closing = float((pair.taper / pair.reference_radii[1]).sum())
        self._known: dict[tuple[float, ...], Score] = {}
        self.start = tuple(key.start for key in keys)
        self.cases = recipe.cases()
        self.costs = costs_of(self._rows(self.start), weight, self.closing)

    def score(self, values: tuple[float, ...]) -> Score:
        """Over all cases of the sweep."""
        if values not in self._known:
            self._known[values] = self._scored(self._rows(values))
        return self._known[values]

    def searched(self) -> list[Case]:
        """Cases for the search, all or as many as it takes.

        Drawn without replacement; for the worst case the worst at the start come first.
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
        work = SweepWork(_WithSettings(self.recipe, self.cases, self.keys, values), _lanes())
        blocks = [work.run(number, lambda steps: None) for number in range(work.blocks)]
        rows = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
        self._known.setdefault(values, self._scored(rows))
        return rows

    def _scored(self, rows: Rows) -> Score:
        return score_of(rows, self.objective, self.weight, self.closing)


class _WithSettings(SweepCases):
    """The cases of a sweep with other values of some keys; the rest of them is built once."""

    def __init__(
        self,
        recipe: Recipe,
        built: SweepCases,
        keys: Sequence[FreeKey],
        values: Sequence[float],
    ) -> None:
        super().__init__(with_keys(recipe.spec, keys, values), recipe.pair, rigs=recipe.rigs)
        self._built = built
        self._settings = [key.name for key in keys], [np.asarray(value) for value in values]

    def case(self, number: int) -> Case | InputError:
        """See `SweepCases.case`."""
        case = self._built.case(number)
        return case if isinstance(case, InputError) else with_settings(case, *self._settings)


@lru_cache
def _lanes() -> BatchRunner:
    """All devices, with what they have compiled before."""
    return BatchRunner()


def with_keys(spec: ScenarioSpec, keys: Sequence[FreeKey], values: Sequence[float]) -> ScenarioSpec:
    """A sweep whose [judgement] has these values."""
    new = {key.name.rpartition(".")[2]: one for key, one in zip(keys, values, strict=True)}
    return replace(spec, judgement=replace(spec.judgement, **new))

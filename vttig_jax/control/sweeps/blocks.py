"""What one process does of a sweep: blocks of cases, each a table of rows."""

import time
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ...base.errors import InputError
from ..simulation.accumulators import Accumulators
from ..simulation.case import Case
from ..simulation.metrics import METRICS, MetricInputs, metrics_of, outcomes_of
from ..simulation.simulate import periods_of
from .batching import (
    LANES,
    STEPS,
    BatchRunner,
    CaseLeaves,
    CaseStructure,
    lanes_for,
    numbers_of,
    stacked,
    varying,
)
from .cases import DRAW, SweepCases, rig_table

Rows = dict[str, np.ndarray]
"""Columns of a table: `case`, the axes, the metrics, `outcome`."""

REFUSED = "refused"
"""Outcome of a case whose values do not go together: it is not simulated."""

_BLOCK_STEPS = 1 << 28
"""Lane-steps of a block at most, some ten seconds: what an interruption loses."""

_LEAST, _MOST = 64, 4 * LANES
"""Cases of one program in a block."""

_MOST_KINDS = 16
_CALLS = 4


class Group(NamedTuple):
    """Cases of one program: their places in the block, themselves, and their numbers."""

    places: list[int]
    cases: list[Case]
    numbers: list[CaseLeaves]


class SweepWork:
    """Runs the blocks of a sweep.

    **Arguments**
    - `cases`: of the sweep. - `lanes`: where they run.

    **Raises** the `InputError` of the first case where no value of any axis lets one run.
    """

    def __init__(self, cases: SweepCases, lanes: BatchRunner) -> None:
        self.cases = cases
        self.lanes = lanes
        samples = [cases.case(number) for number in cases.samples()]
        refused = [case for case in samples if isinstance(case, InputError)]
        self._samples = [case for case in samples if not isinstance(case, InputError)]
        if not self._samples:
            raise refused[0]
        self._own = _varying(self._samples)
        self.block = _block(self._samples, min(cases.kinds, _MOST_KINDS))
        """Cases of a block: the same for any number of devices, so that a sweep can be resumed."""

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return -(-len(self.cases) // self.block)

    def run(self, number: int, tick: Callable[[int], None]) -> Rows:
        """The rows of a block; `tick` is told lane-steps done, the filled-up lanes left out."""
        first = number * self.block
        places = range(first, min(first + self.block, len(self.cases)))
        rows: Rows = {name: np.full(len(places), np.nan) for name in METRICS}
        outcome = np.full(len(places), REFUSED, dtype="<U9")
        for group in self._groups(places):
            for some, facts, tally in self._simulated(group, tick):
                for name, values in metrics_of(facts, tally).items():
                    rows[name][some] = values[: len(some)]
                outcome[some] = outcomes_of(facts, tally)[: len(some)]
        return self._described(places) | rows | {"outcome": outcome}

    def trial(self, lanes: int) -> float:
        """Seconds that a lane-step takes, from some compiled calls of the first program."""
        case = self._samples[0]
        first = numbers_of(case)
        stack = stacked([first], self._own[first.program], lanes)
        periods = max(STEPS // case.substeps, 1)
        self.lanes.run(stack, periods, case.substeps)  # compiles
        began = time.perf_counter()
        self.lanes.run(stack, _CALLS * periods, case.substeps)
        return (time.perf_counter() - began) / (lanes * _CALLS * periods * case.substeps)

    def _groups(self, places: Sequence[int]) -> list[Group]:
        """Cases of a block by program; those that cannot run are left out."""
        groups: dict[CaseStructure, Group] = {}
        for place, number in enumerate(places):
            case = self.cases.case(number)
            if isinstance(case, InputError):
                continue
            numbers = numbers_of(case)
            group = groups.setdefault(numbers.program, Group([], [], []))
            group.places.append(place)
            group.cases.append(case)
            group.numbers.append(numbers)
        return list(groups.values())

    def _simulated(
        self, group: Group, tick: Callable[[int], None]
    ) -> Iterator[tuple[list[int], MetricInputs, Accumulators]]:
        """Places, facts and tallies of a group, long runs beside long ones."""
        own = self._own.get(group.numbers[0].program, _none(group.numbers[0]))
        periods = [periods_of(case) for case in group.cases]
        order = sorted(range(len(periods)), key=lambda place: (periods[place], place))
        devices, substeps = len(self.lanes.devices), group.cases[0].substeps
        for first in range(0, len(order), LANES * devices):
            some = order[first : first + LANES * devices]
            numbers = [group.numbers[place] for place in some]
            stack = stacked(numbers, own, lanes_for(len(some), devices))
            lengths = np.array([periods[place] for place in some])

            def count(before: int, now: int, lengths: np.ndarray = lengths) -> None:
                done = np.minimum(lengths, now) - np.minimum(lengths, before)
                tick(int(done.sum()) * substeps)

            facts, tally = self.lanes.run(stack, periods[some[-1]], substeps, count)
            yield [group.places[place] for place in some], facts, tally

    def _described(self, places: Sequence[int]) -> Rows:
        """Number, axes and rig of the cases."""
        values = [self.cases.values(number) for number in places]
        columns: Rows = {"case": np.array(places, np.int64)}
        for axis in self.cases.axes:
            kind = self.cases.kind(axis)
            columns[axis] = np.array([one[axis] for one in values], None if kind is str else kind)
        if self.cases.rigs:
            rigs = [rig_table(self.cases.rigs[draw]) for draw in columns[DRAW]]
            columns |= {
                f"eccentricities.{name}": np.array([rig[name] for rig in rigs]) for name in rigs[0]
            }
        return columns


def _block(samples: Sequence[Case], kinds: int) -> int:
    """Cases of a block: a power of two of each program, fewer where runs are long."""
    steps = float(np.mean([periods_of(case) * case.substeps for case in samples]))
    wanted = int(np.clip(_BLOCK_STEPS / (kinds * steps), _LEAST, _MOST))
    return kinds << (wanted.bit_length() - 1)


def _varying(samples: Sequence[Case]) -> dict[CaseStructure, tuple[bool, ...]]:
    """Which numbers get lanes of their own, by program."""
    found: dict[CaseStructure, list[CaseLeaves]] = {}
    for numbers in map(numbers_of, samples):
        found.setdefault(numbers.program, []).append(numbers)
    return {program: varying(several) for program, several in found.items()}


def _none(numbers: CaseLeaves) -> tuple[bool, ...]:
    return (False,) * len(numbers.leaves)

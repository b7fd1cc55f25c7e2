"""Blocks of a sweep: the cases that one process runs together, each block a table of rows."""

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
    batch_of,
    lanes_for,
    leaves_of,
    varying,
)
from .cases import DRAW, SweepCases, rig_table

Rows = dict[str, np.ndarray]
"""Columns of a table: `case`, the axes, the metrics, `outcome`."""

REFUSED = "refused"
"""Outcome of a case whose values contradict each other, so that it is not simulated."""

_BLOCK_STEPS = 1 << 28
"""Limit of lane-steps in a block, chosen for about ten seconds: an interruption loses one block."""

_LEAST, _MOST = 64, 4 * LANES
"""Limits of the number of cases of one structure in a block: chosen values."""

_MOST_KINDS, _CALLS = 16, 4
"""Limit of the text combinations that enlarge a block; number of timed calls: chosen values."""


class Group(NamedTuple):
    """Cases of one structure, with their indices in the block and their numbers."""

    indices: list[int]
    cases: list[Case]
    leaves: list[CaseLeaves]


class SweepWork:
    """Blocks of a sweep, ready to run.

    **Arguments**
    - `cases`: cases of the sweep. - `runner`: runner of the batches.

    **Raises** the `InputError` of the first case if no representative case can run.
    """

    def __init__(self, cases: SweepCases, runner: BatchRunner) -> None:
        self.cases = cases
        self.runner = runner
        samples = [cases.case(number) for number in cases.representative_cases()]
        refused = [case for case in samples if isinstance(case, InputError)]
        self._samples = [case for case in samples if not isinstance(case, InputError)]
        if not self._samples:
            raise refused[0]
        self._batched = _varying(self._samples)
        self.block_size = _block_size(self._samples, min(cases.text_combinations, _MOST_KINDS))
        """Cases in a block, independent of the number of devices so that a sweep can be resumed."""

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return -(-len(self.cases) // self.block_size)

    def run(self, number: int, progress: Callable[[int], None]) -> Rows:
        """Return the rows of a block; `progress` is called with steps, without those of fillers."""
        first = number * self.block_size
        numbers = range(first, min(first + self.block_size, len(self.cases)))
        rows: Rows = {name: np.full(len(numbers), np.nan) for name in METRICS}
        outcome = np.full(len(numbers), REFUSED, dtype="<U9")
        for group in self._groups(numbers):
            for indices, inputs, accumulators in self._simulate(group, progress):
                for name, values in metrics_of(inputs, accumulators).items():
                    rows[name][indices] = values[: len(indices)]
                outcome[indices] = outcomes_of(inputs, accumulators)[: len(indices)]
        return self._case_columns(numbers) | rows | {"outcome": outcome}

    def seconds_per_lane_step(self, lanes: int) -> float:
        """Measure the time of a lane-step, s, with some compiled calls of the first structure."""
        case = self._samples[0]
        first = leaves_of(case)
        batch = batch_of([first], self._batched[first.structure], lanes)
        periods = max(STEPS // case.substeps, 1)
        self.runner.run(batch, periods, case.substeps)  # compiles
        began = time.perf_counter()
        self.runner.run(batch, _CALLS * periods, case.substeps)
        return (time.perf_counter() - began) / (lanes * _CALLS * periods * case.substeps)

    def _groups(self, numbers: Sequence[int]) -> list[Group]:
        """Group the cases of a block by structure, without those that cannot run."""
        groups: dict[CaseStructure, Group] = {}
        for index, number in enumerate(numbers):
            case = self.cases.case(number)
            if isinstance(case, InputError):
                continue
            leaves = leaves_of(case)
            group = groups.setdefault(leaves.structure, Group([], [], []))
            group.indices.append(index)
            group.cases.append(case)
            group.leaves.append(leaves)
        return list(groups.values())

    def _simulate(
        self, group: Group, progress: Callable[[int], None]
    ) -> Iterator[tuple[list[int], MetricInputs, Accumulators]]:
        """Run a group in batches of similar length; yield indices, inputs and accumulators."""
        batched = self._batched.get(group.leaves[0].structure, _none(group.leaves[0]))
        periods = [periods_of(case) for case in group.cases]
        order = sorted(range(len(periods)), key=lambda index: (periods[index], index))
        devices, substeps = len(self.runner.devices), group.cases[0].substeps
        for first in range(0, len(order), LANES * devices):
            chosen = order[first : first + LANES * devices]
            leaves = [group.leaves[index] for index in chosen]
            batch = batch_of(leaves, batched, lanes_for(len(chosen), devices))
            lengths = np.array([periods[index] for index in chosen])

            def count(before: int, now: int, lengths: np.ndarray = lengths) -> None:
                done = np.minimum(lengths, now) - np.minimum(lengths, before)
                progress(int(done.sum()) * substeps)

            results = self.runner.run(batch, periods[chosen[-1]], substeps, count)
            yield [group.indices[index] for index in chosen], *results

    def _case_columns(self, numbers: Sequence[int]) -> Rows:
        """Return the columns of number, axes and rig of the cases."""
        values = [self.cases.values(number) for number in numbers]
        columns: Rows = {"case": np.array(numbers, np.int64)}
        for axis in self.cases.axes:
            kind = self.cases.kind(axis)
            columns[axis] = np.array([row[axis] for row in values], None if kind is str else kind)
        if self.cases.rigs:
            rigs = [rig_table(self.cases.rigs[draw]) for draw in columns[DRAW]]
            columns |= {
                f"eccentricities.{name}": np.array([rig[name] for rig in rigs]) for name in rigs[0]
            }
        return columns


def _block_size(samples: Sequence[Case], combinations: int) -> int:
    """Return the cases of a block: a power of two per combination, fewer where runs are long."""
    steps = float(np.mean([periods_of(case) * case.substeps for case in samples]))
    size = int(np.clip(_BLOCK_STEPS / (combinations * steps), _LEAST, _MOST))
    return combinations << (size.bit_length() - 1)


def _varying(samples: Sequence[Case]) -> dict[CaseStructure, tuple[bool, ...]]:
    """Return for each structure which numbers get a lane axis."""
    groups: dict[CaseStructure, list[CaseLeaves]] = {}
    for leaves in map(leaves_of, samples):
        groups.setdefault(leaves.structure, []).append(leaves)
    return {structure: varying(group) for structure, group in groups.items()}


def _none(case: CaseLeaves) -> tuple[bool, ...]:
    return (False,) * len(case.leaves)

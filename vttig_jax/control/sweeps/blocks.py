"""Blocks of a sweep: cases that one process runs together, and whose rows are stored together."""

import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future
from contextlib import closing
from itertools import zip_longest
from typing import NamedTuple

import numpy as np

from ...base.errors import InputError
from ..simulation.accumulators import Accumulators
from ..simulation.case import Case
from ..simulation.metrics import METRICS, MetricInputs, metrics_of, outcomes_of
from ..simulation.simulate import periods_of
from .batching import (
    LANES,
    BatchRunner,
    CaseBatch,
    batch_of,
    lanes_for,
    varying,
)
from .case_leaves import CaseLeaves, CaseStructure, leaves_of
from .cases import SweepCases
from .parallel import Follow, ParallelRuns

Rows = dict[str, np.ndarray]
"""Columns of a table: `case`, the axes, the metrics, `outcome`."""

REFUSED = "refused"
"""Outcome of a case whose values contradict each other, so that it is not simulated."""

_BLOCK_STEPS = 1 << 28
"""Largest number of lane-steps in a block; a chosen value for about ten seconds.

A lane-step is one plant step of one case. An interruption loses at most the running blocks."""

_LEAST, _MOST = 64, 4 * LANES
"""Smallest and largest number of cases of one structure in a block; chosen values."""

_MOST_KINDS = 16
"""Largest number of text combinations that is used for the block size; a chosen value."""


class _Batch(NamedTuple):
    """Batch of a group, with the indices and the numbers of periods of its cases."""

    runner: BatchRunner
    indices: list[int]
    cases: CaseBatch
    periods: np.ndarray

    def run(self, place: int, follow: Follow) -> tuple[MetricInputs, Accumulators]:
        """Run the batch on device number `place`; `follow` gets the finished lane-steps."""

        def count(before: int, now: int) -> None:
            done = np.minimum(self.periods, now) - np.minimum(self.periods, before)
            follow(int(done.sum()) * self.cases.structure.substeps)

        return self.runner.run(self.cases, int(self.periods[-1]), count, place=place)


class _Started(NamedTuple):
    """Block whose batches have started: block number, case numbers, and the runs of its batches.

    A run is the list of case indices in the block, and the future of the result.
    """

    number: int
    numbers: Sequence[int]
    runs: list[tuple[list[int], Future[tuple[MetricInputs, Accumulators]]]]


class SweepWork:
    """Blocks of a sweep, ready to run.

    **Arguments**
    - `cases`: cases of the sweep. - `runner`: runner of the batches.

    **Raises** the `InputError` of the first case if no representative case can run.
    """

    def __init__(self, cases: SweepCases, runner: BatchRunner) -> None:
        self.cases = cases
        self.runner = runner
        self.build_s = 0.0
        """Time in which cases were built and put into lanes, s."""
        samples = [cases.case(number) for number in cases.representative_cases()]
        refused = [case for case in samples if isinstance(case, InputError)]
        self._samples = [case for case in samples if not isinstance(case, InputError)]
        if not self._samples:
            raise refused[0]
        groups: dict[CaseStructure, list[CaseLeaves]] = {}
        for one in map(leaves_of, self._samples):
            groups.setdefault(one.structure, []).append(one)
        self._batched = {structure: varying(group) for structure, group in groups.items()}
        self.block_size = _block_size(self._samples, min(cases.text_combinations, _MOST_KINDS))
        """Cases in a block, independent of the number of devices so that a sweep can be resumed."""

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return -(-len(self.cases) // self.block_size)

    def run(self, number: int, progress: Callable[[int], None]) -> Rows:
        """Return the rows of a block; `progress` gets the number of further finished lane-steps.

        Lanes that are only filled with copies are not counted.
        """
        with closing(self.run_blocks([number], progress)) as blocks:
            return next(blocks)[1]

    def run_blocks(
        self, numbers: Sequence[int], progress: Callable[[int], None]
    ) -> Generator[tuple[int, Rows]]:
        """Yield number and rows of the blocks; the next block is built while a block runs."""
        with ParallelRuns(len(self.runner.devices)) as parallel:
            started = deque[_Started]()
            for number in numbers:
                started.append(self._start(number, parallel))
                if len(started) > 1:
                    yield self._finish(started.popleft(), parallel, progress)
            while started:
                yield self._finish(started.popleft(), parallel, progress)

    def _start(self, number: int, parallel: ParallelRuns) -> "_Started":
        """Build the cases of a block and start their batches."""
        began = time.perf_counter()
        first = number * self.block_size
        numbers = range(first, min(first + self.block_size, len(self.cases)))
        batches = [self._batches(group) for group in self._groups(numbers)]
        # The first batches of all groups come first, so that their programs compile side by side.
        turns = [one for turn in zip_longest(*batches) for one in turn if one is not None]
        runs = [(batch.indices, parallel.start(batch.run)) for batch in turns]
        self.build_s += time.perf_counter() - began
        return _Started(number, numbers, runs)

    def _finish(
        self, started: "_Started", parallel: ParallelRuns, progress: Callable[[int], None]
    ) -> tuple[int, Rows]:
        """Wait for the batches of a block and return its number and rows."""
        numbers = started.numbers
        rows: Rows = {name: np.full(len(numbers), np.nan) for name in METRICS}
        outcome = np.full(len(numbers), REFUSED, dtype="<U9")
        for indices, future in started.runs:
            inputs, accumulators = parallel.result(future, progress)
            for name, values in metrics_of(inputs, accumulators).items():
                rows[name][indices] = values[: len(indices)]
            outcome[indices] = outcomes_of(inputs, accumulators)[: len(indices)]
        return started.number, self._case_columns(numbers) | rows | {"outcome": outcome}

    def _groups(self, numbers: Sequence[int]) -> list[dict[int, CaseLeaves]]:
        """Return the cases of a block that can run by their index, grouped by structure."""
        groups: dict[CaseStructure, dict[int, CaseLeaves]] = {}
        for index, number in enumerate(numbers):
            leaves = self.cases.leaves(number)
            if not isinstance(leaves, InputError):
                groups.setdefault(leaves.structure, {})[index] = leaves
        return list(groups.values())

    def _batches(self, group: dict[int, CaseLeaves]) -> Iterator["_Batch"]:
        """Yield the batches of a group; the cases of a batch have runs of similar length."""
        structure = next(iter(group.values())).structure
        batched = self._batched.get(structure, (False,) * len(group[min(group)].leaves))
        order = sorted(group, key=lambda index: (group[index].periods, index))
        lanes = lanes_for(len(order), len(self.runner.devices))
        for first in range(0, len(order), lanes):
            chosen = order[first : first + lanes]
            cases = [group[index] for index in chosen]
            periods = np.array([case.periods for case in cases])
            yield _Batch(self.runner, chosen, batch_of(cases, batched, lanes), periods)

    def _case_columns(self, numbers: Sequence[int]) -> Rows:
        """Return the columns with the case number and the value of every axis."""
        values = [self.cases.values(number) for number in numbers]
        columns: Rows = {"case": np.array(numbers, np.int64)}
        for axis in self.cases.axes:
            kind = self.cases.kind(axis)
            columns[axis] = np.array([row[axis] for row in values], None if kind is str else kind)
        return columns


def _block_size(samples: Sequence[Case], combinations: int) -> int:
    """Return the number of cases in a block: `combinations` times a power of two.

    Long runs give smaller blocks.
    """
    steps = float(
        np.mean([periods_of(case.motion, case.period) * case.substeps for case in samples])
    )
    size = int(np.clip(_BLOCK_STEPS / (combinations * steps), _LEAST, _MOST))
    return combinations << (size.bit_length() - 1)

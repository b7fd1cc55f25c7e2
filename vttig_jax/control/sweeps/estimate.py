"""Size of a sweep before it starts: lane-steps, and whether memory is sufficient."""

import os
from typing import NamedTuple

from ...base.errors import InputError
from ..simulation.case import Case
from ..simulation.metrics import METRICS
from ..simulation.simulate import periods_of
from .blocks import SweepWork

_SAMPLED = 64
"""Number of cases whose run length is examined; a chosen value."""


class SweepCost(NamedTuple):
    """Numbers of cases and of lane-steps of a sweep, as they are expected."""

    cases: int
    lane_steps: float

    def __str__(self) -> str:
        return f"{self.cases} cases, {self.lane_steps:.3g} lane-steps"


def estimate(work: SweepWork) -> SweepCost:
    """Return the size of a sweep, from the lengths of some of its runs.

    **Raises** `InputError` for a sweep whose table needs more memory than there is.
    """
    cases, count = work.cases, len(work.cases)
    # The table, and a copy while it is concatenated.
    needed = 16e-9 * count * (2 + len(METRICS) + len(cases.axes))
    if hasattr(os, "sysconf"):  # not on Windows, where no sweep is refused
        available = 1e-9 * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        if needed > available:
            raise InputError(
                f"{count} cases need {needed:.3g} GB of memory, but there are {available:.3g};"
                " split an axis into several sweeps.",
                where="sweep",
            )
    numbers = sorted({count * index // _SAMPLED for index in range(_SAMPLED)})
    sampled = [case for case in map(cases.case, numbers) if isinstance(case, Case)]
    steps = [periods_of(case.motion, case.period) * case.substeps for case in sampled]
    return SweepCost(count, count / len(numbers) * sum(steps))

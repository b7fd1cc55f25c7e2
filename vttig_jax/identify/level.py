"""Back on the encoders: what was taken off the transmission error of every log, put back."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .columns import OFFSET
from .mounting import offset_name
from .solve import Solution
from .summary import HarmonicSummary


def restored(solution: Solution, levels: Sequence[float]) -> Solution:
    """The solution with the level of every log added to its offset.

    `tied` still belongs to the rows, which have no level.
    """
    values = solution.values.copy()
    for log, level in enumerate(levels):
        values[solution.names.index(offset_name(log, len(levels)))] += level
    return replace(solution, values=values)


def lifted(summary: HarmonicSummary, levels: Sequence[float]) -> HarmonicSummary:
    """The summary of the rows with the level of every log in them: for whoever reads offsets."""
    if not any(levels):
        return summary
    matrix = np.eye(summary.columns.width)
    for log, level in enumerate(levels):
        matrix[-1, summary.columns.index(OFFSET, log)] = level
    return replace(
        summary,
        flanks=tuple(flank.transformed(matrix) for flank in summary.flanks),
        plateaus=tuple(replace(p, summary=lifted(p.summary, levels)) for p in summary.plateaus),
    )

"""Compiled programs of a batch, and the few shapes that logs of unequal length share."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import equinox as eqx
import jax
import numpy as np

from .batch_model import BatchModel, BatchShape
from .fit_arrays import ArrayFit, WhiteTable, fit_tables, white_table
from .log_arrays import LogArrays, stacked
from .preparation import PreparedLog

_LAGS = (4, 8, 16)
"""Numbers of lags for which a program is compiled; the noise of a few logs counts them (chosen)."""

_MOST_LOGS, _FEW_LOGS = 64, 8
"""Logs of a call of the compiled programs: about half a second. Smaller batches take 8 (chosen)."""

_MOST_SAMPLES = 4_000_000
"""Samples of a call, which bounds its memory to some 500 MB (chosen)."""

_LARGER = 2.0
"""Factor by which a known shape may be larger than a log; a new one must be compiled (chosen)."""


class Shapes:
    """Shapes of the programs that were compiled so far."""

    def __init__(self) -> None:
        self._known: list[BatchShape] = []

    def holding(self, shape: BatchShape) -> BatchShape:
        """Return a known shape that is large enough and not much too large, or a new one."""
        fitting = [
            known
            for known in self._known
            if known.over(shape) == known
            and known.samples <= _LARGER * shape.samples
            and known.rows * known.height <= _LARGER * shape.rows * shape.height
        ]
        if not fitting:
            fitting = [shape.rounded()]
            self._known += fitting
        return min(fitting, key=lambda known: known.rows * known.height * known.runs)


def logs_at_once(samples: int, logs: int = _MOST_LOGS) -> int:
    """Return the number of logs that a call of the programs takes."""
    most = _FEW_LOGS if logs <= _FEW_LOGS else _MOST_LOGS
    return max(1, min(most, 1 << (max(1, _MOST_SAMPLES // samples).bit_length() - 1)))


@dataclass(frozen=True, eq=False)
class Call:
    """One call of the programs; its rows are computed while other logs are prepared.

    **Arguments**
    - `model`: model with the shapes of the call. - `logs`: number of logs.
    - `tables`: rows of the logs, which tell how many lags their noise needs.
    """

    model: BatchModel
    logs: int
    tables: WhiteTable

    @classmethod
    def of(
        cls, model: BatchModel, logs: Sequence[PreparedLog], shapes: Shapes, count: int
    ) -> "Call":
        """Send at most `count` logs to the first program; the others of the call are empty."""
        shape = shapes.holding(reduce(BatchShape.over, (log.shape for log in logs)))
        batch = stacked([log.arrays for log in logs], shape.samples, count)
        own = model.with_shape(shape)
        return cls(own, len(logs), _tables(own, batch))

    def result(self) -> ArrayFit:
        """Return the fits, with as many lags as the noise of these logs needs."""
        needed = int(np.asarray(self.tables.needed)[: self.logs].max())
        lags = next(lags for lags in _LAGS if lags >= needed)
        shape = self.model.shape._replace(lags=lags)
        found = _fits(self.model.with_shape(shape), self.tables)
        return jax.tree.map(lambda array: np.asarray(array)[: self.logs], found)


@eqx.filter_jit
def _tables(model: BatchModel, logs: LogArrays) -> WhiteTable:
    return jax.lax.map(lambda log: white_table(model, log), logs)


@eqx.filter_jit
def _fits(model: BatchModel, tables: WhiteTable) -> ArrayFit:
    return fit_tables(model, tables)

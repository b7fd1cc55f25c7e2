"""Calls of the compiled programs of a batch; logs of unequal length share a few array shapes."""

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
"""Numbers of noise lags for which a program is compiled; each call uses the smallest sufficient
one (chosen)."""

_SIZES = (8, 16, 64)
"""Numbers of logs in one call of a program, which takes about half a second for the largest; the
smallest that holds the waiting logs is used (chosen)."""

_MOST_SAMPLES = 4_000_000
"""Largest number of samples in one call, which limits its memory to about 500 MB (chosen)."""

_LARGER = 2.0
"""A known shape is reused if it is at most this factor larger than needed; otherwise a program for
a new shape is compiled (chosen)."""


class Shapes:
    """Collection of the array shapes for which programs have been compiled so far."""

    def __init__(self) -> None:
        self._known: list[BatchShape] = []

    def holding(self, shape: BatchShape) -> BatchShape:
        """Return a known shape that is large enough but not much too large for `shape`.

        If there is none, `shape` is rounded up, and the result is added to the known shapes.
        """
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


def logs_at_once(samples: int, logs: int = _SIZES[-1]) -> int:
    """Return how many logs one call takes: a power of two that is small enough for the memory.

    `samples` is the length of a padded log, and `logs` is the number of logs that wait.
    """
    most = next((size for size in _SIZES if size >= logs), _SIZES[-1])
    return max(1, min(most, 1 << (max(1, _MOST_SAMPLES // samples).bit_length() - 1)))


@dataclass(frozen=True, eq=False)
class Call:
    """One call of the compiled programs for several logs.

    JAX computes the block rows in the background, while Python prepares further logs.

    **Arguments**
    - `model`: model with the array sizes of the call. - `logs`: number of logs, without padding.
    - `tables`: block rows of the logs, and the number of lags that their noise needs.
    """

    model: BatchModel
    logs: int
    tables: WhiteTable

    @classmethod
    def of(
        cls, model: BatchModel, logs: Sequence[PreparedLog], shapes: Shapes, count: int
    ) -> "Call":
        """Start the first program (block rows) for `logs`, padded to `count` with empty logs.

        `shapes` are the known shapes, from which the call takes one.
        """
        shape = shapes.holding(reduce(BatchShape.over, (log.shape for log in logs)))
        batch = stacked([log.arrays for log in logs], shape.samples, count)
        own = model.with_shape(shape)
        return cls(own, len(logs), _tables(own, batch))

    def result(self) -> ArrayFit:
        """Run the second program, which fits the logs, and return the fits.

        Its number of lags is the smallest compiled one that the noise of these logs needs.
        """
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

"""Delays of the blocks of a log, and the standard error of a delay that differs between blocks.

A log is divided in time into K blocks with equally many rows. One regression, with the harmonics,
the offsets and the gap that all blocks share, estimates the delay d̂ₖ of every block and the
covariance matrix C of these estimates. Two explanations are compared: one delay d for the whole
log, and delays dₖ that scatter about d with an unknown standard deviation τ. The restricted
likelihood of the second, with V = C + τ²I, is

    ln L(τ) = −½ [ln |V| + ln 1ᵀV⁻¹1 + (d̂ − m 1)ᵀV⁻¹(d̂ − m 1)],    m(τ) = 1ᵀV⁻¹d̂ / 1ᵀV⁻¹1,

and the mean delay m has the variance 1 / 1ᵀV⁻¹1. The distribution of τ before the data has the
density ∝ 1/(s + τ) up to 10⁴ s, where s is the standard error of one block: it is flat below s, and
for τ ≫ s the interval of m becomes that of Student's distribution.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, final

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import brentq
from scipy.special import ndtr

from ...base.errors import NoAnswerError
from ..compress.block_rows import BlockRun, LogRows
from ..compress.harmonic_summary import HarmonicSummary, summarise
from ..model.column_layout import OFFSET, ColumnLayout, column_of, own_parameters
from ..model.harmonics import TermPlan
from ..noise.noise_model import autoregression
from .linear_fit import LinearFit
from .model_selection import SelectedModel
from .nuisance import NuisanceRegression, own_terms

_BLOCKS = 8  # blocks of a log (chosen); a scatter of fewer blocks is hardly known
_FEWEST_ROWS = 16  # least number of rows in a block (chosen)
_TOLD = 1e-6  # least share of the column of a block that all other columns leave (chosen)
_DELAY, _LEVEL = "delay_in_", "level_in_"  # names of the columns of a block, before its number
_FEWEST = 3  # least number of blocks whose scatter is judged (chosen)
_LIKELIER = 3.0  # how many times likelier a scatter must be than one delay (chosen)
_GRID = 400  # values of τ from 1e-3 to 1e4 standard errors of a block (chosen)


@dataclass(frozen=True, eq=False)
class DelayBlocks:
    """Corrections of the delay in the blocks of one log, s, and their covariance matrix, s².

    A correction is added to the delay that the linear fit has already removed.

    **Arguments**
    - `halves`: corrections in the first and in the second half of the rows, s, and their covariance
      matrix, s²; None if one half does not determine the delay. In this regression, each half has
      one delay and one level.
    """

    value: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    halves: tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "2 2"]] | None = None

    def wider(self, factor: float) -> "DelayBlocks":
        """Return the delays with all standard errors multiplied by `factor`."""
        halves = self.halves and (self.halves[0], self.halves[1] * factor**2)
        return replace(self, covariance=self.covariance * factor**2, halves=halves)

    @cached_property
    def _by_scatter(self) -> tuple[Float[np.ndarray, "3 n"], Float[np.ndarray, " n"]]:
        """Mean, standard error and log restricted likelihood for each τ; and the weights of τ.

        The first τ is 0, and its weight is that of one common delay.
        """
        own, vectors = np.linalg.eigh(self.covariance)
        value, ones = vectors.T @ self.value, vectors.T @ np.ones(len(own))
        scale = 1 / np.sqrt(np.mean(1 / np.diag(self.covariance)))
        grid = np.geomspace(1e-3, 1e4, _GRID)
        variance = own + np.concatenate([[0.0], (scale * grid) ** 2])[:, None]
        weight = np.sum(ones**2 / variance, axis=1)
        mean = np.sum(ones * value / variance, axis=1) / weight
        square = np.sum((value - mean[:, None] * ones) ** 2 / variance, axis=1)
        height = -0.5 * (np.sum(np.log(variance), axis=1) + np.log(weight) + square)
        prior = np.gradient(grid) / (1 + grid)
        share = np.concatenate([[1.0], prior / prior.sum()]) * np.exp(height - height.max())
        return np.stack([mean, 1 / np.sqrt(weight), height]), share / share.sum()

    @property
    def scatters(self) -> bool:
        """Whether delays that scatter are at least three times as likely as one delay.

        This needs the delays of at least three blocks.
        """
        if len(self.value) < _FEWEST:
            return False
        one = self._by_scatter[1][0]
        return bool(1 - one >= _LIKELIER * one)

    @property
    def common_std_s(self) -> float:
        """Standard error of one delay that all blocks share, s."""
        return float(self._by_scatter[0][1, 0])

    def half_width_s(self, step_s: float) -> float:
        """Return the half-width of the 95 % interval of the mean delay around `step_s`, s.

        It averages over both explanations and over τ, each weighed by its likelihood. `step_s` is
        the correction of the delay that the fit states.
        """
        (mean, std, _), share = self._by_scatter

        def outside(half: float) -> float:
            high, low = (step_s + half - mean) / std, (step_s - half - mean) / std
            return float(share @ (ndtr(low) + ndtr(-high))) - 0.05

        most = float(np.max(np.abs(mean - step_s) + 6 * std))
        root: Any = brentq(outside, 0.0, most, xtol=1e-6 * most)
        return float(root)


def blocks_of_logs(selected: SelectedModel, widening: float) -> tuple[DelayBlocks, ...]:
    """Return the delays of the blocks of every log whose rows determine them.

    `widening` is the factor by which the standard error of the delay exceeds that of the noise
    model; it holds for the blocks too.
    """
    names = own_parameters(selected.summary.columns)[0]
    linear = selected.linear
    beside = {column_of(name) for name in names}
    found = [_delay_blocks(linear, log, beside) for log in range(len(linear.rows))]
    return tuple(one.wider(widening) for one in found if one is not None)


def _delay_blocks(linear: LinearFit, log: int, beside: Collection[str]) -> DelayBlocks | None:
    """Return the delays of the blocks of one log, or None if its rows do not determine them.

    `beside` are the columns of the coefficients that are estimated beside the delays.
    """
    rows = linear.rows[log]
    times = np.sort(np.concatenate([np.zeros(0), *(run.curve.time for run in rows.runs)]))
    if len(times) < _BLOCKS * _FEWEST_ROWS:
        return None
    edges = times[np.arange(1, _BLOCKS) * len(times) // _BLOCKS]
    delays = [f"{_DELAY}{k}" for k in range(_BLOCKS)]
    levels = [f"{_LEVEL}{k}" for k in range(1, _BLOCKS)]
    try:
        summary = _divided(rows, edges, linear.model.terms)
        own = own_terms(summary, autoregression(summary))
        others = [name for name in own.names if name in beside]
        value, covariance, left = own.estimates(delays, [*others, *levels, *delays])
        halves = _of_halves(own, others)
    except (NoAnswerError, np.linalg.LinAlgError, ValueError):
        return None
    kept = np.flatnonzero(left > _TOLD)
    return DelayBlocks(value[kept], covariance[np.ix_(kept, kept)], halves)


def _of_halves(
    own: NuisanceRegression, others: list[str]
) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "2 2"]] | None:
    """Return `DelayBlocks.halves`; `others` are the columns beside delays and levels."""
    half = _BLOCKS // 2
    delays = [f"{_DELAY}{k}" for k in range(_BLOCKS)]
    both = {
        "first_half": delays[:half],
        "second_half": delays[half:],
        "level_of_second_half": [f"{_LEVEL}{k}" for k in range(half, _BLOCKS)],
    }
    names = tuple(both)
    value, covariance, left = own.merged(both).estimates(names[:2], [*others, *names])
    return (value, covariance) if np.all(left > _TOLD) else None


@final
@dataclass(frozen=True, eq=False)
class _DividedRows:
    """Rows of one run with a delay and a level of every block, in place of the common delay.

    The rows are computed when they are read, so that they are not in memory twice.

    **Arguments**
    - `rows`: rows of the run. - `columns`: layout of these rows. - `block`: block of every row.
    """

    rows: Float[np.ndarray, "n q"]
    columns: ColumnLayout
    block: Int[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, part: slice) -> Float[np.ndarray, "m wide"]:
        rows, block, columns = self.rows[part], self.block[part], self.columns
        offset, delay, stop = columns.index(OFFSET), columns.index("delay"), columns.own_slice.stop
        found = np.zeros((len(rows), columns.width + 2 * _BLOCKS - 2))
        first = stop - 2  # the level of the first block would stand here
        place = np.arange(len(rows))
        found[place, first + block] = rows[:, offset]
        found[place, first + _BLOCKS + block] = rows[:, delay]
        found[:, :delay] = rows[:, :delay]
        found[:, delay : stop - 1] = rows[:, delay + 1 : stop]
        found[:, first + 2 * _BLOCKS :] = rows[:, stop:]
        return found


def _divided(rows: LogRows, edges: Float[np.ndarray, " m"], terms: TermPlan) -> HarmonicSummary:
    """Return the summary of the rows with a delay and a level of every block; see `_DividedRows`.

    The offset of the log is the level of the first block.
    """
    columns = rows.columns
    added = [f"{_LEVEL}{k}" for k in range(1, _BLOCKS)]
    added += [f"{_DELAY}{k}" for k in range(_BLOCKS)]
    kept = tuple(name for name in columns.own[0] if name != "delay")
    layout = ColumnLayout(columns.free, columns.tied, ((*kept, *added),))

    def read(run: BlockRun) -> _DividedRows:
        block = np.searchsorted(edges, run.curve.time, side="right")
        return _DividedRows(run.rows, columns, block)

    return summarise([replace(rows, columns=layout)], terms, read=read)

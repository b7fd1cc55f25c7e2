"""Tests of the residual: correlation that the noise model misses, and lines that are no order."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.special import chdtrc

from ...base.numerics.counting import whole_below
from ...base.threads import one_blas_thread
from ...base.units import REV
from ...logs.lines.search import Line, find_lines
from ...logs.lines.search import Stretch as LineRun
from ...pair.gear_pair import Flank
from ..compress.block_means import block_means
from ..compress.block_rows import LogRows
from ..model.column_layout import OFFSET, ColumnLayout
from ..model.harmonics import SECOND_ORDER, AnyTerm, TermPlan
from ..noise.noise_model import NoiseModel
from ..preliminary.linear_fit import LinearFit
from ..solve.residuals import Weights
from .checks import ResidualLine, Whiteness

_LAGS = 20  # lags of the autocorrelation; chosen value
_HIGHEST = 12.0
"""Highest frequency of the search for lines, cycles per driving revolution."""

_ROWS_PER_CYCLE = 3.0  # fewest rows per cycle of the highest frequency; chosen value
_ROWS_KEPT = 4.0  # rows per cycle of the highest frequency in long logs; chosen value
_LEAST_ROWS = 100  # innovations for the test of whiteness; chosen value
_MOST_CELLS = 50_000  # values of the regressors in a search for lines; chosen value
_MOST_LINES = 3  # lines per search; chosen value
_FALSE_ALARM = 1e-3  # probability of a false line; chosen value


def whiteness(
    residuals: Sequence[Float[np.ndarray, " _"]],
    times: Sequence[Float[np.ndarray, " _"]],
    noises: Sequence[NoiseModel],
) -> Whiteness | None:
    """Return the autocorrelation of the whitened residual, and its Ljung–Box test.

    G. M. Ljung, G. E. P. Box, Biometrika 65 (1978) 297. A small probability means that the residual
    is more correlated than the noise model of its run allows. The result is None for too few rows.
    """
    innovations = [
        noise.whitened(residual, time)
        for residual, time, noise in zip(residuals, times, noises, strict=True)
        if len(residual) > len(noise.coefficients) + 1 + _LAGS
    ]
    count = sum(map(len, innovations))
    if count < _LEAST_ROWS:
        return None
    square = sum(float(part @ part) for part in innovations)
    if square == 0:
        return None
    correlation = np.array(
        [
            sum(float(part[lag:] @ part[:-lag]) for part in innovations) / square
            for lag in range(1, _LAGS + 1)
        ]
    )
    statistic = (
        count * (count + 2) * float(np.sum(correlation**2 / (count - np.arange(1, _LAGS + 1))))
    )
    order = max(len(noise.coefficients) for noise in noises)
    freedom = max(_LAGS - order, 1)
    return Whiteness(
        autocorrelation=tuple(correlation.tolist()),
        ljung_box=statistic,
        probability=float(chdtrc(freedom, statistic)),
    )


def explained(linear: LinearFit, kept: ColumnLayout, weights: Sequence[Weights]) -> float | None:
    """Return the share of the variance that the harmonics explain beside all other columns.

    It is 1 − S/S₀ with the sums of squares that least squares on offset, drift, delay and
    regressors leave of the residual, S, and of the transmission error, S₀. Each flank of each log
    has its offset; the other columns are those of the layout `kept`. The result is None for S₀ = 0.
    """
    squares = np.zeros(2)
    for log, (rows, own) in enumerate(zip(linear.rows, weights, strict=True)):
        place = rows.columns.index(OFFSET)
        present = rows.columns.own[0]
        cells = [rows.columns.index(n) for n in kept.own[log] if n != OFFSET and n in present]
        columns, values = [], []
        for side, (flank, runs) in enumerate(rows.by_flank().items()):
            stacked = np.concatenate(runs)
            stacked = stacked[stacked[:, place] > 0]
            offsets = np.zeros((len(stacked), 2))
            offsets[:, side] = stacked[:, place]
            columns.append(np.hstack([offsets, stacked[:, cells]]))
            values.append(np.stack([stacked @ own[flank], stacked[:, -1]], axis=1))
        if values:
            design, value = np.concatenate(columns), np.concatenate(values)
            size = np.linalg.norm(design, axis=0)
            design = design / np.where(size > 0, size, 1.0)
            solution = np.linalg.lstsq(design, value, rcond=1e-12)[0]
            squares += np.sum((value - design @ solution) ** 2, axis=0)
    return float(1 - squares[0] / squares[1]) if squares[1] > 0 else None


@one_blas_thread
def lines_left(
    rows: Sequence[LogRows], weights: Sequence[Weights], terms: TermPlan, *, same_zero: bool
) -> list[ResidualLine]:
    """Return the significant lines of the residual, in cycles per driving revolution.

    Both flanks are searched together, where `flank` is None, and then each flank alone, where it is
    "A" or "B". A missing order has a phase of its own on each flank, and the joint search does not
    find an order with opposite phases. Logs with different zeros are searched one by one, because
    the phase of a line that is no order of a shaft differs between them. `log` is then the number
    of the log from 1; it is 0 for the search in all logs together.
    """
    if same_zero or len(rows) == 1:
        return _lines(rows, weights, terms, 0)
    return [
        line
        for number, (log, own) in enumerate(zip(rows, weights, strict=True), 1)
        for line in _lines([log], [own], terms, number)
    ]


def _lines(
    rows: Sequence[LogRows], weights: Sequence[Weights], terms: TermPlan, number: int
) -> list[ResidualLine]:
    """Return the lines of logs with one zero.

    A line of a single flank is added if the search on both flanks did not find it.
    """
    logs = enumerate(zip(rows, weights, strict=True))
    runs = [run for place, (log, own) in logs for run in _runs(log, own, place)]
    flanks = sorted({flank for flank, _ in runs})
    turns = max((float(np.ptp(run.angle)) / REV for _, run in runs), default=0.0)
    fixed = [h.term for h in terms.free + terms.tied if _is_beside(h.term, terms)]
    known = [float(terms.frequency(term)) for term in fixed]
    found: list[ResidualLine] = []
    for flank in [None, *(flanks if len(flanks) == 2 else [])]:
        part = [run for own, run in runs if flank in (None, own)]
        for line in _searched(part, _FALSE_ALARM if flank is None else _FALSE_ALARM / 2):
            near = [*known, *(other.cycles_per_rev for other in found)]
            if all(abs(line.cycles_per_rev - cycles) * turns > 0.5 for cycles in near):
                found.append(ResidualLine(log=number, flank=flank, **vars(line)))
    return found


def _searched(runs: list[LineRun], false_alarm: float) -> tuple[Line, ...]:
    """Search for lines in addition to the regressors of the fit.

    A regressor is thus not reported as a line. In long logs this would cost more than the fit.
    There a constant replaces the regressors, whose contribution the residual no longer contains.
    """
    if not runs:
        return ()
    step = max(float(np.quantile(np.abs(np.diff(run.angle)), 0.9)) for run in runs)
    highest = min(_HIGHEST, REV / step / _ROWS_PER_CYCLE)
    if highest < 1:
        return ()
    if sum(run.nuisance.size for run in runs) > _MOST_CELLS:
        runs = [_short(run, highest) for run in runs]
    return find_lines(runs, highest=highest, false_alarm=false_alarm, most=_MOST_LINES)


def _is_beside(term: AnyTerm, terms: TermPlan) -> bool:
    """Return whether a harmonic is a regressor of the search for lines.

    The tied second-order terms of the exact relation are none, because they follow from the first
    orders. As regressors they would absorb a second order that the model misses.
    """
    return term not in SECOND_ORDER or term in [h.term for h in terms.free]


def _runs(log: LogRows, weights: Weights, number: int) -> list[tuple[Flank, LineRun]]:
    """Return the flank and the residual of every run of a log, with the regressors of its rows.

    Rows of weight 0 and short runs are left out. `number` is the number of the log in the group
    name.
    """
    columns = log.columns
    place = columns.index(OFFSET)
    dropped = [
        columns.cosine(len(columns.free) + k) + part
        for k, term in enumerate(columns.tied)
        if term in SECOND_ORDER
        for part in (0, 1)
    ]
    runs = []
    for run in log.runs:
        share = run.rows[:, place]
        counted = share > 0
        if counted.sum() >= _LAGS:
            rows = run.rows[counted] / share[counted, None]
            residual = rows @ weights[run.segment.flank]
            group = f"{run.segment.flank} of log {number}"
            angle = run.curve.driving_angle[counted]
            nuisance = np.delete(rows[:, :-1], dropped, axis=1)
            runs.append((run.segment.flank, LineRun(angle, residual, nuisance, group)))
    return runs


def _short(run: LineRun, highest: float) -> LineRun:
    """Return a run as block means over a quarter of the shortest cycle.

    Its only regressor is a constant.
    """
    turns = max(float(np.ptp(run.angle)) / REV, 1e-9)
    size = max(1, whole_below(len(run.angle) / turns / (_ROWS_KEPT * highest)))
    angle, value = (block_means(values, size) for values in (run.angle, run.value))
    return LineRun(angle, value, np.ones((len(angle), 1)), run.group)

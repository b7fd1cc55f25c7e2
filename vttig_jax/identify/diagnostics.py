"""What a residual still holds: memory the noise model missed, and lines no order explains."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from ..base.units import REV
from ..logs.line_search import Line, find_lines
from ..logs.line_search import Run as LineRun
from .blocks import block_means
from .columns import OFFSET
from .noise import NoiseModel
from .residual import Weights
from .rows import LogRows

_LAGS = 20
_HIGHEST = 12.0
"""Cycles per driving revolution up to which lines are looked for."""

_ROWS_PER_CYCLE = 3.0
_ROWS_KEPT = 4.0
_LEAST_ROWS = 100
_MOST_CELLS = 50_000
_MOST_LINES = 3


def whiteness(
    residuals: Sequence[Float[np.ndarray, " _"]],
    times: Sequence[Float[np.ndarray, " _"]],
    noises: Sequence[NoiseModel],
) -> dict | None:
    """Autocorrelation of the whitened residual, and the Ljung–Box test of it.

    G. M. Ljung, G. E. P. Box, Biometrika 65 (1978) 297. A small probability says that the residual
    remembers more than the noise model of its run allows for. None where there are too few rows.
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
    return {
        "autocorrelation": correlation.tolist(),
        "ljung_box": statistic,
        "probability": float(chi2.sf(statistic, freedom)),
    }


def lines_left(
    rows: Sequence[LogRows], weights: Sequence[Weights], *, same_zero: bool
) -> list[dict]:
    """Significant lines of the residual, in cycles per driving revolution.

    Logs with a zero of their own are searched one by one: the phase of a line that is no order of
    a shaft differs between them. `log` then counts them from 1; it is 0 for all logs together.
    """
    if same_zero or len(rows) == 1:
        return [{"log": 0, **vars(line)} for line in _lines(rows, weights)]
    return [
        {"log": number, **vars(line)}
        for number, pair in enumerate(zip(rows, weights, strict=True), 1)
        for line in _lines(pair[:1], pair[1:])
    ]


def _lines(rows: Sequence[LogRows], weights: Sequence[Weights]) -> tuple[Line, ...]:
    """Lines of the residual of logs with one zero.

    The regressors of the fit stand beside every trial line, so that none of them passes for one;
    in long logs, where that costs more than the fit itself, a constant stands for them: the
    residual has nothing of them left.
    """
    runs = [run for number, log in enumerate(rows) for run in _runs(log, weights[number], number)]
    if not runs:
        return ()
    step = max(float(np.quantile(np.abs(np.diff(run.angle)), 0.9)) for run in runs)
    highest = min(_HIGHEST, REV / step / _ROWS_PER_CYCLE)
    if highest < 1:
        return ()
    if sum(run.nuisance.size for run in runs) > _MOST_CELLS:
        runs = [_short(run, highest) for run in runs]
    return find_lines(runs, highest=highest, most=_MOST_LINES)


def _runs(log: LogRows, weights: Weights, number: int) -> list[LineRun]:
    """Rows of a log with what the model leaves of them; rows without weight are left out."""
    place = log.columns.index(OFFSET)
    runs = []
    for run in log.runs:
        share = run.rows[:, place]
        counted = share > 0
        if counted.sum() >= _LAGS:
            rows = run.rows[counted] / share[counted, None]
            residual = rows @ weights[run.segment.flank]
            group = f"{run.segment.flank} of log {number}"
            angle = run.curve.driving_angle[counted]
            runs.append(LineRun(angle, residual, rows[:, :-1], group))
    return runs


def _short(run: LineRun, highest: float) -> LineRun:
    """The run in block means of a quarter of the shortest cycle, beside a constant."""
    turns = max(float(np.ptp(run.angle)) / REV, 1e-9)
    size = max(1, int(len(run.angle) / turns / (_ROWS_KEPT * highest)))
    angle, value = (block_means(values, size) for values in (run.angle, run.value))
    return LineRun(angle, value, np.ones((len(angle), 1)), run.group)

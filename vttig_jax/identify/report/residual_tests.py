"""Tests of the residual of a fit: correlation that the noise model misses, and spectral lines."""

from collections.abc import Sequence
from dataclasses import astuple

import numpy as np
from jaxtyping import Float
from scipy.special import chdtrc

from ...base.numerics.counting import whole_below
from ...base.threads import one_blas_thread
from ...base.units import REV
from ...logs.lines.comb import shaft_of_multiples
from ...logs.lines.comparison import Comparison
from ...logs.lines.hidden_shaft import Multiples, hidden_shaft
from ...logs.lines.rows import highest_resolved
from ...logs.lines.search import Stretch as LineRun
from ...logs.lines.search import find_lines
from ...pair.gear_pair import Flank
from ..compress.block_means import block_means
from ..compress.block_rows import LogRows, turns_of
from ..model.column_layout import OFFSET, ColumnLayout, is_given
from ..model.harmonics import SECOND_ORDER, AnyTerm, Harmonic, TermPlan
from ..noise.noise_model import NoiseModel
from ..preliminary.linear_fit import LinearFit
from ..solve.residuals import Weights
from .checks import HiddenShaft, JoinedLine, ResidualLine, Whiteness

_LAGS = 20  # number of lags of the autocorrelation; chosen value
_HIGHEST = 12.0
"""Highest frequency of the search for lines, cycles per driving revolution."""

_ROWS_PER_CYCLE = 3.0  # fewest rows per cycle of the highest frequency; chosen value
_ROWS_PER_MULTIPLE = 2.0
"""Fewest rows per cycle of a multiple of a known line. Fewer rows suffice than for a line, because
the frequency of a multiple is known and cannot be confused with an alias."""

_ROWS_KEPT = 4.0  # rows per cycle of the highest frequency after averaging long logs; chosen value
_LEAST_ROWS = 100  # fewest innovations for the test of whiteness; chosen value
_MOST_CELLS = 50_000  # largest size (rows × regressors) of a search with regressors; chosen value
_MOST_LINES = 3  # lines per search; chosen value
_WITHIN = 3.0  # standard errors within which two frequencies are the same; chosen value
_TOLD = 0.02
"""A line is compared with the whole orders of the driven shaft if the standard error of its
frequency is below this, in cycles per driven revolution."""

_CERTAIN = 1e-6  # a hidden shaft is searched from lines with a lower false alarm rate; chosen value
_FALSE_ALARM = 1e-3  # largest false alarm probability of a reported line; chosen value


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
    """Return the share of the variance that the harmonics explain in addition to other columns.

    The share is 1 − S/S₀. Offset, drift, delay and regressors are fitted by least squares to the
    residual, which leaves the sum of squares S, and to the transmission error, which leaves S₀. A
    given flank model counts as harmonics. Each flank of each log has its own offset; the other
    columns are those of the layout `kept`. The result is None for S₀ = 0.
    """
    squares = np.zeros(2)
    for log, (rows, own) in enumerate(zip(linear.rows, weights, strict=True)):
        place = rows.columns.index(OFFSET)
        present = rows.columns.own[0]
        nuisance = [n for n in kept.own[log] if n != OFFSET and not is_given(n)]
        cells = np.array([rows.columns.index(n) for n in nuisance if n in present], np.int64)
        columns, values = [], []
        for side, (flank, runs) in enumerate(rows.runs_by_flank().items()):
            for run in runs:
                counted = np.flatnonzero(run.rows[:, place] > 0)
                offsets = np.zeros((len(counted), 2))
                offsets[:, side] = run.rows[counted, place]
                columns.append(np.hstack([offsets, run.rows[np.ix_(counted, cells)]]))
                left = run.rows @ own[flank]
                values.append(np.stack([left, run.error], axis=1)[counted])
        if values:
            design, value = np.concatenate(columns), np.concatenate(values)
            size = np.linalg.norm(design, axis=0)
            design = design / np.where(size > 0, size, 1.0)
            solution = np.linalg.lstsq(design, value, rcond=1e-12)[0]
            squares += np.sum((value - design @ solution) ** 2, axis=0)
    return float(1 - squares[0] / squares[1]) if squares[1] > 0 else None


@one_blas_thread
def lines_left(
    rows: Sequence[LogRows],
    weights: Sequence[Weights],
    terms: TermPlan,
    *,
    same_zero: bool,
    joint: Sequence[ResidualLine] | None = None,
) -> list[ResidualLine]:
    """Return the significant spectral lines of the residual.

    Both flanks are searched together (`flank` of a line is None), and then each flank alone
    (`flank` is "A" or "B"), because a missing order may have opposite phases on the flanks, so that
    the joint search does not find it. Logs with different zeros are searched one by one, because
    the phase of a line that is no order of a shaft differs between them; `log` of a line is then
    the number of the log from 1. It is 0 for a search in all logs together. `joint` is the result
    of `joint_lines` if it is already computed.
    """
    if same_zero or len(rows) == 1:
        return _lines(rows, weights, terms, 0, joint)
    return [
        line
        for number, (log, own) in enumerate(zip(rows, weights, strict=True), 1)
        for line in _lines([log], [own], terms, number)
    ]


def _lines(
    rows: Sequence[LogRows],
    weights: Sequence[Weights],
    terms: TermPlan,
    number: int,
    joint: Sequence[ResidualLine] | None = None,
) -> list[ResidualLine]:
    """Return the lines of logs whose angles have the same zero.

    First come the lines of both flanks together, then those of single flanks at other frequencies.
    Lines within half a resolution of a fitted order are left out. `number` is stored as `log`.
    """
    runs = _all_runs(rows, weights)
    flanks = sorted({flank for flank, _ in runs})
    turns = turns_of(rows)
    fixed = [h.term for h in terms.free + terms.tied if _is_beside(h.term, terms)]
    known = [float(terms.frequency(term)) for term in fixed]
    found: list[ResidualLine] = []
    for flank in [None, *(flanks if len(flanks) == 2 else [])]:
        if flank is None and joint is not None:
            lines = joint
        else:
            part = [run for own, run in runs if flank in (None, own)]
            lines = _searched(part, flank, number)
        for line in lines:
            near = [*known, *(other.cycles_per_rev for other in found)]
            if all(abs(line.cycles_per_rev - cycles) * turns > 0.5 for cycles in near):
                found.append(line)
    return found


def joint_lines(rows: Sequence[LogRows], weights: Sequence[Weights]) -> list[ResidualLine]:
    """Return the significant lines of both flanks together, including lines close to an order."""
    return _searched([run for _, run in _all_runs(rows, weights)])


def compared(
    rows: Sequence[LogRows],
    weights: Sequence[Weights],
    without: Sequence[Harmonic],
    cycles: Sequence[float],
) -> Comparison | None:
    """Prepare a comparison of several sets of lines and orders that may explain the residual.

    The compared residual is that of the fit without the harmonics `without`. `cycles` are all
    frequencies that may explain it, cycles per driving revolution. The result is None for too few
    rows.
    """
    runs = _all_runs(rows, weights, [h.term for h in without])
    highest = _highest([run for _, run in runs])
    if highest < 1:
        return None
    short = [_affordable([run for _, run in runs], highest), [flank for flank, _ in runs]]
    return Comparison.of(*short, frequencies=cycles, highest=highest)


def hidden_shafts(
    rows: Sequence[LogRows],
    weights: Sequence[Weights],
    terms: TermPlan,
    lines: Sequence[ResidualLine | JoinedLine],
) -> list[HiddenShaft]:
    """Return a list with the hidden shaft whose orders are the lines; empty if there is none.

    If the frequencies of the lines are exact enough, they determine the shaft; see `hidden_shaft`.
    Otherwise the spectrum at the multiples of a certain line is used; see `shaft_of_multiples`.
    Lines at whole orders of the driving or driven shaft do not count. The second method is not
    possible for lines that were found in single logs without a common zero.
    """
    ratio = float(terms.ratio)
    known: list[tuple[float, float]] = []
    for line in lines:
        cycles, std = line.cycles_per_rev, line.cycles_std
        beside = [*(other for other, _ in known), round(cycles)]
        if std < _TOLD * ratio:
            beside.append(round(cycles / ratio) * ratio)
        if all(abs(cycles - other) > _WITHIN * std for other in beside):
            known.append((cycles, std))
    found = hidden_shaft([cycles for cycles, _ in known], [std for _, std in known])
    found = found or _shaft_of_spectrum(rows, weights, terms, lines)
    return [] if found is None else [HiddenShaft(*astuple(found))]


def _shaft_of_spectrum(
    rows: Sequence[LogRows],
    weights: Sequence[Weights],
    terms: TermPlan,
    lines: Sequence[ResidualLine | JoinedLine],
) -> Multiples | None:
    ratio, resolution = float(terms.ratio), 1 / max(turns_of(rows), 1e-9)

    def is_order(cycles: float) -> bool:
        driven = abs(cycles - round(cycles / ratio) * ratio) < resolution < ratio
        return driven or abs(cycles - round(cycles)) < resolution

    certain = [one for one in lines if isinstance(one, JoinedLine)]
    certain += [
        one
        for one in lines
        if isinstance(one, ResidualLine) and one.flank is None and one.log == 0
        if one.false_alarm <= _CERTAIN and not is_order(one.cycles_per_rev)
    ]
    if not certain:
        return None
    bases = [one.cycles_per_rev for one in sorted(certain, key=lambda one: one.false_alarm)]
    runs = _all_runs(rows, weights, [h.term for h in terms.fractional])
    highest = _highest([run for _, run in runs], _ROWS_PER_MULTIPLE)
    short = _affordable([run for _, run in runs], highest)
    flanks = [flank for flank, _ in runs]
    sides = [
        [run for own, run in zip(flanks, short, strict=True) if own == flank]
        for flank in sorted(set(flanks))
    ]
    return shaft_of_multiples(sides, bases, highest=highest, is_order=is_order)


def _all_runs(
    rows: Sequence[LogRows], weights: Sequence[Weights], without: Sequence[AnyTerm] = ()
) -> list[tuple[Flank, LineRun]]:
    logs = enumerate(zip(rows, weights, strict=True))
    return [run for place, (log, own) in logs for run in _runs(log, own, place, without)]


def _highest(runs: Sequence[LineRun], rows_per_cycle: float = _ROWS_PER_CYCLE) -> float:
    """Return the highest frequency of a search, cycles per driving revolution; 0 without runs.

    Both 90 % of the rows and the rows that cover half of the travel have at least `rows_per_cycle`
    rows in a cycle. In a log that mostly stands still, the second limit is the lower one.
    """
    if not runs:
        return 0.0
    step = max(float(np.quantile(np.abs(np.diff(run.angle)), 0.9)) for run in runs)
    by_rows = REV / (rows_per_cycle * step) if step > 0 else np.inf
    return min(_HIGHEST, by_rows, highest_resolved(runs, rows_per_cycle))


def _searched(
    runs: list[LineRun], flank: Flank | None = None, number: int = 0
) -> list[ResidualLine]:
    """Return the significant lines of the runs; `flank` and `number` are stored in the result.

    The regressors of the fit are fitted together with each line, so that no regressor is reported
    as a line. In long logs this would take longer than the fit; a constant replaces them there.
    """
    highest = _highest(runs)
    if highest < 1:
        return []
    runs = _affordable(runs, highest)
    false_alarm = _FALSE_ALARM if flank is None else _FALSE_ALARM / 2
    lines = find_lines(runs, highest=highest, false_alarm=false_alarm, most=_MOST_LINES)
    return [ResidualLine(log=number, flank=flank, **vars(line)) for line in lines]


def _affordable(runs: list[LineRun], highest: float) -> list[LineRun]:
    if sum(run.nuisance.size for run in runs) > _MOST_CELLS:
        return [_short(run, highest) for run in runs]
    return runs


def _is_beside(term: AnyTerm, terms: TermPlan) -> bool:
    """Return whether a harmonic is a regressor in the search for lines.

    The tied second-order terms of the exact relation are no regressors, because they follow from
    the first orders. As free regressors they would absorb a second order that the model misses.
    """
    return term not in SECOND_ORDER or term in [h.term for h in terms.free]


def _runs(
    log: LogRows, weights: Weights, number: int, without: Sequence[AnyTerm] = ()
) -> list[tuple[Flank, LineRun]]:
    """Return every run of a log as its flank, its residual and the regressors of its rows.

    Rows of weight 0 and short runs are left out. `number` is the number of the log in the name of
    the group of the run. The free harmonics `without` are not subtracted from the residual and are
    no regressors.
    """
    columns = log.columns
    place = columns.index(OFFSET)
    tied = enumerate(columns.tied, len(columns.free))
    fixed = [columns.cosine(k) for k, term in tied if term in SECOND_ORDER]
    left = [columns.cosine(k) for k, term in enumerate(columns.free) if term in without]
    dropped = [cell + part for cell in (*fixed, *left) for part in (0, 1)]
    kept = np.delete(np.arange(columns.width - 1), dropped)
    weights = {flank: own.copy() for flank, own in weights.items()}
    for own in weights.values():
        own[[cell + part for cell in left for part in (0, 1)]] = 0.0
    runs = []
    for run in log.runs:
        share = run.rows[:, place]
        counted = share > 0
        if counted.sum() >= _LAGS:
            residual = (run.rows @ weights[run.segment.flank])[counted] / share[counted]
            group = f"{run.segment.flank} of log {number}"
            angle = run.curve.driving_angle[counted]
            shape = (len(residual), len(kept))
            # If the run is larger, the search uses no regressors, so they are not copied.
            nuisance = np.broadcast_to(1.0, shape)
            if nuisance.size <= _MOST_CELLS:
                nuisance = run.rows[np.ix_(counted, kept)] / share[counted, None]
            runs.append((run.segment.flank, LineRun(angle, residual, nuisance, group)))
    return runs


def _short(run: LineRun, highest: float) -> LineRun:
    """Return a run averaged over blocks of a quarter cycle of the frequency `highest`.

    The only regressor of the result is a constant.
    """
    most = min(highest_resolved([run], _ROWS_KEPT) / highest, len(run.angle))
    size = max(1, whole_below(most))
    angle, value = (block_means(values, size) for values in (run.angle, run.value))
    return LineRun(angle, value, np.ones((len(angle), 1)), run.group)

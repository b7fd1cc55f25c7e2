"""Mean gap over the driving angles that both flanks covered, and gap at the speeds of the log.

The fit assigns every part of the gap that is proportional to the speed to the delay. If the gap
depends on the speed in another way, no single gap describes the log, and the fitted delay may
contain a part of the gap. Let gₖ be the deviations from the fitted gap at the driving speeds ωₖ.
The half-width of the interval of the gap is then at least max |gₖ|. The part of the gap that is
proportional to the speed is taken as up to twice these deviations, so that the half-width of the
delay is at least 2 (max gₖ − min gₖ) / (2 i (max ωₖ − min ωₖ)), with the ratio i.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from jaxtyping import Float, Int
from scipy.special import chdtrc

from ...base.numerics.quantiles import NORMAL_95
from ...base.units import DEG, REV
from ...pair.gear_pair import Flank
from ..model.column_layout import OFFSET
from ..model.harmonics import TermPlan
from ..preliminary.linear_fit import LinearFit
from ..solve.sandwich import standard_errors
from ..solve.solved_fit import SolvedFit
from .checks import CoveredGap, GapAtSpeed, JumpComparison, Reversal
from .comparisons.backlash_readings import gap_values, mean_gap
from .comparisons.closure import WINDOW_DEG
from .estimate import Estimate
from .gap_of_delay import GapOfDelay
from .parameters import BESIDE_FREE_DELAY, LARGEST, OPEN, interval_of

_CELL = DEG
"""Driving angles are divided into cells of this width, rad. Each cell that both flanks covered
counts once (chosen)."""


_MOST_CELLS = 20_000  # cells at which a curve with fractional orders is computed; chosen value


def covered_gap(
    estimate: Estimate, of_delay: GapOfDelay | None, *, unbounded: bool = False
) -> CoveredGap:
    """Return the mean gap of the fitted curves over the driving angles that both flanks covered.

    Its standard error is the largest of these: from the noise model, from the scatter of parts of
    the log, from a fit with a random walk as drift, from a fit with two delays, from one without a
    drift that resembles the gap, from the crossings beside such a drift, and from the gaps at
    different speeds. If the correlation time of
    the noise is a notable part of a run (scatter "memory"), an estimate for this case replaces the
    first two.

    **Arguments**
    - `of_delay`: gap that a delay which is taken as zero may add.
    - `unbounded`: whether a delay of any size may look like the gap.
    """
    solved, scatter = estimate.solved, estimate.scatter
    if len(solved.summary.flanks) < 2:
        return CoveredGap(reason=_one_flank(solved.linear))
    if unbounded:
        return CoveredGap(reason=BESIDE_FREE_DELAY)
    ranges = _common_ranges(solved.linear)
    if len(ranges) == 0:
        reason = "no driving angle was covered on both flanks; drive both ways over the same angles"
        return CoveredGap(reason=reason)
    driving, times = _distinct(ranges, solved.linear.model.terms)
    mean = mean_gap(driving, solved, times)
    value = float(mean.value[0])
    own = 0.0 if scatter is None else float(standard_errors(solved, mean.functional, scatter)[0])
    std = math.sqrt(mean.variance(solved.solution.covariance)[0])
    if scatter == "memory" and estimate.frozen is not None:
        own = math.hypot(own, math.sqrt(estimate.frozen.covariance(solved, mean.functional)[0, 0]))
    std = own if scatter == "memory" else max(std, own)
    for rival in estimate.rivals:
        other = mean_gap(driving, rival, times)
        apart = math.sqrt(other.variance(rival.solution.covariance)[0])
        std = max(std, math.hypot(apart, value - float(other.value[0])))
    std = max(std, estimate.least_gap_std)
    std = math.hypot(std, max((abs(value - crossed) for crossed in estimate.crossed), default=0.0))
    found = interval_of("gap", "deg", value / DEG, std / DEG)
    if of_delay is not None:
        found = of_delay.widened(found)
    if (found.high95 or 0.0) - (found.low95 or 0.0) > 2 * LARGEST["deg"]:
        return CoveredGap(reason=OPEN)
    return CoveredGap(
        value=found.value,
        std=found.std,
        low95=found.low95,
        high95=found.high95,
        determined=True,
        covered_deg=float(np.sum(ranges[:, 1] - ranges[:, 0])) * _CELL / DEG,
    )


def _one_flank(linear: LinearFit) -> str:
    """Return why the fit has one flank only."""
    found = {flank.flank for flank in linear.summary.flanks}
    dropped = {s.flank for one in linear.inputs for s in one.segments} - found
    if not dropped:
        return "one direction: one flank alone shows no gap"
    [flank] = dropped
    return f"the strokes have too few samples on flank {flank}; log longer strokes, or faster"


def gap_of_least_drift(estimate: Estimate) -> tuple[float, float] | None:
    """Return the covered gap of the fit `least_drift`, °, and its standard error; None without it.

    The angles are those of `covered_gap`, which has to be determined.
    """
    other = estimate.least_drift
    if other is None:
        return None
    driving, times = _distinct(
        _common_ranges(estimate.solved.linear), estimate.solved.linear.model.terms
    )
    mean = mean_gap(driving, other, times)
    std = math.sqrt(mean.variance(other.solution.covariance)[0])
    return float(mean.value[0]) / DEG, std / DEG


def _common_ranges(linear: LinearFit) -> Int[np.ndarray, "k 2"]:
    """Return the ranges of driving angle that both flanks covered, as cells of 1°.

    A row contains the first cell of a range and the cell after its last. Angles count from the zero
    of the first log; logs with another zero are left out.
    """
    found: dict[Flank, list[tuple[int, int]]] = {"A": [], "B": []}
    count = len(linear.channels) if linear.model.same_zero else 1
    for channels, segments in zip(linear.channels[:count], linear.segments, strict=False):
        for segment in segments:
            angle = channels.driving[segment.start : segment.stop] / _CELL
            found[segment.flank].append((int(np.floor(angle.min())), int(np.ceil(angle.max()))))
    return on_both_flanks(found)


def on_both_flanks(found: Mapping[Flank, Sequence[tuple[int, int]]]) -> Int[np.ndarray, "k 2"]:
    """Return the ranges of cells that are covered on both flanks, without overlap.

    `found` contains for each flank its covered ranges, which may overlap. A range is the first cell
    and the cell after the last one.
    """
    ranges = np.array([r for own in found.values() for r in own], np.int64).reshape(-1, 2)
    edges = np.unique(ranges)
    on_both = np.ones(max(len(edges) - 1, 0), bool)
    for own in found.values():
        change = np.zeros(len(edges), np.int64)
        for low, high in own:
            np.add.at(change, np.searchsorted(edges, (low, high)), (1, -1))
        on_both &= np.cumsum(change)[:-1] > 0
    return np.stack([edges[:-1][on_both], edges[1:][on_both]], axis=1)


def _distinct(
    ranges: Int[np.ndarray, "k 2"], terms: TermPlan
) -> tuple[Float[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Return the centres of the cells of `ranges`, rad, and how many times each cell counts.

    Cells that are one hunting period apart have the same gap and are computed once. This does not
    hold with fractional orders. If there are then more than `_MOST_CELLS` cells, only every k-th
    cell is used; k has no common divisor with the number of cells per turn, so that all angles
    count equally.
    """
    turn = round(REV / _CELL)
    period = terms.ratio.denominator * turn
    if not terms.fractional and np.ptp(ranges) >= period:
        times = np.zeros(period, np.int64)
        for low, high in ranges.tolist():
            whole, rest = divmod(high - low, period)
            times += whole
            times[(low + np.arange(rest)) % period] += 1
        cells = np.flatnonzero(times)
        return (cells + 0.5) * _CELL, times[cells]
    step = -(-int(np.sum(ranges[:, 1] - ranges[:, 0])) // _MOST_CELLS)
    while math.gcd(step, turn) > 1:
        step += 1
    first = int(ranges.min())
    parts = [np.arange(low + (first - low) % step, high, step) for low, high in ranges.tolist()]
    cells = np.concatenate(parts)
    return (cells + 0.5) * _CELL, np.ones(len(cells), np.int64)


_NARROW = 0.02  # added to the standard error of the jumps, as a share of the gap; chosen value
_MEDIAN = math.sqrt(math.pi / 2)  # standard error of the median / of the mean, for normal values


def compared_jumps(
    jumps: Sequence[Reversal], solved: SolvedFit, gap: CoveredGap
) -> JumpComparison | None:
    """Compare the jumps at the reversals with the fitted gap at the same driving angles.

    The standard error of a jump is the larger one of two: from the residual in windows of the same
    width, and from the scatter of the jumps. The standard error of the fitted gap includes the
    bound of a delay that the log does not determine. Jumps where the teeth may still cross the gap
    are left out, and so are logs with another zero. The result is None if no jump is left.
    """
    same_zero = solved.linear.model.same_zero
    own = [j for j in jumps if not j.crossing and (same_zero or j.log == 1)]
    if not gap.determined or not own:
        return None
    window = np.linspace(-0.5, 0.5, 11) * WINDOW_DEG
    places = np.add.outer([jump.driving_deg for jump in own], window) * DEG
    fitted = gap_values(places.ravel(), solved).reshape(places.shape).mean(axis=1) / DEG
    all_there = mean_gap(places.ravel(), solved)
    fitted_std = math.sqrt(all_there.variance(solved.solution.covariance)[0]) / DEG
    off = np.array([jump.jump_deg for jump in own]) - fitted
    single = math.sqrt(2) * _window_std(solved) / DEG
    if len(off) > 1:
        single = max(single, float(np.std(off, ddof=1)))
    if len(off) > 2:
        single *= _MEDIAN
    middle = float(np.median(fitted))
    return JumpComparison(
        count=len(own),
        median_deg=middle + float(np.median(off)),
        std_deg=math.hypot(single / math.sqrt(len(off)), _NARROW * middle),
        fitted_deg=middle,
        fitted_std_deg=max(fitted_std, gap.std or 0.0),
    )


def _window_std(solved: SolvedFit) -> float:
    """Return the rms, rad, of the means of the residual in windows of the width `WINDOW_DEG`."""
    means = []
    for curve, residual in zip(*solved.curves_and_residuals, strict=True):
        window = np.floor(curve.driving_angle / (WINDOW_DEG * DEG)).astype(np.int64)
        _, place, count = np.unique(window, return_inverse=True, return_counts=True)
        means.append(np.bincount(place, residual) / count)
    return float(np.sqrt(np.mean(np.concatenate(means) ** 2)))


_BINS = 8  # largest number of speeds at which the gap is computed; chosen value
_APART = 1.15  # smallest ratio of neighbouring speeds; chosen value
_LEAST_PIECES = 4  # fewest pieces of a flank at one speed; chosen value
_PIECE_ROWS = 10  # fewest rows of a piece; chosen value
_UNLIKELY = 1e-5  # the gap depends on the speed if the p-value of equal gaps is lower; chosen value


class _SpeedRows(NamedTuple):
    """Rows of all runs, with one value per row.

    **Arguments**
    - `speed`: driving speed, rad/s. - `residual`: residual of the fit, rad.
    - `flank`: 1 for A, −1 for B.
    - `piece`: number of the piece of a run to which the row belongs. Pieces are longer than the
      correlation of the noise.
    - `late`: columns of a delay that changes steadily: for each log its speed of the driven shaft,
      rad/s, times the time, scaled to −1 … 1; zero in all other logs.
    """

    speed: Float[np.ndarray, " n"]
    residual: Float[np.ndarray, " n"]
    flank: Int[np.ndarray, " n"]
    piece: Int[np.ndarray, " n"]
    late: Float[np.ndarray, "n logs"]


def gap_deviations(solved: SolvedFit) -> tuple[GapAtSpeed, ...]:
    """Return the gap at several driving speeds minus the gap of the fit.

    One regression of the residuals gives the mean of each flank at each speed, and the change of
    the delay within each log, which would otherwise look like a gap that depends on the speed if
    the log is fast in one part and slow in another. The gap is the mean of flank B minus the mean
    of flank A. Standard errors are from the sums over pieces of runs (sandwich). The result is
    empty if there is one speed only.
    """
    rows = _speed_rows(solved)
    if rows is None:
        return ()
    edges = np.quantile(rows.speed, np.linspace(0, 1, _BINS + 1))
    place = np.clip(np.searchsorted(edges, rows.speed, side="right") - 1, 0, _BINS - 1)
    speeds: list[float] = []
    kept = np.full(_BINS, -1)
    for number in range(_BINS):
        inside = place == number
        usual = float(np.mean(rows.speed[inside])) * 60 / REV if inside.any() else 0.0
        pieces = [np.unique(rows.piece[inside & (rows.flank == side)]) for side in (1, -1)]
        if min(map(len, pieces)) >= _LEAST_PIECES and usual >= _APART * (speeds or [0.0])[-1]:
            kept[number] = len(speeds)
            speeds.append(usual)
    if len(speeds) < 2:
        return ()
    place = kept[place]
    used = _SpeedRows(*(values[place >= 0] for values in rows))
    means, covariance = _flank_means(used, place[place >= 0], len(speeds))
    step = np.hstack([-np.eye(len(speeds)), np.eye(len(speeds))])
    values, stds = step @ means, np.sqrt(np.diag(step @ covariance @ step.T))
    return tuple(
        GapAtSpeed(speed_rpm=speed, value=float(value) / DEG, std=float(std) / DEG)
        for speed, value, std in zip(speeds, values, stds, strict=True)
    )


def _speed_rows(solved: SolvedFit) -> _SpeedRows | None:
    """Return the rows of all runs on the fitted flanks, or None without such a run."""
    number, found = 0, []
    logs = len(solved.linear.rows)
    for log, (rows, own) in enumerate(zip(solved.linear.rows, solved.weights, strict=True)):
        share_place = rows.columns.index(OFFSET)
        rows_correlated = solved.noise.correlation_s / max(rows.block_s, 1e-300)
        size = max(_PIECE_ROWS, math.ceil(3 * rows_correlated))
        times = [run.curve.time for run in rows.runs]
        first = min((float(time[0]) for time in times), default=0.0)
        length = max((float(time[-1]) for time in times), default=0.0) - first
        for run in rows.runs:
            share = run.rows[:, share_place]
            counted = share > 0
            if counted.sum() < 2 or run.segment.flank not in own:
                continue
            residual = (run.rows[counted] @ own[run.segment.flank]) / share[counted]
            angle, time = run.curve.driving_angle[counted], run.curve.time[counted]
            piece = number + np.arange(len(angle)) // size
            number = int(piece[-1]) + 1
            side = np.full(len(angle), 1 if run.segment.flank == "A" else -1)
            speed, late = np.gradient(angle, time), np.zeros((len(angle), logs))
            late[:, log] = speed * (2 * (time - first) / max(length, 1e-300) - 1)
            found.append(_SpeedRows(np.abs(speed), residual, side, piece, late))
    if not found:
        return None
    return _SpeedRows(*map(np.concatenate, zip(*found, strict=True)))


def _flank_means(
    rows: _SpeedRows, place: Int[np.ndarray, " n"], count: int
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m m"]]:
    """Return the means of the residual at `count` speeds, flank A first, and their covariance.

    `place` is the index of the speed of every row. The covariance is that of independent pieces.
    """
    column = np.where(rows.flank == 1, place, count + place)
    own = np.zeros((len(place), 2 * count))
    own[np.arange(len(place)), column] = 1.0
    scale = np.sqrt(np.mean(rows.late**2, axis=0))
    design = np.hstack([own, rows.late / np.where(scale > 0, scale, 1.0)])
    solution = np.linalg.lstsq(design, rows.residual, rcond=1e-9)[0]
    left = rows.residual - design @ solution
    _, piece = np.unique(rows.piece, return_inverse=True)
    sums = np.stack([np.bincount(piece, left * values) for values in design.T], axis=1)
    pieces = np.count_nonzero(sums, axis=0)
    sums *= np.sqrt(pieces / np.maximum(pieces - 1, 1))
    inverse = np.linalg.pinv(design.T @ design, rcond=1e-9, hermitian=True)
    covariance = inverse @ (sums.T @ sums) @ inverse
    return solution[: 2 * count], covariance[: 2 * count, : 2 * count]


def depends_on_speed(gaps: Sequence[GapAtSpeed]) -> bool:
    """Return whether the gap depends on the speed in another way than a delay explains.

    A delay explains a part that is linear in the speed. A straight line is fitted to the gaps over
    the speed, and a χ² test is made of the remaining differences.
    """
    if len(gaps) < 3:
        return False
    speed, value, std = np.array([(g.speed_rpm, g.value, g.std) for g in gaps]).T
    design = np.stack([np.ones_like(speed), speed], axis=1) / std[:, None]
    solution = np.linalg.lstsq(design, value / std, rcond=None)[0]
    misfit = float(np.sum((value / std - design @ solution) ** 2))
    return bool(chdtrc(len(gaps) - 2, misfit) < _UNLIKELY)


def shifted(gaps: Sequence[GapAtSpeed], gap_deg: float) -> tuple[GapAtSpeed, ...]:
    """Return the gap at each speed: `gap_deg` plus the deviation in `gaps`."""
    return tuple(msgspec.structs.replace(one, value=gap_deg + one.value) for one in gaps)


_LINEAR_PART = 2.0
"""Largest part of the gap that is proportional to the speed, in units of the remaining part. The
value is that of a gap that stops growing within the speeds of the log (chosen value)."""


def least_stds(deviations: Sequence[GapAtSpeed], ratio: float) -> dict[str, float]:
    """Return lower bounds of the standard errors of gap (rad) and delay (s).

    They are needed if the gap depends on the speed, because no single gap then describes the log;
    otherwise the result is empty. The keys are parameter names, and `ratio` is i.
    """
    if not depends_on_speed(deviations):
        return {}
    value = np.array([one.value for one in deviations]) * DEG
    speed = np.array([one.speed_rpm for one in deviations]) * REV / 60
    delay = _LINEAR_PART * float(np.ptp(value)) / (2 * abs(ratio) * float(np.ptp(speed)))
    return {
        "constant_backlash": float(np.abs(value).max()) / NORMAL_95,
        "delay": delay / NORMAL_95,
    }

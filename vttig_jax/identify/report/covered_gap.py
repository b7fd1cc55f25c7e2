"""Mean gap over the driving angles that both flanks covered, and gap at the speeds of the log.

The fit assigns every part of the gap that is proportional to the speed to the delay. If the gap
depends on the speed in another way, no single gap describes the log, and the fitted delay may
contain a part of the gap. Let gₖ be the deviations from the fitted gap at the driving speeds ωₖ.
The half-width of the interval of the gap is then at least max |gₖ|. The part of the gap that is
proportional to the speed is taken as up to twice these deviations, so that the half-width of the
delay is at least 2 (max gₖ − min gₖ) / (2 i (max ωₖ − min ωₖ)), with the ratio i.
"""

import math
from collections.abc import Iterator, Mapping, Sequence

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
from .backlash_readings import mean_gap
from .checks import CoveredGap, GapAtSpeed, JumpComparison, Reversal
from .closure import WINDOW_DEG
from .estimate import Estimate
from .parameters import LARGEST, OPEN

_CELL = DEG
"""Driving angles are divided into cells of this width, rad. Each cell that both flanks covered
counts once (chosen)."""


_MOST_CELLS = 20_000  # cells at which a curve with fractional orders is computed; chosen value


def covered_gap(estimate: Estimate, margin: float) -> CoveredGap:
    """Return the mean gap of the fitted curves over the driving angles that both flanks covered.

    Its standard error is the largest of these: from the noise model, from the scatter of parts of
    the log, from a fit with a random walk as drift, from a fit with two delays, and from the gaps
    at different speeds. If the correlation time of the noise is a notable part of a run (scatter
    "memory"), an estimate for this case replaces the first two.

    **Arguments**
    - `margin`: largest gap, rad, that an unknown delay within its bound can imitate; 0 for a delay
      that is known or fitted.
    """
    solved, scatter = estimate.solved, estimate.scatter
    if len(solved.summary.flanks) < 2:
        return CoveredGap(reason="one direction: one flank alone shows no gap")
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
    half = math.hypot(NORMAL_95 * std, margin)
    if half / DEG > LARGEST["deg"]:
        return CoveredGap(reason=OPEN)
    low, high = value - half, value + half
    if margin and high > 0:
        low, value = max(low, 0.0), max(value, 0.0)
    return CoveredGap(
        value=value / DEG,
        std=math.hypot(std, margin / math.sqrt(3)) / DEG,
        low95=low / DEG,
        high95=high / DEG,
        determined=True,
        covered_deg=float(np.sum(ranges[:, 1] - ranges[:, 0])) * _CELL / DEG,
    )


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
    fitted = [float(mean_gap(place, solved).value[0]) / DEG for place in places]
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


def gap_deviations(solved: SolvedFit) -> tuple[GapAtSpeed, ...]:
    """Return the gap at several driving speeds minus the gap of the fit.

    At each speed it is the mean residual of flank B minus the mean residual of flank A. The runs
    are divided into pieces that are longer than the correlation of the noise; the scatter of the
    means of these pieces gives the standard error. The result is empty if there is one speed only.
    """
    rows = list(_pieces(solved))
    if not rows:
        return ()
    speed, value, flank, piece = (np.concatenate(part) for part in zip(*rows, strict=True))
    edges = np.quantile(speed, np.linspace(0, 1, _BINS + 1))
    place = np.clip(np.searchsorted(edges, speed, side="right") - 1, 0, _BINS - 1)
    found: list[GapAtSpeed] = []
    for number in range(_BINS):
        inside = place == number
        parts = [
            _mean_of_pieces(value[inside & (flank == side)], piece[inside & (flank == side)])
            for side in (1, -1)
        ]
        usual = float(np.mean(speed[inside])) * 60 / REV if inside.any() else 0.0
        last = found[-1].speed_rpm if found else 0.0
        if None in parts or usual < _APART * last:
            continue
        (high, high_std), (low, low_std) = (part for part in parts if part is not None)
        found.append(
            GapAtSpeed(
                speed_rpm=usual,
                value=(low - high) / DEG,
                std=math.hypot(high_std, low_std) / DEG,
            )
        )
    return tuple(found) if len(found) > 1 else ()


def _pieces(solved: SolvedFit) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield four arrays for every run, with one value per row of the run.

    They are the driving speed (rad/s), the residual (rad), the flank (1 for A, −1 for B) and the
    number of the piece to which the row belongs.
    """
    number = 0
    for rows, own in zip(solved.linear.rows, solved.weights, strict=True):
        share_place = rows.columns.index(OFFSET)
        rows_correlated = solved.noise.correlation_s / max(rows.block_s, 1e-300)
        size = max(_PIECE_ROWS, math.ceil(3 * rows_correlated))
        for run in rows.runs:
            share = run.rows[:, share_place]
            counted = share > 0
            if counted.sum() < 2 or run.segment.flank not in own:
                continue
            residual = (run.rows[counted] @ own[run.segment.flank]) / share[counted]
            angle, time = run.curve.driving_angle[counted], run.curve.time[counted]
            pieces = number + np.arange(len(angle)) // size
            number = int(pieces[-1]) + 1
            side = np.full(len(angle), 1 if run.segment.flank == "A" else -1)
            yield np.abs(np.gradient(angle, time)), residual, side, pieces


def _mean_of_pieces(
    value: Float[np.ndarray, " n"], piece: Int[np.ndarray, " n"]
) -> tuple[float, float] | None:
    """Return the mean of `value`, and its standard error from the scatter between pieces.

    `piece` is the number of the piece of each value. The result is None for too few pieces.
    """
    _, index, count = np.unique(piece, return_inverse=True, return_counts=True)
    if len(count) < _LEAST_PIECES:
        return None
    mean = float(value.mean())
    off = np.bincount(index, value - mean)
    return mean, math.sqrt(float(off @ off) * len(count) / (len(count) - 1)) / len(value)


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

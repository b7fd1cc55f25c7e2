"""Does the compensation of an axis work: what its log shows, beside what a table should leave.

An axis that is told to stand at p shows left(p) = c(p) + E(p + c(p)) (`correction`). Each fault
changes this curve: −c for a reversed sign, 0 for nothing loaded, the other direction's c, E of
another turn or of a zero that is shifted, and a c that follows its table at a limited speed. With
the rows y of the log, whose noise has the covariance κ² Σ that the fit of this log found,

    −2 ln L = rᵀ (Σ + D Dᵀ + ε² X Xᵀ)⁻¹ r / κ² + ln |…|,    r = y − left,

where the columns of D are what the run leaves open about its curves (its draws) and the unknown
zeros of both encoders, and X are the orders of the fit, together as large as the table. No axis is
quite its model, so each curve has the share ε ≤ 0.1 of the table that makes it likeliest, and pays
for it in the determinant. With ε = 1 and left = 0 the curve is any other table: a fault that
explains less than this one is not told. All curves share D: a fault turns phases, not sizes.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from ...base.units import DEG, REV
from ...model.rows import Rows
from .correction import DIRECTIONS, AxisError, CorrectionTable

FAULTS = {
    "nothing_loaded": "nothing is loaded: the axis shows its whole error",
    "sign_reversed": "the sign is reversed, which doubles the error",
    "directions_exchanged": "the columns of the two directions are exchanged",
    "another_turn": "the table is that of another turn: the axis is {:.0f} turns further",
    "zero_shifted": "the zero of the axis is shifted by {:.4g}°; export again with"
    " --axis-zero-deg {zero_deg:.4f}",
    "rate_limited": "the correction follows its table at {:.3g}°/s at most",
    "changed": "the table is the right one, but the axis has changed since its log; record again",
    "unexplained": "no known fault explains what is left; is this the table of these options?",
}
"""Slug → sentence on what is wrong."""

_CLEAR = 6.9
"""Log likelihood ratio from which on one curve excludes another: 1 : 1000."""

_SHARES = np.append(0.0, np.geomspace(0.001, 0.1, 5))
"""Shares ε of the table that a curve may miss (chosen): a tenth may be another load or warmth."""

_SEARCHED = 5.0
"""What a curve that is searched for among many pays in log likelihood (chosen)."""

_TRIES, _THIN = 720, 256
"""Shifts of a turn that are tried, and rows at which they are (chosen)."""

_LIMITS = np.geomspace(0.03, 0.9, 16)
"""Speed limits that are tried, in parts of the largest speed that the table asks for (chosen)."""


@dataclass(frozen=True)
class AxisRows:
    """Rows of a log of an axis against its command.

    **Arguments**
    - `rows`: the rows, in runs. - `time`, `command`: of all samples of the log, s and rad.
    - `picked`: some samples of each row, at which curves are averaged.
    - `flank`: flank that carries. - `left`: actual less commanded position, rad, but for constants.
    - `taps`: filter that makes the noise of a run white, with variance 1.
    - `open`: D, what is not known of the curves beside noise, rad. - `series`: orders of the fit of
      this log, of any size.
    """

    rows: Rows
    time: Float[np.ndarray, " m"]
    command: Float[np.ndarray, " m"]
    picked: Int[np.ndarray, "n k"]
    flank: np.ndarray
    left: Float[np.ndarray, " n"]
    taps: Float[np.ndarray, " taps"]
    open: Float[np.ndarray, "n d"]
    series: Float[np.ndarray, "n p"]

    def white(self, values: np.ndarray) -> np.ndarray:
        """Return values of the rows filtered so that their noise is white, with variance 1."""
        runs = np.split(values, self.rows.first[1:])
        parts = (lfilter(self.taps, 1.0, run, axis=0) for run in runs)
        return np.concatenate([part[len(self.taps) - 1 :] for part in parts])


class Verdict(NamedTuple):
    """Curves that the log does not exclude, the likeliest first, and what they say.

    **Arguments**
    - `names`: "right" and slugs of `FAULTS`. - `value`: shift, °, turns or speed, °/s, of the
      first one. - `log_ratio`: log likelihood of the first one over that of the right table.
    """

    names: tuple[str, ...]
    value: float | None
    log_ratio: float


def judged(error: AxisError, table: CorrectionTable, rows: AxisRows, turns: int) -> Verdict:
    """Return which curves the rows of a log do not exclude.

    **Arguments**
    - `error`: E of the run. - `table`: what the control should add. - `turns`: turns of the axis
      after which E repeats.
    """
    whole = np.std(list(table.values.values()), axis=1).max() * np.sqrt(len(rows.series))
    series = rows.series * whole / np.linalg.norm(rows.series)
    design = rows.white(np.column_stack([rows.open, series]))
    gram, solvers, paid = design.T @ design, [], []
    for share in (*_SHARES, 1.0):
        size = np.repeat([1.0, share], [rows.open.shape[1], series.shape[1]])
        inner = np.eye(len(gram)) + gram * np.outer(size, size)
        solvers.append((size, cho_factor(inner)))
        paid.append(np.linalg.slogdet(inner)[1])

    def misfits(left: np.ndarray | float) -> np.ndarray:
        """Return rᵀ (Σ + D Dᵀ + ε² X Xᵀ)⁻¹ r for every share ε."""
        white = rows.white(rows.left - left)
        inside = design.T @ white
        open_ = [(size * inside) @ cho_solve(factor, size * inside) for size, factor in solvers]
        return white @ white - np.array(open_)

    *_, free = misfits(0.0)
    noise = max(free / len(design), 1.0)

    def misfit(left: np.ndarray) -> float:
        return float(np.min((misfits(left) / noise + paid)[:-1]))

    found = {one[0]: one[1:] for one in _curves(error, table, rows, turns, misfit)}
    found["unexplained"] = (free / noise + paid[-1], None, 0.0)
    score = {name: -0.5 * size - searched for name, (size, _, searched) in found.items()}
    names = sorted(score, key=lambda name: -score[name])
    names = [name for name in names if score[name] > score[names[0]] - _CLEAR]
    if "right" in names:  # a small shift or a high limit is no fault
        names = ["right", *(n for n in names if n not in ("right", "zero_shifted", "rate_limited"))]
    return Verdict(tuple(names), found[names[0]][1], score[names[0]] - score["right"])


def _curves(
    error: AxisError,
    table: CorrectionTable,
    rows: AxisRows,
    turns: int,
    misfit: Callable[[np.ndarray], float],
) -> Iterator[tuple[str, float, float | None, float]]:
    """Yield the name of each curve, its misfit, its value, and what it pays for being searched."""
    step = np.sign(np.diff(rows.command, prepend=rows.command[:1]))
    step[0] = step[np.argmax(step != 0)]  # before its first motion it came as it goes
    ahead = step[np.maximum.accumulate(np.where(step != 0, np.arange(len(step)), 0))] > 0
    held = [table.values.get(n, next(iter(table.values.values()))) for n in DIRECTIONS]
    both = [np.interp(rows.command, table.positions, one) for one in held]
    target, position = np.where(ahead, *both), rows.command[rows.picked]
    added, other = target[rows.picked], np.where(ahead, *both[::-1])[rows.picked]
    thin = slice(None, None, -(-len(added) // _THIN))

    def shown(position: np.ndarray, added: np.ndarray, turn: int, part: slice) -> np.ndarray:
        found = np.empty_like(position)
        for flank in error.errors:
            own = rows.flank[part] == flank
            where = (position + added)[own]
            found[own] = error.at(flank, where.ravel(), turn).reshape(where.shape)
        return found + added

    def left(added: np.ndarray, shift: float = 0.0, turn: int | None = None) -> np.ndarray:
        turn = here if turn is None else turn
        return shown(position - shift, added, turn, slice(None)).mean(axis=1)

    size, here = min((misfit(left(added, turn=turn)), turn) for turn in error.turns)
    yield "right", size, None, 0.0
    yield "nothing_loaded", misfit(left(0 * added)), None, 0.0
    yield "sign_reversed", misfit(left(-added)), None, 0.0
    if len(table.values) > 1:
        yield "directions_exchanged", misfit(left(other)), None, 0.0
    if len(error.turns) == 1 < turns:
        size, turn = min((misfit(left(added, turn=turn)), turn) for turn in range(1, turns))
        yield "another_turn", size, float(turn), float(np.log(turns))
    shifts = np.linspace(-REV / 2, REV / 2, _TRIES, endpoint=False)
    middle, mean = (one[thin].mean(axis=1, keepdims=True) for one in (position, added))
    moved = shown(middle - shifts, mean, here, thin)
    near = shifts[np.argmin(np.var(rows.left[thin, None] - moved, axis=0))]
    ends = near + np.array([-4, 4]) * REV / _TRIES
    found: Any = minimize_scalar(lambda x: misfit(left(added, x)), bounds=ends, method="bounded")
    yield "zero_shifted", float(found.fun), float(found.x) / DEG, _SEARCHED
    steps = np.diff(rows.time)  # the correction jumps at the few samples at which the axis turns
    fastest = np.quantile(np.abs(np.diff(target)), 0.98) / np.median(steps)
    limits, near = fastest * _LIMITS, _LIMITS[1] / _LIMITS[0]
    for last in (False, False, True):  # each round tries limits eight times as close
        slewed = np.repeat(target[:, None], len(limits), axis=1)
        for k, most in enumerate(np.multiply.outer(steps, limits), 1):
            slewed[k] = slewed[k - 1] + np.clip(target[k] - slewed[k - 1], -most, most)
        sizes = [misfit(left(one[rows.picked])) for one in slewed.T]
        limit = limits[np.argmin(sizes)]
        limits, near = limit * np.geomspace(1 / near, near, len(limits)), near ** (1 / 8)
        if last:
            yield "rate_limited", min(sizes), float(limit) / DEG, _SEARCHED


def size_of(
    mean: Float[np.ndarray, " n"], covariance: Float[np.ndarray, "n n"]
) -> Float[np.ndarray, "3"]:
    """Return the rms of a curve that noise blurs, and the ends of its 95 % interval.

    The mean square of the estimate is larger by the mean variance, which is taken off; its own
    variance is 2 tr V²/n² + 4 mᵀ V m/n².
    """
    square = mean @ mean - np.trace(covariance)
    spread = 1.96 * np.sqrt(2 * np.sum(covariance**2) + 4 * mean @ covariance @ mean)
    return np.sqrt(np.maximum([square, square - spread, square + spread], 0.0) / len(mean))

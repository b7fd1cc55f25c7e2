"""Small problems with known rows, and their density from dense covariance matrices."""

from dataclasses import dataclass

import mpmath
import numpy as np

from vttig_jax.model import (
    DELAY,
    FLAT,
    GROUPS,
    KNOWN,
    LAGS,
    Column,
    Problem,
    RowName,
    Rows,
    embedding,
    problem_of,
)
from vttig_jax.pair.schema import Flank

USUAL = dict(zip(GROUPS, (0.7, 0.5, 0.4, 0.3, 0.2, 0.1), strict=True))


@dataclass(frozen=True)
class Small:
    """Rows of some logs, the columns of their model and where these are linearised."""

    columns: tuple[Column, ...]
    logs: tuple[Rows, ...]
    centres: dict
    usual: dict

    @property
    def problem(self) -> Problem:
        return problem_of(self.columns, self.logs, None, centres=self.centres, usual=self.usual)


def rows_with(
    names: list[RowName], table: np.ndarray, lengths: list[int], flanks: list[Flank]
) -> Rows:
    """Rows of runs of these lengths on these flanks."""
    last = np.cumsum(lengths) - 1
    count = len(table)
    return Rows(
        names={name: place for place, name in enumerate([*names, RowName("y")])},
        table=table,
        first=last - np.array(lengths) + 1,
        last=last,
        flanks=tuple(flanks),
        samples=np.arange(count)[:, None],
        speed=np.ones(count),
        angle=np.arange(count) * 0.1,
        time=np.arange(count) * 1.0,
    )


def drawn(seed: int, lengths=((14, 11), (12, 17)), noise: float = 0.3) -> Small:
    """Logs with an offset each, a gap, a delay with moving parts, orders of both shafts, a walk.

    Names are those of the model where its names matter: offset, gap and delay.
    """
    rng = np.random.default_rng(seed)
    one, delay, a, b, c = (RowName(kind) for kind in ("one", "delay", "a", "b", "c"))
    parts, drift = [RowName("part", 0), RowName("part", 1)], RowName("drift", 0)
    names = [one, delay, a, b, c, *parts, drift]
    columns = [Column(one, (log,)) for log in range(len(lengths))]
    columns += [
        Column(one, differs=True),
        Column(delay, prior=KNOWN, width=0.8),
        Column(a, prior=KNOWN, width=1.5),
        Column(b, prior="driving"),
        Column(c, prior="driven", width=0.5),
        Column(b, differs=True, prior="difference"),
        Column(c, differs=True, prior="difference"),
    ]
    for log in range(len(lengths)):
        columns += [Column(part, (log,), prior="delay_parts") for part in parts]
        columns.append(Column(drift, (log,), prior="drift", width=0.4))
    logs = []
    for runs in lengths:
        count = sum(runs)
        table = rng.normal(size=(count, len(names) + 1))
        table[:, 0] = 1.0
        table[:, 5] = table[:, 1] * np.linspace(1, 0, count)
        table[:, 6] = table[:, 1] - table[:, 5]
        table[:, 7] = np.linspace(0, 1, count)
        flanks: list[Flank] = ["A" if k % 2 == 0 else "B" for k in range(len(runs))]
        slow = np.convolve(rng.normal(size=count + 5), np.ones(6) / 6, "valid")
        table[:, -1] = 3 + table[:, 2] - 0.4 * table[:, 1] + noise * (slow + rng.normal(size=count))
        table[:, -1] -= 0.6 * np.repeat([1 if flank == "A" else -1 for flank in flanks], runs)
        logs.append(rows_with(names, table, list(runs), flanks))
    return Small(tuple(columns), tuple(logs), {DELAY: 0.25}, USUAL)


def theta_near(seed: int, problem: Problem, far: float = 0.7) -> np.ndarray:
    """A random θ around usual scales."""
    rng = np.random.default_rng([7, seed])
    usual = np.log(np.asarray(problem.compressed.usual))
    return np.concatenate([[0.8], np.zeros(LAGS - 1), [-0.5], usual]) + far * rng.normal(
        size=LAGS + 1 + len(GROUPS)
    )


def whole(small: Small) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All rows: model columns, readings, and the number of the run of every row."""
    tables, runs = [], []
    for number, rows in enumerate(small.logs):
        for first, last, flank in zip(rows.first, rows.last, rows.flanks, strict=True):
            link = embedding(small.columns, rows.names, number, flank)
            tables.append(rows.table[first : last + 1] @ link)
            runs.append(np.full(last - first + 1, len(runs)))
    table = np.concatenate(tables)
    return table[:, :-1], table[:, -1], np.concatenate(runs)


def autocovariance(partial: np.ndarray, sigma: float, count: int) -> np.ndarray:
    """Autocovariance of an autoregression at the lags 0 … count − 1, in 50 digits.

    By definition: the k-th partial autocorrelation is the last coefficient of the best prediction
    from k values, and each prediction leaves 1 − π_k² of the variance.
    """
    with mpmath.workdps(50):
        exact = [mpmath.mpf(float(one)) for one in partial]
        levels = [mpmath.mpf(sigma) ** 2 / mpmath.fprod(1 - one**2 for one in exact)]
        taps: list = []
        for k in range(1, count):
            ahead = mpmath.fsum(tap * level for tap, level in zip(taps, levels[::-1], strict=False))
            if k <= len(exact):
                seen = mpmath.fsum(t * c for t, c in zip(taps, levels[1:], strict=False))
                one, left = exact[k - 1], levels[0] - seen
                levels.append(ahead + one * left)
                taps = [a - one * b for a, b in zip(taps, taps[::-1], strict=True)] + [one]
            else:
                levels.append(ahead)
        return np.array(levels[:count])


def dense(small: Small, theta: np.ndarray) -> tuple[np.ndarray, ...]:
    """Columns, readings, covariance of the noise in 50 digits, widths and means of the priors.

    All are in scaled coefficients; the width of a flat prior is infinite.
    """
    problem = small.problem
    norm = 1 / np.diag(problem.natural)
    x, y, run = whole(small)
    x, y = x @ problem.natural, y / problem.unit
    levels = autocovariance(0.9999 * np.tanh(theta[:LAGS]), float(np.exp(theta[LAGS])), len(y))
    apart = np.abs(np.subtract.outer(np.arange(len(y)), np.arange(len(y))))
    noise = levels[apart] * np.equal.outer(run, run).astype(int)
    scale = dict(zip(GROUPS, np.exp(theta[LAGS + 1 :]), strict=True))
    scale |= {FLAT: np.inf, KNOWN: 1 / problem.unit}
    width = norm * [column.width * scale[column.prior] for column in small.columns]
    mean = -norm * [small.centres.get(column.name, 0.0) for column in small.columns]
    return x, y, noise, width, mean / problem.unit


def dense_density(small: Small, theta: np.ndarray, digits: int = 0) -> float:
    """Log density of θ from the marginal covariance of all rows; flat columns are projected.

    With `digits` the matrices are solved by `mpmath` with so many digits.
    """
    x, y, covariance, width, mean = dense(small, theta)
    covariance = covariance if digits else covariance.astype(float)
    for column, own in zip(x.T, width, strict=True):
        if np.isfinite(own):
            covariance = covariance + np.outer(column, column) * own**2
    prior = np.array([column.prior for column in small.columns])
    twice = restricted(covariance, x[:, prior == FLAT], y - x @ mean, digits)
    twice -= 2 * np.sum(np.log(width[prior == KNOWN]))
    far = theta[LAGS + 1 :] - np.log([small.usual[g] / small.problem.unit for g in GROUPS])
    widths = np.array([2.5, 0.7, 0.7, 0.4, 0.4, 0.4, 0.4, 0.4])
    twice += np.sum((theta[:LAGS] / widths) ** 2)
    present = np.isin(GROUPS, prior)
    twice += np.sum(np.where(present, 2 * np.log1p(np.exp(2 * far)) - 2 * far, far**2))
    return -0.5 * float(twice)


def restricted(covariance: np.ndarray, flat: np.ndarray, y: np.ndarray, digits: int) -> float:
    """ln|V| + ln|XᵀV⁻¹X| + the quadratic form of y after X is projected out."""
    if digits:
        with mpmath.workdps(digits):
            v, x, r = (mpmath.matrix(part.tolist()) for part in (covariance, flat, y))
            solution = v**-1
            gram, score = x.T * solution * x, x.T * solution * r
            left = (r.T * solution * r)[0] - (score.T * gram**-1 * score)[0]
            return float(mpmath.log(mpmath.det(v)) + mpmath.log(mpmath.det(gram)) + left)
    solution = np.linalg.solve(covariance, np.c_[y, flat])
    gram, score = flat.T @ solution[:, 1:], flat.T @ solution[:, 0]
    logs = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(gram)[1]
    return float(logs + y @ solution[:, 0] - score @ np.linalg.solve(gram, score))

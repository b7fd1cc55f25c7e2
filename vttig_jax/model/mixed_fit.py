"""Passes over the logs: rows, outliers, compression and the largest density until they settle."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import optimistix as optx
from jaxtyping import Bool, Float

from ..base.errors import NoAnswerError
from ..pair.gear_pair import Drive, GearPair
from ..pair.schema import HarmonicOrders
from .columns import DELAY, GAP, GROUPS, Assumptions, Column, Design, design_of, embedding
from .density import LAGS, Compressed
from .functionals import Posterior
from .newton import first_theta, maximise
from .outliers import is_heavy, spread, weights_of
from .problem import cleared, problem_of, products_of, sides_of, with_known
from .rows import LATE, Extra, RowName, Rows, S, Shafts, Wave, merged
from .scope import Scope, scope_of

_LONGEST = 0.05
"""Largest delay that is followed, as a share of the duration of a log: the search does not settle
where nothing tells a delay (chosen)."""

_MOST_PASSES = 7
CLEAR = 4.0
"""Standard errors of an order that stands out: noise alone passes it once in three thousand orders,
and a table has some thirty."""

_SMALL = 4.0
_MOST_OUTLIERS = 0.25
"""Share above which rows far off are no outliers but the noise itself."""

_CLEAN, _QUIET, _ROUNDING = 3e-3, 1e-2, 1e-10
"""Variance that every row has beside its noise, in u²: a log without noise has a density too."""

NEEDED = 12.0
"""2 ln of the likelihood ratio above which a component is reported: one in some thousand logs that
do not have it."""

_HELD = 1e12
"""Precision of a coefficient that is held at zero."""

_SETTLED = 0.1
"""Change of a wave by a step of the delay, in its standard errors, at which the passes end."""


@dataclass(frozen=True, eq=False)
class MixedFit:
    """Fit of the mixed model to logs of one rig."""

    shafts: tuple[Shafts, ...]
    rows: tuple[Rows, ...]
    waves: tuple[Wave, ...]
    posterior: Posterior
    delay_s: float
    bends: Float[np.ndarray, " bends"]
    passes: int
    steps: int
    usual: float
    weights: list[np.ndarray] | None
    scope: Scope
    orders: HarmonicOrders
    clear: frozenset[RowName] = frozenset()
    settled: bool = True

    @property
    def good(self) -> Bool[np.ndarray, " n"]:
        """Mask of the rows of all logs that are no outliers."""
        if self.weights is None:
            return np.ones(sum(len(one.table) for one in self.rows), bool)
        return np.concatenate(self.weights) > 0.5

    @property
    def residual(self) -> Float[np.ndarray, " n"]:
        """Residual of every row of all logs, rad."""
        columns, coefficients = self.posterior.problem.columns, self.posterior.coefficients
        return np.concatenate(residuals(columns, self.rows, coefficients))


def mixed_fit(
    shafts: Sequence[Shafts],
    pair: GearPair | Drive,
    orders: HarmonicOrders,
    *,
    lines: Sequence[float] = (),
    after: MixedFit | None = None,
    assumed: Assumptions = Assumptions(),
    given: Extra | None = None,
) -> MixedFit:
    """Fit the mixed model: rows at the delay of the last pass, until the delay stands still.

    **Arguments**
    - `shafts`: logs with their runs and starts. - `orders`: harmonic orders of both shafts and the
      mesh.
    - `lines`: frequencies of further lines, cycles per driving turn.
    - `after`: an earlier fit of these logs, at whose delay, outliers and orders that stand out
      this one begins.
    - `assumed`: what is assumed before the logs are read.
    - `given`: derivatives by what is not linear, as further columns: of a flank model of the user,
      of lines by their frequencies or of logs by their starts.
    """
    shafts = tuple(shafts)
    design = design_of(shafts, pair, orders, lines=lines, assumed=assumed, given=given)
    delay_s, weights, free = assumed.delay_s or 0.0, None, assumed.delay_s is None
    if after is not None:
        delay_s, weights = after.delay_s, after.weights
        design = replace(design, clear=after.clear)
    theta, searched, noise, steps = None, False, 0.0, 0
    number, value, last = 0, 0.0, 0.0
    while True:
        number += 1
        rows = ()  # the table is the largest part of a fit: one at a time
        design = replace(design, delay_s=delay_s)
        rows = design.rows(shafts)
        if not any(len(one.table) for one in rows):
            raise NoAnswerError(
                f"no run of this log has {LAGS + 2} rows of {design.row_s:.2g} s; record longer"
                " runs."
            )
        # after the delay is taken off, since a delay is no error of gears
        design = replace(design, usual=usual_error(rows))
        if number <= 2 or weights is not None:  # the first pass may hold a delay
            first = weights is None
            weights, noise = outlying(rows, design.columns, certain=not first)
            if weights is not None:
                shafts = tuple(
                    one.without(own.samples[weight < 0.5].ravel())
                    for one, own, weight in zip(shafts, rows, weights, strict=True)
                )
                if first:
                    continue
        problem = problem_of(
            design.columns,
            rows,
            weights,
            centres={DELAY: delay_s},
            noise=_ROUNDING * design.usual**2 * np.eye(1, LAGS + 1)[0],
            usual=design.scales(noise, sum(len(one.table) for one in rows)),
            memory=design.memory,
        )
        while True:
            search = largest if searched else partial(maximise, rough=True)
            found = search(problem.compressed, theta)
            if not np.isfinite(found.aux.value) and not (theta is None and searched):
                # What was largest before the last step of the delay may have no density, nor what
                # is usual.
                theta, searched = None, theta is None
                continue
            theta = np.asarray(found.value)
            steps += int(found.stats["num_steps"])
            posterior = Posterior(problem, theta, found.aux)
            if clear := clear_orders(posterior):
                # Beside one large order the others of its width would take up slow noise.
                design = replace(design, clear=design.clear | clear)
                problem = cleared(problem, clear, assumed.orders * design.usual)
                theta, searched = None, False
                continue
            step = posterior.given_noise(posterior.row(DELAY)[None], moved=True) if free else None
            settled = step is None or is_linear(step, posterior, design)
            moves = number < _MOST_PASSES and (not settled or any(one.ramps for one in shafts))
            if moves or searched:
                break
            searched = True
        if not moves:
            break
        shafts = tuple(
            with_ramps(one, log, posterior, design) if one.ramps else one
            for log, one in enumerate(shafts)
        )
        if step is not None:
            # The waves turn with the delay, so that a step may leave a share of itself, of either
            # sign: the next one is that of the secant, of half to three times the length.
            value, before = float(step[0][0]), value
            last = value / (float(np.clip((before - value) / last, 1 / 3, 2)) if last else 1.0)
            if not abs(delay_s + last) < _LONGEST * max(np.ptp(one.time) for one in shafts):
                settled = False
                break
            delay_s += last
    return MixedFit(
        shafts=shafts,
        rows=rows,
        waves=design.waves,
        posterior=posterior,
        delay_s=delay_s,
        bends=design.bends,
        passes=number,
        steps=steps,
        usual=design.usual,
        weights=weights,
        scope=scope_of(shafts, rows, design.waves),
        orders=orders,
        clear=design.clear,
        settled=settled and bool(found.result == optx.RESULTS.successful),
    )


def clear_orders(posterior: Posterior) -> frozenset[RowName]:
    """Return the higher orders with a common width that stand out of it."""
    own = [c for c in posterior.problem.columns if c.prior in ("driving", "driven")]
    if not own:
        return frozenset()
    rows = np.stack([posterior.row(c.name) for c in own])
    mean, covariance = posterior.given_noise(rows, moved=True)
    square = (mean**2 / np.diag(covariance)).reshape(-1, 2).mean(axis=1)
    return frozenset(
        c.row for c, size in zip(own, np.repeat(square, 2), strict=True) if size > 0.5 * CLEAR**2
    )


def is_linear(step: tuple[np.ndarray, np.ndarray], posterior: Posterior, design: Design) -> bool:
    """Return whether the logs are as good as linear in a step of the delay, of mean and variance.

    It turns no wave by more than a tenth of its standard error, at the highest speed, and is within
    a standard error: the column of the delay is a tenth smaller than the speed at most.
    """
    value, variance = float(step[0][0]), float(step[1][0, 0])
    if value**2 > variance:
        return False
    problem = posterior.problem
    std = problem.unit * np.diag(problem.natural)
    std = std * np.sqrt(np.diag(posterior.at.spread)[: len(std)])
    cycles = {wave.row("cos"): wave.cycles(design.shafts[0].ratio) for wave in design.waves}
    cycles |= {row._replace(part="sin"): own for row, own in cycles.items()}
    turned = abs(value) * float(design.bends[-1])
    turned *= np.array([cycles.get(column.row, 0.0) for column in problem.columns])
    return bool(np.all(turned * np.abs(posterior.moved) <= _SETTLED * std))


def largest(logs: Compressed, theta: Float[np.ndarray, " p"] | None = None) -> optx.Solution:
    """Return the largest of the maxima that three starts lead to, of which `theta` is one.

    The density of a short log may have two maxima: one explains what repeats by orders, the other
    by noise that remembers.
    """
    orders = first_theta(logs)
    noise = orders.copy()
    noise[0], noise[LAGS + 1 : LAGS + 4] = 1.5, np.log(logs.usual[:3]) - _SMALL
    found = [maximise(logs, start, rough=True) for start in (theta, orders, noise)]
    height = lambda one: float(np.nan_to_num(one.aux.value, nan=np.inf))  # noqa: E731
    best = min(found, key=height)
    usual = float(orders[LAGS + 1])
    if np.asarray(best.value)[LAGS] < usual + np.log(_QUIET) or height(best) == np.inf:
        # A smooth log without noise is as well a noise that remembers everything.
        quiet = orders.copy()
        quiet[0], quiet[LAGS] = 0.0, usual + 0.5 * np.log(_ROUNDING) + 1.0
        best = min(best, maximise(logs, quiet, rough=True), key=height)
    return maximise(logs, best.value)


def with_ramps(shafts: Shafts, log: int, posterior: Posterior, design: Design) -> Shafts:
    """Return a log whose runs include those of its ramps that stay on their flank.

    A row that stays has the noise of the fit, with deviation s. One that crosses the gap g lies
    anywhere in it. A ramp stays if that explains its rows better, mean r² < 2 s² ln(g/(√(2π) s)).
    """
    columns, coefficients = posterior.problem.columns, posterior.coefficients
    index = posterior.problem.index
    gap = abs(coefficients[index[GAP]]) if GAP in index else 0.0
    noise = posterior.innovation_std
    limit = 2 * np.log(gap / (np.sqrt(2 * np.pi) * noise)) if gap > 0 else 1.0
    kept = []
    for ramp in shafts.ramps:
        (rows,) = design.rows([replace(shafts, runs=(ramp,))])
        if len(rows.table):
            link = embedding(columns, rows.names, log, ramp.flank)
            residual = rows.table @ (link @ np.append(-coefficients, 1.0))
            if np.mean(residual**2) < max(limit, 1.0) * noise**2:
                kept.append(ramp)
    return replace(shafts, runs=merged((*shafts.runs, *kept)), ramps=())


def usual_error(rows: Sequence[Rows]) -> float:
    """Return a robust deviation of the readings about a line on each flank, rad."""
    left = []
    for one in rows:
        for flank in S:
            own = one.flank == flank
            if own.any():
                x = np.stack([np.ones(own.sum()), one.angle[own] - one.angle[own].mean()], 1)
                error = one.table[own, -1]
                left.append(error - x @ np.linalg.lstsq(x, error, rcond=None)[0])
    every = np.concatenate(left)
    return max(1.4826 * float(np.median(np.abs(every - np.median(every)))), 1e-9)


def outlying(
    rows: Sequence[Rows], columns: Sequence[Column], *, certain: bool
) -> tuple[list[Float[np.ndarray, " n"]] | None, float]:
    """Return weights of the rows (None: no outliers), and the noise, rad.

    `certain`: whether it is known already that there are outliers. A delay that is still in the
    readings follows every change of the speed, also those that do not tell it.
    """
    steady = [c for c in columns if c.prior not in ("delay_parts", "gap_by_speed", "drift")]
    steady.append(Column(LATE))
    gram = products_of(list(sides_of(steady, rows)))
    y = np.concatenate([one.table[:, -1] for one in rows])
    norm = np.sqrt(np.diag(gram)[:-1] / len(y))
    norm[norm == 0] = 1.0
    hold = 1e-4 * len(y) * np.eye(len(norm))
    scaled = gram[:-1, :-1] / norm / norm[:, None]
    away = np.linalg.solve(scaled + hold, gram[:-1, -1] / norm) / norm
    residual = np.concatenate(residuals(steady, rows, away))
    clean = spread(residual) < _CLEAN * float(np.std(y))  # the rest is that of the ridge
    if clean or not (certain or is_heavy(residual)):
        return None, spread(residual)
    x = np.concatenate(combined(steady, rows, np.eye(len(norm) + 1)[:, :-1] / norm))
    weight, share = weights_of(x, y)
    heavy = x * weight[:, None]
    residual = y - x @ np.linalg.solve(heavy.T @ x + hold, heavy.T @ y)
    if share > _MOST_OUTLIERS or np.all(weight > 0.5):
        return None, spread(residual)
    ends = np.cumsum([len(one.table) for one in rows])[:-1]
    return np.split(weight, ends), spread(residual[weight > 0.5])


def residuals(
    columns: Sequence[Column], rows: Sequence[Rows], coefficients: Float[np.ndarray, " columns"]
) -> list[Float[np.ndarray, " n"]]:
    """Return the residual of every row of each log, rad."""
    return combined(columns, rows, np.append(-coefficients, 1.0))


def combined(
    columns: Sequence[Column], rows: Sequence[Rows], factors: Float[np.ndarray, "all ..."]
) -> list[Float[np.ndarray, "n ..."]]:
    """Return [X | y] @ `factors` for the rows of each log."""
    found = []
    for number, one in enumerate(rows):
        links = (embedding(columns, one.names, number, flank) for flank in S)
        on_a, on_b = (one.table @ (link @ factors) for link in links)
        found.append(np.where(one.flank == "A", on_a.T, on_b.T).T)
    return found


def likelihood_ratio(fit: MixedFit, group: str) -> float:
    """Return 2 ln of the restricted likelihood with a group of columns over that without it.

    All other prior widths and the noise are maximised again. It is 0 for a group that the fit does
    not have.
    """
    logs, posterior = fit.posterior.problem.compressed, fit.posterior
    own = np.asarray(logs.member)[:, GROUPS.index(group)] > 0
    if not own.any():
        return 0.0
    without = maximise(with_known(logs, np.where(own, _HELD, 0.0)), posterior.theta).aux.likelihood
    return max(0.0, float(without - own.sum() * np.log(_HELD) - posterior.at.likelihood))

"""Standard errors that are valid for a wrong noise model.

With the score g_b of the parameters p, summed over an uninterrupted block b of rows, the covariance

    C (Σ_b g_b g_bᵀ) C,    C = (JᵀJ)⁻¹,

is valid for residuals of varying size, and for correlation shorter than a block (P. J. Huber 1967,
H. White 1980). It agrees with C if the noise model is correct. The quantile is that of Student's
distribution for one degree of freedom less than there are blocks. On few turns the correlation is
as long as a block. There a mean over cosines of the scores g_t of the rows replaces Σ_b g_b g_bᵀ,

    (1/K) Σ_k Λ_k Λ_kᵀ,    Λ_k = √2 Σ_t cos(πk (t − ½)/T) g_t,    k = 1 … K = 8,

with the quantile for 8 degrees of freedom (U. K. Müller, J. Econometrics 141 (2007) 1331; Y. Sun,
J. Econometrics 178 (2014) 659). The interval is at least as wide as that for noise which is
correlated from run to run (`remembered_noise`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

from ...base.numerics.quantiles import NORMAL_95
from ...pair.gear_pair import Flank
from ..model.column_layout import OFFSET
from .solved_fit import SolvedFit

_BLOCKS = 28
"""Approximate number of blocks, which determines their length; chosen value."""

_FEWEST = 6  # blocks for an estimate; chosen value
_SHORTEST = 10  # rows of a block; chosen value
_COSINES = 8  # cosines of the scores on few turns; chosen value

Scatter = Literal["blocks", "cosines", "memory"]
"""Source of the standard errors: "blocks", the scatter of blocks of the log; "cosines", the scatter
of cosine sums Λ_k of the scores; "memory", the larger one of "cosines" and `remembered_noise`."""


@dataclass(frozen=True, eq=False)
class Functional:
    """Linear functions of the parameters p and of the free coefficients β of each flank.

    **Arguments**
    - `slope`: derivative with respect to p, where β follows as the best one for each p, shape
      (k, p).
    - `free`: derivative with respect to β at fixed p, shape (k, free columns) for each flank.
    """

    slope: Float[np.ndarray, "k p"]
    free: Mapping[Flank, Float[np.ndarray, "k free"]] = field(default_factory=dict)


def functional_of(
    solved: SolvedFit, rows: Mapping[Flank, Float[np.ndarray, "k columns"]]
) -> Functional:
    """Return k linear functions: the sum over the flanks of `rows` times the coefficients.

    The coefficients are those of all columns of the flank, free and tied, without y.
    """
    count = len(next(iter(rows.values())))
    slope, of_free = np.zeros((count, len(solved.solution.names))), {}
    for place, (flank, factor) in enumerate(
        zip(solved.summary.flanks, solved.whitened, strict=True)
    ):
        if flank.flank in rows:
            own, free = rows[flank.flank], factor.free
            follow = -np.linalg.solve(factor.factor[:free, :free], factor.factor[:free, free:-1])
            slope += (own[:, free:] + own[:, :free] @ follow) @ solved.solution.jacobian[place]
            of_free[flank.flank] = own[:, :free]
    return Functional(slope, of_free)


def widened(solved: SolvedFit, scatter: Scatter) -> Float[np.ndarray, " p"]:
    """Return the factor, at least 1, by which each standard error of a parameter increases.

    The factor is the standard error from the scatter divided by that of the noise model.
    """
    plain = np.sqrt(np.diag(solved.model_covariance))
    own = standard_errors(solved, Functional(np.eye(len(plain))), scatter)
    ratio = np.divide(own, plain, out=np.ones_like(plain), where=plain > 0)
    return np.maximum(ratio, 1.0)


def standard_errors(
    solved: SolvedFit, functional: Functional, scatter: Scatter
) -> Float[np.ndarray, " k"]:
    """Return the standard errors of functions of the fit from the scatter of parts of the log.

    They are multiplied by the ratio of the 97.5 % quantiles of Student's and the normal
    distribution. With blocks they are 0 if there are fewer than six blocks.
    """
    if scatter != "blocks":
        return _of_cosines(solved, functional, memory=scatter == "memory")
    rows = [one.changes for one in _influences(solved, functional)]
    sums = _blocks(rows, sum(len(run.rows) for own in solved.linear.rows for run in own.runs))
    if len(sums) < _FEWEST:
        return np.zeros(len(functional.slope))
    freedom = len(sums) - 1
    return _quantile(freedom) * np.sqrt(len(sums) / freedom * np.sum(sums**2, axis=0))


def changes_by_constants(solved: SolvedFit, functional: Functional) -> Float[np.ndarray, "runs k"]:
    """Return the change of each function if the TE of one run of `solved.runs` increases by 1 rad.

    Each row of the result belongs to one run.
    """
    found = _influences(solved, functional)
    return np.array([one.rate.T @ one.constant for one in found]).reshape(len(found), -1)


def _of_cosines(
    solved: SolvedFit, functional: Functional, *, memory: bool
) -> Float[np.ndarray, " k"]:
    """Return the standard errors from cosine sums of the scores.

    With `memory` they are at least those from `remembered_noise`. They are 0 if every run is too
    short to show scatter.
    """
    found = _influences(solved, functional, whole=True)
    if not found:
        return np.zeros(len(functional.slope))
    influence = np.concatenate([one.changes for one in found])
    phase = np.pi * (np.arange(len(influence)) + 0.5) / len(influence)
    cosines = np.sqrt(2) * np.cos(np.outer(np.arange(1, _COSINES + 1), phase))
    own = _quantile(_COSINES) * np.sqrt(np.mean((cosines @ influence) ** 2, axis=0))
    if not memory:
        return own
    remembered = solved.remembered_noise.half_widths(
        [one.weights for one in found if one.weights is not None]
    )
    return np.maximum(own, remembered / NORMAL_95)


def _quantile(count: int) -> float:
    """Return the 97.5 % quantile of Student's distribution divided by that of the normal one.

    `count` is the number of degrees of freedom.
    """
    return float(stdtrit(count, 0.975)) / NORMAL_95


def _blocks(rows: Sequence[Float[np.ndarray, "_ k"]], total: int) -> Float[np.ndarray, "blocks k"]:
    """Return the sums over blocks of neighbouring rows; no block extends over two runs.

    `rows` holds an array for every run, and `total` is the number of rows of all logs.
    """
    length = max(_SHORTEST, total // _BLOCKS)
    sums = [
        piece.sum(axis=0)
        for run in rows
        for piece in np.array_split(run, max(1, round(len(run) / length)))
    ]
    return np.array(sums).reshape(len(sums), -1)


@dataclass(frozen=True, eq=False)
class _Influence:
    """Influence of the whitened rows of one run on k functions of the fit.

    **Arguments**
    - `rate`: derivative of the functions with respect to y of the whitened rows.
    - `left`: residual of the whitened rows.
    - `constant`: whitened offset column, the change of the whitened rows if y increases by 1.
    - `weights`: derivative of the functions with respect to y of the rows before whitening; None
      unless all rows are whitened.
    """

    rate: Float[np.ndarray, "n k"]
    left: Float[np.ndarray, " n"]
    constant: Float[np.ndarray, " n"]
    weights: Float[np.ndarray, "n k"] | None

    @property
    def changes(self) -> Float[np.ndarray, "n k"]:
        """Change of each function that the residual of each whitened row causes."""
        return self.rate * self.left[:, None]


def _combinations(
    solved: SolvedFit, functional: Functional
) -> dict[Flank, Float[np.ndarray, "columns _"]]:
    """Return flank → combinations of the columns that `_influences` whitens, not all columns.

    They are the directions x of every function, then the weights of the residual, then the offset.
    """
    columns, of_score = solved.summary.columns, functional.slope @ solved.model_covariance
    found = {}
    for place, side in enumerate(solved.summary.flanks):
        factor = solved.whitened[place]
        free = factor.free
        upper = factor.factor[:free, :free]
        tied = solved.solution.jacobian[place] @ of_score.T
        combined = np.zeros((columns.width, len(of_score) + 2))
        combined[:free, :-2] = -np.linalg.solve(upper, factor.factor[:free, free:-1]) @ tied
        combined[free:-1, :-2] = tied
        if side.flank in functional.free:
            of_free = np.linalg.solve(upper.T, functional.free[side.flank].T)
            combined[:free, :-2] += np.linalg.solve(upper, of_free)
        combined[:, -2] = [*-solved.coefficients[place], 1.0]
        combined[columns.index(OFFSET), -1] = 1.0
        found[side.flank] = combined
    return found


def _influences(
    solved: SolvedFit, functional: Functional, *, whole: bool = False
) -> list[_Influence]:
    """Return the influence of the rows on each function, run by run in time order.

    The residual r of a whitened row x of the columns changes p by C g, where g is the score of p,
    and β at fixed p by (X_fᵀ X_f)⁻¹ x_f r, where f marks the free columns. The first rows of a run,
    as many as the order of the noise, are left out unless `whole` is true.
    """
    combined = _combinations(solved, functional)
    found = []
    for _, run, embedding in solved.runs:
        own = solved.noise.at(run.segment.speed)
        whitening = own.whitening(run.curve.time) if whole else None
        table = run.rows @ (embedding.T @ combined[run.segment.flank])
        white = own.whitened(table, run.curve.time) if whitening is None else whitening @ table
        rate, left, constant = white[:, :-2], white[:, -2], white[:, -1]
        weights = None if whitening is None else whitening.T @ rate
        found.append(_Influence(rate, left, constant, weights))
    return found

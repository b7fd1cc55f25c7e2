"""Standard errors that are valid for a wrong noise model.

With the score g_b of the parameters p, summed over an uninterrupted block b of rows, the covariance

    C (Σ_b g_b g_bᵀ) C,    C = (JᵀJ)⁻¹,

is valid for residuals of varying size, and for correlation shorter than a block (P. J. Huber 1967,
H. White 1980). It agrees with C if the noise model is correct. The quantile is that of Student's
distribution for one degree of freedom less than there are blocks. On few turns the correlation is
as long as a block. There a mean over cosines of the scores g_t of the rows replaces Σ_b g_b g_bᵀ,

    (1/K) Σ_k Λ_k Λ_kᵀ,    Λ_k = √2 Σ_t cos(πk (t − ½)/T) g_t,    k = 1 … K = 8,

with the quantile for 8 degrees of freedom (U. K. Müller, J. Econometrics
141 (2007) 1331; Y. Sun, J. Econometrics 178 (2014) 659).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

from ...base.numerics.quantiles import NORMAL_95
from ...pair.gear_pair import Flank
from .solved_fit import SolvedFit

_BLOCKS = 28
"""Approximate number of blocks, which determines their length; chosen value."""

_FEWEST = 6  # blocks for an estimate; chosen value
_SHORTEST = 10  # rows of a block; chosen value
_COSINES = 8  # cosines of the scores on few turns; chosen value

Scatter = Literal["blocks", "cosines"]
"""Parts of the log whose scatter gives the standard errors."""


@dataclass(frozen=True, eq=False)
class Functional:
    """Linear functions of the parameters p and of the free coefficients β of each flank.

    **Arguments**
    - `slope`: derivative with respect to p, with the best β for p, shape (k, p).
    - `free`: derivative with respect to β at fixed p, shape (k, free columns) for each flank.
    """

    slope: Float[np.ndarray, "k p"]
    free: Mapping[Flank, Float[np.ndarray, "k free"]] = field(default_factory=dict)


def widened(solved: SolvedFit, scatter: Scatter) -> Float[np.ndarray, " p"]:
    """Return the factor, at least 1, by which the scatter increases each standard error."""
    plain = np.sqrt(np.diag(solved.model_covariance))
    own = standard_errors(solved, Functional(np.eye(len(plain))), scatter)
    ratio = np.divide(own, plain, out=np.ones_like(plain), where=plain > 0)
    return np.maximum(ratio, _quantile(_COSINES) if scatter == "cosines" else 1.0)


def standard_errors(
    solved: SolvedFit, functional: Functional, scatter: Scatter
) -> Float[np.ndarray, " k"]:
    """Return the standard errors of functions of the fit from the scatter of parts of the log.

    They contain the ratio of the 97.5 % quantiles of Student's and the normal distribution. All are
    0 if there are fewer than six blocks or 32 rows.
    """
    rows = _influences(solved, functional)
    if scatter == "blocks":
        sums = _blocks(rows, sum(len(run.rows) for own in solved.linear.rows for run in own.runs))
        if len(sums) < _FEWEST:
            return np.zeros(len(functional.slope))
        freedom = len(sums) - 1
        return _quantile(freedom) * np.sqrt(len(sums) / freedom * np.sum(sums**2, axis=0))
    influence = np.concatenate([np.zeros((0, len(functional.slope))), *rows])
    if len(influence) < 4 * _COSINES:
        return np.zeros(len(functional.slope))
    phase = np.pi * (np.arange(len(influence)) + 0.5) / len(influence)
    cosines = np.sqrt(2) * np.cos(np.outer(np.arange(1, _COSINES + 1), phase))
    return _quantile(_COSINES) * np.sqrt(np.mean((cosines @ influence) ** 2, axis=0))


def _quantile(freedom: int) -> float:
    """Return the 97.5 % quantile of Student's distribution over that of the normal one."""
    return float(stdtrit(freedom, 0.975)) / NORMAL_95


def _blocks(rows: Sequence[Float[np.ndarray, "_ k"]], total: int) -> Float[np.ndarray, "blocks k"]:
    """Return the sums over blocks of rows; `total` is the number of all rows of the logs."""
    length = max(_SHORTEST, total // _BLOCKS)
    sums = [
        piece.sum(axis=0)
        for run in rows
        for piece in np.array_split(run, max(1, round(len(run) / length)))
    ]
    return np.array(sums).reshape(len(sums), -1)


def _influences(solved: SolvedFit, functional: Functional) -> list[Float[np.ndarray, "_ k"]]:
    """Return what the residual of every row changes the functions by, run by run in time order.

    With the whitened row x of the columns and its residual r, the change of p is C g with the score
    g of p, and that of β at fixed p is (X_fᵀ X_f)⁻¹ x_f r.
    """
    summary, of_score = solved.summary, functional.slope @ solved.model_covariance
    sides = {flank.flank: place for place, flank in enumerate(summary.flanks)}
    found = []
    for rows, embedding in zip(solved.linear.rows, summary.embeddings, strict=True):
        for run in sorted(rows.runs, key=lambda run: run.segment.start):
            flank = run.segment.flank
            own = solved.noise.at(run.segment.speed)
            if flank not in sides or len(run.rows) < len(own.filter) + _SHORTEST:
                continue
            factor, place = solved.whitened[sides[flank]], sides[flank]
            white = own.whitened(run.rows @ embedding[flank].T, run.curve.time)
            free = factor.free
            upper = factor.factor[:free, :free]
            regressors = white[:, free:-1] - white[:, :free] @ np.linalg.solve(
                upper, factor.factor[:free, free:-1]
            )
            left = white[:, -1] - white[:, :-1] @ solved.coefficients[place]
            influence = regressors @ solved.solution.jacobian[place] @ of_score.T
            if flank in functional.free:
                of_free = np.linalg.solve(upper, np.linalg.solve(upper.T, white[:, :free].T))
                influence += (functional.free[flank] @ of_free).T
            found.append(influence * left[:, None])
    return found

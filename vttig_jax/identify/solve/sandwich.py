"""Standard errors that are valid for a wrong noise model.

With the score g_b of the parameters p, summed over an uninterrupted block b of rows, the covariance

    C (Σ_b g_b g_bᵀ) C,    C = (JᵀJ)⁻¹,

is valid for residuals of varying size, and for correlation shorter than a block (P. J. Huber 1967,
H. White 1980). It agrees with C if the noise model is correct. On few turns the correlation is as
long as a block. There a mean over cosines of the scores g_t of the rows replaces Σ_b g_b g_bᵀ,

    (1/K) Σ_k Λ_k Λ_kᵀ,    Λ_k = √2 Σ_t cos(πk (t − ½)/T) g_t,    k = 1 … K = 8,

with the quantile of Student's distribution for 8 degrees of freedom (U. K. Müller, J. Econometrics
141 (2007) 1331; Y. Sun, J. Econometrics 178 (2014) 659).
"""

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri, stdtrit

from .solved_fit import SolvedFit

_BLOCKS = 28
"""Approximate number of blocks, which determines their length; chosen value."""

_FEWEST = 12  # blocks for an estimate; chosen value
_SHORTEST = 10  # rows of a block; chosen value
_COSINES = 8  # cosines of the scores on few turns; chosen value


def widened(solved: SolvedFit) -> Float[np.ndarray, " p"]:
    """Return the factor, at least 1, by which blocks increase the standard error of each parameter.

    All factors are 1 if there are fewer than twelve blocks.
    """
    scores, covariance = _block_scores(solved), solved.solution.covariance
    plain = np.sqrt(np.diag(covariance))
    if len(scores) < _FEWEST:
        return np.ones(len(plain))
    correction = len(scores) / (len(scores) - 1)
    spread = covariance @ scores.T
    robust = np.sqrt(correction * np.sum(spread**2, axis=1))
    ratio = np.divide(robust, plain, out=np.ones_like(plain), where=plain > 0)
    return np.maximum(ratio, 1.0)


def widened_on_few_turns(solved: SolvedFit) -> Float[np.ndarray, " p"]:
    """Return the factor, at least 1, by which cosines of the scores increase each standard error.

    It contains the ratio of the 97.5 % quantiles of Student's and the normal distribution.
    """
    rows, covariance = _row_scores(solved), solved.solution.covariance
    scores = np.concatenate([np.zeros((0, len(covariance))), *rows])
    plain = np.sqrt(np.diag(covariance))
    quantiles = float(stdtrit(_COSINES, 0.975) / ndtri(0.975))
    if len(scores) < 4 * _COSINES:
        return np.full(len(plain), quantiles)
    phase = np.pi * (np.arange(len(scores)) + 0.5) / len(scores)
    cosines = np.sqrt(2) * np.cos(np.outer(np.arange(1, _COSINES + 1), phase))
    spread = covariance @ (cosines @ scores).T
    robust = np.sqrt(np.mean(spread**2, axis=1))
    ratio = np.divide(robust, plain, out=np.ones_like(plain), where=plain > 0)
    return quantiles * np.maximum(ratio, 1.0)


def _block_scores(solved: SolvedFit) -> Float[np.ndarray, "blocks p"]:
    """Return the score of the parameters of every block."""
    total = sum(len(run.rows) for rows in solved.linear.rows for run in rows.runs)
    length = max(_SHORTEST, total // _BLOCKS)
    scores = []
    for score in _row_scores(solved):
        pieces = np.array_split(score, max(1, round(len(score) / length)))
        scores += [piece.sum(axis=0) for piece in pieces]
    return np.array(scores).reshape(len(scores), len(solved.solution.names))


def _row_scores(solved: SolvedFit) -> list[Float[np.ndarray, "_ p"]]:
    """Return the scores of the rows of every run in time order, without the free harmonics."""
    summary, solution = solved.summary, solved.solution
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
            follow = np.linalg.solve(factor.factor[:free, :free], factor.factor[:free, free:-1])
            regressors = white[:, free:-1] - white[:, :free] @ follow
            left = white[:, -1] - white[:, :-1] @ solved.coefficients[place]
            found.append((regressors * left[:, None]) @ solution.jacobian[place])
    return found

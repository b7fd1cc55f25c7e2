"""Wander of the level of the transmission error, a random walk beside the noise of the rows.

Temperature, clearance and load move the level of a log. A parabola of time follows it only roughly,
and noise that is independent from run to run hides the rest from the standard errors of the delay
and the gap. A second fit therefore has a cubic B-spline of time whose coefficients are a random
walk. The restricted likelihood of the rows decides on its size. With Q coefficients of the other
columns and m steps of standard deviation σ/κ, beside white innovations of standard deviation σ,

    F(κ) = (N − Q) ln S(κ) + ln |XᵀX + κ² DᵀD| − m ln κ²,

where S is the least sum of squares, steps included, and κ → ∞ is the model without wander
(D. A. Harville, J. Amer. Statist. Assoc. 72 (1977) 320).
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from ..compress.block_rows import BlockRun
from ..compress.orthogonal import triangle_of
from ..compress.regressors import Drift, steps
from .linear_fit import LinearFit
from .model_selection import SelectedModel
from .nuisance import NuisanceRegression

_PIECES = 24
"""Pieces of the spline of all logs together, six for each of four legs; chosen value."""

_FEWEST_LEGS, _MOST_LEGS = 4, 24
"""Legs of a log, each in one direction, with which a walk is tried. In fewer legs it resembles the
gap; over more legs the level averages out (chosen)."""

_GAIN = 20.0
"""Least 2 Δ ln L of the random walk; chosen value."""

_STIFFEST, _SOFTEST = 1e4, 1e-3  # bounds of κ; chosen values


def with_walk(selected: SelectedModel) -> SelectedModel | None:
    """Return the model with a random walk as drift, or None if the likelihood does not demand it.

    A walk is tried on logs that reverse a few times. In one direction it resembles a delay.
    """
    linear = selected.linear
    legs = [_legs(rows.runs) for rows in linear.rows]
    tried = len(selected.summary.flanks) == 2 and min(legs) >= _FEWEST_LEGS
    if not tried or max(legs) > _MOST_LEGS:
        return None
    longest = max(float(np.ptp(one.time)) for one in linear.channels)
    drift = Drift(knots_s=longest * len(legs) / _PIECES)
    drift = _held(_look(selected, drift))
    if drift is None:
        return None
    walk = _look(selected, drift)
    kept = {name for own in selected.summary.columns.own for name in own}
    own = [
        tuple(name for name in each if name in kept or name.startswith("spline_"))
        for each in walk.summary.columns.own
    ]
    return replace(selected, linear=walk, summary=walk.summary.keeping(own), drift=drift)


def _legs(runs: Sequence[BlockRun]) -> int:
    """Return the number of pieces of a log in one direction."""
    flanks = [run.segment.flank for run in sorted(runs, key=lambda run: run.segment.start)]
    return len(list(groupby(flanks)))


def _look(selected: SelectedModel, drift: Drift) -> LinearFit:
    """Return the linear fit with another drift, at the same delay and weights."""
    linear = selected.linear
    model = replace(linear.model, drift=drift)
    seconds = linear.channels[0].delay_s
    return selected.weights.look(linear.inputs, model, seconds, linear.block_s)


def _held(linear: LinearFit) -> Drift | None:
    """Return the drift with the stiffness of the largest likelihood, or None if it gains nothing.

    `linear` is the fit with free coefficients of the spline.
    """
    own = linear.own
    if own.is_exact:
        return None
    found: Any = minimize_scalar(
        lambda log: _height(own, np.exp(log)),
        bounds=(np.log(_SOFTEST), np.log(_STIFFEST)),
        method="bounded",
    )
    if _height(own, np.inf) - float(found.fun) < _GAIN:
        return None
    # The rows of the steps pass the filter of the noise as uncorrelated observations.
    stiffness = float(np.exp(found.x)) / np.sqrt(float(linear.filter @ linear.filter))
    return Drift(knots_s=linear.model.drift.knots_s, stiffness=stiffness)


def _height(own: NuisanceRegression, stiffness: float) -> float:
    """Return F; infinite stiffness means no spline."""
    splines = [k for k, name in enumerate(own.names) if name.startswith("spline_")]
    others = [k for k in range(len(own.names)) if k not in splines]
    if np.isinf(stiffness):
        triangle, count = triangle_of(own.triangle[:, [*others, -1]]), 0
    else:
        held = np.zeros((len(splines), own.triangle.shape[1]))
        for log in _logs([own.names[k] for k in splines]):
            cells = [splines[k] for k in log]
            held[np.ix_(log, cells)] = stiffness * steps(len(log))
        triangle, count = triangle_of(np.concatenate([own.triangle, held])), len(splines)
    diagonal = np.abs(np.diag(triangle))
    left = max(float(diagonal[-1] ** 2), 1e-300)
    height = (own.rows - len(others)) * np.log(left) + 2 * float(np.sum(np.log(diagonal[:-1])))
    return height - (2 * count * np.log(stiffness) if count else 0.0)


def _logs(names: list[str]) -> list[list[int]]:
    """Return the places of the names of each log; those of a log are neighbours."""
    logs: list[list[int]] = []
    for place, name in enumerate(names):
        if name.split("_of_")[0] == "spline_1":
            logs.append([])
        logs[-1].append(place)
    return logs

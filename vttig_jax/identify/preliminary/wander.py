"""Wander: a random walk of the level of the transmission error, in addition to the noise.

Temperature, clearance and load change the level during a log. A parabola of time follows the level
only roughly. The noise model takes the runs as independent, so the standard errors of delay and gap
do not contain the rest. A second fit therefore has a cubic B-spline of time as drift, whose
coefficients are a random walk. The restricted likelihood of the N whitened rows X determines the
size of its steps. With Q coefficients of the other columns, white innovations of standard deviation
σ, and m steps D b between the spline coefficients b, of standard deviation σ/κ, it minimises

    F(κ) = (N − Q) ln S(κ) + ln |XᵀX + κ² DᵀD| − m ln κ²,

where S is the least sum of squares of residuals and steps. κ → ∞ is the model without wander
(D. A. Harville, J. Amer. Statist. Assoc. 72 (1977) 320).
"""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from ...logs.motion.segments import legs_of
from ..compress.orthogonal import triangle_of
from ..compress.regressors import Drift, steps
from .linear_fit import LinearFit
from .model_selection import SelectedModel
from .nuisance import NuisanceRegression

_PIECES = 24
"""Number of spline pieces of all logs together: six for each of four legs; chosen value."""

_FEWEST_LEGS, _MOST_LEGS = 4, 24
"""Numbers of legs of a log with which a random walk is tried (chosen); a leg is a part in one
direction. With fewer legs the walk resembles the gap; with more legs it averages out."""

_GAIN = 20.0
"""The model has the walk only if it increases 2 ln L by at least this value; chosen value."""

_STIFFEST, _SOFTEST = 1e4, 1e-3  # bounds of κ; chosen values


def with_walk(selected: SelectedModel) -> SelectedModel | None:
    """Return the selected model with a random walk as drift.

    The result is None if the walk does not increase the likelihood enough, or if it is not tried.
    It is tried only if every log has 4 to 24 legs; in one direction it would resemble a delay.
    """
    linear = selected.linear
    legs = [legs_of([run.segment for run in rows.runs]) for rows in linear.rows]
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


def _look(selected: SelectedModel, drift: Drift) -> LinearFit:
    """Make a pass with another drift but the same delay and weights, and return its linear fit."""
    linear = selected.linear
    model = replace(linear.model, drift=drift)
    seconds = linear.channels[0].delay_s
    return selected.weights.look(linear.inputs, model, seconds, linear.block_s)


def _held(linear: LinearFit) -> Drift | None:
    """Return the drift with the stiffness κ of the largest likelihood; None if it gains too little.

    `linear` is a fit with a spline whose coefficients are free.
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
    # The whitening filter also scales the step rows, which count as uncorrelated observations.
    stiffness = float(np.exp(found.x)) / np.sqrt(float(linear.filter @ linear.filter))
    return Drift(knots_s=linear.model.drift.knots_s, stiffness=stiffness)


def _height(own: NuisanceRegression, stiffness: float) -> float:
    """Return F(κ) of the module docstring; `stiffness` is κ, and infinity means no spline."""
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
    """Return for each log the indices of its spline coefficients in `names`.

    The names of one log are consecutive and begin with "spline_1".
    """
    logs: list[list[int]] = []
    for place, name in enumerate(names):
        if name.split("_of_")[0] == "spline_1":
            logs.append([])
        logs[-1].append(place)
    return logs

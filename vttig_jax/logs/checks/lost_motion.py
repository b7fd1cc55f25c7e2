"""Driven angle without the motion that the teeth lose when they cross the gap after a reversal.

Let the driving shaft need the travel c to cross the gap. The place s of the teeth in the gap, from
0 to 1, follows the play operator of the driving angle φ₁, and the driven angle is linear in both:

    s ← min(max(s + Δφ₁ / c, 0), 1),    φ₂ = a + b φ₁ + k s.

c has the least sum of squares. In short strokes the crossing is a notable part of the travel: the
slope of φ₂ over φ₁ alone is then too small, and its residual is large.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...base.units import DEG
from ..encoder_log import EncoderLog

_MOST_ROWS = 4000  # largest number of samples that are compared (chosen)
_TRIALS = 40  # number of trial values of c, at equal ratios (chosen)
_LEAST = DEG  # least c, rad of the driving shaft (chosen)
_LONGEST = 0.9  # largest c, as a share of the travel of the driving shaft (chosen)


class FollowedMotion(NamedTuple):
    """Angles of both shafts in rad at the same samples, the driven one without lost motion."""

    driving: Float[np.ndarray, " m"]
    driven: Float[np.ndarray, " m"]


def without_lost_motion(log: EncoderLog) -> FollowedMotion:
    """Return φ₁ and φ₂ − k s at up to `_MOST_ROWS` evenly spaced samples of a log."""
    rows = slice(None, None, -(-len(log) // _MOST_ROWS))
    driving, driven = log.driving_angle[rows], log.driven_angle[rows]
    travel = float(np.ptp(driving))
    crossings = np.geomspace(min(_LEAST, _LONGEST * travel), _LONGEST * travel, _TRIALS)
    columns = np.stack([np.ones_like(driving), driving - driving.mean()], axis=1)
    basis = np.linalg.qr(columns)[0]

    def rest(values: np.ndarray) -> np.ndarray:
        return values - basis @ (basis.T @ values)

    left = rest(driven)
    places = _places(driving, np.concatenate([crossings, crossings]))
    free = rest(places)
    size = np.maximum(np.sum(free**2, axis=0), 1e-300)
    lost = free.T @ left / size
    best = int(np.argmax(lost**2 * size))
    return FollowedMotion(driving, driven - lost[best] * places[:, best])


def _places(
    driving: Float[np.ndarray, " m"], crossings: Float[np.ndarray, " trials"]
) -> Float[np.ndarray, "m trials"]:
    """Return s for every trial; the first half starts with s = 0 and the second with s = 1."""
    step = np.diff(driving)[:, None] / crossings
    places = np.empty((len(driving), len(crossings)))
    places[0] = np.repeat([0.0, 1.0], len(crossings) // 2)
    for row, moved in enumerate(step):
        np.clip(places[row] + moved, 0.0, 1.0, out=places[row + 1])
    return places

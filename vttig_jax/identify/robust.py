"""Robust loss: how much every sample counts, by how far it stands off the fit.

With u = r/s, s the robust scale of a log's residuals (1.4826 times the median distance from their
median):

    Huber      w = min(1, 1.345/|u|)            bounded influence
    bisquare   w = (1 − (u/4.685)²)², 0 beyond  redescending: a far outlier counts for nothing

Both keep 95 % of the efficiency of least squares under Gaussian noise (P. J. Huber, E. M.
Ronchetti, Robust Statistics, 2nd ed. 2009).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

Loss = Literal["square", "huber", "bisquare"]

HUBER, BISQUARE = 1.345, 4.685
FAR, FAR_SHARE = 8.0, 2e-3
"""A log with more than this share of residuals beyond this many robust scales has outliers."""

_AROUND = 9

DROPPED = 0.5
"""A sample with less weight counts as down-weighted in the report."""

_ROUNDING = 1e-10
"""Scale, rad, below which residuals are rounding: 2e-5″, a tenth of a count of 36 bits a turn."""


def scale_of(residual: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Median of residuals, and 1.4826 times the median distance from it; never quite zero."""
    middle = float(np.median(residual))
    return middle, max(1.4826 * float(np.median(np.abs(residual - middle))), _ROUNDING)


def has_outliers(pieces: Sequence[Float[np.ndarray, " _"]]) -> bool:
    """Far more residuals beyond eight robust scales than any bell curve has, each on its own.

    A model that is wrong leaves far residuals too, but side by side: an outlier also stands far off
    the median of the nine samples around it. Every piece counts from its own median, so that two
    flanks off to either side hide none.
    """
    pieces = [piece - np.median(piece) for piece in pieces if len(piece)]
    if not pieces:
        return False
    residual = np.concatenate(pieces)
    lonely = np.concatenate([p - median_filter(p, _AROUND, mode="nearest") for p in pieces])
    far = [np.abs(part) > FAR * scale_of(part)[1] for part in (residual, lonely)]
    return float(np.mean(far[0] & far[1])) > FAR_SHARE


def weights_of(
    residual: Float[np.ndarray, " n"], scale: float, loss: Loss
) -> Float[np.ndarray, " n"]:
    """Weight 0 … 1 of every residual."""
    far = np.abs(residual) / scale
    if loss == "huber":
        return HUBER / np.maximum(far, HUBER)
    if loss == "bisquare":
        return np.where(far < BISQUARE, (1 - (far / BISQUARE) ** 2) ** 2, 0.0)
    return np.ones_like(residual)


def variance_factor(
    residual: Float[np.ndarray, " n"], scale: float, loss: Loss, size: int
) -> float:
    """What the variance of the last least squares, on rows of `size` samples, lacks.

    An estimate with influence ψ = w r has the variance E ψ²/(E ψ′)². Huber's samples are moved to
    their ψ and all rows count: least squares gives E ψ². Bisquare's rows are weighted, and their
    misfit divided by E w of them: that gives E wr²/(E w)² for single samples and E ψ²/(E w)³ for
    means of many. The slope ψ′ is taken from the residuals themselves.
    """
    if loss == "square":
        return 1.0
    far = residual / scale
    if loss == "huber":
        return 1 / float(np.mean(np.abs(far) < HUBER)) ** 2
    weight = weights_of(residual, scale, loss)
    inside = (far / BISQUARE) ** 2
    slope = float(np.mean(np.where(inside < 1, (1 - inside) * (1 - 5 * inside), 0.0)))
    share = float(np.mean(weight))
    if size > 1:
        return share**3 / slope**2
    influence = float(np.mean((weight * far) ** 2))
    return influence * share**2 / (slope**2 * float(np.mean(weight * far**2)))


@dataclass(frozen=True)
class Outliers:
    """Down-weighted samples of one log.

    **Arguments**
    - `loss`, `passes`: what was done, and how often.
    - `share`: of the samples used; `positive`: share of those that stand above the fit.
    - `scale_deg`: robust scale of the residuals; `largest_deg`: of the down-weighted ones.
    - `first`: (time s, driving angle deg) of the first few.
    """

    loss: Loss
    passes: int
    share: float
    positive: float
    scale_deg: float
    largest_deg: float
    first: tuple[tuple[float, float], ...]

    def to_json(self) -> dict:
        """Fields under `checks.outliers`."""
        return {**vars(self), "first": [list(place) for place in self.first]}

    @property
    def sentence(self) -> str:
        """The same in words."""
        if self.share == 0:
            return f"{self.loss} loss: no sample stands off the fit"
        side = (
            "above"
            if self.positive > 0.9
            else "below"
            if self.positive < 0.1
            else "on both sides of"
        )
        time_s, angle_deg = self.first[0]
        return (
            f"{self.loss} loss: {self.share:.2%} of the samples count less than half; they stand"
            f" {side} the fit by up to {self.largest_deg:.3g}°, the first at {time_s:.6g} s"
            f" (driving {angle_deg:.1f}°)"
        )

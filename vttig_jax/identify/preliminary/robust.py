"""Robust loss functions, and the passes that reweight the samples until the weights settle.

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

from ...base.units import DEG
from ..compress.regressors import Samples
from ..settings import Loss
from .linear_fit import Input, LinearFit, Model, linear_fit

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


MOST_PASSES = 20
_HUBER_FIRST = 5
"""Passes with the convex loss before the redescending one, which would keep a bad start."""

_STILL = 1e-3
_MOST_TESTED = 20_000
_SHOWN = 5


@dataclass(frozen=True, eq=False)
class Reweighted:
    """A linear whose samples are weighed.

    **Arguments**
    - `linear`: the last pass; `values`: weights of every log, None where all samples count alike.
    - `loss`, `passes`: what was done.
    - `variance_factor`: what the variance of least squares lacks.
    - `outliers`: of every log; empty for squares.
    - `pulls`: what was taken off the samples instead, by a loss that lets none go.
    """

    linear: LinearFit
    loss: Loss
    passes: int = 0
    values: tuple[Samples | None, ...] | None = None
    variance_factor: float = 1.0
    outliers: tuple[Outliers, ...] = ()
    pulls: tuple[Samples | None, ...] | None = None

    def look(
        self, inputs: tuple[Input, ...], model: Model, delay_s: float, block_s: float
    ) -> LinearFit:
        """Another pass with the same weights."""
        return linear_fit(inputs, model, delay_s, self.values, block_s, pulls=self.pulls)


def reweighted(
    linear: LinearFit,
    loss: Loss | Literal["auto"],
    start: Sequence[Samples | None] | None = None,
) -> Reweighted:
    """Weigh the samples by how far they stand off the fit, twenty passes at most.

    "auto" looks for outliers first, and where there are any takes the redescending loss. Without
    weights to `start` from, readings that stand off their neighbours begin without any.
    """
    if loss == "auto":
        suspected = any(has_outliers(_pieces(linear, log)) for log in range(len(linear.inputs)))
        loss = "bisquare" if suspected else "square"
    if loss == "square":
        return Reweighted(linear, loss)
    if start is None:
        start = [1.0 - one.log.spikes for one in linear.inputs]
    weights: list[Samples] = [
        np.ones(len(one.log)) if own is None else own
        for one, own in zip(linear.inputs, start, strict=True)
    ]
    cleaned = any(own.min() < 1 for own in weights)
    stage: Loss = loss if cleaned else "huber"
    if cleaned:
        linear = _look_again(linear, weights=weights)
    passes = 0
    while True:
        fresh = [_weights(linear, log, stage) for log in range(len(linear.inputs))]
        change = max(
            float(np.abs(new - old).mean()) for new, old in zip(fresh, weights, strict=True)
        )
        weights = fresh
        if stage == "huber":
            linear = _look_again(
                linear, pulls=[_pull(linear, k, own) for k, own in enumerate(weights)]
            )
        else:
            linear = _look_again(linear, weights=weights)
        passes += 1
        still = change < _STILL
        if (still and stage == loss) or passes == MOST_PASSES:
            break
        if loss == "bisquare" and (passes >= _HUBER_FIRST or still):
            stage = "bisquare"
    spread = [_scaled(linear, log) for log in range(len(linear.inputs))]
    size = min(rows.size for rows in linear.rows)
    factor = variance_factor(np.concatenate(spread), 1.0, loss, size)
    found = tuple(_outliers(linear, log, weights[log], loss, passes) for log in range(len(weights)))
    values = tuple(c.weight for c in linear.channels)
    pulls = tuple(c.pull for c in linear.channels)
    return Reweighted(linear, loss, passes, values, factor, found, pulls)


def _look_again(
    linear: LinearFit,
    weights: Sequence[Samples] | None = None,
    pulls: Sequence[Samples] | None = None,
) -> LinearFit:
    return linear_fit(
        linear.inputs,
        linear.model,
        linear.channels[0].delay_s,
        weights,
        linear.block_s,
        segments=linear.segments,
        pulls=pulls,
    )


def _pull(linear: LinearFit, log: int, weight: Samples) -> Samples:
    """What a sample stands too far off, (1 − w) r: without it its residual is ψ = w r.

    Under correlated noise a down-weighted row would stand between neighbours that are not, and the
    whitening would give it more weight than any. A sample that is moved stays a sample.
    """
    pull = np.zeros(len(weight))
    for run, residual in zip(linear.rows[log].runs, linear.residuals(log), strict=True):
        part = slice(run.segment.start, run.segment.stop)
        pull[part] = (1 - weight[part]) * residual
    return pull


def _pieces(linear: LinearFit, log: int) -> list[Samples]:
    samples = sum(run.segment.stop - run.segment.start for run in linear.rows[log].runs)
    return linear.residuals(log, max(1, samples // _MOST_TESTED))


def _tested(linear: LinearFit, log: int) -> Samples:
    pieces = _pieces(linear, log)
    return np.concatenate(pieces) if pieces else np.zeros(1)


def _scaled(linear: LinearFit, log: int) -> Samples:
    """Residuals of the samples in robust scales of their log."""
    residual = _tested(linear, log)
    return residual / scale_of(residual)[1]


def _weights(linear: LinearFit, log: int, loss: Loss) -> Samples:
    pieces = linear.residuals(log)
    middle, scale = scale_of(np.concatenate(pieces)) if pieces else (0.0, 1.0)
    weight = np.ones(len(linear.inputs[log].log))
    ramps = linear.inputs[log].ramps
    if ramps:
        # No fit of the steady speeds reaches into a ramp: there the neighbours tell.
        on = ~linear.inputs[log].log.spikes
        for ramp in ramps:
            part = slice(ramp.segment.start, ramp.segment.stop)
            weight[part] = on[part]
    for run, residual in zip(linear.rows[log].runs, pieces, strict=True):
        part = slice(run.segment.start, run.segment.stop)
        weight[part] = weights_of(residual - middle, scale, loss)
    return weight


def _outliers(linear: LinearFit, log: int, weight: Samples, loss: Loss, passes: int) -> Outliers:
    pieces = linear.residuals(log)
    residual = np.concatenate(pieces)
    place = np.concatenate(
        [np.arange(r.segment.start, r.segment.stop) for r in linear.rows[log].runs]
    )
    low = weight[place] < DROPPED
    time, angle = linear.inputs[log].log.time, linear.channels[log].driving
    first = place[low][:_SHOWN]
    return Outliers(
        loss,
        passes,
        float(np.mean(low)),
        float(np.mean(residual[low] > 0)) if low.any() else 0.0,
        scale_of(residual)[1] / DEG,
        float(np.abs(residual[low]).max(initial=0.0)) / DEG,
        tuple((float(time[k]), float(angle[k] / DEG)) for k in first),
    )

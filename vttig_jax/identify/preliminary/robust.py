"""Robust loss functions, and the passes that reweight the samples until the weights converge.

The weight w of a sample with the residual r depends on u = r/s. s is the robust scale of the
residuals of the log: 1.4826 times the median of their absolute differences from their median.

    Huber      w = min(1, 1.345/|u|)             bounded influence
    bisquare   w = (1 − (u/4.685)²)², |u| < 4.685; otherwise 0: a far outlier has no influence

Both keep 95 % of the efficiency of least squares under Gaussian noise (P. J. Huber, E. M.
Ronchetti, Robust Statistics, 2nd ed. 2009).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import median_filter

from ...base.units import DEG
from ..compress.regressors import DROPPED, Samples
from ..settings import Loss
from .linear_fit import Input, LinearFit, Model, linear_fit

HUBER, BISQUARE = 1.345, 4.685
FAR, FAR_SHARE = 8.0, 2e-3
"""A log has outliers if more than 0.2 % of its residuals exceed 8 robust scales; chosen values."""

_AROUND = 9  # samples in the window of the running median; chosen value

_ROUNDING = 1e-10
"""Smallest robust scale, rad, because smaller residuals are rounding: 2e-5″, about 1/2³⁶ turn."""


def scale_of(residual: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the median of the residuals and their robust scale, which is never zero, rad."""
    middle = float(np.median(residual))
    return middle, max(1.4826 * float(np.median(np.abs(residual - middle))), _ROUNDING)


def has_outliers(pieces: Sequence[Float[np.ndarray, " _"]]) -> bool:
    """Return whether more than 0.2 % of the residuals are outliers. `pieces` are those of each run.

    An outlier exceeds eight robust scales both as a residual and as its difference from the running
    median of nine samples: a wrong model also gives large residuals, but over many neighbouring
    samples. The median of each run is subtracted first, so that different offsets of the two flanks
    do not hide an outlier.
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
    """Return the weight 0 … 1 of every residual; `scale` is the robust scale, in the same unit."""
    far = np.abs(residual) / scale
    if loss == "huber":
        return HUBER / np.maximum(far, HUBER)
    if loss == "bisquare":
        return np.where(far < BISQUARE, (1 - (far / BISQUARE) ** 2) ** 2, 0.0)
    return np.ones_like(residual)


def variance_factor(
    residual: Float[np.ndarray, " n"], scale: float, loss: Loss, size: int
) -> float:
    """Return the true variance of a robust estimate over the variance that the last pass computes.

    An estimate with the influence ψ = w r has the variance E ψ²/(E ψ′)², where E is the mean over
    the samples and ψ′ the derivative by r. The last pass is ordinary least squares on the rows.
    Huber's loss replaces each sample by its ψ with full weight, so least squares computes E ψ². The
    bisquare loss weights the samples, so least squares computes E wr²/(E w)² for rows of one
    sample, and E ψ²/(E w)³ for rows of `size` > 1 samples.
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
    """Outliers of one log: samples that count less than half.

    **Arguments**
    - `loss`, `passes`: loss function, and number of passes.
    - `share`: share of the used samples that are outliers. - `positive`: share of the outliers that
      lie above the fit.
    - `scale_deg`: robust scale of all residuals. - `largest_deg`: largest residual of an outlier.
    - `first`: (time in s, driving angle in deg) of the first five outliers.
    - `slow`: share of all samples that are left out because they follow a long interval.
    """

    loss: Loss
    passes: int
    share: float
    positive: float
    scale_deg: float
    largest_deg: float
    first: tuple[tuple[float, float], ...]
    slow: float = 0.0

    @property
    def sentence(self) -> str:
        """Sentence on the outliers for the report."""
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
        doubt = "do not follow the model and " if self.are_many else ""
        return (
            f"{self.loss} loss: {self.share:.2%} of the samples {doubt}count less than half; they"
            f" stand {side} the fit by up to {self.largest_deg:.3g}°, the first at {time_s:.6g} s"
            f" (driving {angle_deg:.1f}°)" + self._slow
        )

    @property
    def are_many(self) -> bool:
        """Whether so many samples stand off the fit that the model is in doubt."""
        return self.share >= _MANY and not self.slow

    @property
    def _slow(self) -> str:
        if not self.slow:
            return ""
        return (
            f"; most of them follow a long sampling interval, as late readings of a slow bus do, so"
            f" all {self.slow:.2%} of such samples are left out"
        )


_MANY = 0.1  # least share of outliers that is a warning (chosen)
MOST_PASSES = 20  # passes of a robust loss over the logs; chosen value
_HUBER_FIRST = 5
"""Passes with Huber's loss before the bisquare loss, which can keep the error of a bad start."""

_STILL = 1e-3  # mean change of the weights below which they have converged; chosen value
_MOST_TESTED = 20_000  # samples, about, for outlier test and variance factor; chosen value
_SHOWN = 5  # outliers listed in the report

_LONG = 1.2  # a reading is slow if its interval exceeds this many median intervals; chosen value
_MOST_SLOW = 0.4  # largest share of slow readings that is left out; chosen value
_OFTEN, _SEEN, _CHANCE = 4.0, 0.03, 1e-9
"""Slow readings are left out if outliers are 4 times more frequent among them than among the other
readings, if 3 % of them are outliers, and if this happens by chance with p < 1e-9; chosen."""


@dataclass(frozen=True, eq=False)
class Reweighted:
    """Linear fit with weighted samples.

    **Arguments**
    - `linear`: fit of the last pass. - `values`: for each log the weights of its samples; None for
      equal weights.
    - `loss`, `passes`: loss function, and number of passes.
    - `variance_factor`: factor by which the loss increases the variance.
    - `outliers`: outliers of every log; empty for the square loss.
    - `pulls`: for each log the values that Huber's loss subtracts from its samples instead of
      weighting them, rad; None for the other losses.
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
        """Make another pass over the logs with the same weights, and return its linear fit."""
        return linear_fit(inputs, model, delay_s, self.values, block_s, pulls=self.pulls)


def reweighted(
    linear: LinearFit,
    loss: Loss | Literal["auto"],
    start: Sequence[Samples | None] | None = None,
) -> Reweighted:
    """Weight the samples by their residuals, in at most twenty passes.

    "auto" selects the bisquare loss if a log has outliers, otherwise the square loss. `start` are
    the initial weights of each log; by default spikes have the weight 0, others the weight 1.
    """
    if loss == "auto":
        suspected = any(has_outliers(_pieces(linear, log)) for log in range(len(linear.inputs)))
        loss = "bisquare" if suspected else "square"
    if loss == "square":
        return Reweighted(linear, loss)
    weights = _first_weights(linear, start)
    cleaned = any(own.min() < 1 for own in weights)
    stage: Loss = loss if cleaned else "huber"
    if cleaned:
        linear = _look_again(linear, weights=weights)
    off = [np.zeros(len(own), bool) for own in weights]
    passes, asked = 0, False
    while True:
        fresh = [np.where(off[k], 0.0, _weights(linear, k, stage)) for k in range(len(off))]
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
        if passes == MOST_PASSES or (still and stage == loss and (asked or loss != "bisquare")):
            break
        if still and stage == loss:
            off = [slow_readings(linear.inputs[k].log.time, own) for k, own in enumerate(weights)]
            asked = True
            if not any(own.any() for own in off):
                break
        if loss == "bisquare" and (passes >= _HUBER_FIRST or still):
            stage = "bisquare"
    spread = [_scaled(linear, log, own) for log, own in enumerate(off)]
    size = min(rows.size for rows in linear.rows)
    factor = variance_factor(np.concatenate(spread), 1.0, loss, size)
    found = tuple(
        replace(_outliers(linear, log, weights[log], loss, passes), slow=float(off[log].mean()))
        for log in range(len(weights))
    )
    return Reweighted(
        linear=linear,
        loss=loss,
        passes=passes,
        values=tuple(c.weight for c in linear.channels),
        variance_factor=factor,
        outliers=found,
        pulls=tuple(c.pull for c in linear.channels),
    )


def _first_weights(linear: LinearFit, start: Sequence[Samples | None] | None) -> list[Samples]:
    if start is None:
        return [1.0 - one.log.spikes for one in linear.inputs]
    return [
        np.ones(len(one.log)) if own is None else own
        for one, own in zip(linear.inputs, start, strict=True)
    ]


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
    """Return (1 − w) r of every sample of a log, which Huber's loss subtracts from the sample, rad.

    The residual is then ψ = w r, and the sample keeps its full weight. Different weights would not
    work in correlated noise: the whitening would give a down-weighted row between rows of full
    weight the largest influence.
    """
    pull = np.zeros(len(weight))
    for run, residual in zip(linear.rows[log].runs, linear.residuals(log), strict=True):
        part = slice(run.segment.start, run.segment.stop)
        pull[part] = (1 - weight[part]) * residual
    return pull


def _pieces(linear: LinearFit, log: int) -> list[Samples]:
    samples = sum(run.segment.stop - run.segment.start for run in linear.rows[log].runs)
    return linear.residuals(log, max(1, samples // _MOST_TESTED))


def _scaled(linear: LinearFit, log: int, off: Bool[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    """Return the residuals of a log divided by their robust scale.

    Samples that are marked in `off` are left out, and of a long log only every k-th is returned.
    """
    runs, pieces = linear.rows[log].runs, linear.residuals(log)
    kept = [
        piece[~off[run.segment.start : run.segment.stop]]
        for run, piece in zip(runs, pieces, strict=True)
    ]
    residual = np.concatenate([np.zeros(0), *kept])
    residual = residual[:: max(1, len(residual) // _MOST_TESTED)] if len(residual) else np.zeros(1)
    return residual / scale_of(residual)[1]


def slow_readings(time: Samples, weight: Samples) -> Bool[np.ndarray, " n"]:
    """Return the mask of the late readings of a slow bus, which the fit must leave out.

    They are all samples after a long interval if many of these and few other samples are outliers
    (small `weight`). Otherwise no sample is marked. At a low speed a late reading is too close to
    the fit to be an outlier, but it still biases the gap.
    """
    interval = np.diff(time, prepend=time[0])
    long, doubtful = interval > _LONG * np.median(np.diff(time)), weight < DROPPED
    if not long.any() or long.mean() > _MOST_SLOW:
        return np.zeros(len(time), bool)
    from scipy.special import bdtrc  # slow to import, and seldom needed

    often, seldom = float(doubtful[long].mean()), float(doubtful[~long].mean())
    chance = float(bdtrc(doubtful[long].sum() - 1, long.sum(), max(seldom, 1e-9)))
    return long & (often > _OFTEN * seldom) & (often > _SEEN) & (chance < _CHANCE)


def _weights(linear: LinearFit, log: int, loss: Loss) -> Samples:
    pieces = linear.residuals(log)
    middle, scale = scale_of(np.concatenate(pieces)) if pieces else (0.0, 1.0)
    weight = np.ones(len(linear.inputs[log].log))
    ramps = linear.inputs[log].ramps
    if ramps:
        # The fit of the steady speeds has no residuals in a ramp. There, a spike has the weight 0.
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
        loss=loss,
        passes=passes,
        share=float(np.mean(low)),
        positive=float(np.mean(residual[low] > 0)) if low.any() else 0.0,
        scale_deg=scale_of(residual)[1] / DEG,
        largest_deg=float(np.abs(residual[low]).max(initial=0.0)) / DEG,
        first=tuple((float(time[k]), float(angle[k] / DEG)) for k in first),
    )

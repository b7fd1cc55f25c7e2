"""Values, intervals, limits and probabilities from draws, with circular statistics for phases."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ...base.angles import difference_deg, wrap_deg
from ...base.errors import NoAnswerError
from ...base.numerics.polar_spread import polar_spread
from ...base.units import ARCSEC, DEG, REV
from ...identify.result import Fit
from ...model.parameter import BELOW, UPPER, Parameter
from ...model.parameters import SIGNIFICANT
from ...pair.gear_pair import Drive, GearPair

_TAILS = (0.025, 0.5, 0.975)  # ends of the 95 % interval, and the median
_BATCHES = 8
"""Number of batches of successive steps into which the draws of one ensemble are split (chosen)."""


@dataclass(frozen=True)
class PosteriorParameter(Parameter):
    """Parameter from draws, with an equal-tailed interval and a `median`.

    `value` is the posterior mean. For an amplitude it is the length of the mean vector; the mean of
    the lengths would be too large because of noise. The `std`, `median` and interval of an
    amplitude are those of the lengths. The value of a phase is the circular mean.
    """

    median: float | None = None

    def to_json(self) -> dict:
        """Return the fields of `Parameter`, with `median`."""
        return super().to_json() | {"median": self.median}


GAPS = ("constant_backlash", "gap_over_angles_covered", "backlash_plus_delay")
"""Quantities that are reported in degrees."""


def shown_unit(name: str, unit: str) -> tuple[str, float]:
    """Return the unit in which a quantity is reported, and its size in internal units."""
    if name in GAPS:
        return "deg", DEG
    return {"rad": ("arcsec", ARCSEC)}.get(unit, (unit, 1.0))


def reported_name(fit: Fit, quantity: str) -> str | None:
    """Return the parameter that reports a quantity of a fit, for a component its amplitude."""
    if quantity in fit.parameters:
        return quantity
    source = quantity.removesuffix("_x").removesuffix("_y")
    ends = ("", "_deg", "_s", "_eccentricity_mm", "_amplitude_arcsec", "_arcsec")
    return next((f"{source}{end}" for end in ends if f"{source}{end}" in fit.parameters), None)


def parameters_of_draws(
    fit: Fit, names: Sequence[str], flat: Float[np.ndarray, "n d"]
) -> dict[str, PosteriorParameter]:
    """Return every parameter of the fit by name, in the order of the fit.

    `flat` holds the draws of the quantities `names`. A parameter that the fit marks as undetermined
    stays undetermined for the same reason: the draws only repeat the prior.
    """
    found = {
        name: PosteriorParameter(name, one.unit, reason=one.reason)
        for name, one in fit.parameters.items()
    }
    for place, quantity in enumerate(names):
        name = reported_name(fit, quantity)
        if name is None or not fit.parameters[name].determined:
            continue
        unit = fit.parameters[name].unit
        scale = {"deg": DEG, "arcsec": ARCSEC}.get(unit, 1.0)
        component = "" if name == quantity else quantity[-2:]
        if component == "_x":
            phase = f"{quantity.removesuffix('_x')}_phase_deg"
            pair = polar_of_draws((name, phase), unit, flat[:, place : place + 2] / scale)
            found |= {one.name: one for one in pair}
        elif component != "_y":
            found[name] = scalar_of_draws(name, unit, flat[:, place] / scale)
    return found


def scalar_of_draws(name: str, unit: str, draws: Float[np.ndarray, " n"]) -> PosteriorParameter:
    """Return a parameter with mean, std, median and equal-tailed interval of its `draws`.

    `draws` are in the unit `unit` of the parameter.
    """
    value, std = float(draws.mean()), float(draws.std(ddof=1))
    reason = None if abs(value) >= SIGNIFICANT * std else BELOW
    return _told(name, unit, value, std, np.quantile(draws, _TAILS), reason)


def _told(
    name: str,
    unit: str,
    value: float,
    std: float,
    quantiles: Sequence[float] | np.ndarray,
    reason: str | None = None,
) -> PosteriorParameter:
    """Return a parameter with its lower bound, median and upper bound, the `quantiles`.

    It is significant unless there is a `reason` why not.
    """
    low, median, high = map(float, quantiles)
    told = value, std, low, high, True, reason is None, reason
    return PosteriorParameter(name, unit, *told, median=median)


def phase_of_draws(name: str, angles_deg: Float[np.ndarray, " n"]) -> PosteriorParameter:
    """Return the parameter of draws of an angle, deg, with any number of whole turns.

    The value is the circular mean in [0, 360), and the std √(−2 ln R) with R the length of the mean
    unit vector. Median and bounds are the mean plus quantiles of the signed differences of the
    draws from it; they may lie outside [0, 360).

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.posterior.summary.draws import phase_of_draws
    >>> phase = phase_of_draws("phase_deg", np.array([350.0, 358.0, 2.0, 6.0, 374.0]))
    >>> round(phase.value, 2), round(phase.low95, 2), round(phase.high95, 2)
    (2.0, -9.2, 13.2)

    ```
    """
    from scipy.stats import circmean, circstd  # slow to import

    # The mean of `circmean` can round to 360.
    mean = float(wrap_deg(circmean(angles_deg, high=360, low=0)))
    std = float(circstd(angles_deg, high=360, low=0))
    quantiles = mean + np.quantile(difference_deg(angles_deg, mean), _TAILS)
    return _told(name, "deg", mean, std, quantiles)


def polar_of_draws(
    names: tuple[str, str], unit: str, plane: Float[np.ndarray, "n 2"]
) -> tuple[PosteriorParameter, PosteriorParameter]:
    """Return the parameters amplitude and phase from draws (x, y) of a vector.

    If the length of the mean vector is below three standard errors of the component along it, the
    amplitude has its 95 % quantile as an upper limit, and the phase has no value. `names` are those
    of the two parameters, and `unit` is that of `plane` and of the amplitude.
    """
    value, std, *_ = polar_spread(plane.mean(axis=0), np.cov(plane.T))
    length = np.hypot(plane[:, 0], plane[:, 1])
    _, median, _ = spread = np.quantile(length, _TAILS)
    if value < SIGNIFICANT * std:
        upper = float(np.quantile(length, 0.95))
        amplitude = _told(names[0], unit, value, std, (0.0, median, upper), UPPER)
        reason = f"{names[0]} is below three standard errors"
        phase = PosteriorParameter(names[1], "deg", determined=True, reason=reason)
        return replace(amplitude, upper95=upper), phase
    return (
        _told(names[0], unit, value, float(length.std(ddof=1)), spread),
        phase_of_draws(names[1], np.arctan2(plane[:, 1], plane[:, 0]) / DEG),
    )


def batches(shape: Sequence[int]) -> Int[np.ndarray, " m"]:
    """Return the number of the batch of every draw of the shape (ensembles, steps, walkers).

    The steps of every ensemble are divided into equal parts, and each part is a batch. Draws of
    different batches are nearly independent, so the scatter of the batch means gives the
    Monte-Carlo error of their mean.
    """
    ensembles, steps, walkers = shape
    parts = min(_BATCHES, steps)
    part = np.arange(steps) * parts // steps + parts * np.arange(ensembles)[:, None]
    return np.repeat(part.ravel(), walkers)


@dataclass(frozen=True)
class Share:
    """Probability estimated from draws, with its Monte-Carlo standard error."""

    value: float
    std_error: float

    def __str__(self) -> str:
        return f"{self.value:.3g} ± {self.std_error:.1g}"


@dataclass(frozen=True)
class SmallestGap:
    """Draws of the smallest gap over the hunting period.

    **Arguments**
    - `pair`: gear pair, for millimetres and tooth numbers.
    - `gap`: smallest backlash of every draw, rad of the driven gear, shape (m,).
    - `driving_angle`: driving angle of that gap, rad, within the hunting period.
    - `batch`: batch of every draw, shape (m,); different batches are independent.
    - `upper`: 97.5 % upper limit of the smallest gap, rad, from an upper band of the gap.
    """

    pair: GearPair | Drive
    gap: Float[np.ndarray, " m"]
    driving_angle: Float[np.ndarray, " m"]
    batch: Int[np.ndarray, " m"]
    upper: float

    @property
    def interval(self) -> tuple[float, float, float]:
        """Lower limit, median and upper limit of the smallest gap, rad, 95 %.

        The lower limit and the median are quantiles of the draws. Uncertain orders make the curve
        of a draw uneven, so that its smallest value lies below the true one. The upper limit is
        therefore at least `upper`, which comes from a band and does not have this error.
        """
        low, median, high = (float(part) for part in np.quantile(self.gap, _TAILS))
        return low, median, max(high, self.upper)

    @property
    def safe_closing_mm(self) -> Float[np.ndarray, " m"]:
        """Axial closing, mm, that takes up the smallest gap j_min of each draw.

        It is s = j_min R₂/(tan β_L + tan β_R).

        **Raises** `NoAnswerError` for a drive and for untapered gears, which no closing affects.
        """
        axial = millimetres(self.pair)[1]
        if math.isnan(axial):
            kind = "a drive without gear geometry"
            kind = kind if isinstance(self.pair, Drive) else "gears without taper"
            raise NoAnswerError(f"no axial displacement closes the gap of {kind}.")
        return self.gap * axial

    def probability_of_binding(self, closing_mm: float) -> Share:
        """Return the fraction of draws in which an axial closing s, mm, makes the gears bind.

        They bind if s > j_min R₂/(tan β_L + tan β_R). The standard error of the fraction is the
        larger of two: the binomial one, after adding half a draw that binds and half a draw that
        does not, and that of the batch means.
        """
        binds = (self.safe_closing_mm < closing_mm).astype(float)
        count, value = len(binds), float(binds.mean())
        smoothed = (binds.sum() + 0.5) / (count + 1)
        binomial = np.sqrt(smoothed * (1 - smoothed) / count)
        return Share(value, float(max(binomial, self._batch_error(binds))))

    @property
    def place(self) -> tuple[float, float]:
        """Driving angle, rad, at which most draws have their smallest gap, and their fraction.

        Draws within one tooth of this angle (for a drive: a twelfth of a turn) are counted.
        """
        teeth = 12 if isinstance(self.pair, Drive) else self.pair.driving.teeth
        bins = np.floor(self.driving_angle / (REV / teeth)).astype(int)
        common = np.bincount(bins).argmax()
        middle = float(np.median(self.driving_angle[bins == common]))
        period = self.pair.hunting_turns * REV
        away = np.abs((self.driving_angle - middle + period / 2) % period - period / 2)
        return middle, float(np.mean(away <= REV / teeth))

    def to_json(self) -> dict:
        """Return quantiles of the smallest gap, °, its angle, and the safe closing, mm."""
        angle, share = self.place
        axial = millimetres(self.pair)[1]
        return {
            "backlash_deg": self._summary(1 / DEG),
            "driving_deg": angle / DEG,
            "share_there": share,
            "safe_closing_mm": None if math.isnan(axial) else self._summary(axial),
            "draws": len(self.gap),
        }

    def rows(self) -> list[tuple[str, str]]:
        """Return names and values, as text, for the report."""
        record = self.to_json()
        gap, closing = record["backlash_deg"], record["safe_closing_mm"]
        share = f"{100 * record['share_there']:.0f}"
        where = f"at {record['driving_deg']:.1f}° in {share} % of the draws"
        where = "at another angle in every draw" if share == "0" else where
        span = f"{gap['median']:.5f}° ({gap['low95']:.5f}° … {gap['high95']:.5f}°), 95 %, {where}"
        rows = [("smallest gap", span)]
        if closing is not None:
            span = f"{closing['median']:.4f} mm ({closing['low95']:.4f} … {closing['high95']:.4f})"
            rows.append(("closing that takes it up", f"{span}, 95 %"))
            low = closing["low95"]
            binding = f"{low:.4f} mm binds somewhere with probability 2.5 %"
            safe = binding if low > 0 else "none, because the smallest gap may already be zero"
            rows.append(("safe axial closing", safe))
        return rows

    def _summary(self, scale: float) -> dict[str, float]:
        """Return mean, std, median and 95 % interval of the smallest gap, times `scale`."""
        low, median, high = self.interval
        return {
            "mean": float(self.gap.mean()) * scale,
            "std": float(self.gap.std(ddof=1)) * scale,
            "median": median * scale,
            "low95": low * scale,
            "high95": high * scale,
        }

    def _batch_error(self, values: Float[np.ndarray, " m"]) -> float:
        """Return the standard error of the mean of `values`, from the means of the batches."""
        _, batch, counts = np.unique(self.batch, return_inverse=True, return_counts=True)
        if len(counts) < 2:
            return 0.0
        sums = np.bincount(batch, values)
        deviations = sums - counts * values.mean()
        return float(np.sqrt(np.sum(deviations**2) * len(counts) / (len(counts) - 1)) / len(values))


def millimetres(pair: GearPair | Drive) -> tuple[float, float]:
    """Return two lengths in mm per rad of backlash; NaN if undefined.

    The first is the arc at the reference circle of the driven gear. The second is the axial
    displacement that closes the backlash.
    """
    if isinstance(pair, Drive):
        return math.nan, math.nan
    radius, thinning = float(pair.reference_radii[1]), float(pair.thinning)
    return radius, radius / thinning if thinning else math.nan

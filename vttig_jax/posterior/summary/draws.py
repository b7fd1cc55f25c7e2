"""Values, intervals, limits and probabilities from draws; phases are treated as circular."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ...base.angles import difference_deg, wrap_deg
from ...base.errors import NoAnswerError
from ...base.units import ARCSEC, DEG, REV
from ...identify.fit_result import Fit
from ...identify.report.parameters import BELOW, ROUNDING, SIGNIFICANT, Parameter, polar_spread
from ...pair.gear_pair import Drive, GearPair


@dataclass(frozen=True)
class CircularSummary:
    """Draws of one angle, in degrees.

    **Arguments**
    - `mean`: circular mean, in [0, 360).
    - `std`: circular standard deviation √(−2 ln R), R the length of the mean unit vector.
    - `median`, `low`, `high`: mean plus quantiles of the signed way from it; they stand around the
      mean and may leave [0, 360).
    """

    mean: float
    std: float
    median: float
    low: float
    high: float


def circular_summary(
    angles_deg: Float[np.ndarray, " m"], probability: float = 0.95
) -> CircularSummary:
    """Summarise draws of an angle with an equal-tailed interval.

    **Arguments**
    - `angles_deg`: any multiples of a turn, shape (m,).
    - `probability`: inside the interval.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.posterior.summary.draws import circular_summary
    >>> found = circular_summary(np.array([350.0, 358.0, 2.0, 6.0, 374.0]))
    >>> round(found.mean, 2), round(found.low, 2), round(found.high, 2)
    (2.0, -9.2, 13.2)

    ```
    """
    from scipy.stats import circmean, circstd  # slow to import

    # Rounding can make it 360 itself.
    mean = float(wrap_deg(circmean(angles_deg, high=360, low=0)))
    way = difference_deg(angles_deg, mean)
    tail = (1.0 - probability) / 2.0
    low, median, high = mean + np.quantile(way, [tail, 0.5, 1.0 - tail])
    std = float(circstd(angles_deg, high=360, low=0))
    return CircularSummary(mean, std, float(median), float(low), float(high))


_TAILS = (0.025, 0.5, 0.975)
_NEGATIVE = "negative, which no gap is: friction or wind-up ahead of the gap, or a wrong sign"
_UPPER = "below three standard errors: an upper limit only"
_NOT_SAMPLED = "not sampled: the value of the fit"
_BATCHES = 8
"""Stretches in time into which the draws of one ensemble are cut."""


@dataclass(frozen=True)
class PosteriorParameter(Parameter):
    """A parameter from draws: its interval is equal-tailed, its `median` stands beside it.

    `value` is the posterior mean. For an amplitude it is the length of the mean vector, not the
    mean of the lengths, which noise makes too long; its `std`, `median` and interval are those of
    the lengths. The value of a phase is the circular mean.
    """

    median: float | None = None

    def to_json(self) -> dict:
        """Fields of the contract with `median`."""
        return super().to_json() | {"median": self.median}


def border(name: str, unit: str) -> tuple[str, float]:
    """Unit in which people read a coordinate, and internal units per that unit."""
    if name == "constant_backlash":
        return "deg", DEG
    return {"rad": ("arcsec", ARCSEC)}.get(unit, (unit, 1.0))


def parameters_of_draws(
    fit: Fit,
    names: tuple[str, ...],
    flat: Float[np.ndarray, "n d"],
    delay_offset_s: float,
) -> dict[str, PosteriorParameter]:
    """Every name of the contract → parameter, in the order of the fit.

    What the fit calls undetermined stays so with its reason: the draws of such a coordinate only
    repeat the prior. A parameter without a coordinate keeps what the fit says.
    """
    column = {name: flat[:, place] for place, name in enumerate(names)}
    found: dict[str, PosteriorParameter] = {}
    for name, known in fit.parameters.items():
        if name in found:
            continue
        source, scale = _source(name)
        phase = _phase_name(name)
        if not known.determined:
            found[name] = PosteriorParameter(name, known.unit, reason=known.reason)
        elif source in column:
            offset = delay_offset_s if source == "delay" else 0.0
            found[name] = scalar_of_draws(name, known.unit, column[source] / scale + offset)
        elif phase is not None and f"{source}_x" in column:
            plane = np.stack([column[f"{source}_x"], column[f"{source}_y"]], axis=1) / scale
            found |= {p.name: p for p in polar_of_draws((name, phase), known.unit, plane)}
        else:
            found[name] = _kept(known)
    return {name: found[name] for name in fit.parameters}


def scalar_of_draws(name: str, unit: str, draws: Float[np.ndarray, " n"]) -> PosteriorParameter:
    """Mean, spread and equal-tailed interval of a coordinate that is quoted as it is."""
    value, std = float(draws.mean()), float(draws.std(ddof=1))
    low, median, high = (float(part) for part in np.quantile(draws, _TAILS))
    gap = name == "constant_backlash_deg"
    smallest = ROUNDING / DEG if gap else 0.0
    significant = abs(value) >= max(SIGNIFICANT * std, smallest)
    reason = None if significant else BELOW
    if significant and gap and value < 0:
        significant, reason = False, _NEGATIVE
    return PosteriorParameter(
        name, unit, value, std, low, high, True, significant, reason, median=median
    )


def polar_of_draws(
    names: tuple[str, str], unit: str, plane: Float[np.ndarray, "n 2"]
) -> tuple[PosteriorParameter, PosteriorParameter]:
    """Amplitude and phase of draws of a plane vector.

    Below three standard errors (of the coordinate along the mean) the amplitude has its 95 %
    quantile as an upper limit, and the phase no value.
    """
    along_std = polar_spread(plane.mean(axis=0), np.cov(plane.T))
    value, std = along_std[0], along_std[1]
    length = np.hypot(plane[:, 0], plane[:, 1])
    low, median, high = (float(part) for part in np.quantile(length, _TAILS))
    if value < SIGNIFICANT * std:
        upper = float(np.quantile(length, 0.95))
        reason = f"{names[0]} is below three standard errors"
        return (
            PosteriorParameter(
                names[0], unit, value, std, 0.0, upper, True, False, _UPPER, upper, median
            ),
            PosteriorParameter(names[1], "deg", determined=True, reason=reason),
        )
    turn = circular_summary(np.arctan2(plane[:, 1], plane[:, 0]) / DEG)
    own_std = float(length.std(ddof=1))
    return (
        PosteriorParameter(names[0], unit, value, own_std, low, high, True, True, median=median),
        PosteriorParameter(
            names[1],
            "deg",
            turn.mean,
            turn.std,
            turn.low,
            turn.high,
            True,
            True,
            median=turn.median,
        ),
    )


def batches(
    chosen: Int[np.ndarray, " m"], shape: Sequence[int], pieces: int = _BATCHES
) -> Int[np.ndarray, " m"]:
    """Batch of every chosen draw: its ensemble and its stretch of steps.

    Draws of different batches are nearly independent, so that the scatter of batch means tells the
    Monte-Carlo error of their mean. `shape` is (ensembles, steps, walkers), the draws flattened in
    that order.
    """
    _, steps, walkers = shape
    step = chosen // walkers % steps
    pieces = min(pieces, steps)
    return chosen // (steps * walkers) * pieces + step * pieces // steps


def _source(name: str) -> tuple[str, float]:
    """Coordinate, or stem of the pair _x and _y, behind a parameter, and its scale."""
    if name == "constant_backlash_deg":
        return "constant_backlash", DEG
    if name == "delay_s":
        return "delay", 1.0
    scale = ARCSEC if name.endswith("_arcsec") else 1.0
    for ending in ("_eccentricity_mm", "_amplitude_arcsec", "_arcsec", "_phase_deg"):
        if name.endswith(ending):
            return name.removesuffix(ending), scale
    return name, 1.0


def _phase_name(name: str) -> str | None:
    """The phase that belongs to an amplitude; None for anything else."""
    if name.endswith(("_eccentricity_mm", "_amplitude_arcsec", "_encoder_arcsec")):
        return f"{_source(name)[0]}_phase_deg"
    return None


def _kept(known: Parameter) -> PosteriorParameter:
    fields = {key: getattr(known, key) for key in Parameter.__dataclass_fields__}
    return PosteriorParameter(**{**fields, "reason": known.reason or _NOT_SAMPLED})


@dataclass(frozen=True)
class Share:
    """A probability estimated from draws, with its Monte-Carlo standard error."""

    value: float
    std_error: float

    def __str__(self) -> str:
        return f"{self.value:.3g} ± {self.std_error:.1g}"


@dataclass(frozen=True)
class SmallestGap:
    """Draws of the smallest gap over the hunting period.

    **Arguments**
    - `pair`: for millimetres and tooth numbers.
    - `gap`: smallest backlash of every draw, rad of the driven gear, shape (m,).
    - `driving_angle`: where it is, rad, within the hunting period.
    - `batch`: draws of different batches are independent, shape (m,).
    """

    pair: GearPair | Drive
    gap: Float[np.ndarray, " m"]
    driving_angle: Float[np.ndarray, " m"]
    batch: Int[np.ndarray, " m"]

    @property
    def safe_closing_mm(self) -> Float[np.ndarray, " m"]:
        """Closing that takes up the smallest gap of each draw, s = j_min R₂/(tan β_L + tan β_R).

        **Raises** `NoAnswerError` for a drive and for untapered gears, which no closing moves.
        """
        return self.gap / _closing(self.pair)

    def probability_of_binding(self, closing_mm: float) -> Share:
        """Share of draws in which a closing, mm, binds anywhere: s > j_min R₂/(tan β_L + tan β_R).

        Its standard error is the larger of the binomial one and that of the batch means; where no
        draw or every draw binds, half a draw is taken to the other side.
        """
        binds = (self.safe_closing_mm < closing_mm).astype(float)
        count, value = len(binds), float(binds.mean())
        smoothed = (binds.sum() + 0.5) / (count + 1)
        binomial = np.sqrt(smoothed * (1 - smoothed) / count)
        return Share(value, float(max(binomial, self._batch_error(binds))))

    @property
    def place(self) -> tuple[float, float]:
        """Where most draws have their smallest gap, rad, and the share that has it there.

        Draws within one tooth of each other (a twelfth of a turn without teeth) count as one place.
        """
        teeth = 12 if isinstance(self.pair, Drive) else self.pair.driving.teeth
        bins = np.floor(self.driving_angle / (REV / teeth)).astype(int)
        common = np.bincount(bins).argmax()
        middle = float(np.median(self.driving_angle[bins == common]))
        period = self.pair.hunting_turns * REV
        away = np.abs((self.driving_angle - middle + period / 2) % period - period / 2)
        return middle, float(np.mean(away <= REV / teeth))

    def to_json(self) -> dict:
        """Quantiles of the smallest gap in degrees, where it is, and the safe closing in mm."""
        angle, share = self.place
        closing = None
        if not isinstance(self.pair, Drive) and float(self.pair.thinning):
            closing = _quantities(self.safe_closing_mm)
        return {
            "backlash_deg": _quantities(self.gap / DEG),
            "driving_deg": angle / DEG,
            "share_there": share,
            "safe_closing_mm": closing,
            "draws": len(self.gap),
        }

    def rows(self) -> list[tuple[str, str]]:
        """Names and values for people."""
        record = self.to_json()
        gap, closing = record["backlash_deg"], record["safe_closing_mm"]
        where = (
            f"at {record['driving_deg']:.1f}° in {100 * record['share_there']:.0f} % of the draws"
        )
        span = f"{gap['median']:.5f}° ({gap['low95']:.5f}° … {gap['high95']:.5f}°), 95 %, {where}"
        rows = [("smallest gap", span)]
        if closing is not None:
            span = f"{closing['median']:.4f} mm ({closing['low95']:.4f} … {closing['high95']:.4f})"
            rows.append(("closing that takes it up", f"{span}, 95 %"))
            safe = f"{closing['low95']:.4f} mm binds somewhere with probability 2.5 %"
            rows.append(("safe axial closing", safe))
        return rows

    def _batch_error(self, values: Float[np.ndarray, " m"]) -> float:
        """Standard error of the mean from the means of independent batches."""
        _, batch, counts = np.unique(self.batch, return_inverse=True, return_counts=True)
        if len(counts) < 2:
            return 0.0
        sums = np.bincount(batch, values)
        away = sums - counts * values.mean()
        return float(np.sqrt(np.sum(away**2) * len(counts) / (len(counts) - 1)) / len(values))


def _closing(pair: GearPair | Drive) -> float:
    """Backlash, rad, that one mm of axial displacement takes up."""
    thinning = 0.0 if isinstance(pair, Drive) else float(pair.thinning)
    if isinstance(pair, Drive) or not thinning:
        kind = "a drive without gear geometry" if isinstance(pair, Drive) else "gears without taper"
        raise NoAnswerError(f"no axial displacement closes the gap of {kind}.")
    return thinning / float(pair.reference_radii[1])


def _quantities(draws: Float[np.ndarray, " m"]) -> dict[str, float]:
    low, median, high = (float(part) for part in np.quantile(draws, _TAILS))
    return {
        "mean": float(draws.mean()),
        "std": float(draws.std(ddof=1)),
        "median": median,
        "low95": low,
        "high95": high,
    }

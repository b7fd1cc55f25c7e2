"""Checks of a fit as typed records.

The JSON object of a fit contains each record under the names of its fields. Numbers are in the
units at the end of their names. `log` is the number of a log, from 1.
"""

import math
from collections.abc import Sequence

from ...logs.checks.ratio import Verdict
from ...logs.checks.slope_cause import Cause
from ...pair.gear_pair import Flank
from ..preliminary.robust import Outliers
from ..solve.least_squares import Direction
from .gap_of_delay import GapOfDelay
from .order_table import Order
from .record import Record

REMEMBERS = 1e-3
"""Ljung–Box probability below which standard errors are estimated from blocks; chosen value."""


class Closure(Record, frozen=True):
    """Difference of the transmission error between two angles one hunting period apart.

    `period_deg` is the hunting period and `overlap_deg` the angle over which the difference was
    taken, both as driving angles.
    """

    period_deg: float
    overlap_deg: float
    rms_deg: float
    mean_deg: float


class Reversal(Record, frozen=True, omit_defaults=True):
    """Jump of the transmission error at a reversal: TE_B − TE_A at the angle `driving_deg`.

    `turn_deg` is the driving angle of the turning point. For a gear pair the record also contains
    the variable backlash j_v at `driving_deg` and the constant backlash by the paper's method,
    which is the jump minus j_v. `crossing` is True if the teeth may still be inside the gap there.
    """

    log: int
    driving_deg: float
    turn_deg: float
    jump_deg: float
    variable_backlash_deg: float | None = None
    constant_backlash_deg: float | None = None
    crossing: bool = False


_SIGNIFICANT = 3.0
"""Standard errors between jumps and gap above which they disagree; chosen value."""


class JumpComparison(Record, frozen=True):
    """Comparison of the jumps at the reversals with the fitted gap at the same driving angles.

    Values are in degrees of the driven shaft. `fitted_deg` is the median of the fitted gap at the
    jumps. `median_deg` is `fitted_deg` plus the median of (jump − fitted gap at its angle). `count`
    is the number of jumps.
    """

    count: int
    median_deg: float
    std_deg: float
    fitted_deg: float
    fitted_std_deg: float

    @property
    def agrees(self) -> bool:
        """Whether jumps and fitted gap differ by at most three standard errors."""
        std = math.hypot(self.std_deg, self.fitted_std_deg)
        return abs(self.median_deg - self.fitted_deg) <= _SIGNIFICANT * std

    @property
    def sentence(self) -> str:
        """Sentence that reports the comparison and explains a disagreement."""
        several = self.count > 1
        jumps = f"the {self.count} jumps at reversals" if several else "the jump at the reversal"
        beside = (
            f"({'median ' if several else ''}{self.median_deg:.5f}° ± {self.std_deg:.2g}°)"
            f" {{}} the fitted gap there ({self.fitted_deg:.5f}° ± {self.fitted_std_deg:.2g}°)"
        )
        if self.agrees:
            return f"{jumps} {beside.format('agree with' if several else 'agrees with')}"
        return (
            f"{jumps} {beside.format('disagree with' if several else 'disagrees with')}: one of the"
            " two is no backlash. Near a reversal the shafts are slow, so a delay, friction or"
            " wind-up that the fit takes for a gap is missing in the jumps, and a load that leaves"
            " its flank before the turn makes them too small; compare a slow log with a fast one"
        )


class RatioCheck(Record, frozen=True, omit_defaults=True):
    """Given ratio of a log, and the ratio that its angles show.

    `seen` and its standard error `std` are None for a log that contains only a TE curve. `cause` is
    what explains best a deviation from the given ratio.
    """

    given: str
    seen: float | None
    std: float | None
    verdict: Verdict
    cause: Cause = "open"


class Disagreement(Record, frozen=True):
    """Comparison of the first order of one shaft and flank between a log and the first log.

    `first_arcsec` and `this_arcsec` are the amplitudes in both logs. `difference_arcsec` is the
    absolute value |c − c₁| of the difference of the complex amplitudes; for logs without a common
    zero it is the difference of the amplitudes. `std_arcsec` is its standard error.
    """

    log: int
    shaft: str
    flank: str
    first_arcsec: float
    this_arcsec: float
    difference_arcsec: float
    std_arcsec: float


_CLEARLY = 6.0
"""A negative gap contradicts the log if its size is more than this number of rms residuals; a
smaller negative gap may come from friction or wind-up (chosen value)."""


class CoveredGap(Record, frozen=True):
    """TE_B − TE_A averaged over the driving angles that both flanks covered, in degrees.

    The mean counts each of the `covered_deg` degrees once. If the log cannot separate a delay from
    the gap, the interval is widened by the effect of the largest possible delay, and its negative
    part is cut off, because a gap cannot be negative. If the gap is not `determined`, `reason` says
    why, and the numbers are None.
    """

    value: float | None = None
    std: float | None = None
    low95: float | None = None
    high95: float | None = None
    determined: bool = False
    reason: str | None = None
    covered_deg: float = 0.0

    @property
    def in_words(self) -> str:
        """The gap with its 95 % interval, or the reason why it is undetermined."""
        if not self.determined:
            return f"undetermined ({self.reason})"
        return f"{self.value:.5f}° (95 % interval {self.low95:.5f} … {self.high95:.5f}°)"

    @property
    def is_contradiction(self) -> bool:
        """Whether the whole interval lies below zero, although a gap cannot be negative."""
        return self.determined and self.high95 is not None and self.high95 < 0

    def contradicts(self, residual_rms_deg: float) -> bool:
        """Return whether the gap is clearly negative, which contradicts the log.

        The whole interval must lie below zero, and the value must lie below zero by more than six
        times `residual_rms_deg`, the rms residual.
        """
        return self.is_contradiction and -(self.value or 0.0) > _CLEARLY * residual_rms_deg


class GapAtSpeed(Record, frozen=True):
    """Gap at one speed of the driving shaft, with standard error, degrees of the driven shaft."""

    speed_rpm: float
    value: float
    std: float


class Whiteness(Record, frozen=True):
    """Autocorrelation of the whitened residual at lags 1, 2, …, and its Ljung–Box test.

    `ljung_box` is the test statistic and `probability` its p-value. `widening` is the largest
    factor by which a standard error grows if it is estimated from the scatter of blocks of the log.
    """

    autocorrelation: tuple[float, ...]
    ljung_box: float
    probability: float
    widening: float = 1.0


UNKNOWN_STEP = 10.0
"""Steps of a walk above this many rms residuals are not determined (chosen). In the robot axes,
whose level wanders, a step is as large as the residual; in simulated logs a few times larger."""


class Wander(Record, frozen=True):
    """Random walk of the level of the transmission error.

    `step_arcsec` is the standard deviation of a step, and `knots_s` is the time of a step.
    `widening` is the largest factor by which the walk increases a standard error.
    `step_of_residual` is the step divided by the rms residual of the fit without the walk. Beyond
    `UNKNOWN_STEP` the other columns follow the walk, and the log does not determine its size.
    """

    step_arcsec: float
    knots_s: float
    widening: float
    step_of_residual: float = 0.0


class ResidualLine(Record, frozen=True):
    """Significant line of the residual; see `logs.lines.search.Line`.

    `log` is 0 for a search in all logs together, and `flank` is None for a search on both flanks.
    """

    log: int
    flank: Flank | None
    cycles_per_rev: float
    cycles_std: float
    amplitude_arcsec: float
    amplitude_std_arcsec: float
    phase_deg: float
    false_alarm: float


class JoinedLine(Record, frozen=True):
    """Line of the residual that was added to the model as a fractional order of the driving shaft.

    `replaced` names the orders near the line that were removed from the model, because BIC does not
    support them if the model has the line.
    """

    order: float
    cycles_per_rev: float
    cycles_std: float
    false_alarm: float
    replaced: tuple[str, ...] = ()


class HiddenShaft(Record, frozen=True):
    """Shaft without an encoder, found because several lines are multiples of its frequency.

    It turns `turns_per_rev` times per driving turn, and `orders` are the multiples that were found.
    `coincidence` is the likelihood of lines at random frequencies divided by the likelihood of this
    shaft.
    """

    turns_per_rev: float
    turns_std: float
    orders: tuple[int, ...]
    coincidence: float


class ReadingsComparison(Record, frozen=True, omit_defaults=True):
    """Deviations of backlash readings from the gap that a fit without these readings predicts.

    `scatter_deg` is the standard deviation of the deviations about their mean, and
    `expected_std_deg` the standard error of the predicted gap. `used` is True if the readings are
    data of the final fit. `contradicts` is None for one flank, which predicts no gap.
    """

    source: str
    sha256: str
    count: int
    rms_deg: float
    mean_deg: float
    scatter_deg: float
    largest_deg: float
    largest_at_deg: float
    expected_std_deg: float
    used: bool
    contradicts: bool | None = None


class PassDifference(Record, frozen=True):
    """Difference of the transmission error of two consecutive passes: later minus earlier pass.

    It is computed over the `overlap_deg` degrees of driving angle that both passes cover on the
    same flank. `scatter_deg` is the standard deviation of the difference about its mean.
    """

    log: int
    flank: Flank
    passes: tuple[int, int]
    overlap_deg: float
    mean_deg: float
    rms_deg: float
    scatter_deg: float


class HalfDifference(Record, frozen=True):
    """Comparison of the first order of one shaft and flank between two halves of a log.

    Every pass is divided in the middle. The first halves of all passes are fitted together, and so
    are the second halves. `first_arcsec` and `second_arcsec` are the amplitudes of both fits.
    `difference_arcsec` is the absolute value |c₂ − c₁| of the difference of the complex amplitudes,
    so that it includes a change of the phase. `std_arcsec` is its standard error.
    """

    log: int
    shaft: str
    flank: str
    first_arcsec: float
    second_arcsec: float
    difference_arcsec: float
    std_arcsec: float


class Checks(Record, frozen=True, kw_only=True):
    """Checks of a fit.

    A check that was not carried out is None or empty. `passes`, `halves`, `lines` and
    `hidden_shafts` are computed when they are first read, for example by a report. Until then they
    keep the block rows of the logs in memory. No other part of a fit depends on them.

    **Arguments**
    - `order_spectrum`: first orders of both shafts. - `closure`: see `Closure`.
    - `whiteness`: test of the residual. - `readings`: comparison with backlash readings.
    - `reversals`: jump at every reversal. - `jumps`: comparison of the jumps with the fitted gap.
    - `drawing_backlash_deg`: backlash of the drawing.
    - `ratio`: ratio of every log. - `agreement`: further logs compared with the first.
    - `gap_over_angles_covered`: mean gap over the driving angles that both flanks covered.
    - `gap_of_delay`: gap that a delay which is taken as zero may add to the fitted gap, or None.
    - `gap_by_speed`: gap at several speeds, after removal of the delay; empty at one speed.
    - `explained`: share of the variance of the transmission error that the harmonics explain, after
      offset, drift, delay and flank step are removed; None without variance.
    - `drift_order`, `drift_knots_s`, `drift_arcsec`: highest power of time, distance of the knots
      of a spline, and coefficients. - `drift_stiffness_s`: shortest period that the drift follows.
    - `wander`: random walk of the level beyond the drift; None if the log shows none.
    - `outliers`: outliers of every log; empty for least squares. - `solver_steps`: steps of the
      solver. - `weakest_direction`: combination of parameters with the largest standard error.
    - `passes`, `halves`: comparisons within each log. - `lines`: lines of the residual.
    - `joined_lines`: lines that were added to the model. - `hidden_shafts`: see `HiddenShaft`.
    """

    order_spectrum: tuple[Order, ...] = ()
    closure: Closure | None = None
    whiteness: Whiteness | None = None
    wander: Wander | None = None
    readings: ReadingsComparison | None = None
    reversals: tuple[Reversal, ...] = ()
    jumps: JumpComparison | None = None
    drawing_backlash_deg: float | None = None
    ratio: tuple[RatioCheck, ...] = ()
    agreement: tuple[Disagreement, ...] = ()
    gap_over_angles_covered: CoveredGap = CoveredGap()
    gap_of_delay: GapOfDelay | None = None
    gap_by_speed: tuple[GapAtSpeed, ...] = ()
    explained: float | None = None
    drift_order: int = 0
    drift_knots_s: float | None = None
    drift_stiffness_s: float | None = None
    drift_arcsec: tuple[float, ...] = ()
    outliers: tuple[Outliers, ...] = ()
    weakest_direction: Direction | None = None
    solver_steps: int = 0
    passes: Sequence[PassDifference] = ()
    halves: Sequence[HalfDifference] = ()
    lines: Sequence[ResidualLine] = ()
    joined_lines: tuple[JoinedLine, ...] = ()
    hidden_shafts: Sequence[HiddenShaft] = ()

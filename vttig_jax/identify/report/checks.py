"""Checks of a fit as typed records.

The JSON object of a fit contains each record under the names of its fields. Numbers are in the
units at the end of their names. `log` is the number of a log, from 1.
"""

import math
from collections.abc import Sequence

from ...logs.checks.ratio import Verdict
from ...pair.gear_pair import Flank
from ..preliminary.robust import Outliers
from ..solve.least_squares import Direction
from .order_table import Order
from .record import Record

REMEMBERS = 1e-3
"""Ljung–Box probability below which standard errors are estimated from blocks; chosen value."""


class Closure(Record, frozen=True):
    """Difference of the transmission error after one hunting period `period_deg`."""

    period_deg: float
    overlap_deg: float
    rms_deg: float
    mean_deg: float


class Reversal(Record, frozen=True, omit_defaults=True):
    """Jump of the transmission error at a reversal, TE_B − TE_A at the angle `driving_deg`.

    A fit of a gear pair also gives the variable backlash j_v at this angle, and the constant
    backlash by the paper's method, which is the jump minus j_v.
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

    Angles are in degrees of the driven shaft. `median_deg` minus `fitted_deg` is the median of the
    differences between a jump and the fitted gap at its angle.
    """

    count: int
    median_deg: float
    std_deg: float
    fitted_deg: float
    fitted_std_deg: float

    @property
    def agrees(self) -> bool:
        """Whether both are the same within three standard errors of their difference."""
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


class RatioCheck(Record, frozen=True):
    """Given ratio of a log, and the ratio that the log shows; None for a TE-curve log."""

    given: str
    seen: float | None
    std: float | None
    verdict: Verdict


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
"""Least size of a gap below zero that contradicts the log, in rms residuals; a smaller one may be
friction or wind-up (chosen value)."""


class CoveredGap(Record, frozen=True):
    """TE_B − TE_A averaged over the driving angles that both flanks covered, in degrees.

    The mean counts each of the `covered_deg` degrees once. If the log cannot distinguish a delay
    from the gap, the interval also contains the bound of the delay, and it is cut at zero, because
    a gap cannot be negative.
    """

    value: float | None = None
    std: float | None = None
    low95: float | None = None
    high95: float | None = None
    determined: bool = False
    reason: str | None = None
    covered_deg: float = 0.0

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
    """Gap at a speed of the driving shaft, in degrees of the driven shaft."""

    speed_rpm: float
    value: float
    std: float


class Whiteness(Record, frozen=True):
    """Autocorrelation of the whitened residual from lag 1, and its Ljung–Box test.

    `widening` is the largest factor by which blocks of the log increase a standard error.
    """

    autocorrelation: tuple[float, ...]
    ljung_box: float
    probability: float
    widening: float = 1.0


class Wander(Record, frozen=True):
    """Random walk of the level: standard deviation of a step, and the time of a step.

    `widening` is the largest factor by which it increases a standard error.
    """

    step_arcsec: float
    knots_s: float
    widening: float


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
    """Shaft without an encoder in the log, to whose orders several lines belong.

    It turns `turns_per_rev` times per driving turn. `coincidence` is the likelihood of lines at
    random frequencies against that of this shaft.
    """

    turns_per_rev: float
    turns_std: float
    orders: tuple[int, ...]
    coincidence: float


class ReadingsComparison(Record, frozen=True, omit_defaults=True):
    """Deviations of backlash readings from the gap of a fit without the readings.

    `used` tells whether the readings are further data of the fit. `contradicts` is None for one
    flank, which expects no gap.
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
    """Difference of two consecutive passes over the same angles, the later minus the earlier."""

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
    `hidden_shafts` are computed when they are first read, and no other part of a fit depends on
    them. Until then they keep the block rows of the logs in memory. A report and a run folder read
    all of them.

    **Arguments**
    - `order_spectrum`: first orders of both shafts. - `closure`: see `Closure`.
    - `whiteness`: test of the residual. - `readings`: comparison with backlash readings.
    - `reversals`: jump at every reversal. - `jumps`: these beside the fitted gap.
    - `drawing_backlash_deg`: backlash of the drawing.
    - `ratio`: ratio of every log. - `agreement`: further logs compared with the first.
    - `gap_over_angles_covered`: mean gap over the driving angles that both flanks covered.
    - `gap_by_speed`: gap at the speeds of the log, beside the delay; empty at one speed.
    - `explained`: share of the variance of the transmission error that the harmonics explain,
      beside offset, drift, delay and flank step; None without variance.
    - `drift_order`, `drift_knots_s`, `drift_arcsec`: highest power of time, distance of the knots
      of a spline, and coefficients. - `drift_stiffness_s`: shortest period that the drift follows.
    - `wander`: random walk of the level beyond the drift; None if the log does not demand it.
    - `outliers`: of every log, for a robust loss. - `weakest_direction`, `solver_steps`: of the
      solver.
    - `passes`, `halves`: comparisons within each log. - `lines`: lines of the residual.
    - `joined_lines`: lines that joined the model. - `hidden_shafts`: shafts of several lines.
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

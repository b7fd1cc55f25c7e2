"""Records of a fit: its noise, its logs and its checks, as they stand in the JSON object."""

import math
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np
from jaxtyping import Float

from ..logs.checks.ratio import Cause, Verdict
from ..logs.lines.search import Line

Severity = Literal["warning", "question", "note"]
Outcome = Literal["ok", "partly_determined", "not_determined", "not_converged", "contradicts"]


class Record(msgspec.Struct, frozen=True):
    """Immutable record whose fields are the keys of its JSON object, in the same order."""

    def to_json(self) -> dict:
        """Return the JSON object of the record; numbers that are not finite become None."""
        plain = msgspec.json.encode(self, enc_hook=lambda value: value.tolist())
        return msgspec.json.decode(plain)


class Finding(Record, frozen=True):
    """One sentence on a fit.

    **Arguments**
    - `slug`: stable name of its kind. - `severity`: a "warning" changes a stated number or its
      meaning, a "question" is settled by the user, a "note" is a detail.
    - `sentence`, `cure`: what was seen, and what to do; the cure may be empty.
    - `numbers`: numbers of the sentence, with their units at the end of their names.
    """

    slug: str
    severity: Severity
    sentence: str
    cure: str = ""
    numbers: dict[str, float] = msgspec.field(default_factory=dict)

    @property
    def text(self) -> str:
        """The sentence with its cure."""
        return f"{self.sentence}; {self.cure}" if self.cure else self.sentence


class Noise(Record, frozen=True):
    """Noise of the rows of a fit: an autoregression n_k = Σ_j c_j n_{k−j} + innovation.

    **Arguments**
    - `coefficients`: c₁, c₂, … - `block_s`: duration of a row.
    - `std_deg`, `innovation_std_deg`: standard deviation of the noise and of its innovations.
    - `correlation_s`: time over which the noise averages out, half of ∫ ρ(t) dt.
    - `slow_share`: share of the variance of the noise that the rows before tell, 0 for white noise.
    """

    model: str
    coefficients: tuple[float, ...]
    block_s: float
    std_deg: float
    innovation_std_deg: float
    correlation_s: float
    slow_share: float

    def whitened(self, residual: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
        """Return the innovations of the residual rows of one run."""
        taps = np.append(1.0, -np.array(self.coefficients))
        return np.convolve(residual, taps)[len(self.coefficients) : len(residual)]


class LogStart(Record, frozen=True):
    """Angles of both shafts, relative to the first log, at which the angles of a log are zero.

    Each angle has a standard error, which is 0 for an angle that is not fitted. Both are None where
    the orders of both logs do not tell the start; the log then has orders of its own.
    """

    driving_deg: float | None
    driving_std_deg: float | None
    driven_deg: float | None
    driven_std_deg: float | None


class Disagreement(Record, frozen=True):
    """First order of a log (from 1) that is not that of the first log, on one flank, arcsec."""

    log: int
    shaft: str
    flank: str
    first_arcsec: float
    this_arcsec: float
    difference_arcsec: float
    std_arcsec: float

    def sentence(self, first: str) -> str:
        """Return both orders in words; `first` is the name of the first log."""
        return (
            f"the {self.shaft} shaft has a first order of {self.this_arcsec:.3g}″ on flank"
            f" {self.flank}, but {self.first_arcsec:.3g}″ in {first} (difference"
            f" as vectors {self.difference_arcsec:.3g}″ ± {self.std_arcsec:.2g}″)"
        )


class LogRecord(Record, frozen=True):
    """One log of a fit.

    **Arguments**
    - `source`, `sha256`: file and digest. - `zero`: its angles are zero at the first sample
      ("start") or at the encoder reading zero ("reading").
    - `start`: start angles. - `zero_readings`: shaft → reading at which its angle is zero, or the
      first reading of a log whose angles are zero at the reading zero.
    - `samples`: number of samples read, used, used on each flank, and not used (masked).
    """

    source: str
    sha256: str
    zero: str
    start: LogStart
    zero_readings: dict[str, int | float | None]
    samples: dict[str, int]


class CoveredGap(Record, frozen=True):
    """TE_B − TE_A averaged over the driving angles that both flanks covered, in degrees.

    The mean counts each of the `covered_deg` degrees once.
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


class GapAtSpeed(Record, frozen=True):
    """Gap at one speed of the driving shaft, with standard error, degrees of the driven shaft."""

    speed_rpm: float
    value: float
    std: float


class DelayOfPart(Record, frozen=True):
    """Delay of the driven channel around a time of a log (from 1), with standard error."""

    log: int
    time_s: float
    value: float
    std: float


@dataclass(frozen=True)
class FoundLine(Line):
    """Line of the residual that is no order; `joined`: whether it is an order of the model now."""

    joined: bool = False


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


class Closure(Record, frozen=True):
    """Difference of the transmission error between two angles one hunting period apart.

    `period_deg` is the hunting period and `overlap_deg` the angle over which the difference was
    taken, both as driving angles.
    """

    period_deg: float
    overlap_deg: float
    rms_deg: float
    mean_deg: float


class Reversal(Record, frozen=True):
    """Jump of the transmission error at a reversal: TE_B − TE_A at the angle `driving_deg`.

    `turn_deg` is the driving angle of the turning point. `variable_backlash_deg` is the fitted
    variable backlash j_v at `driving_deg`, and `constant_backlash_deg` the jump less j_v, the
    paper's way to the constant backlash; both are None in a log with a zero of its own. `crossing`
    is True if the teeth may still be inside the gap there. `std_deg` is the standard error of the
    jump by the scatter of its samples.
    """

    log: int
    driving_deg: float
    turn_deg: float
    jump_deg: float
    variable_backlash_deg: float | None = None
    constant_backlash_deg: float | None = None
    crossing: bool = False
    std_deg: float = 0.0


class JumpComparison(Record, frozen=True):
    """Jumps at the reversals beside the fitted gap over the angles covered, degrees.

    `median_deg` is the median of the jumps, each less the amount by which the fitted gap of its
    place exceeds the mean, and `std_deg` its standard error, from their scatter or from that of
    their samples, whichever is larger.
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
        return abs(self.median_deg - self.fitted_deg) <= 3 * std


class ReadingsComparison(Record, frozen=True):
    """Deviations of backlash readings from the gap that a fit without these readings predicts.

    `scatter_deg` is the standard deviation of the deviations about their mean, and
    `expected_std_deg` the standard error of the mean of the predicted gaps. `used` is True if the
    readings are data of the final fit.
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

    @property
    def contradicts(self) -> bool:
        """Whether the mean deviation is beyond chance."""
        std = math.hypot(self.expected_std_deg, self.scatter_deg / math.sqrt(self.count))
        return self.count > 1 and self.mean_deg**2 > 12 * std**2


class Checks(Record, frozen=True, kw_only=True):
    """Checks of a fit; one that was not carried out is None or empty.

    **Arguments**
    - `gap_over_angles_covered`: mean gap over the driving angles that both flanks covered.
    - `gap_by_speed`: gap at several speeds, after removal of the delay; empty at one speed.
    - `delay_by_parts`: delay in the parts of every log; empty where one delay explains the logs.
    - `explained`: share of the variance of the transmission error that the harmonics explain, after
      offset, drift, delay and flank step are removed; None without variance.
    - `likelihood_ratio`: component → 2 ln of its likelihood ratio: "drift", "delay_parts" and
      "gap_by_speed". Above 12 the report has a sentence on it.
    - `drift_arcsec`: largest less smallest level of a log.
    - `outliers`: share of rows that are left out as outliers.
    - `passes`, `solver_steps`: of the fit.
    - `lines`: lines of the residual that are no order.
    - `ratio`: ratio of every log. - `closure`: see `Closure`.
    - `reversals`: jump at every reversal. - `jumps`: their comparison with the fitted gap.
    - `readings`: comparison with backlash readings. - `drawing_backlash_deg`: that of the drawing.
    """

    gap_over_angles_covered: CoveredGap = CoveredGap()
    gap_by_speed: tuple[GapAtSpeed, ...] = ()
    delay_by_parts: tuple[DelayOfPart, ...] = ()
    explained: float | None = None
    likelihood_ratio: dict[str, float] = msgspec.field(default_factory=dict)
    drift_arcsec: float = 0.0
    outliers: float = 0.0
    passes: int = 0
    solver_steps: int = 0
    lines: tuple[FoundLine, ...] = ()
    ratio: tuple[RatioCheck, ...] = ()
    closure: Closure | None = None
    reversals: tuple[Reversal, ...] = ()
    jumps: JumpComparison | None = None
    readings: ReadingsComparison | None = None
    drawing_backlash_deg: float | None = None

"""Ratio that a log shows beside the given one, and what else a slope may come from.

The ratio is the slope of driven over driving angle, beside the motion that the teeth lose when they
cross the gap after a reversal. Let the driving shaft need the travel c to cross the gap. The place
s of the teeth in the gap, from 0 to 1, follows the play operator of the driving angle φ₁, and the
driven angle is linear in both:

    s ← min(max(s + Δφ₁ / c, 0), 1),    φ₂ = a + b φ₁ + k s.

c has the least sum of squares. In short strokes the crossing is a notable part of the travel: the
slope of φ₂ over φ₁ alone is then too small, and its residual is large. A slope of the transmission
error may also come from a delay or a drift; the likelihoods of the three are compared.
"""

import math
import tomllib
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from ...base.errors import LogError
from ...base.numerics.student_noise import fit_student_noise
from ...base.units import DEG, LENGTH_UNITS, REV
from ..encoder_log import EncoderLog
from ..slope import (
    APART,
    DEVIATIONS,
    MOST_TEETH,
    TOLERANCE,
    better_fraction,
    decimal_option,
    likely_fraction,
    ratio_option,
    slope,
)

_TEXTS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
"""Kind of a text (difference, cure, why) → verdict or cause → text, with words in braces."""

Cause = Literal["ratio", "delay", "drift", "open"]
"""Best explanation; "open" if none is clearly better than the others."""

CLEAR = 10.0
"""Least 2 Δ ln L by which an explanation must exceed the next one, as between a ratio and a delay
that changes (chosen)."""

_BLOCKS = 400  # largest number of blocks of the log, about; chosen value

_MOVES = 0.02
"""Share of the largest speed above which a direction of motion counts (chosen)."""


def cause_of_slope(log: EncoderLog) -> Cause:
    """Return what explains the slope of the transmission error of `log` best, by likelihood.

    Each explanation has one coefficient: of the driving angle, of its speed, or of the time. An
    offset, a gap between the two directions and first orders of the driving shaft are fitted beside
    it, in the means of blocks of rows, with autoregressive noise. The best explanation must be
    clearly better than the others and than noise alone.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs import EncoderLog
    >>> from vttig_jax.logs.checks.ratio import cause_of_slope
    >>> from vttig_jax.pair import parse_pair_spec
    >>> drive = parse_pair_spec({"drive": {"ratio": "1"}})
    >>> time = np.arange(4000) / 200.0
    >>> driving = 720 * time + 300 * np.sin(0.7 * time)
    >>> noise = 0.01 * np.random.default_rng(0).normal(size=4000)
    >>> late = driving - 0.005 * np.gradient(driving, time) + noise
    >>> cause_of_slope(EncoderLog.from_arrays(time, driving, late, pair=drive, unit="deg"))
    'delay'
    >>> fast = 1.001 * driving + noise
    >>> cause_of_slope(EncoderLog.from_arrays(time, driving, fast, pair=drive, unit="deg"))
    'ratio'

    ```
    """
    angle, speed = log.driving_angle, log.driving_speed.value
    way = np.sign(np.where(np.abs(speed) > _MOVES * np.abs(speed).max(), speed, 0.0))
    error = log.driven_angle - float(log.ratio) * angle
    columns = (error, angle, speed, log.time, np.ones(len(log)), way, np.cos(angle), np.sin(angle))
    edges = np.linspace(0, len(log), min(_BLOCKS, len(log)) + 1).astype(np.int64)
    sums = np.array([np.add.reduceat(column, edges[:-1]) for column in columns])
    level, angle, speed, time, *base = sums / np.diff(edges)
    plain = fit_student_noise(level, np.stack(base, axis=1))

    def gain(column: Float[np.ndarray, " b"]) -> float:
        columns = np.stack([*base, column - column.mean()], axis=1)
        return 2 * (fit_student_noise(level, columns, plain).log_likelihood - plain.log_likelihood)

    gains: dict[Cause, float] = {"ratio": gain(angle), "delay": gain(speed), "drift": gain(time)}
    best = max(gains, key=gains.__getitem__)
    others = max(0.0, *(size for name, size in gains.items() if name != best))
    return best if gains[best] > others + CLEAR else "open"


_MOST_ROWS = 4000  # largest number of samples that are compared (chosen)
_TRIALS = 40  # number of trial values of c, at equal ratios (chosen)
_LEAST = DEG  # least c, rad of the driving shaft (chosen)
_LONGEST = 0.9  # largest c, as a share of the travel of the driving shaft (chosen)


def without_lost_motion(
    log: EncoderLog,
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Return φ₁ and φ₂ − k s at up to `_MOST_ROWS` evenly spaced samples of a log."""
    rows = slice(None, None, -(-len(log) // _MOST_ROWS))
    driving, driven = log.driving_angle[rows], log.driven_angle[rows]
    travel = float(np.ptp(driving))
    crossings = np.geomspace(min(_LEAST, _LONGEST * travel), _LONGEST * travel, _TRIALS)
    columns = np.stack([np.ones_like(driving), driving - driving.mean()], axis=1)
    basis = np.linalg.qr(columns)[0]

    def rest(values: np.ndarray) -> np.ndarray:
        return values - basis @ (basis.T @ values)

    places = np.empty((len(driving), 2 * _TRIALS))
    places[0] = np.repeat([0.0, 1.0], _TRIALS)  # s at the start
    for row, moved in enumerate(np.diff(driving)[:, None] / np.tile(crossings, 2)):
        np.clip(places[row] + moved, 0.0, 1.0, out=places[row + 1])
    free = rest(places)
    size = np.maximum(np.sum(free**2, axis=0), 1e-300)
    lost = free.T @ rest(driven) / size
    best = int(np.argmax(lost**2 * size))
    return driving, driven - lost[best] * places[:, best]


SHIFT_TURNS, MOST_TOLERANCE = 0.015, 0.01
"""Over few turns the slope of a log is uncertain, because a first order resembles a wrong ratio.
The relative tolerance is then `SHIFT_TURNS` / (turns of the driven shaft), up to `MOST_TOLERANCE`,
which is one tooth of a gear with 100 teeth (both chosen)."""

SURELY = 2.0
"""Number of standard errors by which a deviation has to exceed the tolerance, so that the log shows
with 97.5 % that it does."""

DOUBTFUL = 3.0
"""A deviation of more than this many standard errors from the given ratio is reported (chosen). In
112 simulated logs with the correct ratio the largest deviation was 1.7."""

Verdict = Literal["agrees", "swapped", "sign", "swapped_sign", "differs", "none"]


@dataclass(frozen=True)
class SeenRatio:
    """Ratio estimated from a log, and the `given` ratio of the pair file.

    **Arguments**
    - `seen`, `std`: ratio in the log and its standard error; None for a log that gives the
      transmission error in place of the driven channel (TE-curve log).
    - `verdict`: whether `seen` agrees with `given`, or else with its inverse or its negative.
    - `cause`: what explains best that `seen` deviates from `given` by more than chance.
    - `travel`: path of the driving shaft from its lowest to its highest angle, rad.
    - `scatter`: rms of the motion of the driven shaft that does not follow the driving shaft, rad.
    - `lead`: text on the lead of a linear axis with which the log has the given ratio, or "".
    """

    seen: float | None
    std: float | None
    given: Fraction
    verdict: Verdict
    cause: Cause = "open"
    travel: float = 0.0
    scatter: float = 0.0
    lead: str = ""

    @property
    def better(self) -> Fraction | None:
        """Simple fraction that fits the log if the given ratio does not; see `better_fraction`."""
        if self.seen is None or self.verdict != "agrees":
            return None
        return better_fraction(self.given, self.seen, self.std or 0.0)

    @property
    def deviations(self) -> float:
        """Ratio in the log minus the given ratio, in standard errors.

        It is 0 if the log shows no ratio or if its standard error is unknown.
        """
        if self.seen is None or not self.std:
            return 0.0
        return (self.seen - float(self.given)) / self.std

    @property
    def is_doubtful(self) -> bool:
        """Whether the ratio in the log deviates by more than chance, but is not refused."""
        return self.verdict == "agrees" and abs(self.deviations) > DOUBTFUL

    @property
    def short(self) -> str:
        """Short text with the ratio in the log and the given ratio."""
        given = f"{self._given} given"
        if self.seen is None:
            return f"{given}, a TE-curve log has none to check"
        return f"{self.seen:.6g} ± {self.std:.1g} seen, {given}"

    @property
    def _given(self) -> str:
        decimal = f"{float(self.given):.6g}"
        return decimal if str(self.given) == decimal else f"{self.given} = {decimal}"

    @property
    def sentence(self) -> str:
        """Sentence on the ratio in the log, with advice if it disagrees with the given ratio."""
        given = self._given
        if self.seen is None:
            return f"a TE-curve log has no ratio to check; {given} is taken as given."
        seen = f"the log shows a ratio of {self.seen:.6g} ± {self.std:.1g}"
        if self.verdict == "agrees":
            if self.better is None or self.cause in ("delay", "drift"):
                if not self.is_doubtful:
                    return f"{seen}, as given ({given})."
                off, share = self.deviations, self.seen / float(self.given) - 1
                rounded = max(self.given.numerator, self.given.denominator) > MOST_TEETH
                known = self.cause in ("delay", "drift") or not rounded
                why = self._said("why", self.cause if known else "rounded")
                return (
                    f"{seen}, {abs(off):.1f} standard errors {'above' if off > 0 else 'below'} the"
                    f" given {self.given} ({1e6 * share:+.3g} ppm){self._astray}{why}"
                )
            fits = f"{self.better} fits, so write that if these are the teeth: {self._option}."
            biases = "which biases gap, delay and orders"
            return f"{seen}, {given} given{self._astray}, {biases}; {fits}"
        log_has = f"the log's is {self._said('difference', self.verdict)}"
        far = abs(float(self.given) - 1) > 2 * TOLERANCE
        divided = far and abs(self.seen - 1) < TOLERANCE and self.verdict == "differs"
        cure = self._said("cure", "divided" if divided else self.verdict)
        return f"{seen}, but {given} is given{self._astray}; {log_has}; {cure}."

    def _said(self, kind: str, slug: str) -> str:
        """Return a text of `_TEXTS` with the numbers of this ratio."""
        seen, std = self.seen or 0.0, self.std or 0.0
        found = likely_fraction(abs(seen), std) if seen else None
        near = f"{seen:.6g}" if found is None else f"{found if seen > 0 else -found}"
        inverse = 1 / self.given
        if max(inverse.numerator, inverse.denominator) > MOST_TEETH:
            # The given ratio is a rounded decimal, and its inverse would be a wrong ratio.
            inverse = found or inverse
        return _TEXTS[kind][slug].format(
            given=self.given,
            scale=1 / self.given,
            turns=f"{inverse.denominator}:{inverse.numerator}",
            inverse=inverse,
            lead=self.lead,
            option=self._option,
            decimal=decimal_option(abs(seen or 1.0), std),
            near=near,
            said="is" if self.cause == "ratio" else "may be",
        )

    @property
    def _option(self) -> str:
        """Option that states the ratio of the log."""
        return f"--ratio {ratio_option(abs(self.seen or 1.0), self.std or 0.0)}"

    @property
    def _astray(self) -> str:
        """Text on how far the given ratio goes astray over the log; it begins with a comma."""
        if self.seen is None or not self.travel or self.verdict not in ("agrees", "differs"):
            return ""
        degrees = abs(self.seen - float(self.given)) * self.travel / DEG
        return f", off by {degrees:.3g}° of the driven shaft over this log"


def seen_ratio(log: EncoderLog) -> SeenRatio:
    """Estimate the ratio of driven to driving speed by regression over the log, with a verdict.

    If the slope leaves so much that the shafts do not seem to turn together, the motion that the
    teeth lose in the gap is left out of the driven angle.

    A ratio within the tolerance that deviates by more than chance is not refused, because a belt
    that creeps and a rounded decimal are good logs. The result then says what explains it best.
    """
    if log.driven is None:
        return SeenRatio(None, None, log.ratio, "none")
    driving, driven = log.driving_angle, log.driven_angle
    middle, travel = driving - driving.mean(), float(np.ptp(driving))
    rest = driven - float(driven @ middle / (middle @ middle)) * middle
    if not _turn_together(log, float(np.std(rest))):
        driving, driven = without_lost_motion(log)
    seen, std = slope(driving, driven)
    turns = max(float(np.ptp(log.driven_angle)) / REV, 1e-9)
    tolerance, given = max(TOLERANCE, min(MOST_TOLERANCE, SHIFT_TURNS / turns)), float(log.ratio)
    verdicts: dict[Verdict, float] = {"agrees": given, "sign": -given}
    verdicts |= {"swapped": 1 / given, "swapped_sign": -1 / given, "differs": seen}
    verdict: Verdict = next(
        name
        for name, value in verdicts.items()
        if abs(seen - value) <= max(tolerance * abs(value) + SURELY * std, DEVIATIONS * std)
    )
    scatter = float(np.std(driven - seen * driving))
    found = SeenRatio(seen, std, log.ratio, verdict, travel=travel, scatter=scatter)
    for one, power in ((log.driving, -1), (log.driven, 1)):
        if one.unit in LENGTH_UNITS:
            lead = abs(seen / log.ratio) ** power * REV / abs(one.radians_per_unit)
            text = f"the lead (--lead-mm {lead * LENGTH_UNITS[one.unit]:.4g}), or "
            found = replace(found, lead=text)
    return replace(found, cause=cause_of_slope(log)) if found.is_doubtful else found


def check_ratio(log: EncoderLog) -> SeenRatio:
    """Return `seen_ratio`, or raise `LogError` if the log contradicts the given ratio.

    A contradiction is a deviation of more than 5 standard errors that is also, by at least two
    standard errors, more than 0.5 % (up to 1 % if the driven shaft covers less than three turns).
    Shafts that do not turn together are a contradiction too.
    """
    ratio = seen_ratio(log)
    if log.driven is not None and not _turn_together(log, ratio.scatter):
        raise LogError(
            f"the two channels do not turn together: {np.degrees(ratio.scatter):.3g}° rms of the"
            f" {np.degrees(np.ptp(log.driven_angle)):.3g}° that the driven shaft turns do not"
            " follow the driving shaft; name the right columns with --column driving=NAME --column"
            " driven=NAME.",
            where=log.place.at("driven"),
        )
    if ratio.verdict not in ("agrees", "none"):
        raise LogError(ratio.sentence, where=log.place.at("driven"))
    return ratio


def _turn_together(log: EncoderLog, scatter: float) -> bool:
    """Return whether a residual of rms `scatter`, rad, is small against the driven shaft's travel.

    The rms of the rounding to the steps of both encoders does not count.
    """
    assert log.driven is not None
    steps = math.hypot(log.driven.resolution, float(log.ratio) * log.driving.resolution)
    return scatter**2 - steps**2 / 12 <= (APART * float(np.ptp(log.driven_angle))) ** 2

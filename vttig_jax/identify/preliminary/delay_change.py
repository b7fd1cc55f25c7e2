"""Change of the delay within a log, and the wrong ratio that may look like one.

A wrong ratio gives the transmission error a slope. If speed or direction differ between the two
halves of a log, the offsets and the drift absorb a part of this slope, and the rest looks like a
different delay in each half. Both explanations (changed delay, wrong ratio) have one coefficient,
so that their likelihoods can be compared directly.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...base.errors import NoAnswerError
from ...pair.gear_pair import Drive
from ..compress.block_rows import LogRows
from ..compress.harmonic_summary import summarise
from ..model.column_layout import own_parameters
from ..noise.noise_model import autoregression
from .delay import TOLD
from .delay_blocks import DelayBlocks
from .linear_fit import LinearFit, linear_fit
from .model_selection import SelectedModel
from .nuisance import own_terms

_CHANGED = 3.0
"""Standard errors above which a change of the delay within a log is reported; chosen value."""

_TOLD_APART = 10.0
"""Twice the difference of two log-likelihoods above which one of the two explanations is preferred;
chosen value. On a robot axis of known ratio the right and the wrong explanation differ by six."""


@dataclass(frozen=True)
class Slope:
    """Error of the given ratio, in ppm, that may look like a change of the delay.

    `evidence` is 2 (ln L₁ − ln L₂), where L₁ is the likelihood of a changed delay and L₂ is the
    likelihood of a wrong ratio. It is negative if the wrong ratio explains the log better.
    """

    ppm: float
    std_ppm: float
    evidence: float


@dataclass(frozen=True)
class DelayChange:
    """Delay in the second half of a log minus the delay in the first half, with standard error, s.

    `slope` is the error of the ratio that would explain the change instead; it is None if it was
    not tested or if the ratio is exact.
    """

    change_s: float
    std_s: float
    slope: Slope | None = None

    @property
    def is_clear(self) -> bool:
        """Whether the change is larger than three of its standard errors."""
        return abs(self.change_s) > _CHANGED * self.std_s

    @property
    def sentence(self) -> str:
        """Sentence that reports the change of the delay (ms) and its possible cause.

        If a wrong ratio explains the log about as well or better, the sentence also gives the error
        of the ratio (ppm) and says how to check it.
        """
        seen = (
            f"the delay changes by {1e3 * self.change_s:+.3g} ± {1e3 * self.std_s:.1g} ms from the"
            " first half of the log to the second; the stated delay is a mean over the log, and its"
            " interval reaches at least 0.3 of the change to each side; the intervals of the gap"
            " and of the other parameters contain the values of a fit with one delay in each half"
        )
        cause = "a clock that drifts or a bus under changing load does this"
        rival = self.slope
        if rival is None or rival.evidence > _TOLD_APART:
            return f"{seen}; {cause}"
        wrong = f"a ratio {rival.ppm:+.0f} ± {rival.std_ppm:.0f} ppm off the given one"
        cure = "check the ratio in the pair file, or fit with --free-ratio"
        if rival.evidence < -_TOLD_APART:
            return (
                f"{seen}; but {wrong}, or a slow error that looks like one, explains the log better"
                f" (2 ΔlnL = {-rival.evidence:.0f}): {cure}"
            )
        return (
            f"{seen}; {wrong} explains the log as well (2 ΔlnL = {abs(rival.evidence):.1f}, and"
            f" {_TOLD_APART:.0f} would tell them apart) and makes another delay and gap: {cure}."
            f" Otherwise {cause}"
        )


_LATE = "delay_late"
"""Name of the regressor of a delay that exists only in the second half of a log."""


def delay_change(blocks: Sequence[DelayBlocks]) -> DelayChange | None:
    """Return the change of the delay from the first half of a log to the second half.

    `blocks` are the delays of the blocks of each log. The most significant change of all logs is
    returned. The result is None if there is no log whose two halves both determine the delay.
    """
    found = []
    for one in blocks:
        if one.halves is not None:
            (first, second), covariance = one.halves
            variance = covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1]
            found.append(DelayChange(float(second - first), float(np.sqrt(variance))))
    return _clearest(found)


def change_between_fits(linear: LinearFit) -> DelayChange | None:
    """Return the change of the delay as `delay_change` does, from one fit of each half of a log.

    Harmonics, gap and drift of such a fit are those of its half, so that a level that wanders from
    half to half does not look like a change of the delay.
    """
    found = []
    for log, rows in enumerate(linear.rows):
        middle = 0.5 * (linear.channels[log].time[0] + linear.channels[log].time[-1])
        late = [bool(run.curve.time.mean() > middle) for run in rows.runs]
        halves = [delay_of(linear, rows, [own == half for own in late]) for half in (False, True)]
        if halves[0] is not None and halves[1] is not None:
            (first, first_std), (second, second_std) = halves[0], halves[1]
            found.append(DelayChange(second - first, float(np.hypot(first_std, second_std))))
    return _clearest(found)


def _clearest(found: Sequence[DelayChange]) -> DelayChange | None:
    return max(found, key=lambda one: abs(one.change_s) / one.std_s, default=None)


def delay_of(
    linear: LinearFit, rows: LogRows, counted: Sequence[bool]
) -> tuple[float, float] | None:
    """Return the correction of the delay from some runs of one log, and its standard error, s.

    The correction is added to the delay that the linear fit has already removed. `counted` is True
    for each run that is used. The result is None if these runs do not determine the delay.
    """
    runs = tuple(run for run, own in zip(rows.runs, counted, strict=True) if own)
    if not runs:
        return None
    try:
        summary = summarise([replace(rows, runs=runs)], linear.model.terms)
        own = own_terms(summary, autoregression(summary))
    except (NoAnswerError, np.linalg.LinAlgError, ValueError):
        return None
    if "delay" not in own.names or own.left("delay") < TOLD:
        return None
    return own.estimate("delay", own.names)


def with_two_delays(selected: SelectedModel) -> SelectedModel:
    """Return the selected model with another delay in the second half of each log."""
    linear = selected.linear
    model = replace(linear.model, regressors=(*linear.model.regressors, _LATE))
    delay_s = linear.channels[0].delay_s
    other = selected.weights.look(linear.inputs, model, delay_s, linear.block_s)
    kept = {"delay", *(name for own in selected.summary.columns.own for name in own)}
    own = [
        tuple(name for name in each if name in kept or name.startswith(_LATE))
        for each in other.summary.columns.own
    ]
    return replace(selected, linear=other, summary=other.summary.keeping(own))


def with_rival(change: DelayChange | None, selected: SelectedModel) -> DelayChange | None:
    """Return the change of the delay, and compare it with a wrong ratio as another explanation.

    The comparison (`slope`) is added only to a significant change, and only if the ratio may be
    wrong: tooth counts make the ratio of a gear pair exact, and a fitted ratio is already free.
    """
    linear, weights = selected.linear, selected.weights
    names = list(dict.fromkeys((*own_parameters(selected.summary.columns)[0], "delay")))
    exact = not isinstance(linear.model.pair, Drive) or "ratio" in names
    if change is None or not change.is_clear or exact:
        return change
    tried = dict.fromkeys((*linear.model.regressors, "ratio", _LATE))
    own = linear_fit(
        linear.inputs,
        replace(linear.model, regressors=tuple(tried)),
        linear.channels[0].delay_s,
        weights.values,
        linear.block_s,
        segments=linear.segments,
        pulls=weights.pulls,
    ).own
    misfit = {rival: own.misfit([*names, rival]) for rival in ("ratio", _LATE)}
    per_ppm = 1e-6 * float(linear.inputs[0].log.ratio)
    value, std = own.estimate("ratio", [*names, "ratio"])
    evidence = own.rows * float(np.log(misfit["ratio"] / misfit[_LATE]))
    return replace(change, slope=Slope(value / per_ppm, std / per_ppm, evidence))

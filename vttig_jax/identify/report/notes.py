"""Notes on a fit, and the assumptions under which its numbers are valid."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import PurePath

import numpy as np

from ...base.units import DEG, REV
from ...logs.checks.ratio import SeenRatio
from ...logs.encoder_log import EncoderLog
from ..model.harmonics import TermPlan
from ..model.identifiability import Identifiability
from ..noise.noise_model import NoiseModel
from ..preliminary.delay import TOO_SHORT, Delay, one_speed
from ..preliminary.linear_fit import Input
from ..preliminary.model_selection import SelectedModel
from ..settings import FitSettings
from ..solve.least_squares import Solution
from .checks import Checks, CoveredGap, GapAtSpeed
from .covered_gap import depends_on_speed, gap_of_least_drift
from .estimate import Estimate
from .gap_of_delay import GapOfDelay
from .parameters import SIGNIFICANT, Parameter
from .per_log import LogRecord, differences

_SAMPLES = 10_000  # number of samples that decide whether a column was computed; chosen value
_PROPORTIONAL = 1e-8  # range of the deviation from a line, in ranges of the angle; chosen value
_CORRELATED = 0.9  # correlation of delay and backlash above which a note is given; chosen value


def warnings_of(
    selected: SelectedModel,
    identifiable: Identifiability,
    estimate: Estimate,
    regressors: tuple[Parameter, ...],
    logs: tuple[LogRecord, ...],
    *,
    checks: Checks,
) -> tuple[str, ...]:
    """Return the warnings: notes on doubtful numbers or on actions of the user, gravest first."""
    solution, change, delays = estimate.solved.solution, estimate.change, estimate.delays
    inputs, outliers = selected.linear.inputs, selected.weights.outliers
    return (
        *_contradicted_delay(selected.delay, estimate.rest_of_delay),
        *(one.found.unclear for one in inputs if one.found.unclear),
        *_open_delay(selected, identifiable),
        *_too_little_left_out(inputs, checks.gap_over_angles_covered),
        *_of_logs(inputs, [[one.sentence] if one.are_many else [] for one in outliers]),
        *solver_notes(solution),
        *(_computed(inputs) or _ratio_notes(regressors, checks, inputs[0].log)),
        *identifiable.notes,
        *_gap_alone(identifiable, checks.gap_over_angles_covered),
        *_negative_sum(selected, identifiable, solution),
        *([change.sentence] if change and change.is_clear else []),
        *([delays.sentence] if delays and delays.differ else []),
        *([estimate.frozen.sentence] if estimate.frozen else []),
        *_few_legs(estimate, checks.gap_over_angles_covered),
        *_speed_note(checks.gap_by_speed),
        *([checks.jumps.sentence] if checks.jumps and not checks.jumps.agrees else []),
        *differences(logs, of_gaps=not identifiable.short),
    )


def notes_of(
    selected: SelectedModel,
    identifiable: Identifiability,
    estimate: Estimate,
    of_delay: GapOfDelay | None,
    settings: FitSettings,
) -> tuple[str, ...]:
    """Return the notes that are not warnings: first conditions of the numbers, then log details."""
    inputs, outliers = selected.linear.inputs, selected.weights.outliers
    slow = [[one.sentence] if one.slow else [] for one in outliers]
    usual = [[] if one.slow or one.are_many else [one.sentence] for one in outliers]
    return (
        *_noise_notes(estimate.solved.noise),
        *_neglected_delay(selected.delay, of_delay, identifiable),
        *_unused_bound(selected.delay, identifiable, settings.delay_within_ms),
        *_of_logs(inputs, [[*one.found.notes] for one in inputs]),
        *_of_logs(inputs, slow),
        *identifiable.terms.dropped,
        *_fractional_notes(identifiable.terms),
        *_correlated(selected, identifiable, estimate.solved.solution),
        *selected.notes,
        *_of_logs(inputs, [[*one.log.notes] for one in inputs]),
        *_of_logs(inputs, usual),
    )


def _neglected_delay(
    delay: Delay, of_delay: GapOfDelay | None, identifiable: Identifiability
) -> list[str]:
    """Return the note on a delay that is taken as zero but may change the gap."""
    if of_delay is None or of_delay.bounded:
        return []
    steady = one_speed([s for own in identifiable.segments for s in own])
    cure = (
        "otherwise log a second speed, which tells the delay better"
        if steady
        else "if the delay may be larger, give its limit with --delay-within"
    )
    scale, unit = (1e3, "ms") if delay.std_s >= 1e-4 else (1e6, "µs")
    return [
        f"the delay, {scale * delay.step_s:.3g} ± {scale * delay.std_s:.2g} {unit}, is not"
        " significant and is taken as zero; it may change the gap by"
        f" ±{of_delay.half_width_deg:.2g}°, which the interval of the constant backlash contains."
        " If both channels are sampled at the same instant, say so with --delay off;"
        f" {cure}"
    ]


def _unused_bound(
    delay: Delay, identifiable: Identifiability, within_ms: float | None
) -> list[str]:
    """Return a note if the bound of the delay that the user gives changes nothing."""
    if within_ms is None:
        return []
    if len(identifiable.flanks) < 2:
        return ["--delay-within is not used: the log has one flank and therefore no backlash"]
    if delay.state != "fitted":
        return []
    found_ms = 1e3 * (delay.seconds + delay.step_s)
    beyond = f", and it lies beyond that limit of {within_ms:g} ms: check the limit"
    return [
        f"--delay-within is not used: the log itself tells the delay, {found_ms:.3g} ms"
        + (beyond if abs(found_ms) > within_ms else "")
    ]


def _noise_notes(noise: NoiseModel) -> list[str]:
    """Return a note if a log has no noise, for example a simulated log."""
    if not noise.is_rounding:
        return []
    return [
        "the log holds no noise: its harmonics leave less than a millionth of the transmission"
        f" error ({noise.std / DEG:.1g}°); the standard errors are those of a noise of that"
        " millionth and not those of a measurement, so a value that lies many of them off the truth"
        " may still be right to all digits that matter"
    ]


def _speed_note(gaps: Sequence[GapAtSpeed]) -> list[str]:
    """Return the note on a gap that depends on the speed."""
    if not depends_on_speed(gaps):
        return []
    slow, fast = gaps[0], gaps[-1]
    return [
        f"the gap depends on the speed: {slow.value:.4f}° ± {slow.std:.2g}° at"
        f" {slow.speed_rpm:.3g} rpm of the driving shaft and {fast.value:.4f}° ± {fast.std:.2g}° at"
        f" {fast.speed_rpm:.3g} rpm, beside the delay. No single gap describes the log: the"
        " interval of the gap contains that of every speed, and the delay may hold a part of the"
        " gap; fit slow and fast passes as logs of their own, or compare gaps of one speed only"
    ]


def _of_logs(inputs: Sequence[Input], own: Sequence[Sequence[str]]) -> list[str]:
    """Return the notes on the logs in one list; a note that all logs share appears once.

    `own` contains the notes on each log. Other notes begin with the name of the log if there are
    several.
    """
    shared = [note for note in next(iter(own), ()) if all(note in notes for notes in own)]
    notes = list(shared)
    for one, each in zip(inputs, own, strict=False):
        front = f"{PurePath(one.log.source).name}: " if len(inputs) > 1 else ""
        notes += [front + note for note in each if note not in shared]
    return notes


def _open_delay(selected: SelectedModel, identifiable: Identifiability) -> list[str]:
    """Return a note if the log cannot separate the delay from the backlash."""
    delay = selected.delay
    if not delay.is_bounded or len(identifiable.flanks) < 2:
        return []
    speeds = [abs(s.speed) for own in identifiable.segments for s in own]
    shift = 2 * float(identifiable.terms.ratio) * max(speeds) * 1e-6 / DEG
    short = delay.reason == TOO_SHORT
    cause, cure = ("so short a log", "longer strokes") if short else ("one speed", "a second speed")
    return [
        f"{cause} does not tell a delay from the backlash: every microsecond looks like"
        f" {shift:.2g}° of backlash. The interval allows ±{1e3 * delay.bound_s:.4g} ms; log {cure},"
        " or state the delay with --delay (0.5ms) or its limit with --delay-within"
    ]


def _contradicted_delay(delay: Delay, rest: tuple[float, float] | None) -> list[str]:
    """Return a note if the log shows another delay than the stated one."""
    if rest is None:
        return []
    seen = f"about {1e3 * (delay.seconds + rest[0]):.3g} ms"  # its error is that of white noise
    if delay.state == "given":
        stated = f"not of {1e3 * delay.seconds:.4g} ms as stated with --delay"
        cure = "correct it, or let the fit find the delay with --delay auto"
    else:
        stated = "although --delay off states that both channels are sampled at the same instant"
        cure = "fit without --delay off"
    return [
        f"the log shows a delay of {seen}, {stated}: a part of it is then taken for backlash and"
        f" eccentricity; {cure}"
    ]


def _negative_sum(
    selected: SelectedModel, identifiable: Identifiability, solution: Solution
) -> list[str]:
    """Return the note on a sum of backlash and delay that is below zero."""
    is_sum = selected.delay.is_bounded and len(identifiable.flanks) == 2
    if not is_sum or "constant_backlash" not in solution.names:
        return []
    index = solution.names.index("constant_backlash")
    value, std = solution.values[index], np.sqrt(solution.covariance[index, index])
    if not (solution.determined[index] and value < -SIGNIFICANT * std):
        return []
    speeds = [abs(s.speed) for own in identifiable.segments for s in own]
    late_ms = -1e3 * value / (2 * float(identifiable.terms.ratio) * max(speeds))
    return [
        "the sum of backlash and delay is below zero, which no gap is: the driving channel is late"
        f" by at least {late_ms:.2g} ms, or the columns are exchanged, which at a ratio of 1 shows"
        " only here; exchange them with --column driving=NAME --column driven=NAME, or give the"
        " delay with --delay"
    ]


def _correlated(
    selected: SelectedModel, identifiable: Identifiability, solution: Solution
) -> list[str]:
    """Return a note if fitted delay and constant backlash are strongly correlated."""
    names = ("delay", "constant_backlash")
    if selected.delay.state != "fitted" or not {*names} <= set(solution.names):
        return []
    pair = [solution.names.index(name) for name in names]
    spread = solution.covariance[np.ix_(pair, pair)]
    correlation = spread[0, 1] / np.sqrt(spread[0, 0] * spread[1, 1])
    if abs(correlation) <= _CORRELATED:
        return []
    steady = one_speed([s for own in identifiable.segments for s in own])
    return [
        "delay and constant backlash are hardly told apart (correlation"
        f" {correlation:+.3f}); their standard errors hold that"
        + (", and a second speed would separate them" if steady else "")
    ]


def _fractional_notes(terms: TermPlan) -> list[str]:
    """Return a note on fractional orders, which only the fit contains and other results omit."""
    names = [harmonic.name for harmonic in terms.fractional]
    if not names:
        return []
    single = len(names) == 1
    have, hold = ("has", "its phase holds") if single else ("have", "their phases hold")
    return [
        f"{', '.join(names)} {have} no fixed position on the gears: {hold} only at the zero of the"
        " log. The backlash map, `export`, `locate` and `simulate` leave"
        f" {'it' if single else 'them'} out"
    ]


def _gap_alone(identifiable: Identifiability, gap: CoveredGap) -> list[str]:
    """Return a note if both shafts turned so little that the log tells only the covered gap."""
    if len(identifiable.short) < len(identifiable.turns) or not gap.determined:
        return []
    return [
        "the shafts turned too little for their eccentricities and the constant backlash. The log"
        f" tells only the gap over the {gap.covered_deg:.0f}° of the driving shaft that both"
        f" directions covered: {gap.in_words}"
    ]


def _few_legs(estimate: Estimate, gap: CoveredGap) -> list[str]:
    """Return a note if the drift may hold a part of the gap, or make one."""
    if gap.value is not None and estimate.crossed:
        return [_left_out(estimate.crossed, gap.value)]
    if gap.value is None or (other := gap_of_least_drift(estimate)) is None:
        return []
    value, std = other
    if abs(gap.value - value) <= std:
        return []
    return [
        "a drift in time explains the log better than none, but with so few changes of direction"
        " and a shaft that makes only a part of a turn it resembles the backlash: the gap over the"
        f" covered angles is {gap.value:.3g}° with it and {value:.3g}° without it, and its interval"
        " contains both. Log the motion to and fro several times, or fit with --drift-order 0 if"
        " nothing drifts"
    ]


def _too_little_left_out(inputs: Sequence[Input], gap: CoveredGap) -> list[str]:
    """Return a note if the fitted gap takes more travel to cross than is left out of a log."""
    clear = [one for one in inputs if not one.found.unclear]
    by_motion = [one for one in clear if one.log.torque is None and one.log.direction is None]
    if gap.low95 is None or gap.value is None or not by_motion:
        return []
    least = min(by_motion, key=lambda one: one.found.crossing)
    ratio = abs(float(least.log.ratio))
    if gap.low95 * DEG <= ratio * least.found.crossing:
        return []
    return [
        f"the teeth need {gap.value / ratio:.3g}° of the driving shaft to cross the fitted gap of"
        f" {gap.value:.3g}°, but only {least.found.crossing / DEG:.3g}° after a reversal are left"
        f" out of {PurePath(least.log.source).name}, so that samples inside the gap may count as a"
        " flank and make it too small; log longer strokes, or remove these samples from the log"
    ]


def _left_out(crossed: Sequence[float], gap_deg: float) -> str:
    """Return a note on a drift that was left out because of the gaps `crossed`, rad."""
    low, high = (f"{number / DEG:.3g}°" for number in (min(crossed), max(crossed)))
    return (
        "a drift in time explains the log better than none, but it resembles the backlash and is"
        " left out, because the teeth cross a gap of"
        f" {low if low == high else f'{low} to {high}'} after the reversals beside such a drift;"
        f" the gap over the covered angles is {gap_deg:.3g}° without it, and its interval contains"
        " both. Log the motion to and fro several times"
    )


def _computed(inputs: Sequence[Input]) -> list[str]:
    """Return a note if the driven angle is proportional to the driving angle to the last digit."""
    for one in inputs:
        part = slice(None, None, max(1, len(one.log) // _SAMPLES))
        angle, driven = one.log.driving_angle[part], one.log.driven_angle[part]
        line = np.stack([np.ones_like(angle), angle], axis=1)
        coefficients = np.linalg.lstsq(line, driven, rcond=None)[0]
        if np.ptp(driven - line @ coefficients) <= _PROPORTIONAL * np.ptp(driven):
            return [
                f"the driven angle of {PurePath(one.log.source).name} is {coefficients[1]:.9g}"
                " times the driving angle to the last digit: one of both columns was computed from"
                " the other and not measured, so that this fit says nothing about gears; name the"
                " measured columns with --column driving=NAME and --column driven=NAME"
            ]
    return []


def solver_notes(solution: Solution) -> list[str]:
    """Return a note if the solver found no minimum."""
    if solution.converged:
        return []
    return [
        f"the solver stopped after {solution.steps} steps, {solution.misfit:.3g} standard"
        " deviations off the harmonics of the log; the relation made linear is"
        f" {solution.linear_misfit:.3g} off. The numbers say nothing: correct teeth and module"
        " of the pair file, list fewer orders in [fit], or record more turns"
    ]


def _ratio_notes(regressors: tuple[Parameter, ...], checks: Checks, log: EncoderLog) -> list[str]:
    """Return a note if the fitted ratio, or the ratio seen in a log, contradicts the given one."""
    for one in regressors:
        if one.name == "ratio" and one.significant and one.value is not None:
            off, std = (1e6 * part / float(log.ratio) for part in (one.value, one.std or 0.0))
            turns = float(np.ptp(log.driven_angle)) / REV if log.driven is not None else 0.0
            cure = (
                "it is wrong, or a slow error or wind-up looks the same over a part of a turn"
                if turns < 1
                else "check the teeth and counts_per_rev, because the numbers of this fit hold for"
                " the ratio that it found"
            )
            return [
                f"the ratio comes out {off - 1e6:+.0f} ± {std:.0f} ppm off {log.ratio} as given;"
                f" {cure}"
            ]
    if any(one.name == "ratio" for one in regressors):
        return []
    travel = float(np.ptp(log.driving_angle))
    seen = [
        SeenRatio(c.seen, c.std, Fraction(c.given), verdict=c.verdict, cause=c.cause, travel=travel)
        for c in checks.ratio
    ]
    return [one.sentence for one in seen if one.is_doubtful and one.cause != "delay"][:1]

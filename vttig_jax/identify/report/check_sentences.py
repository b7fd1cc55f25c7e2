"""Sentences on the checks of a fit."""

from fractions import Fraction

from ...logs.checks.fractions import better_fraction
from ..solve.least_squares import Direction
from .checks import (
    REMEMBERS,
    UNKNOWN_STEP,
    Checks,
    CoveredGap,
    HalfDifference,
    HiddenShaft,
    JoinedLine,
    PassDifference,
    ResidualLine,
    Reversal,
    Wander,
)

_SIGNIFICANT = 3.0  # standard errors above which a value is significant; chosen value

BOTH_GAPS = (
    "This mean contains what the eccentricities add at these angles; constant_backlash_deg is only"
    " the part that is the same at every angle"
)
"""Sentence on the two gaps of a report."""

_HALVES_DIFFER = 4.0
"""Standard errors above which a change between the halves of a log is reported; chosen value."""


def check_sentences(
    checks: Checks, *, several_logs: bool, has_noise: bool, gap_determined: bool
) -> list[str]:
    """Return a sentence for every check with a reportable result.

    **Arguments**
    - `checks`: checks of a fit.
    - `several_logs`: whether the fit has several logs, so that the sentences name the log.
    - `has_noise`: whether the log has noise; otherwise changes between its halves are not reported.
    - `gap_determined`: whether the constant backlash is a determined parameter.
    """
    return [
        *_repeatability(checks, several_logs, has_noise),
        *_gap(checks, several_logs, gap_determined),
        *_others(checks),
    ]


def _repeatability(checks: Checks, several: bool, has_noise: bool) -> list[str]:
    """Return sentences on closure, passes, halves, residual lines, whiteness and wander."""
    sentences = []
    if found := checks.closure:
        sentences.append(
            f"closure after {found.period_deg:g}°: {found.rms_deg:.5f}° rms"
            f" ({found.mean_deg:+.5f}° mean) over {found.overlap_deg:.0f}°"
        )
    sentences += [_pass(one, several=several) for one in checks.passes[:3]]
    if has_noise:
        sentences += [_half(one) for one in checks.halves if _differs(one)]
    sentences += [_joined(one) for one in checks.joined_lines]
    sentences += [_line(one) for one in checks.lines]
    sentences += [_shaft(one) for one in checks.hidden_shafts]
    if (white := checks.whiteness) and white.widening > 1 and white.probability >= REMEMBERS:
        sentences.append(
            "on few turns slow noise resembles an order: standard errors are up to"
            f" {white.widening:.2g} times larger, from the eight slowest waves (cosines) of the log"
        )
    elif white and white.widening > 1:
        sentences.append(
            "the residual remembers more than the noise model allows for (probability"
            f" {white.probability:.1g} by the Ljung–Box test of neighbouring residuals): standard"
            f" errors are taken from blocks of the log, up to {white.widening:.2g} times larger"
        )
    if (wander := checks.wander) and wander.widening > 1:
        sentences.append(_wanders(wander))
    return sentences


def _wanders(one: Wander) -> str:
    times = f"standard errors up to {one.widening:.2g} times larger"
    if one.step_of_residual > UNKNOWN_STEP:
        return (
            f"a level that wanders within {one.knots_s:.2g} s explains the log better than the"
            " drift, but the log does not tell by how much: the orders and the gap can take the"
            f" place of such a level, so that a second fit with it makes {times}"
        )
    return (
        f"the level of the transmission error wanders by {one.step_arcsec:.3g}″ in"
        f" {one.knots_s:.2g} s, which the drift does not follow: a second fit follows it, and its"
        f" results make {times}"
    )


def doubt(
    value: float | None,
    low95: float | None,
    high95: float | None,
    reason: str | None = None,
) -> str:
    """Return a remark in brackets that says why a value is not significant.

    `reason` is that of the parameter. If the interval does not contain zero, the remark states the
    rule of the reason, because "not significant" would contradict the interval beside it.

    **Example**
    ```python
    >>> from vttig_jax.identify.report.check_sentences import doubt
    >>> doubt(-0.5, -1.2, 0.2, "below three standard errors")
    ' (not significant)'
    >>> doubt(-0.5, -0.9, -0.1, "below 4 standard errors; the other parameters take it as zero")
    ' (below 4 standard errors, taken as zero)'
    >>> doubt(-0.5, -0.52, -0.48)
    ' (below zero)'

    ```
    """
    if value is None or low95 is None or high95 is None or low95 <= 0 <= high95:
        return " (not significant)"
    if reason is not None and reason.startswith("below"):
        rule, semicolon, _ = reason.partition(";")
        return f" ({rule}, taken as zero)" if semicolon else f" ({rule})"
    return " (below zero)" if value < 0 else " (not significant)"


def _gap(checks: Checks, several: bool, gap_determined: bool) -> list[str]:
    """Return sentences on the jumps at reversals, and on the mean gap over the covered angles.

    The mean gap is reported if the constant backlash is not determined, or if the gap is negative.
    """
    sentences = [_jump(one, several=several) for one in checks.reversals[:3]]
    if checks.jumps and checks.jumps.agrees:
        sentences.append(checks.jumps.sentence)
    elif not checks.jumps and any(one.crossing for one in checks.reversals):
        sentences.append(
            "these jumps lie where the teeth may still cross the gap that was fitted, so they are"
            " no test of it"
        )
    gap = checks.gap_over_angles_covered
    if gap.determined and (not gap_determined or gap.is_contradiction):
        sentences.append(_covered(gap))
    return sentences


def _covered(gap: CoveredGap) -> str:
    mark = ", no significant backlash"
    if gap.is_contradiction:
        mark = ": below zero, so friction, wind-up or a wrong sign and no backlash"
    elif (gap.value or 0.0) >= _SIGNIFICANT * (gap.std or 0.0):
        mark = ""
    return (
        f"flank B stands {gap.value:+.5f}° ± {gap.std:.5f}° above flank A over the"
        f" {gap.covered_deg:.0f}° of the driving shaft that both flanks covered{mark}. {BOTH_GAPS}"
    )


def _others(checks: Checks) -> list[str]:
    """Return sentences on ratio, backlash readings, weakest direction and drawing backlash."""
    sentences = []
    for log in checks.ratio[:1]:
        if log.seen is not None:
            sentences.append(f"ratio {log.given} given, {log.seen:.9g} ± {log.std:.1g} seen")
            if better := better_fraction(Fraction(log.given), log.seen, log.std or 0.0):
                sentences[-1] += f"; {better} fits, so write that if these are the teeth"
    if read := checks.readings:
        joined = "joined the fit" if read.used else "check only"
        sentences.append(
            f"{read.count} backlash readings ({joined}): {read.mean_deg:+.5f}° mean,"
            f" {read.rms_deg:.5f}° rms from the fit, scatter {read.scatter_deg:.5f}°"
            + (": they contradict it" if read.contradicts else "")
        )
    if weakest := checks.weakest_direction:
        sentences.append(_weakest(weakest))
    if (drawing := checks.drawing_backlash_deg) is not None:
        sentences.append(f"constant backlash by the drawing: {drawing:.4f}°")
    return sentences


def _pass(one: PassDifference, *, several: bool) -> str:
    first, second = one.passes
    place = f" of log {one.log}" if several else ""
    return (
        f"flank {one.flank}{place}, pass {second} minus pass {first}: {one.mean_deg:+.5f}°"
        f" mean, {one.scatter_deg:.5f}° scatter over {one.overlap_deg:.0f}°"
    )


def _differs(one: HalfDifference) -> bool:
    return one.difference_arcsec > _HALVES_DIFFER * one.std_arcsec


def _half(one: HalfDifference) -> str:
    return (
        f"{one.shaft} order 1 on flank {one.flank} changes by"
        f" {one.difference_arcsec:.3g}″ ± {one.std_arcsec:.2g}″ from the first half of the"
        " log to the second"
    )


def _line(one: ResidualLine) -> str:
    place = f" of log {one.log}" if one.log else ""
    place += f" on flank {one.flank}" if one.flank else ""
    return (
        f"line left in the residual{place}: {one.amplitude_arcsec:.3g}″ ±"
        f" {one.amplitude_std_arcsec:.1g}″ at {one.cycles_per_rev:.5g} cycles per"
        f" driving revolution (probability {one.false_alarm:.1g} by chance)"
    )


def _joined(one: JoinedLine) -> str:
    return (
        f"line of the residual at {one.cycles_per_rev:.7g} ± {one.cycles_std:.1g} cycles per"
        f" driving revolution joined the model as driving order {one.order} (false alarm"
        f" {one.false_alarm:.1g})"
    )


def _shaft(one: HiddenShaft) -> str:
    *first, last = map(str, one.orders)
    return (
        f"a hidden shaft turns {one.turns_per_rev:.7g} ± {one.turns_std:.1g} times per driving turn"
        f" (orders {', '.join(first)} and {last} found; coincidence {one.coincidence:.1g})"
    )


def _jump(one: Reversal, *, several: bool) -> str:
    place = f" of log {one.log}" if several else ""
    sentence = f"jump at {one.driving_deg:.1f}°{place}: {one.jump_deg:.5f}°"
    if one.constant_backlash_deg is None:
        return sentence
    return sentence + (
        f", less j_v there {one.constant_backlash_deg:.5f}° (the paper's way to the"
        " constant backlash)"
    )


def _weakest(weakest: Direction) -> str:
    shares = weakest.parameters.items()
    named = [(name.replace("_of_", " of log ").replace("_", " "), share) for name, share in shares]
    text = " ".join(f"{'−' if share < 0 else '+'} {name}" for name, share in named)
    return (
        f"hardest to tell apart: {text.removeprefix('+ ')}; this combination has"
        f" {weakest.inflation:.3g} times the standard error of one parameter fitted alone"
    )

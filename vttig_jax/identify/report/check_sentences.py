"""Sentences on the checks of a fit."""

from collections.abc import Mapping
from typing import Any

_HALVES_DIFFER = 4.0
"""Standard errors above which a change between the halves of a log is reported; chosen value."""


def check_sentences(
    checks: Mapping[str, Any], *, several_logs: bool, has_noise: bool, gap_determined: bool
) -> list[str]:
    """Return a sentence for every check with a reportable result.

    **Arguments**
    - `checks`: checks of a fit. - `several_logs`: whether the sentences name the log.
    - `has_noise`: whether the log has noise; otherwise changes between its halves are not reported.
    - `gap_determined`: whether the constant backlash is a determined parameter.
    """
    return [
        *_repeatability(checks, several_logs, has_noise),
        *_gap(checks, several_logs, gap_determined),
        *_others(checks),
    ]


def _repeatability(checks: Mapping[str, Any], several: bool, has_noise: bool) -> list[str]:
    """Return sentences on closure, passes, halves, lines in the residual, and whiteness."""
    sentences = []
    if found := checks["closure"]:
        sentences.append(
            f"closure after {found['period_deg']:g}°: {found['rms_deg']:.5f}° rms"
            f" ({found['mean_deg']:+.5f}° mean) over {found['overlap_deg']:.0f}°"
        )
    sentences += [_pass(one, several=several) for one in checks.get("passes", [])[:3]]
    if has_noise:
        sentences += [_half(one) for one in checks.get("halves", []) if _differs(one)]
    for line in checks.get("lines", []):
        place = f" of log {line['log']}" if line["log"] else ""
        place += f" on flank {line['flank']}" if line.get("flank") else ""
        sentences.append(
            f"line left in the residual{place}: {line['amplitude_arcsec']:.3g}″ ±"
            f" {line['amplitude_std_arcsec']:.1g}″ at {line['cycles_per_rev']:.5g} cycles per"
            f" driving revolution (false alarm {line['false_alarm']:.1g})"
        )
    white = checks.get("whiteness")
    if white and white["widening"] > 1:
        sentences.append(
            "the residual remembers more than the noise model allows for (Ljung–Box"
            f" {white['probability']:.1g}): standard errors are taken from blocks of the log,"
            f" up to {white['widening']:.2g} times larger"
        )
    return sentences


def _gap(checks: Mapping[str, Any], several: bool, gap_determined: bool) -> list[str]:
    """Return sentences on jumps at reversals, and on the gap if no constant backlash is known."""
    sentences = []
    for jump in checks["reversals"][:3]:
        place = f" of log {jump['log']}" if several else ""
        sentence = f"jump at {jump['driving_deg']:.1f}°{place}: {jump['jump_deg']:.5f}°"
        if "constant_backlash_deg" in jump:
            sentence += (
                f", less j_v there {jump['constant_backlash_deg']:.5f}° (the paper's way to the"
                " constant backlash)"
            )
        sentences.append(sentence)
    if (gap := checks.get("apparent_gap")) and not gap_determined:
        low = gap["value_deg"] < -3 * gap["std_deg"]
        mark = ", no significant backlash"
        if gap["significant"]:
            mark = ""
        elif low:
            mark = ": below zero, so friction or wind-up and no backlash"
        sentences.append(
            f"flank B stands {gap['value_deg']:+.5f}° ± {gap['std_deg']:.5f}° above flank A"
            f" over the angles covered{mark}"
        )
    return sentences


def _others(checks: Mapping[str, Any]) -> list[str]:
    """Return sentences on ratio, readings, weakest direction and drawing."""
    sentences = []
    for log in checks.get("ratio", [])[:1]:
        if log["seen"] is not None:
            sentences.append(
                f"ratio {log['given']} given, {log['seen']:.9g} ± {log['std']:.1g} seen"
            )
    if read := checks.get("readings"):
        joined = "joined the fit" if read["used"] else "check only"
        sentences.append(
            f"{read['count']} backlash readings ({joined}): {read['mean_deg']:+.5f}° mean,"
            f" {read['rms_deg']:.5f}° rms from the fit, scatter {read['scatter_deg']:.5f}°"
            + (": they contradict it" if read.get("contradicts") else "")
        )
    if weakest := checks.get("weakest_direction"):
        sentences.append(_weakest(weakest))
    if (drawing := checks["drawing_backlash_deg"]) is not None:
        sentences.append(f"constant backlash by the drawing: {drawing:.4f}°")
    return sentences


def _pass(one: dict, *, several: bool) -> str:
    first, second = one["passes"]
    place = f" of log {one['log']}" if several else ""
    return (
        f"flank {one['flank']}{place}, pass {second} less pass {first}: {one['mean_deg']:+.5f}°"
        f" mean, {one['scatter_deg']:.5f}° scatter over {one['overlap_deg']:.0f}°"
    )


def _differs(one: dict) -> bool:
    return one["difference_arcsec"] > _HALVES_DIFFER * one["std_arcsec"]


def _half(one: dict) -> str:
    return (
        f"{one['shaft']} order 1 on flank {one['flank']} changes by"
        f" {one['difference_arcsec']:.3g}″ ± {one['std_arcsec']:.2g}″ from the first half of the"
        " log to the second"
    )


def _weakest(weakest: dict) -> str:
    shares = weakest["parameters"].items()
    named = [(name.replace("_of_", " of log ").replace("_", " "), share) for name, share in shares]
    text = " ".join(f"{'−' if share < 0 else '+'} {name}" for name, share in named)
    return (
        f"weakest direction: {text.removeprefix('+ ')} (standard error ×"
        f" {weakest['inflation']:.3g})"
    )

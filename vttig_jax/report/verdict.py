"""What a run means in three sentences, and what to record next."""

import math

import numpy as np

from ..base.units import ARCSEC, DEG
from ..identify.result import Fit
from ..pair.gear_pair import GearPair
from ..plotting.curves import driving_turns, residual_spectrum
from ..runs.map_table import RunTable
from .content import RunContent

_MEANT = {
    "backlash_deg": "the backlash",
    "eccentricity_mm": "the eccentricities",
    "amplitude_arcsec": "the errors once per turn",
    "encoder_arcsec": "the errors of the encoders",
    "delay_s": "the delay between the channels",
}
"""End of the name of a parameter → what it tells in plain words."""

_FAILED = {
    "not_converged": "The fit did not converge, so that none of its numbers is to be trusted.",
    "contradicts": "The log contradicts itself: its numbers are not those of a pair of gears.",
    "not_determined": "The log determines no parameter of the gears, for the reasons below.",
}


def verdict(content: RunContent) -> tuple[str, str, str]:
    """Return three sentences: what the log tells, the main number, and how far to trust it."""
    return _told(content.run.fit), _main(content), _trust(content.run.fit)


def _told(fit: Fit) -> str:
    """Return which quantities the log tells and which it does not."""
    told: dict[bool, list[str]] = {True: [], False: []}
    for end, meant in _MEANT.items():
        own = [p for name, p in fit.parameters.items() if name.endswith(end)]
        own = [p.determined for p in own if not (p.reason or "").startswith("not fitted")]
        own += [fit.checks.gap_over_angles_covered.determined] * ("backlash" in end)
        if own:
            told[any(own)].append(meant)
    left = f", but not {_and(told[False], ' or ')}" if told[False] else ""
    return _FAILED.get(fit.outcome, f"The log tells {_and(told[True])}{left}.")


def _and(words: list[str], last: str = " and ") -> str:
    return last.join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def _main(content: RunContent) -> str:
    """Return the sentence with the main number: the gap, or the transmission error."""
    fit, found = content.run.fit, content.map
    gap, said = fit.checks.gap_over_angles_covered, ""
    low, high = gap.low95, gap.high95
    if gap.value is not None and low is not None and high is not None:
        said = f"Between its two flanks the driven shaft can turn by {gap.in_words}"
        if low <= 0 < high:
            said = f"No gap shows: flank B stands {gap.in_words} beside flank A, so that a gap is"
            said += f" below {high:.4f}° of the driven shaft. {_swings(fit)}"
        elif isinstance(fit.pair, GearPair):
            length_um = 1e3 * gap.value * DEG * float(fit.pair.reference_radii[1])
            said += f", {length_um:.3g} µm at the reference circle"
        if isinstance(found, RunTable) and found.record["smallest"]:
            ends = [found.record[end]["backlash_deg"] for end in ("smallest", "largest")]
            said += f"; over all positions of the gears it is {ends[0]:.4f}° to {ends[1]:.4f}°"
    return f"{said or _swings(fit)}."


def _swings(fit: Fit) -> str:
    """Return how far the driven shaft leads and lags, and which order makes the most of it."""
    sizes = {flank: e.peak_to_peak_deg * DEG / ARCSEC for flank, e in fit.flank_errors.items()}
    swings = _and([f"{size:.4g}″ on flank {flank}" for flank, size in sizes.items()])
    said = f"The driven shaft runs ahead of and behind an even motion by {swings}"
    for top in sorted(fit.orders, key=lambda one: -one.amplitude_arcsec)[:1]:
        if top.significant:
            size = f"{2 * top.amplitude_arcsec:.4g}″"
            said += f" (the order {top.shaft} {top.order:.5g} alone makes {size})"
    return f"{said} from peak to peak, over {driving_turns(fit):.3g} turns of the driving shaft"


def _trust(fit: Fit) -> str:
    """Return how far the numbers can be trusted."""
    grave = [one.sentence for one in fit.findings if one.severity != "note"]
    if grave:
        return f"Read the findings ({len(grave)}) before these numbers, above all: {grave[0]}."
    if fit.outcome in _FAILED or not fit.checks.explained:
        return "What to record next stands below."
    share = f"{100 * fit.checks.explained:.4g} % of the variance of the transmission error"
    left = f"{fit.residual_rms_deg * DEG / ARCSEC:.3g}″ (rms of averaged rows)"
    rest = residual_spectrum(fit)
    left += f"; {rest.words}" if rest is not None else ""
    return f"Nothing in the log contradicts this: the fit explains {share} and leaves {left}."


def next_steps(fit: Fit) -> list[str]:
    """Return what to record or to state next, the gravest first, and how to plan it."""
    steps = [one.cure for one in fit.findings if one.cure]
    if len(fit.flanks) == 1:
        steps.append("record both directions in one log: only together they show the backlash")
    ratio, turns = fit.pair.ratio, driving_turns(fit)
    for shaft, whole in (("driving", 1.0), ("driven", abs(1 / float(ratio)))):
        if turns < 0.9 * whole:  # a table of one turn ends just before it
            steps.append(
                f"record {math.ceil(2 * whole)} turns of the driving shaft in each direction: the"
                f" {shaft} shaft made {turns / whole:.2g} turns, and a whole turn shows its errors"
            )
    if 0 < fit.coverage.share < 1:
        steps.append(
            f"record {fit.pair.hunting_turns} turns of the driving shaft in each direction to"
            f" measure every pair of teeth; {100 * (1 - fit.coverage.share):.3g} % of the map are"
            " extrapolated"
        )
    said = [f"{step[0].upper()}{step[1:].rstrip('.')}." for step in dict.fromkeys(steps)]
    noise, seconds = fit.noise, max(float(np.ptp(curve.time)) for curve in fit.curves)
    return [
        *said,
        "See beforehand what a run would tell: `vttig plan --ratio"
        f" {ratio.denominator}:{ratio.numerator} --turns {max(2 * turns, 2):.3g} --speed-rpm"
        f" {60 * turns / max(seconds, 1e-9):.3g} --rate-hz {1 / noise.block_s:.3g}"
        f" --noise-std-deg {noise.std_deg:.3g} --noise-correlation-s {noise.correlation_s:.3g}`.",
    ]

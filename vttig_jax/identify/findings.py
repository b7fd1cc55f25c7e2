"""What a fit has to say beside its numbers: each function looks for one kind of finding.

Severity, sentence and cure of every kind stand in `findings.toml`. `FINDINGS` lists the functions,
the gravest first. Text, JSON and pictures read the records.
"""

import tomllib
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from msgspec.structs import asdict

from ..base.units import DEG, duration_text
from ..logs.checks.sampling import commensurate
from ..logs.lines.search import hidden_shaft
from ..logs.motion.segments import CLEAR
from ..logs.slope import better_fraction, computed_text, exact_slope
from ..model.columns import DELAY, waves_of
from ..model.mixed_fit import NEEDED, mixed_fit
from ..model.parameters import FULL_TURN
from ..pair.gear_pair import GearPair
from .checking import Identified
from .records import Finding
from .result import Fit
from .starts import disagreements

_CATALOGUE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))


_MINDED = 0.02
"""Least change of the gap with the speed, as a share of it, that is a finding (chosen)."""


def _said(entry: str, **values: Any) -> Finding:
    """Return the finding of an entry of the catalogue, with the values that its sentence names."""
    told = _CATALOGUE[entry]
    return Finding(
        slug=entry.partition(" ")[0],
        severity=told["severity"],
        sentence=told["sentence"].format(**values),
        cure=told.get("cure", "").format(**values),
        numbers={name: values[name] for name in told.get("numbers", ())},
    )


def contradicts(fit: Fit, findings: Sequence[Finding]) -> bool:
    """Return whether the log cannot be that of a drive.

    A column was computed from the other, or the gap is below zero, beyond chance and the residual.
    """
    slugs = {one.slug for one in findings}
    if not slugs & {"column-computed", "gap-below-zero"}:
        return False
    gap = fit.checks.gap_over_angles_covered
    value, std = gap.value or 0.0, gap.std or 0.0
    beyond = value**2 > NEEDED * std**2 and -value > fit.residual_rms_deg
    return "column-computed" in slugs or beyond


def negative_gap(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say that the gap is below zero, which no gap is."""
    gap = fit.checks.gap_over_angles_covered
    if gap.value is None or gap.std is None or gap.high95 is None or gap.high95 >= 0:
        return
    swapped = "the columns are exchanged, " if fit.pair.ratio == 1 else ""
    read = any(log.driven is None for log in found.logs)
    entry = "gap-below-zero" + " errors" * read
    yield _said(entry, gap_deg=gap.value, std_deg=gap.std, swapped=swapped)


def not_settled(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say that the passes, or the search for the noise, did not end."""
    if not fit.core.settled:
        yield _said("not-settled", passes=fit.core.passes)


def open_delay(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say that the interval of the backlash is that of the assumed delay."""
    scope, problem = fit.core.scope, fit.core.posterior.problem
    determined = fit.parameters["delay_s"].determined
    if determined or not fit.core.settled or DELAY not in problem.index or len(scope.flanks) < 2:
        return
    width_s = problem.columns[problem.index[DELAY]].width
    yield _said(
        "delay-open",
        delay_within_ms=1e3 * width_s,
        within=duration_text(width_s),
        deg_per_us=1e-6 * (abs(scope.ratio) * sum(scope.speeds) / DEG),
    )


def changing_delay(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say that one delay does not explain the log."""
    parts, ratio = fit.checks.delay_by_parts, fit.checks.likelihood_ratio["delay_parts"]
    if not parts or not fit.parameters["delay_s"].determined:
        return
    low, high = min(p.value for p in parts), max(p.value for p in parts)
    yield _said(
        "delay-changes",
        least_s=low,
        largest_s=high,
        least_ms=1e3 * low,
        largest_ms=1e3 * high,
        likelihood_ratio=ratio,
    )


def gap_of_speed(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say that the gap depends on the speed, by more than a share of a gap that the log tells."""
    rows, ratio = fit.checks.gap_by_speed, fit.checks.likelihood_ratio["gap_by_speed"]
    if ratio <= NEEDED or len(rows) < 2:
        return
    ends = min(rows, key=lambda one: one.value), max(rows, key=lambda one: one.value)
    slow, fast = sorted(ends, key=lambda one: one.speed_rpm)
    if slow.std < abs(slow.value) > abs(fast.value - slow.value) / _MINDED:
        return
    yield _said(
        "gap-of-speed",
        slow=slow,
        fast=fast,
        slow_deg=slow.value,
        fast_deg=fast.value,
        delay_ms=1e3 * fit.core.delay_s,
        likelihood_ratio=ratio,
    )


def shown_delay(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say which delay the log shows where another one is stated.

    With its estimate d ± s of ν degrees of freedom, where it is fitted, 2 ln of the likelihood
    ratio to the stated d₀ is (ν + 1) ln(1 + (d − d₀)²/(ν s²)).
    """
    core = fit.core
    is_fitted = fit.request is None or fit.request.settings.delay == "auto"
    if is_fitted or fit.given is not None or len(core.scope.flanks) < 2:
        return
    lines = [wave.order for wave in core.waves if wave.shaft == "line"]
    free = mixed_fit(core.shafts, fit.pair, core.orders, lines=lines, after=core)
    told = free.posterior.one(free.posterior.row(DELAY), moved=True)
    shown_s = free.delay_s + told.value
    off = (shown_s - core.delay_s) / told.std
    ratio = (told.freedom + 1) * float(np.log1p(off**2 / told.freedom))
    if ratio > NEEDED:
        yield _said(
            "delay-shown",
            delay_s=shown_s,
            std_s=told.std,
            shown_ms=1e3 * shown_s,
            std_ms=1e3 * told.std,
            stated_ms=1e3 * core.delay_s,
            likelihood_ratio=ratio,
        )


def flanks(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say where the flank of many samples is unknown, and which flank has no long enough stroke."""
    for number, one in enumerate(found.segments):
        if one.unclear:
            yield _said("flank-unclear", text=found.name(number) + one.unclear)
    for flank in found.short:
        yield _said("flank-short", flank=flank)


def computed_column(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say that one column was computed from the other."""
    for number, log in enumerate(found.logs):
        slope = exact_slope(log.driving_angle, log.driven_angle)
        if slope is not None:
            text = found.name(number) + computed_text(slope)
            yield _said("column-computed", text=text, ratio=slope)


def ratio_off(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say that the ratio of the log is not the given one."""
    given = fit.pair.ratio
    for one in fit.regressors:
        if one.name == "ratio" and one.significant and one.value is not None:
            off, std = 1e6 * (one.value / float(given) - 1), 1e6 * (one.std or 0.0) / float(given)
            counts = []  # one of both encoders, as a share of the travel of the driven shaft
            for log in found.logs:
                driven = log.driven.resolution if log.driven is not None else 0.0
                count = driven + abs(float(log.ratio)) * log.driving.resolution
                counts.append(count / float(np.ptp(log.driven_angle)))
            if abs(off) < 1e6 * min(counts):
                return  # floored counts lose up to a count over the travel
            yield _said("ratio-off", off_ppm=off, std_ppm=std, size_ppm=abs(std), given=given)
            return
    for seen in found.ratios:
        if seen.is_doubtful and seen.cause != "delay" and isinstance(fit.pair, GearPair):
            yield _said("ratio-doubtful", text=seen.sentence.removesuffix("."))
            return


def gap_crossed_late(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say that samples inside the gap may count as a flank."""
    gap = fit.checks.gap_over_angles_covered
    by_motion = [
        (segments.crossing, number)
        for number, (log, segments) in enumerate(zip(found.logs, found.segments, strict=True))
        if not (segments.unclear or segments.still) and log.torque is log.direction is None
    ]
    if gap.low95 is None or gap.value is None or not by_motion:
        return
    crossing, number = min(by_motion)
    ratio = abs(fit.core.scope.ratio)
    if gap.low95 * DEG > ratio * crossing:
        yield _said(
            "crossing-short",
            log=found.name(number),
            needed_deg=gap.value / ratio,
            gap_deg=gap.value,
            left_out_deg=crossing / DEG,
        )


def jumps(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Compare the jumps at the reversals with the fitted gap."""
    if one := fit.checks.jumps:
        entry = "jumps-agree" if one.agrees else "jumps-disagree"
        yield _said(entry, jumps_deg=one.median_deg, gap_deg=one.fitted_deg, **asdict(one))


def locked_counts(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say that counts are locked to the clock of the samples."""
    for number, (log, own) in enumerate(zip(found.logs, found.segments, strict=True)):
        for one in () if own.still else commensurate(log, own.segments):
            said, _, cure = one.sentence.partition("; ")
            yield _said("counts-locked", text=found.name(number) + said, cure=cure)


def noise_and_drift(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say how many rows are outliers, that the log has no noise, and that its level moves."""
    if share := fit.checks.outliers:
        entry = "outliers many" if share > 0.1 else "outliers"
        yield _said(entry, share=share, percent=100 * share)
    if fit.noise.std_deg * DEG < 1e-4 * fit.core.usual:
        yield _said("no-noise", std_deg=fit.noise.std_deg)
    if (ratio := fit.checks.likelihood_ratio["drift"]) > NEEDED:
        yield _said("drift", drift_arcsec=fit.checks.drift_arcsec, likelihood_ratio=ratio)


def found_lines(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say which lines the model does not list as orders, and which shafts may have them.

    Several lines may be orders of a shaft without an encoder. Lines at one fraction 1/n of both
    shafts are their first orders, counted n-fold.
    """
    lines = fit.checks.lines
    mean = " in the mean of both flanks" if len(fit.core.scope.flanks) == 2 else ""
    for one in lines:
        entry = "line-joined" if one.joined else "line-left"
        yield _said(entry, mean=mean, std=one.cycles_std, **vars(one))
    shaft = hidden_shaft([x.cycles_per_rev for x in lines], [x.cycles_std for x in lines])
    if shaft is not None:
        *first, last = map(str, shaft.orders)
        told = {"turns_per_rev": shaft.turns, "std": shaft.std, "coincidence": shaft.coincidence}
        yield _said("hidden-shaft", first=", ".join(first), last=last, **told)
    for one in lines:
        times = round(1 / one.cycles_per_rev)
        wanted = (1 / times, abs(fit.core.scope.ratio) / times) if times > 1 else ()
        if wanted and all(
            any((x.cycles_per_rev - at) ** 2 < NEEDED * x.cycles_std**2 for x in lines)
            for at in wanted
        ):
            yield _said("counts-doubtful", times=times)
            return


def equal_orders(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say which listed orders have one frequency, or the same values at the places of a table."""
    core, ratio = fit.core, abs(fit.core.scope.ratio)
    if found.segments and all(one.still for one in found.segments):
        lost = [wave for wave in waves_of(fit.pair, core.orders) if wave not in core.waves]
        angle = np.concatenate([one.in_runs(one.driving) for one in core.shafts])
        seen = {(one.shaft, one.order) for one in fit.orders if one.significant}
        for told in core.waves:
            turned = core.scope.turns.get(told.shaft, 0.0) >= FULL_TURN
            if not turned or (told.shaft, told.order) not in seen or told.order > 2:
                continue
            own = np.outer(angle, [0.0, told.cycles(ratio)])
            basis = np.linalg.qr(np.concatenate([np.cos(own), np.sin(own)[:, 1:]], axis=1))[0]
            # The lowest of the many orders that look alike is the likeliest one.
            for wave in sorted(lost, key=lambda one: one.order):
                one = np.cos(angle * wave.cycles(ratio))
                one -= one.mean()
                rest = one - basis @ (basis.T @ one)
                if wave.order <= 2 and rest @ rest < CLEAR**3 * (one @ one - 1e-6 * len(one)):
                    names = {"told": f"{told.shaft} {told.order:g}"}
                    names["other"] = f"{wave.shaft} {wave.order:g}"
                    yield _said("orders-equal first", **names)
                    break
        if lost:
            names = ", ".join(f"{wave.shaft} {wave.order:g}" for wave in lost)
            yield _said("orders-equal places", orders=names)
    if ratio == 1 and "driving" in {w.shaft for w in core.waves if w.order == 1}:
        if 1 in core.orders.driven_orders:
            yield _said("orders-equal ratio 1")
        return
    cycles = {w.cycles(core.scope.ratio): w for w in core.waves if w.shaft == "driving"}
    listed = [k for k in core.orders.driven_orders if k * ratio in cycles]
    if listed:
        names = ", ".join(f"{k} (driving order {cycles[k * ratio].order:g})" for k in listed)
        yield _said("orders-equal", orders=names)


def other_rig(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say that a log has other first orders than the first log."""
    for one in disagreements(fit.core):
        sentence = one.sentence(PurePath(found.logs[0].source).name)
        yield _said(
            "rigs-differ",
            text=found.name(one.log - 1) + sentence,
            difference_arcsec=one.difference_arcsec,
            std_arcsec=one.std_arcsec,
        )
        return


def open_starts(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Say that the orders of two logs are not compared."""
    for number, one in enumerate(fit.logs[1:], 2):
        told = {"driving": one.start.driving_deg, "driven": one.start.driven_deg}
        if unknown := " and the ".join(shaft for shaft, angle in told.items() if angle is None):
            yield _said("start-unknown", number=number, unknown=unknown)


def logged(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Pass on what reading and dividing the logs had to say."""
    every = [
        [("segments", text) for text in one.notes] + [("log", text) for text in log.notes]
        for one, log in zip(found.segments, found.logs, strict=True)
    ]
    shared = [note for note in every[0] if all(note in notes for notes in every)]
    for slug, text in shared:
        yield _said(slug, text=text)
    for number, notes in enumerate(every):
        for slug, text in notes:
            if (slug, text) not in shared:
                yield _said(slug, text=found.name(number) + text)


def compared(fit: Fit, found: Identified) -> Iterator[Finding]:
    """Compare the fit with readings, a hunting period later, the ratio seen, and the drawing."""
    checks, ratio = fit.checks, fit.checks.ratio[0]
    if one := checks.readings:
        entry = "readings contradict" if one.contradicts else "readings"
        yield _said(entry, joined="joined the fit" if one.used else "check only", **asdict(one))
    if one := checks.closure:
        yield _said("closure", **asdict(one))
    if ratio.seen is not None:
        std = ratio.std or 0.0
        better = better_fraction(Fraction(ratio.given), ratio.seen, std)
        entry = "ratio-seen teeth" if better else "ratio-seen"
        yield _said(entry, given=ratio.given, seen=ratio.seen, std=std, better=better)
    if checks.drawing_backlash_deg is not None:
        yield _said("drawing", backlash_deg=checks.drawing_backlash_deg)


FINDINGS: tuple[Callable[[Fit, Identified], Iterator[Finding]], ...] = (
    negative_gap,
    not_settled,
    computed_column,
    flanks,
    open_delay,
    changing_delay,
    shown_delay,
    gap_of_speed,
    gap_crossed_late,
    jumps,
    ratio_off,
    other_rig,
    locked_counts,
    noise_and_drift,
    found_lines,
    equal_orders,
    open_starts,
    logged,
    compared,
)
"""Functions that make the findings of a fit."""

_ORDER = ("warning", "question", "note")


def findings_of(fit: Fit, found: Identified) -> tuple[Finding, ...]:
    """Return the findings of a fit still without findings, warnings first."""
    made = [one for make in FINDINGS for one in make(fit, found)]
    return tuple(sorted(made, key=lambda one: _ORDER.index(one.severity)))

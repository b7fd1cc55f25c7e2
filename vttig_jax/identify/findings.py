"""What a fit has to say beside its numbers: every sentence is a record made by one small function.

`FINDINGS` lists the functions, the gravest first. Text, JSON and pictures read their records.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import PurePath

import numpy as np

from ..base.units import DEG, duration_text
from ..logs.checks.sampling import commensurate
from ..logs.encoder_log import EncoderLog
from ..logs.lines.search import hidden_shaft
from ..logs.slope import better_fraction, computed_text, exact_slope
from ..model.columns import DELAY
from ..model.mixed_fit import NEEDED, mixed_fit, waves_of
from ..pair.gear_pair import GearPair
from .door import Identified
from .fit_settings import FitSettings
from .records import Finding
from .result import Fit
from .starts import disagreements


@dataclass(frozen=True, eq=False)
class Case:
    """Everything that findings are made from: a fit still without findings, and its logs."""

    fit: Fit
    found: Identified
    settings: FitSettings


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


def negative_gap(case: Case) -> Iterator[Finding]:
    """Say that the gap is below zero, which no gap is."""
    gap = case.fit.checks.gap_over_angles_covered
    if gap.value is None or gap.std is None or gap.high95 is None or gap.high95 >= 0:
        return
    swapped = "the columns are exchanged, " if case.fit.pair.ratio == 1 else ""
    yield Finding(
        "gap-below-zero",
        "warning",
        f"flank B stands {gap.value:.5f}° ± {gap.std:.2g}° from flank A, and no gap is below zero:"
        f" {swapped}the sign of both encoders is inverted, the load overruns and lies on the other"
        " flank, friction or wind-up moves the shafts, or the driving channel is late",
        "correct [log], exchange the columns with --column driving=NAME --column driven=NAME, or"
        " give --delay",
        {"gap_deg": gap.value, "std_deg": gap.std},
    )


def not_settled(case: Case) -> Iterator[Finding]:
    """Say that the passes, or the search for the noise, did not end."""
    if not case.fit.core.settled:
        yield Finding(
            "not-settled",
            "warning",
            "the search ended before delay and noise stood still"
            f" ({case.fit.core.passes} passes), so that the numbers are not final",
            "record more changes of speed, or state the delay with --delay",
        )


def open_delay(case: Case) -> Iterator[Finding]:
    """Say that the interval of the backlash is that of the assumed delay."""
    delay = case.fit.parameters["delay_s"]
    index = case.fit.core.posterior.problem.index
    if delay.determined or DELAY not in index or len(case.fit.core.scope.flanks) < 2:
        return
    width = case.fit.core.posterior.problem.columns[index[DELAY]].width
    effect = abs(case.fit.core.scope.ratio) * sum(case.fit.core.scope.speeds) / DEG
    yield Finding(
        "delay-open",
        "question",
        "the log does not tell a delay of the driven channel from the backlash: every microsecond"
        f" looks like {1e-6 * effect:.2g}° of backlash. The interval of the backlash is that of the"
        f" assumed delay, within ± {duration_text(width)} (one standard deviation)",
        "log a second speed or longer strokes, state the delay with --delay (such as 0.5ms), or say"
        " with --delay-within what it may be",
        {"delay_within_ms": 1e3 * width, "deg_per_us": 1e-6 * effect},
    )


def changing_delay(case: Case) -> Iterator[Finding]:
    """Say that one delay does not explain the log."""
    parts, ratio = case.fit.checks.delay_by_parts, case.fit.checks.likelihood_ratio["delay_parts"]
    if not parts or not case.fit.parameters["delay_s"].determined:
        return
    low, high = min(p.value for p in parts), max(p.value for p in parts)
    yield Finding(
        "delay-changes",
        "warning",
        f"the delay changes within the log, from {1e3 * low:.4g} to {1e3 * high:.4g} ms in its"
        f" parts; delay_s is its mean (2 ln of the likelihood ratio {ratio:.0f})",
        "sample both channels by one clock, or fit parts of the log",
        {"least_s": low, "largest_s": high, "likelihood_ratio": ratio},
    )


def gap_of_speed(case: Case) -> Iterator[Finding]:
    """Say that the gap depends on the speed."""
    rows, ratio = case.fit.checks.gap_by_speed, case.fit.checks.likelihood_ratio["gap_by_speed"]
    if ratio <= NEEDED or len(rows) < 2:
        return
    slow, fast = rows[0], rows[-1]
    yield Finding(
        "gap-of-speed",
        "warning",
        f"the gap depends on the speed: {slow.value:.4f}° ± {slow.std:.2g}° at"
        f" {slow.speed_rpm:.3g} rpm of the driving shaft and {fast.value:.4f}° ± {fast.std:.2g}° at"
        f" {fast.speed_rpm:.3g} rpm, beside the delay of {1e3 * case.fit.core.delay_s:.4g} ms. No"
        " single gap describes the log",
        "fit slow and fast passes as logs of their own, or compare gaps of one speed only",
        {"slow_deg": slow.value, "fast_deg": fast.value, "likelihood_ratio": ratio},
    )


def shown_delay(case: Case) -> Iterator[Finding]:
    """Say which delay the log shows where another one is stated.

    With its estimate d ± s of ν degrees of freedom, where it is fitted, 2 ln of the likelihood
    ratio to the stated d₀ is (ν + 1) ln(1 + (d − d₀)²/(ν s²)).
    """
    core = case.fit.core
    fitted = case.settings.delay == "auto" or case.fit.given is not None
    if fitted or len(core.scope.flanks) < 2:
        return
    lines = [wave.order for wave in core.waves if wave.shaft == "line"]
    free = mixed_fit(core.shafts, case.fit.pair, core.orders, lines=lines, after=core)
    told = free.posterior.one(free.posterior.row(DELAY), moved=True)
    shown_s = free.delay_s + told.value
    off = (shown_s - core.delay_s) / told.std
    ratio = (told.freedom + 1) * float(np.log1p(off**2 / told.freedom))
    if ratio > NEEDED:
        yield Finding(
            "delay-shown",
            "warning",
            f"this log shows a delay of {1e3 * shown_s:.3g} ± {1e3 * told.std:.2g} ms, but"
            f" {1e3 * core.delay_s:.4g} ms is stated, so that the rest of it passes for a gap"
            f" that depends on the speed (2 ln of the likelihood ratio {ratio:.0f})",
            f"leave out --delay, or state --delay {1e3 * shown_s:.3g}ms",
            {"delay_s": shown_s, "std_s": told.std, "likelihood_ratio": ratio},
        )


def unclear_flanks(case: Case) -> Iterator[Finding]:
    """Say that the flank of many samples is unknown."""
    for number, one in enumerate(case.found.segments):
        if one.unclear:
            yield Finding("flank-unclear", "question", case.found.name(number) + one.unclear)


def short_flanks(case: Case) -> Iterator[Finding]:
    """Say which flank has no stroke that is long enough."""
    for flank in case.found.short:
        yield Finding(
            "flank-short",
            "warning",
            f"flank {flank} is left out: each of its strokes is shorter than the fit needs",
            "log longer strokes",
        )


def computed_column(case: Case) -> Iterator[Finding]:
    """Say that one column was computed from the other."""
    for number, log in enumerate(case.found.logs):
        slope = exact_slope(log.driving_angle, log.driven_angle)
        if slope is not None:
            yield Finding(
                "column-computed",
                "warning",
                f"{case.found.name(number)}{computed_text(slope)}, so that this fit says nothing"
                " about gears",
                "name the measured columns with --column driving=NAME and --column driven=NAME",
                {"ratio": slope},
            )


def _one_count(log: EncoderLog) -> float:
    """Return one count of both encoders as a share of the travel of the driven shaft."""
    driven = log.driven.resolution if log.driven is not None else 0.0
    counts = driven + abs(float(log.ratio)) * log.driving.resolution
    return counts / float(np.ptp(log.driven_angle))


def ratio_off(case: Case) -> Iterator[Finding]:
    """Say that the ratio of the log is not the given one."""
    given = case.fit.pair.ratio
    for one in case.fit.regressors:
        if one.name == "ratio" and one.significant and one.value is not None:
            off, std = 1e6 * (one.value / float(given) - 1), 1e6 * (one.std or 0.0) / float(given)
            if all(abs(off) < 1e6 * _one_count(log) for log in case.found.logs):
                return  # floored counts lose up to a count over the travel
            yield Finding(
                "ratio-off",
                "warning",
                f"the ratio comes out {off:+.3g} ± {abs(std):.2g} ppm off {given} as given, and the"
                " numbers of this fit hold for the ratio that it found",
                "check the teeth and counts_per_rev; over a part of a turn a slow error or wind-up"
                " looks the same",
                {"off_ppm": off, "std_ppm": std},
            )
            return
    for seen in case.found.ratios:
        if seen.is_doubtful and seen.cause != "delay" and isinstance(case.fit.pair, GearPair):
            yield Finding("ratio-doubtful", "question", seen.sentence.removesuffix("."))
            return


def seen_ratio(case: Case) -> Iterator[Finding]:
    """Say which ratio the first log shows."""
    one = case.fit.checks.ratio[0]
    if one.seen is None:
        return
    better = better_fraction(Fraction(one.given), one.seen, one.std or 0.0)
    yield Finding(
        "ratio-seen",
        "note",
        f"ratio {one.given} given, {one.seen:.9g} ± {one.std:.1g} seen",
        f"{better} fits, so write that if these are the teeth" if better else "",
        {"seen": one.seen, "std": one.std or 0.0},
    )


def gap_crossed_late(case: Case) -> Iterator[Finding]:
    """Say that samples inside the gap may count as a flank."""
    gap = case.fit.checks.gap_over_angles_covered
    by_motion = [
        (segments.crossing, number)
        for number, (log, segments) in enumerate(
            zip(case.found.logs, case.found.segments, strict=True)
        )
        if not (segments.unclear or segments.still) and log.torque is log.direction is None
    ]
    if gap.low95 is None or gap.value is None or not by_motion:
        return
    crossing, number = min(by_motion)
    ratio = abs(case.fit.core.scope.ratio)
    if gap.low95 * DEG <= ratio * crossing:
        return
    yield Finding(
        "crossing-short",
        "warning",
        f"{case.found.name(number)}the teeth need {gap.value / ratio:.3g}° of the driving shaft to"
        f" cross the fitted gap of {gap.value:.3g}°, but only {crossing / DEG:.3g}° after a"
        " reversal are left out, so that samples inside the gap may count as a flank and make it"
        " too small",
        "log longer strokes, or remove these samples from the log",
        {"gap_deg": gap.value, "left_out_deg": crossing / DEG},
    )


def jumps(case: Case) -> Iterator[Finding]:
    """Compare the jumps at the reversals with the fitted gap."""
    one = case.fit.checks.jumps
    if one is None:
        return
    beside = (
        f"({one.median_deg:.5f}° ± {one.std_deg:.2g}° in the median) {{}} the fitted gap"
        f" ({one.fitted_deg:.5f}° ± {one.fitted_std_deg:.2g}°)"
    )
    numbers = {"jumps_deg": one.median_deg, "gap_deg": one.fitted_deg}
    if one.agrees:
        said = f"the {one.count} jumps at reversals {beside.format('agree with')}"
        yield Finding("jumps-agree", "note", said, numbers=numbers)
        return
    yield Finding(
        "jumps-disagree",
        "warning",
        f"the {one.count} jumps at reversals {beside.format('disagree with')}: near a reversal the"
        " shafts are slow, so a delay, friction or wind-up that the fit takes for a gap is missing"
        " in the jumps, and a load that leaves its flank before the turn makes them too small",
        "compare a slow log with a fast one",
        numbers,
    )


def locked_counts(case: Case) -> Iterator[Finding]:
    """Say that counts are locked to the clock of the samples."""
    for number, (log, own) in enumerate(zip(case.found.logs, case.found.segments, strict=True)):
        for one in () if own.still else commensurate(log, own.segments):
            said, _, cure = one.sentence.partition("; ")
            yield Finding("counts-locked", "warning", case.found.name(number) + said, cure)


def outliers(case: Case) -> Iterator[Finding]:
    """Say how many rows are outliers."""
    if share := case.fit.checks.outliers:
        yield Finding(
            "outliers",
            "warning" if share > 0.1 else "note",
            f"{100 * share:.2g} % of the rows are outliers and are left out",
            "look for lost or late readings" if share > 0.1 else "",
            {"share": share},
        )


def no_noise(case: Case) -> Iterator[Finding]:
    """Say that the log has no noise."""
    if case.fit.noise.std_deg * DEG < 1e-4 * case.fit.core.usual:
        yield Finding(
            "no-noise",
            "note",
            "the log holds no noise: its harmonics leave less than a ten-thousandth of the"
            f" transmission error ({case.fit.noise.std_deg:.1g}°), so that the standard errors are"
            " not those of a measurement",
        )


def drift(case: Case) -> Iterator[Finding]:
    """Say that the level of the transmission error moves."""
    ratio, size_arcsec = case.fit.checks.likelihood_ratio["drift"], case.fit.checks.drift_arcsec
    if ratio > NEEDED:
        yield Finding(
            "drift",
            "note",
            f"the level of the transmission error moves by {size_arcsec:.3g}″ within a"
            f" log, beside the gears (2 ln of the likelihood ratio {ratio:.0f})",
            numbers={"drift_arcsec": size_arcsec, "likelihood_ratio": ratio},
        )


def found_lines(case: Case) -> Iterator[Finding]:
    """Say which lines the model does not list as orders."""
    mean = " in the mean of both flanks" if len(case.fit.core.scope.flanks) == 2 else ""
    for one in case.fit.checks.lines:
        joined = (
            "joined the model as a fractional order. It has no fixed position on the gears: its"
            " phase holds at the zero of the log, and maps, `export`, `locate` and `simulate` leave"
            " it out"
            if one.joined
            else "is left in the residual: no order and no error of a flank contains it"
        )
        yield Finding(
            "line-joined" if one.joined else "line-left",
            "note",
            f"a line of {one.amplitude_arcsec:.3g}″ ± {one.amplitude_std_arcsec:.2g}″{mean} at"
            f" {one.cycles_per_rev:.7g} ± {one.cycles_std:.1g} cycles per driving turn (probability"
            f" {one.false_alarm:.1g} by chance) {joined}",
            "" if one.joined else "list its order in [fit] if it belongs to a shaft",
            {
                "cycles_per_rev": one.cycles_per_rev,
                "std": one.cycles_std,
                "amplitude_arcsec": one.amplitude_arcsec,
            },
        )


def hidden(case: Case) -> Iterator[Finding]:
    """Say that several lines are orders of a shaft without an encoder."""
    lines = case.fit.checks.lines
    shaft = hidden_shaft([x.cycles_per_rev for x in lines], [x.cycles_std for x in lines])
    if shaft is not None:
        *first, last = map(str, shaft.orders)
        yield Finding(
            "hidden-shaft",
            "note",
            f"a hidden shaft turns {shaft.turns:.7g} ± {shaft.std:.1g} times per driving turn"
            f" (orders {', '.join(first)} and {last} found; coincidence {shaft.coincidence:.1g})",
            numbers={"turns_per_rev": shaft.turns, "std": shaft.std},
        )


def wrong_counts(case: Case) -> Iterator[Finding]:
    """Say that lines at one fraction 1/n of both shafts are their first orders, counted n-fold."""
    lines = case.fit.checks.lines
    for one in lines:
        times = round(1 / one.cycles_per_rev)
        wanted = (1 / times, abs(case.fit.core.scope.ratio) / times) if times > 1 else ()
        if wanted and all(
            any((x.cycles_per_rev - at) ** 2 < NEEDED * x.cycles_std**2 for x in lines)
            for at in wanted
        ):
            yield Finding(
                "counts-doubtful",
                "warning",
                f"both shafts have a line at exactly 1/{times} of their order 1, as if all angles"
                f" were {times} times too large",
                f"check counts_per_rev (--counts), which may be {times} times too few, or the unit",
                {"times": times},
            )
            return


def equal_orders(case: Case) -> Iterator[Finding]:
    """Say which listed orders have one frequency, or the same values at the places of a table."""
    ratio = case.fit.core.scope.ratio
    if case.found.segments and all(one.still for one in case.found.segments):
        every = waves_of(case.fit.pair, case.fit.core.orders)
        lost = [f"{w.shaft} {w.order:g}" for w in every if w not in case.fit.core.waves]
        if lost:
            yield Finding(
                "orders-equal",
                "note",
                f"the orders {', '.join(lost)} are left out: the table has too few places or"
                " readings to tell them from lower orders and from noise; read more for them",
            )
    if abs(ratio) == 1 and "driving" in {w.shaft for w in case.fit.core.waves if w.order == 1}:
        if 1 in case.fit.core.orders.driven_orders:
            yield Finding(
                "orders-equal",
                "warning",
                "at a ratio of 1 the orders of both shafts have the same frequencies: what the"
                " driving shaft is said to have may be of the driven shaft, or of both together",
                "list no orders for a shaft that is perfect, driving_orders = [] under [fit]",
            )
        return
    cycles = {w.cycles(ratio): w for w in case.fit.core.waves if w.shaft == "driving"}
    listed = [k for k in case.fit.core.orders.driven_orders if k * abs(ratio) in cycles]
    if listed:
        names = ", ".join(f"{k} (driving order {cycles[k * abs(ratio)].order:g})" for k in listed)
        yield Finding(
            "orders-equal",
            "note",
            f"driven order {names} has the frequency of a driving order and is not told from it",
        )


def other_rig(case: Case) -> Iterator[Finding]:
    """Say that a log has other first orders than the first log."""
    for one in disagreements(case.fit.core):
        yield Finding(
            "rigs-differ",
            "warning",
            case.found.name(one.log - 1) + one.sentence(PurePath(case.found.logs[0].source).name),
            "fit these logs one by one",
            {"difference_arcsec": one.difference_arcsec, "std_arcsec": one.std_arcsec},
        )
        return


def open_starts(case: Case) -> Iterator[Finding]:
    """Say that the orders of two logs are not compared."""
    for number, one in enumerate(case.fit.logs[1:], 2):
        told = {"driving": one.start.driving_deg, "driven": one.start.driven_deg}
        if unknown := " and the ".join(shaft for shaft, angle in told.items() if angle is None):
            yield Finding(
                "start-unknown",
                "note",
                f"log {number} has a zero of its own, and no order that it shares with the first"
                f" log tells where the {unknown} shaft starts: its orders of that shaft are its"
                " own",
                "say --same-zero if both encoders count whole turns from one zero",
            )


def logged(case: Case) -> Iterator[Finding]:
    """Pass on what reading and dividing the logs had to say."""
    every = [
        [("segments", text) for text in one.notes] + [("log", text) for text in log.notes]
        for one, log in zip(case.found.segments, case.found.logs, strict=True)
    ]
    shared = [note for note in every[0] if all(note in notes for notes in every)]
    for slug, text in shared:
        yield Finding(slug, "note", text)
    for number, notes in enumerate(every):
        for slug, text in notes:
            if (slug, text) not in shared:
                yield Finding(slug, "note", case.found.name(number) + text)


def readings(case: Case) -> Iterator[Finding]:
    """Compare backlash readings with the fit."""
    one = case.fit.checks.readings
    if one is None:
        return
    joined = "joined the fit" if one.used else "check only"
    yield Finding(
        "readings",
        "warning" if one.contradicts else "note",
        f"{one.count} backlash readings ({joined}): {one.mean_deg:+.5f}° mean, {one.rms_deg:.5f}°"
        f" rms from the fit without them, scatter {one.scatter_deg:.5f}°"
        + (": they contradict it" if one.contradicts else ""),
        "compare the zero of their angles with that of the log" if one.contradicts else "",
        {"mean_deg": one.mean_deg, "rms_deg": one.rms_deg},
    )


def closed(case: Case) -> Iterator[Finding]:
    """Say how well the transmission error repeats after a hunting period."""
    if one := case.fit.checks.closure:
        yield Finding(
            "closure",
            "note",
            f"closure after {one.period_deg:g}°: {one.rms_deg:.5f}° rms ({one.mean_deg:+.5f}° mean)"
            f" over {one.overlap_deg:.0f}°",
            numbers={"rms_deg": one.rms_deg, "mean_deg": one.mean_deg},
        )


def drawn(case: Case) -> Iterator[Finding]:
    """Say which backlash the drawing has."""
    if (drawing := case.fit.checks.drawing_backlash_deg) is not None:
        said = f"constant backlash by the drawing: {drawing:.4f}°"
        yield Finding("drawing", "note", said, numbers={"backlash_deg": drawing})


FINDINGS: tuple[Callable[[Case], Iterator[Finding]], ...] = (
    negative_gap,
    not_settled,
    computed_column,
    unclear_flanks,
    short_flanks,
    open_delay,
    changing_delay,
    shown_delay,
    gap_of_speed,
    gap_crossed_late,
    jumps,
    ratio_off,
    other_rig,
    locked_counts,
    outliers,
    no_noise,
    drift,
    found_lines,
    hidden,
    wrong_counts,
    equal_orders,
    open_starts,
    logged,
    readings,
    closed,
    seen_ratio,
    drawn,
)
"""Functions that make the findings of a fit."""

_ORDER = ("warning", "question", "note")


def findings_of(case: Case) -> tuple[Finding, ...]:
    """Return the findings of a fit, warnings first."""
    found = [one for make in FINDINGS for one in make(case)]
    return tuple(sorted(found, key=lambda one: _ORDER.index(one.severity)))

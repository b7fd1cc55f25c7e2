"""Every finding both ways: on a log that has it, and not on one that has not."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.special import stdtrit

from tests.identify.drives import drive, drive_log, known, level, near, there_and_back
from tests.logs.profiles import played
from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.identify.findings import FINDINGS
from vttig_jax.identify.identification import fit
from vttig_jax.identify.result import Fit
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.inspection import inspect_log
from vttig_jax.logs.readers.backlash_readings import BacklashReadings
from vttig_jax.pair.gear_pair import Drive, GearPair
from vttig_jax.pair.schema import Encoder, GearTable
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig

GAP = 300.0
"""Gap of the drives, arcsec of the driven shaft."""


def wave(angle, speed):
    """A transmission error of flank A with the first two orders."""
    return 40 * np.sin(angle + 0.3) + 15 * np.sin(2 * angle)


def log_of(pair: Drive, rpms=(30.0, 75.0), *, passes: int = 1, **options) -> EncoderLog:
    """A log to and fro at several speeds."""
    motion = there_and_back(rpms * passes, 12.0)
    return drive_log(pair, motion, **({"gap": level(GAP), "error": wave} | options))


PAIR = drive("1/2", orders=(1, 2))
COUNTED = GearTable(encoder=Encoder(counts_per_rev=100_000))


def with_angles(log: EncoderLog, pair: Drive | GearPair, driving, driven, **options) -> EncoderLog:
    """The log with other angles, rad."""
    return EncoderLog.from_arrays(
        log.time, driving / DEG, driven / DEG, pair=pair, unit="deg", **options
    )


@pytest.fixture(scope="module")
def plain() -> Fit:
    """Fit of a drive that behaves."""
    return fit(log_of(PAIR), PAIR)


def slugs(result: Fit) -> set[str]:
    return {one.slug for one in result.findings}


USUAL = {"closure", "jumps-agree", "orders-equal", "ratio-seen"}
"""Notes on a drive that behaves."""


@cache
def late_and_unstated() -> Fit:
    """5 ms of delay that the fit takes for a gap: 0.9°, which the slow turns do not show."""
    return fit(log_of(PAIR, (30.0,), passes=2, delay_s=level(5e-3)), PAIR, delay="off")


def one_long_stroke() -> Fit:
    """Ten turns forward, and a third of a second back."""
    motion = [0.3, 0.2, 20.0, 0.2, 0.3, 0.1, 0.3, 0.1], [0, 30.0, 30.0, 0, 0, -30.0, -30.0, 0]
    return fit(drive_log(PAIR, motion, gap=level(GAP), error=wave), PAIR)


def short_strokes() -> Fit:
    """The teeth cross the gap over 26° of strokes of 30°."""
    time = np.arange(0.0, 20.0, 1e-3)
    driving = 15.0 * (1 - np.cos(time))
    driven = played(driving / 2, 13.0) + 0.003 * np.random.default_rng(0).standard_normal(len(time))
    return fit(EncoderLog.from_arrays(time, driving, driven, pair=PAIR, unit="deg"), PAIR)


@cache
def hidden_shaft(**settings: Any) -> Fit:
    """Three orders of a shaft between both."""
    turns = lambda a, k: np.sin(1.37 * k * a)  # noqa: E731
    hums = lambda a, v: wave(a, v) + 20 * turns(a, 1) + 10 * turns(a, 2) + 10 * turns(a, 3)  # noqa: E731
    motion = there_and_back((60.0,), 60.0)
    return fit(drive_log(PAIR, motion, gap=level(GAP), error=hums), PAIR, **settings)


@cache
def one_tooth_off() -> Fit:
    """Gears that turn at another ratio than that of their teeth."""
    rig = paper_rig(0, PassMotion(reversal_deg=1440.0))
    log = rig.log(0)
    return fit(with_angles(log, rig.pair, log.driving_angle, 1.0003 * log.driven_angle), rig.pair)


@cache
def a_log_with_notes() -> Fit:
    """Notes of reading, and of dividing by a direction column."""
    log = replace(log_of(PAIR), notes=("read with care",))
    return fit(
        replace(log, direction=np.sign(np.gradient(log.driving_angle)).astype(np.int8)), PAIR
    )


@cache
def late_at_two_speeds(**settings: Any) -> Fit:
    """5 ms of delay, which two speeds tell from a gap."""
    return fit(log_of(PAIR, passes=2, delay_s=level(5e-3)), PAIR, **settings)


def ten_times_the_counts() -> Fit:
    """Angles ten times too large."""
    log = log_of(PAIR, (60.0,), error=lambda a, v: wave(a, v) + 60 * np.sin(a / 2), passes=3)
    return fit(with_angles(log, PAIR, 10 * log.driving_angle, 10 * log.driven_angle), PAIR)


SAY: dict[str, Callable[[], Fit]] = {
    "jumps-disagree": late_and_unstated,
    "crossing-short": late_and_unstated,
    "flank-short": one_long_stroke,
    "flank-unclear": short_strokes,
    "line-joined": hidden_shaft,
    "line-left": lambda: hidden_shaft(lines="report"),
    "hidden-shaft": hidden_shaft,
    "ratio-doubtful": one_tooth_off,
    "drawing": one_tooth_off,
    "log": a_log_with_notes,
    "segments": a_log_with_notes,
    "no-noise": lambda: fit(log_of(PAIR, noise_arcsec=0.0), PAIR),
    "drift": lambda: fit(drifting(), PAIR),
    "delay-shown": lambda: late_at_two_speeds(delay="off"),
    "counts-doubtful": ten_times_the_counts,
}


def drifting() -> EncoderLog:
    """A level that swings by ± 3.6″ within the log."""
    log = log_of(PAIR)
    swing = 1e-3 * DEG * np.sin(REV * log.time / 50)
    return with_angles(log, PAIR, log.driving_angle, log.driven_angle + swing)


SLOW = {"crossing-short", "drawing", "ratio-doubtful", "jumps-disagree"}


@pytest.mark.parametrize(
    "slug", [pytest.param(slug, marks=pytest.mark.slow if slug in SLOW else ()) for slug in SAY]
)
def test_what_a_log_has_is_said(slug):
    assert slug in slugs(SAY[slug]())


def test_what_is_usual_is_not_said_of_a_short_table():
    """One direction of a pair whose shafts have no common order, over less than a period."""
    rig = paper_rig(0, PassMotion(reversal_deg=1440.0, passes=1))
    log = rig.log(0)
    curve = EncoderLog.from_arrays(
        log.time,
        log.driving_angle / DEG,
        pair=rig.pair,
        unit="deg",
        transmission_error=log.transmission_error / ARCSEC,
    )
    assert not USUAL & slugs(fit(curve, rig.pair))


def test_a_drive_that_behaves_has_no_warning(plain):
    assert slugs(plain) == USUAL
    assert plain.warnings == () and plain.outcome == "ok"


def test_numbers_of_a_drive_that_behaves(plain):
    assert near(plain.checks.gap_over_angles_covered, GAP / 3600)
    assert near(plain.parameters["driving_amplitude_arcsec"], 40)


def test_one_speed_leaves_the_delay_open():
    result = fit(log_of(PAIR, (30.0,), passes=2, rate_hz=60.0), PAIR)
    assert "delay-open" in slugs(result) and not result.parameters["delay_s"].determined
    assert near(result.parameters["backlash_plus_delay_deg"], GAP / 3600)
    assert any(name.startswith("delay_within") for name in result.conditional_on)


def test_a_stated_delay_is_not_open():
    result = fit(log_of(PAIR, (30.0,), passes=2, rate_hz=60.0), PAIR, delay=0.0)
    assert "delay-open" not in slugs(result) and "no_delay" in result.conditional_on


def test_a_delay_is_found():
    result = fit(log_of(PAIR, delay_s=level(2e-3)), PAIR)
    delay = result.parameters["delay_s"]
    assert near(delay, 2e-3) and delay.significant


def test_a_delay_that_creeps_is_said():
    creeping = lambda time, _: 1e-3 + 6e-3 * time / 110.0  # noqa: E731
    result = fit(log_of(PAIR, passes=2, delay_s=creeping), PAIR)
    (one,) = [one for one in result.findings if one.slug == "delay-changes"]
    assert one.numbers["largest_s"] > one.numbers["least_s"] + 2e-3


def test_a_gap_that_depends_on_the_speed_is_said():
    bent = lambda angle, speed: np.where(speed > 50, 3 * GAP, GAP)  # noqa: E731
    result = fit(log_of(PAIR, (20.0, 40.0, 70.0, 90.0), gap=bent), PAIR)
    assert "gap-of-speed" in slugs(result)
    rows = result.checks.gap_by_speed
    assert len(rows) > 2 and result.checks.likelihood_ratio["gap_by_speed"] > 12


def test_a_ramp_is_no_speed_of_the_log():
    """Ramps of 2 s between standstill, 60 and 150 rpm."""
    seconds, rpms = [0.3], [0.0]
    for sign in (1.0, -1.0):
        seconds += [2.0, 20.0, 2.0, 8.0, 2.0, 0.3]
        rpms += [60.0 * sign, 60.0 * sign, 150.0 * sign, 150.0 * sign, 0.0, 0.0]
    result = fit(drive_log(PAIR, (seconds, rpms), gap=level(GAP), error=wave), PAIR)
    shown = [one.speed_rpm for one in result.checks.gap_by_speed]
    assert shown == pytest.approx([60.0, 150.0], rel=0.01)


def test_a_delay_that_is_stated_right_is_not_shown():
    assert "delay-shown" not in slugs(late_at_two_speeds(delay=5e-3)) | slugs(late_at_two_speeds())
    (shown,) = [o for o in late_at_two_speeds(delay="off").findings if o.slug == "delay-shown"]
    assert abs(shown.numbers["delay_s"] - 5e-3) < 4 * shown.numbers["std_s"]
    assert "counts-doubtful" not in slugs(hidden_shaft())


def test_exchanged_columns_contradict():
    log = log_of(pair := drive("1", orders=(1, 2)))
    result = fit(with_angles(log, pair, log.driven_angle, log.driving_angle), pair)
    assert result.outcome == "contradicts" and "gap-below-zero" in slugs(result)


@pytest.mark.xfail(reason="moving parts of the model take a line that is not listed", strict=True)
def test_a_line_joins_or_is_left():
    line = lambda angle, speed: wave(angle, speed) + 20 * np.sin(3.37 * angle)  # noqa: E731
    log = drive_log(PAIR, there_and_back((75.0, 110.0), 20.0), gap=level(GAP), error=line)
    joined, left = fit(log, PAIR), fit(log, PAIR, lines="report")
    assert "line-joined" in slugs(joined) and "line-left" in slugs(left)
    for result in (joined, left):
        (one,) = result.checks.lines
        assert one.cycles_per_rev == pytest.approx(3.37, abs=max(5 * one.cycles_std, 2e-3))
    assert joined.residual_rms_deg < 0.3 * left.residual_rms_deg
    order = [o for o in joined.orders if not float(o.order).is_integer()]
    assert order and order[0].amplitude_arcsec == pytest.approx(20, rel=0.05)


def test_lost_readings_are_outliers():
    log = log_of(PAIR)
    generator = np.random.default_rng(1)
    off = np.where(generator.random(len(log)) < 0.02, 0.5, 0.0)
    result = fit(with_angles(log, PAIR, log.driving_angle, log.driven_angle + off * DEG), PAIR)
    assert "outliers" in slugs(result)
    assert near(result.parameters["driving_amplitude_arcsec"], 40)
    share, rows = result.checks.outliers, sum(len(one.table) for one in result.core.rows)
    assert 0.01 < share < 0.1 and share * rows == pytest.approx(round(share * rows))


def test_jumps_are_no_better_known_than_their_samples():
    """Four equal passes without noise, whose driven channel steps by 0.004°."""
    exact = log_of(PAIR, (30.0, 30.0), noise_arcsec=0.0)
    step = 0.004 * DEG
    log = with_angles(exact, PAIR, exact.driving_angle, np.round(exact.driven_angle / step) * step)
    coarse, fine = (fit(one, PAIR, delay="off").checks.jumps for one in (log, exact))
    assert coarse is not None and fine is not None
    assert fine.std_deg < 1e-5 < coarse.std_deg < 0.004


def test_a_jump_is_compared_with_the_gap_of_its_place():
    """All strokes turn where the gap is far from its mean."""
    result = fit(log_of(PAIR, gap=lambda angle, _: GAP + 150 * np.sin(angle + 1)), PAIR)
    jumps = [one.jump_deg for one in result.checks.reversals]
    mean = result.checks.gap_over_angles_covered.value
    assert mean is not None and abs(np.median(jumps) - mean) > 0.005
    assert "jumps-agree" in slugs(result)


@pytest.mark.parametrize("arcsec", [30.0, 0.0])
def test_a_line_above_the_rows_of_a_table_is_told(arcsec):
    pair = drive("1", orders=(1, 2))
    line = lambda angle, _: wave(angle, _) + arcsec * np.sin(100 * angle)  # noqa: E731
    motion = [0.1, 20.5], [3.0, 3.0]
    log = drive_log(pair, motion, gap=level(0.0), error=line, rate_hz=400.0)
    result = fit(log, pair, delay="off", ratio_within=0)
    assert ("line-left" in slugs(result)) == (arcsec > 0)
    for one in result.checks.lines:
        assert not one.joined and one.cycles_per_rev == pytest.approx(100, abs=0.1)
        assert one.amplitude_arcsec == pytest.approx(arcsec, rel=0.05)


def test_one_direction_is_conditional_on_its_flank(plain):
    motion = [0.1, 60.0], [30.0, 30.0]
    result = fit(drive_log(PAIR, motion, gap=level(GAP), error=wave), PAIR)
    assert "flank_A_only" in result.conditional_on and result.flanks == ("A",)
    assert not any("only" in name for name in plain.conditional_on)


def test_a_delay_alone_is_an_answer():
    """Strokes of less than a turn at two speeds."""
    motion = there_and_back((30.0, 75.0) * 6, 0.3)
    log = drive_log(PAIR, motion, gap=level(GAP), delay_s=level(5e-3), rate_hz=1000.0)
    told, stated = fit(log, PAIR), fit(log, PAIR, delay=5e-3)
    assert near(told.parameters["delay_s"], 5e-3) and told.outcome == "partly_determined"
    assert stated.outcome == "not_determined"


def test_an_interval_is_a_quantile_of_its_freedom(plain):
    for one in plain.parameters.values():
        if one.significant:
            half = 0.5 * (known(one.high95) - known(one.low95))
            quantile = stdtrit(known(one.freedom), 0.975)
            assert half == pytest.approx(quantile * known(one.std))
            assert one.to_json()["freedom"] == one.freedom >= 4


def test_a_wrong_ratio_is_said():
    log = log_of(PAIR, ratio=0.5002)
    result = fit(log, PAIR)
    assert "ratio-off" in slugs(result)
    (ratio,) = [one for one in result.regressors if one.name == "ratio"]
    assert near(ratio, 0.5002)
    exact = fit(log, PAIR, ratio_within=0.0)
    assert not [one for one in exact.regressors if one.name == "ratio"]


COUNTING = replace(PAIR, driving=COUNTED, driven=COUNTED)
"""The drive with encoders of 100 000 counts: one of both is 2 ppm of the travel of its logs."""


@pytest.mark.parametrize(("off_ppm", "said"), [(0.7, False), (7.0, True)])
def test_a_ratio_that_is_off_by_less_than_a_count_is_not_said(off_ppm, said):
    """Floored counts lose up to one over the travel, whatever the standard error of the ratio."""
    log = log_of(PAIR, ratio=0.5 * (1 + 1e-6 * off_ppm), noise_arcsec=0.0)
    angles = log.driving_angle, log.driven_angle
    counts = (np.floor(angle / REV * 100_000) for angle in angles)
    result = fit(EncoderLog.from_arrays(log.time, *counts, pair=COUNTING), COUNTING)
    (ratio,) = [one for one in result.regressors if one.name == "ratio"]
    assert ratio.significant
    assert ("ratio-off" in slugs(result)) == said


def test_a_computed_column_is_said():
    time = np.arange(0.0, 60.0, 0.01)
    driving = 180.0 * (30.0 - np.abs(time - 30.0))
    log = EncoderLog.from_arrays(time, driving, 0.5 * driving, pair=PAIR, unit="deg")
    result = fit(log, PAIR)
    assert "column-computed" in slugs(result) and result.outcome == "contradicts"
    assert any("computed" in note for note in inspect_log(log).notes)


def test_readings_agree_or_contradict(plain):
    angles = np.arange(0.0, 1440.0, 90.0)
    generator = np.random.default_rng(0)
    gaps = GAP / 3600 + 1e-4 * generator.standard_normal(len(angles))
    log = log_of(PAIR)
    right = fit(log, PAIR, readings=BacklashReadings.from_arrays(angles, gaps))
    wrong = fit(log, PAIR, readings=BacklashReadings.from_arrays(angles, gaps + 0.02))
    severities = [
        next(one.severity for one in result.findings if one.slug == "readings")
        for result in (right, wrong)
    ]
    assert severities == ["note", "warning"]


def test_readings_may_join_the_fit():
    pair = drive("1/2", orders=(1,))
    log = log_of(pair, (30.0,), passes=2, rate_hz=60.0)
    angles = np.arange(0.0, 1440.0, 90.0)
    readings = BacklashReadings.from_arrays(
        angles, GAP / 3600 + 1e-4 * np.random.default_rng(0).standard_normal(len(angles))
    )
    without = fit(log, pair).checks.gap_over_angles_covered
    joined = fit(log, pair, readings=readings, use_readings=True).checks
    assert joined.readings is not None and joined.readings.used
    assert known(joined.gap_over_angles_covered.std) < 0.3 * known(without.std)
    assert joined.gap_over_angles_covered.value == pytest.approx(GAP / 3600, abs=3e-4)


def test_equal_orders_are_named():
    pair = drive("1", orders=(1, 2))
    (one,) = [one for one in fit(log_of(pair), pair).findings if one.slug == "orders-equal"]
    assert one.severity == "warning"


def test_a_log_without_a_common_zero_says_where_it_starts():
    two = [log_of(PAIR, seed=0), log_of(PAIR, seed=1, start_turns=0.3)]
    result = fit(two, PAIR)
    start = result.logs[1].start
    assert start.driving_deg is not None and start.driving_std_deg is not None
    off = (start.driving_deg - 108 + 180) % 360 - 180
    assert abs(off) < 4 * start.driving_std_deg + 1.0
    smooth = [log_of(PAIR, seed=k, error=level(0.0), start_turns=0.3 * k) for k in (0, 1)]
    unknown = fit(smooth, PAIR)
    assert unknown.logs[1].start.driving_deg is None and "start-unknown" in slugs(unknown)


def test_every_finding_is_one_sentence_with_a_slug(plain):
    assert len({make.__name__ for make in FINDINGS}) == len(FINDINGS) <= 40
    for one in plain.findings:
        assert one.sentence and "\n" not in one.text and one.slug == one.slug.lower()
    record = plain.to_json()
    assert [one["slug"] for one in record["findings"]] == [one.slug for one in plain.findings]
    assert record["notes"] == [one.text for one in plain.findings]
    assert record["warnings"] == [o.text for o in plain.findings if o.severity != "note"]


UNITS = {"deg": 1.0, "rad": DEG, "rev": 1 / 360}


@pytest.mark.parametrize("unit", UNITS)
def test_other_units_make_the_same_claims(plain, unit):
    log = log_of(PAIR)
    size = UNITS[unit]
    other = EncoderLog.from_arrays(
        log.time,
        log.driving_angle / DEG * size,
        log.driven_angle / DEG * size,
        pair=PAIR,
        unit=unit,
    )
    same_claims(fit(other, PAIR), plain)


@pytest.mark.parametrize("factor", [0.1, 7.0])
def test_a_slower_clock_makes_the_same_claims(plain, factor):
    log = log_of(PAIR)
    other = EncoderLog.from_arrays(
        log.time * factor, log.driving_angle / DEG, log.driven_angle / DEG, pair=PAIR, unit="deg"
    )
    same_claims(fit(other, PAIR), plain)


def test_a_turned_log_makes_the_same_claims(plain):
    """Whole turns on both encoders are no other rig."""
    log = log_of(PAIR)
    other = with_angles(log, PAIR, log.driving_angle + 2 * REV, log.driven_angle + REV)
    same_claims(fit(other, PAIR), plain)


def same_claims(one: Fit, other: Fit) -> None:
    """Compare values in standard errors, and standard errors."""
    for name in ("driving_amplitude_arcsec", "constant_backlash_deg"):
        a, b = one.parameters[name], other.parameters[name]
        assert a.determined == b.determined
        assert abs(known(a.value) - known(b.value)) < 0.1 * known(b.std) and a.std == pytest.approx(
            b.std, rel=0.1
        )
    assert slugs(one) - {"segments", "log"} == slugs(other) - {"segments", "log"}

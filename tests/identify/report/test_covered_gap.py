"""Gap over the angles that both flanks covered, and gap at the speeds of a log."""

from fractions import Fraction

import numpy as np
import pytest

from tests.identify.drives import drive, drive_log, known, level, there_and_back
from vttig_jax.base.numerics.quantiles import NORMAL_95
from vttig_jax.base.units import DEG
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.model.harmonics import plan_terms
from vttig_jax.identify.report.check_sentences import check_sentences
from vttig_jax.identify.report.checks import CoveredGap, GapAtSpeed
from vttig_jax.identify.report.covered_gap import (
    _distinct,
    depends_on_speed,
    on_both_flanks,
)
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.flank_assignment import assigned_segments
from vttig_jax.pair.gear_pair import Flank

SLOW = drive("1/10")
HALF = drive("1/2")
SPEEDS_RPM = (30.0, 60.0, 90.0, 120.0)
DELAY_S = 1e-3


def _error(angle, _):
    return 20 * np.sin(angle + 0.3) + 30 * np.sin(angle / 2 + 1)


def _gap_of_angle(angle, _):
    return 100 + 60 * np.sin(angle / 10 + 0.4)


def _saturating(_, rpm):
    return 100 + 80 * np.minimum(rpm / 60, 1)


@pytest.fixture(scope="module")
def third_of_a_turn() -> EncoderLog:
    """Three passes both ways over a third of a turn of the driven shaft."""
    return drive_log(
        SLOW,
        there_and_back([60, 60, 60], 3.33),
        gap=_gap_of_angle,
        error=lambda angle, _: 20 * np.sin(angle + 0.3) + 30 * np.sin(angle / 10 + 1),
        noise_arcsec=3.0,
    )


@pytest.fixture(scope="module")
def third(third_of_a_turn) -> Fit:
    return fit(third_of_a_turn, SLOW, delay="off")


def _range(log: EncoderLog) -> tuple[float, float]:
    """The driving angles in rad that both flanks covered."""
    ends = {"A": [], "B": []}
    for segment in assigned_segments(log).segments:
        angle = log.driving_angle[segment.start : segment.stop]
        ends[segment.flank] += [float(angle.min()), float(angle.max())]
    return max(map(min, ends.values())), min(map(max, ends.values()))


def test_the_covered_gap_is_the_mean_over_the_covered_angles(third, third_of_a_turn):
    low, high = _range(third_of_a_turn)
    truth = float(_gap_of_angle(np.linspace(low, high, 2001), 0).mean()) / 3600
    gap = third.checks.gap_over_angles_covered
    assert gap.determined
    assert abs(known(gap.value) - truth) < 3 * known(gap.std) < 2e-4
    assert known(gap.low95) < truth < known(gap.high95)


def test_the_constant_term_alone_is_not_this_mean(third):
    """Over a third of a turn the constant term and the first order share the gap."""
    parameter = third.parameters["constant_backlash_deg"]
    assert not parameter.determined and "driven shaft turned too little" in parameter.reason
    constant = third.values[third.covariance_names.index("constant_backlash")] / DEG
    gap = third.checks.gap_over_angles_covered
    assert abs(constant - known(gap.value)) > 100 * known(gap.std)


def test_angles_between_samples_are_covered(third, third_of_a_turn):
    """At 60 rpm the samples are 3.6° apart, and the shaft passes every degree between them."""
    low, high = _range(third_of_a_turn)
    assert third.checks.gap_over_angles_covered.covered_deg == pytest.approx(
        (high - low) / DEG, abs=3
    )


def test_one_direction_determines_no_gap():
    durations, rpms = there_and_back([60], 4)
    forward = durations[:5], rpms[:5]
    gap = fit(
        drive_log(HALF, forward, gap=level(150.0), error=_error), HALF
    ).checks.gap_over_angles_covered
    assert not gap.determined and gap.value is None
    assert gap.reason == "one direction: one flank alone shows no gap"


def test_directions_over_disjoint_angles_determine_no_gap():
    log = drive_log(HALF, there_and_back([60], 10), gap=level(150.0), error=_error)
    turns = log.driving_angle / (2 * np.pi)
    backward = np.arange(len(log)) > int(np.argmax(turns))
    direction = np.where(backward & (turns > 6), -1, np.where(~backward & (turns < 4), 1, 0))
    split = EncoderLog.from_arrays(
        log.time, log.driving_angle, log.driven_angle, pair=HALF, unit="rad", direction=direction
    )
    result = fit(split, HALF, delay="off")
    gap = result.checks.gap_over_angles_covered
    assert result.flanks == ("A", "B")
    assert not gap.determined and gap.value is None
    assert (gap.reason or "").startswith("no driving angle was covered on both flanks")


@pytest.fixture(scope="module")
def saturating() -> Fit:
    """Each of four speeds four times, and a gap that no longer grows above 60 rpm."""
    motion = there_and_back(SPEEDS_RPM * 4, 4)
    log = drive_log(HALF, motion, gap=_saturating, error=_error, delay_s=level(DELAY_S))
    return fit(log, HALF, drift_order=0)


@pytest.fixture(scope="module")
def constant() -> Fit:
    motion = there_and_back(SPEEDS_RPM * 4, 4)
    log = drive_log(HALF, motion, gap=level(150.0), error=_error, delay_s=level(DELAY_S))
    return fit(log, HALF, drift_order=0)


def _speed_notes(result: Fit) -> list[str]:
    return [note for note in result.notes if "gap" in note and "speed" in note]


def test_a_gap_that_saturates_with_speed_is_told(saturating):
    assert depends_on_speed(saturating.checks.gap_by_speed)
    (note,) = _speed_notes(saturating)
    assert note.startswith("the gap depends on the speed")


def test_the_intervals_of_gap_and_delay_contain_what_no_single_gap_tells(saturating, constant):
    backlash = saturating.parameters["constant_backlash_deg"]
    gap, delay = saturating.checks.gap_over_angles_covered, saturating.parameters["delay_s"]
    for row in saturating.checks.gap_by_speed:
        assert gap.low95 <= row.value <= gap.high95
        assert backlash.low95 - 1e-9 <= row.value <= backlash.high95 + 1e-9
    assert delay.low95 <= DELAY_S <= delay.high95
    alone = delay.std - constant.parameters["delay_s"].std
    assert alone > 0 and abs(delay.value - DELAY_S) > NORMAL_95 * constant.parameters["delay_s"].std
    assert constant.parameters["constant_backlash_deg"].std < 0.05 * backlash.std


def test_rows_are_the_gap_and_what_the_fitted_delay_explains(saturating):
    rows = saturating.checks.gap_by_speed
    assert [row.speed_rpm for row in rows] == pytest.approx(list(SPEEDS_RPM), rel=1e-3)
    off_s = DELAY_S - saturating.value("delay_s")
    for row in rows:
        driven_deg_per_s = 0.5 * 6 * row.speed_rpm
        truth = float(_saturating(0, row.speed_rpm)) / 3600 + 2 * driven_deg_per_s * off_s
        assert row.value == pytest.approx(truth, abs=5e-4), row
    assert np.ptp([row.value for row in rows]) > 5e-3


def test_a_constant_gap_gives_no_note(constant):
    rows = constant.checks.gap_by_speed
    assert len(rows) >= 3 and not depends_on_speed(rows)
    assert [row.value for row in rows] == pytest.approx([150 / 3600] * len(rows), abs=1e-4)
    assert _speed_notes(constant) == []


def test_a_delay_that_creeps_is_no_gap_that_depends_on_the_speed():
    """The log is slow early and late and fast in between, as is the error of the mean delay."""
    motion = there_and_back((30, 30, 60, 60, 120, 120, 120, 90, 90, 60, 30, 30, 30, 30), 4)

    def creeping(time_s, _):
        return DELAY_S * (1 + 0.1 * time_s / time_s[-1])

    for gap, claimed in ((level(150.0), False), (_saturating, True)):
        log = drive_log(HALF, motion, gap=gap, error=_error, delay_s=creeping, noise_arcsec=2.0)
        rows = fit(log, HALF, drift_order=0).checks.gap_by_speed
        assert len(rows) >= 3 and depends_on_speed(rows) == claimed


def test_one_speed_gives_no_rows(third):
    assert third.checks.gap_by_speed == ()


@pytest.mark.smoke
def test_a_part_linear_in_speed_is_the_delay():
    rows = [GapAtSpeed(speed_rpm=s, value=0.04 + 1e-3 * s, std=1e-5) for s in (10.0, 20.0, 40.0)]
    assert not depends_on_speed(rows)
    assert depends_on_speed([*rows[:2], GapAtSpeed(speed_rpm=40.0, value=0.07, std=1e-5)])
    assert not depends_on_speed(rows[:2])


@pytest.mark.smoke
def test_only_an_interval_below_zero_contradicts():
    below = CoveredGap(-0.05, 0.01, -0.07, -0.03, determined=True)
    assert below.is_contradiction
    assert not CoveredGap(-0.01, 0.01, -0.03, 0.01, determined=True).is_contradiction
    assert not CoveredGap(reason="one direction").is_contradiction


def test_the_report_states_the_covered_gap_where_no_constant_one_is_known(third):
    words = {"several_logs": False, "has_noise": True}
    told = check_sentences(third.checks, **words, gap_determined=False)
    (sentence,) = (one for one in told if "driving shaft that both flanks covered" in one)
    assert sentence.endswith(
        "constant_backlash_deg is only the part that is the same at every angle"
    )
    known = check_sentences(third.checks, **words, gap_determined=True)
    assert not any("both flanks covered" in sentence for sentence in known)


def _gap_wave(angle):
    """A curve with the period of 9/16: orders of both shafts and of their product."""
    driven = 9 / 16 * angle
    return 1.0 + np.cos(angle + 0.3) + 0.5 * np.cos(8 * driven) + 0.2 * np.sin(angle - driven)


def test_cells_a_hunting_period_apart_are_counted_and_not_repeated():
    terms = plan_terms(Fraction(9, 16), (1, 2), (1, 2), 0, None)
    cells = np.arange(-700, 100 * 360 + 123)
    angles, times = _distinct(np.array([[-700, 100], [100, 100 * 360 + 123]]), terms)
    assert len(angles) == 16 * 360 and times.sum() == len(cells)
    every = _gap_wave((cells + 0.5) * DEG).mean()
    assert np.average(_gap_wave(angles), weights=times) == pytest.approx(every, abs=1e-12)
    assert np.average(_gap_wave(angles)) != pytest.approx(every, abs=1e-6)


@pytest.mark.smoke
def test_ranges_of_both_flanks_are_those_of_single_cells():
    generator = np.random.default_rng(5)
    for _ in range(200):
        found: dict[Flank, list[tuple[int, int]]] = {"A": [], "B": []}
        cells: dict[str, set[int]] = {"A": set(), "B": set()}
        for flank, own in found.items():
            for low in generator.integers(-30, 30, generator.integers(0, 4)).tolist():
                own.append((low, low + int(generator.integers(0, 20))))
                cells[flank] |= set(range(*own[-1]))
        ranges = on_both_flanks(found).tolist()
        counted = [cell for low, high in ranges for cell in range(low, high)]
        assert sorted(cells["A"] & cells["B"]) == counted


def test_long_runs_with_fractional_orders_use_every_place_of_a_turn():
    terms = plan_terms(Fraction(9, 16), (1, 1.37), (1,), 0, None)
    angles, times = _distinct(np.array([[0, 150 * 360]]), terms)
    assert len(angles) < 20_000 and np.all(times == 1)
    places = np.bincount(np.rint(angles / DEG - 0.5).astype(int) % 360, minlength=360)
    assert places.min() >= places.max() - 1 > 0
    few, once = _distinct(np.array([[0, 7000], [7000, 7200]]), terms)
    assert len(few) == len(once) == 7200

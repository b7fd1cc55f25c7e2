"""A delay between the channels: found with its sign, left alone, left open, or taken as given."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from tests.identify.quick import errors, quick_rig, scores
from vttig_jax.base.units import DEG, REV
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.preliminary import ramps
from vttig_jax.identify.preliminary.delay import (
    NEGLECTED,
    TOO_SHORT,
    Delay,
    judge_delay,
    one_speed,
)
from vttig_jax.identify.preliminary.nuisance import NuisanceRegression
from vttig_jax.identify.preliminary.ramps import on_its_branch
from vttig_jax.identify.report.parameters import BESIDE_FREE_DELAY
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.logs.motion.flank_assignment import Ramp
from vttig_jax.logs.motion.segments import Segment, find_segments
from vttig_jax.pair.gear_pair import Flank

ECCENTRICITIES = (
    "driving_eccentricity_mm",
    "driving_phase_deg",
    "driven_eccentricity_mm",
    "driven_phase_deg",
)


def _contradictions(result) -> list[str]:
    return [note for note in result.warnings if "the log shows a delay" in note]


def _ramp_notes(result) -> list[str]:
    return [note for note in result.notes if "ramps keep to the flank" in note]


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))])
@pytest.mark.parametrize("delay_s", [3e-3, -2e-3])
def test_one_speed_and_its_ramps_tell_the_delay(delay_s, seed):
    rig = quick_rig(seed, delay_s)
    result = fit(rig.log(seed), rig.pair)
    delay = result.parameters["delay_s"]
    assert delay.determined and delay.significant
    assert delay.value == pytest.approx(delay_s, abs=4 * (delay.std or 0.0))
    assert delay.std is not None and delay.std < 5e-6
    assert max(abs(score) for score in scores(result).values()) < 4
    assert abs(errors(result)["constant_backlash_deg"]) < 0.002
    assert _ramp_notes(result) == [
        "4 of 4 ramps keep to the flank of their motion and count for the delay"
    ]


def test_an_ignored_delay_ends_up_in_the_backlash():
    """2 · 3 ms · i · 360°/s = 1.215°: the judge above would see it."""
    rig = quick_rig(0, 3e-3)
    result = fit(rig.log(0), rig.pair, delay="off")
    assert errors(result)["constant_backlash_deg"] == pytest.approx(1.215, abs=2e-3)
    delay = result.parameters["delay_s"]
    assert not delay.determined and delay.value is None
    assert delay.reason == "not fitted: both channels are taken to be sampled at the same instant"
    assert result.warnings[0].startswith("the log shows a delay of about 3 ms, although --delay")


def test_a_true_statement_on_the_delay_is_not_contradicted(quick_log, quick_rig):
    assert not _contradictions(fit(quick_log, quick_rig.pair, delay="off"))


@pytest.fixture(scope="module")
def steady(paper_pair):
    """No ramps, no ripple, no counts: nothing moves the speed of a run."""
    rig = replace(quick_rig(0, 3e-3, ramp_s=0.01, ripple=0.0), pair=paper_pair)
    return rig, rig.log(0)


def test_at_one_speed_without_ramps_it_is_open(steady):
    rig, log = steady
    delay = fit(log, rig.pair).parameters["delay_s"]
    assert not delay.determined and delay.value is None
    assert delay.reason == (
        "at one steady speed a delay cannot be told from the constant backlash; log a second speed"
    )
    forced = fit(log, rig.pair, delay="free")
    assert not forced.parameters["delay_s"].determined
    assert not forced.parameters["constant_backlash_deg"].determined
    assert forced.checks.gap_over_angles_covered.reason == BESIDE_FREE_DELAY
    assert forced.parameters["driving_eccentricity_mm"].determined


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_counts_at_one_speed_without_ramps_leave_it_open_too(seed):
    rig = quick_rig(seed, 3e-3, ramp_s=0.01, ripple=0.0)
    delay = fit(rig.log(seed), rig.pair).parameters["delay_s"]
    assert not delay.determined or abs((delay.value or 0.0) - 3e-3) < 4 * (delay.std or 0.0)


def test_one_flank_at_one_speed_cannot_tell_it_from_an_offset(steady):
    rig, log = steady
    segment = find_segments(log).segments[0]
    part = slice(segment.start, segment.stop)
    forward = EncoderLog.from_arrays(
        log.time[part], log.driving_angle[part], log.driven_angle[part], pair=rig.pair, unit="rad"
    )
    delay = fit(forward, rig.pair).parameters["delay_s"]
    assert "cannot be told from an offset" in (delay.reason or "")


def test_two_speeds_need_no_ramps():
    """Rms over three seeds: a delay of 3 ms leaves 0.0002° in the gap."""
    left = []
    for seed in range(3):
        fast, slow = (
            quick_rig(seed, 3e-3, speed_rpm=rpm, reversal_deg=3600.0, ramp_s=0.01)
            for rpm in (60.0, 20.0)
        )
        result = fit([fast.log(seed), slow.log(seed + 100)], fast.pair, same_zero=True)
        delay = result.parameters["delay_s"]
        assert delay.value == pytest.approx(3e-3, abs=4 * (delay.std or 0.0))
        assert delay.std is not None and delay.std < 1e-6
        assert max(abs(score) for score in scores(result).values()) < 4
        assert not _ramp_notes(result)
        left.append(errors(result)["constant_backlash_deg"])
    assert np.sqrt(np.mean(np.square(left))) < 2e-4


def test_without_a_delay_it_is_insignificant_and_only_the_gap_pays(quick_log, quick_rig, quick_fit):
    delay = quick_fit.parameters["delay_s"]
    assert delay.determined and not delay.significant
    assert delay.reason == NEGLECTED
    assert abs(delay.value) < 4 * delay.std
    assert delay.high95 - delay.low95 == pytest.approx(2 * 1.959964 * delay.std)
    known = fit(quick_log, quick_rig.pair, delay="off")
    for name in ECCENTRICITIES:
        one, other = quick_fit.parameters[name], known.parameters[name]
        assert (one.value, one.std) == pytest.approx((other.value, other.std), rel=1e-9)
    assert not _ramp_notes(quick_fit)
    gap, given = (one.parameters["constant_backlash_deg"] for one in (quick_fit, known))
    assert gap.value == pytest.approx(given.value, rel=1e-9)
    of_delay = quick_fit.checks.gap_of_delay
    assert of_delay and delay.value and gap.std and gap.low95 and gap.high95 and given.std
    speed = 2 * 45 / 80 * REV  # of both flanks together, at 60 rpm
    assert of_delay.std_deg == pytest.approx(np.hypot(delay.value, delay.std) * speed / DEG, 0.02)
    assert gap.std == pytest.approx(np.hypot(given.std, of_delay.std_deg))
    assert (gap.high95 - gap.low95) / 2 == pytest.approx(1.959964 * gap.std)
    covered = quick_fit.checks.gap_over_angles_covered
    assert covered.std == pytest.approx(gap.std, rel=0.05)
    assert known.checks.gap_of_delay is None
    (note,) = [note for note in quick_fit.notes if "--delay off" in note]
    assert "log a second speed" in note and "--delay-within" not in note
    assert f"±{of_delay.half_width_deg:.2g}°" in note


@pytest.mark.parametrize("seed", [0, 1])
def test_a_delay_too_small_to_be_fitted_is_in_the_interval_of_the_gap(seed):
    rig = quick_rig(seed, -3e-6)
    result = fit(rig.log(seed), rig.pair)
    assert not result.parameters["delay_s"].significant
    gap, of_delay = result.parameters["constant_backlash_deg"], result.checks.gap_of_delay
    assert of_delay is not None and gap.value and gap.std and gap.low95 and gap.high95
    assert gap.low95 < 0.038 < gap.high95
    alone = np.sqrt(gap.std**2 - of_delay.std_deg**2)
    assert abs(gap.value - 0.038) > 4 * alone  # the noise alone does not explain the distance


def test_free_keeps_it_and_pays(quick_log, quick_rig, quick_fit):
    result = fit(quick_log, quick_rig.pair, delay="free")
    delay, gap = (result.parameters[n] for n in ("delay_s", "constant_backlash_deg"))
    assert delay.determined and not delay.significant
    assert None not in (delay.value, delay.std, gap.value, gap.std)
    assert delay.value == pytest.approx(0.0, abs=4 * (delay.std or 0.0))
    known = fit(quick_log, quick_rig.pair, delay="off").parameters["constant_backlash_deg"]
    assert (gap.std or 0.0) > 3 * (known.std or np.nan)
    assert gap.value == pytest.approx(0.038, abs=4 * (gap.std or 0.0))


@pytest.mark.parametrize(("within_ms", "beyond"), [(0.5, True), (5.0, False)])
def test_a_bound_beside_a_delay_that_the_log_tells_is_not_used(within_ms, beyond):
    rig = quick_rig(1, 3e-3)
    log = rig.log(1)
    result = fit(log, rig.pair, delay_within_ms=within_ms)
    assert result.parameters["delay_s"].significant
    (note,) = [note for note in result.notes if "--delay-within is not used" in note]
    assert ("beyond that limit" in note) is beyond
    one = fit(log, rig.pair, delay_within_ms=within_ms, flank="A")
    assert any("one flank" in note and "is not used" in note for note in one.notes)


@pytest.mark.parametrize("wrong_by_s", [0.0, 1e-3])
def test_a_given_delay_is_taken(wrong_by_s):
    rig = quick_rig(1, 3e-3)
    result = fit(rig.log(1), rig.pair, delay=3e-3 - wrong_by_s)
    delay = result.parameters["delay_s"]
    assert not delay.determined and delay.value is None
    assert (delay.reason or "").startswith(f"given as {3e-3 - wrong_by_s:g} s")
    assert "given_delay" in result.conditional_on
    expected = 2 * wrong_by_s * 45 / 80 * 360.0
    assert errors(result)["constant_backlash_deg"] == pytest.approx(expected, abs=1e-3)
    found = _contradictions(result)
    assert len(found) == (wrong_by_s != 0)
    assert all("about 3 ms, not of 2 ms as stated with --delay" in note for note in found)


def test_a_speed_column_leaves_it_open():
    rig = quick_rig(0, 3e-3)
    result = fit(rig.log(0), rig.pair, regressors=["speed"], delay="free")
    delay = result.parameters["delay_s"]
    assert not delay.determined
    assert delay.reason == "a delay and a regressor proportional to speed are the same"


def _coasting(seed: int, delay_s: float):
    """While gear 1 slows down, gear 2 runs ahead to the other flank and stays there."""
    rig = quick_rig(seed, delay_s)
    log, motion = rig.log(seed), rig.motion
    gap = np.asarray(rig.flank_model().backlash(motion.driving_angle(log.time - delay_s)))
    run_s = motion.duration_s / motion.passes
    slowing = run_s - motion.dwell_s - motion.ramp_s
    crossed = [np.clip((log.time - k * run_s - slowing) / 0.15, 0, 1) for k in (0, 1)]
    forward = log.time < run_s
    driven = log.driven_angle + gap * np.where(forward, crossed[0], -crossed[1])
    return rig, EncoderLog.from_arrays(
        log.time, log.driving_angle / DEG, driven / DEG, pair=rig.pair, unit="deg"
    )


@pytest.mark.parametrize("delay_s", [3e-3, pytest.param(0.0, marks=pytest.mark.slow)])
def test_a_ramp_that_changes_flank_is_left_out(delay_s, monkeypatch):
    rig, log = _coasting(0, delay_s)
    result = fit(log, rig.pair, delay="free")
    assert _ramp_notes(result) == [
        "2 of 4 ramps keep to the flank of their motion and count for the delay"
    ]
    delay = result.parameters["delay_s"]
    assert delay.value == pytest.approx(delay_s, abs=4 * (delay.std or 0.0))
    assert max(abs(score) for score in scores(result).values()) < 4
    # Taken at its word, the crossing passes for 0.1 ms.
    monkeypatch.setattr(ramps, "on_its_branch", lambda *_: True)
    deceived = fit(log, rig.pair, delay="free")
    assert abs(deceived.parameters["delay_s"].value - delay_s) > 5e-5


def _own(gram: float = 1.0, right: float = 0.0, raw: float = 1.0) -> NuisanceRegression:
    """One coefficient, `right`/`gram`, with a standard error of √(1/gram)."""
    triangle = np.array([[np.sqrt(gram), right / np.sqrt(gram)], [0.0, 10.0]])
    return NuisanceRegression(("delay",), triangle, 101.0, 1e4, np.array([raw]))


@pytest.mark.parametrize(
    ("before", "right", "state"),
    [
        (0.0, 3.9, "insignificant"),
        (0.0, 4.1, "fitted"),
        (0.0, -4.1, "fitted"),
        (5.0, 0.1, "fitted"),
        (5.0, -4.0, "insignificant"),
    ],
)
def test_what_counts_is_the_whole_delay_and_not_the_step(before, right, state):
    found = _judged(_own(right=right), before)
    assert found.state == state
    assert found.std_s == pytest.approx(1.0, rel=1e-6)
    if state == "fitted":
        assert (found.seconds, found.step_s) == pytest.approx((before, right), rel=1e-6)
    else:
        assert (found.seconds, found.step_s) == pytest.approx((0.0, before + right), rel=1e-6)
    assert _judged(_own(right=right), before, forced=True).state == "fitted"


def _judged(
    own: NuisanceRegression, seconds: float, *, forced: bool = False, two_flanks: bool = True
) -> Delay:
    """Return the decision on a delay of a log at several speeds."""
    return judge_delay(
        own,
        [],
        seconds,
        forced=forced,
        two_flanks=two_flanks,
        steady=False,
        within_s=1e-3,
    )


@pytest.mark.parametrize(("raw", "state"), [(1e4, "fitted"), (2e6, "open"), (0.0, "open")])
def test_a_delay_hidden_behind_offsets_is_open(raw, state):
    found = _judged(_own(right=50.0, raw=raw), 0.0, two_flanks=False)
    assert found.state == state
    assert ("an offset" in found.reason) == (state == "open")


@pytest.mark.parametrize(
    ("within_s", "short", "state"),
    [(60.0, True, "open"), (47.0, True, "open"), (45.0, True, "fitted"), (60.0, False, "fitted")],
)
def test_short_strokes_tell_only_a_delay_beyond_the_bound(within_s, short, state):
    """The delay is 50 standard errors, of which 4 may be missing."""
    own = _own(right=50.0)
    limits = {"two_flanks": True, "steady": False, "within_s": within_s, "short": short}
    found = judge_delay(own, [], 0.0, forced=False, **limits)
    assert found.state == state and (found.reason == TOO_SHORT) == (state == "open")
    assert judge_delay(own, [], 0.0, forced=True, **limits).state == "fitted"


def test_settled_is_a_hundredth_of_a_standard_error():
    assert Delay("fitted", 1e-3, 0.9e-8, 1e-6).is_settled
    assert not Delay("fitted", 1e-3, 1.1e-8, 1e-6).is_settled
    assert Delay("fitted", 1e-3, 0.9e-9, 0.0).is_settled
    assert Delay("insignificant", 0.0, 1e-3, 1e-3).is_settled
    assert Delay("fitted", 0.5, 0.25, 0.1).stepped() == Delay("fitted", 0.75, 0.0, 0.1)


def test_the_error_of_a_delay_taken_as_zero_contains_its_estimate():
    clear, none = (Delay("insignificant", 0.0, step, 1e-3, within_s=2e-3) for step in (3e-3, 0.0))
    assert none.neglected_s(steady=True) == pytest.approx(1.96e-3, rel=1e-4)
    assert clear.neglected_s(steady=True) == pytest.approx(1.96 * np.hypot(3e-3, 1e-3), rel=1e-4)
    assert Delay("fitted", 0.0, 3e-3, 1e-3).neglected_s(steady=True) == 0.0


@pytest.mark.parametrize("step_s", [0.0, 1e-6, -2.5e-6])
@pytest.mark.parametrize("std_s", [1e-6, 1e-4])
def test_at_two_speeds_a_delay_far_above_the_smallest_ones_is_less_probable(step_s, std_s):
    """The quantile by direct integration of the posterior over |delay|."""
    delay = Delay("insignificant", 0.0, step_s, std_s, within_s=1e-3)
    found = delay.neglected_s(steady=False)

    def integral(high: float) -> float:
        def density(size: float) -> float:
            likelihood = sum(np.exp(-(((s * size - step_s) / std_s) ** 2) / 2) for s in (1, -1))
            return likelihood * (1 / (size * np.log(1e4)) + 1e3)  # flat in log size, and in size

        ends = np.geomspace(1e-7, high, 60)
        return sum(quad(density, a, b)[0] for a, b in pairwise(ends))

    assert integral(found) / integral(1e-3) == pytest.approx(0.95, abs=2e-3)
    assert found <= delay.neglected_s(steady=True)
    assert found < (2e-4 if std_s == 1e-4 else 4.5e-6)


def test_the_bound_of_the_user_is_that_of_a_small_delay_at_two_speeds():
    logs = [quick_rig(0, speed_rpm=speed).log(seed) for seed, speed in ((0, 60.0), (1, 90.0))]
    pair = quick_rig(0).pair
    widths = []
    for within_ms in (1e-3, None, 1.0):
        found = fit(logs, pair, same_zero=True, delay_within_ms=within_ms)
        assert not found.parameters["delay_s"].significant
        assert found.checks.gap_of_delay is not None and not found.checks.gap_of_delay.bounded
        assert any("--delay-within" in note for note in found.notes)
        assert not any("is not used" in note for note in found.notes)
        widths.append(found.checks.gap_of_delay.half_width_deg)
    assert widths[0] < 0.8 * widths[1]
    assert widths[1] == pytest.approx(widths[2], rel=0.01)  # the logs exclude larger delays


def test_delays_below_the_smallest_are_bounded_by_their_own_interval():
    delay = Delay("insignificant", 0.0, 1e-9, 1e-9, within_s=1e-3)
    assert delay.neglected_s(steady=False) == delay.neglected_s(steady=True)


def test_one_speed_looks_at_both_senses():
    segments = [Segment(0, 9, "A", 6.0), Segment(9, 20, "B", -6.2)]
    assert one_speed(segments)
    assert not one_speed([*segments, Segment(20, 30, "A", 5.5)])
    assert not one_speed([])


@pytest.mark.parametrize(
    ("at", "kept"), [(0.0, True), (0.2, True), (0.5, False), (1.0, False), (-0.5, False)]
)
def test_a_branch_is_a_quarter_of_the_gap_wide(at, kept):
    """Rows (1, y): flank A at y = 0, flank B at y = 1."""
    ramp = Ramp(Segment(0, 20, "A", 1.0), speeding_up=False)
    rows = np.column_stack([np.ones(20), np.full(20, at)])
    weights: dict[Flank, np.ndarray] = {"A": np.array([0.0, 1.0]), "B": np.array([-1.0, 1.0])}
    assert on_its_branch(ramp, rows, weights, 0.001) is kept
    other = replace(ramp, segment=replace(ramp.segment, flank="B"))
    assert on_its_branch(other, rows, weights, 0.001) is (at == 1.0)
    # Noise widens it, one stray row in twenty is allowed, an unknown flank is not.
    assert on_its_branch(ramp, rows, weights, 1.0)
    assert on_its_branch(ramp, rows, weights, 0.2) is (abs(at) < 0.5 or abs(at) == 0.5)
    rows[:, 1] = 0.0
    rows[0, 1] = 9.0
    assert on_its_branch(ramp, rows, weights, 0.001)
    rows[1, 1] = 9.0
    assert not on_its_branch(ramp, rows, weights, 0.001)
    assert not on_its_branch(ramp, rows, {"B": weights["B"]}, 1e9)


@pytest.mark.parametrize(("slower", "same"), [(19.0, True), (18.99, False)])
def test_speeds_five_percent_apart_count_as_one(slower, same):
    assert one_speed([Segment(0, 9, "A", 20.0), Segment(9, 20, "B", -slower)]) is same

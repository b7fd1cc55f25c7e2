"""Plans of a drive: directions, speeds, delays, and what every choice changes."""

import re
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest

from vttig_jax.base.errors import NoAnswerError, UsageError
from vttig_jax.base.units import DEG, REV
from vttig_jax.pair.gear_pair import Drive, Eccentricities
from vttig_jax.pair.schema import HarmonicOrders
from vttig_jax.posterior.planning.noise import PlannedNoise
from vttig_jax.posterior.planning.plan import plan
from vttig_jax.posterior.planning.run import PlannedRun
from vttig_jax.rig.paper import paper_pair

PAPER_NOISE = PlannedNoise(0.002, 0.00475)
PAPER_RUN: dict[str, Any] = {"turns": 21.0, "rate_hz": 1987.0, "noise": PAPER_NOISE}
FEW = HarmonicOrders(driving_orders=(1, 2), driven_orders=(1, 2), mesh_orders=0)
WHITE = PlannedNoise(0.003)
DRIVE = Drive(Fraction(9, 16))
SHORT: dict[str, Any] = {"turns": 20.0, "rate_hz": 500.0, "noise": WHITE}


@cache
def drive_plan(**changes):
    """A cheap plan of a drive 9/16; `assumed` as pairs, because a cache needs hashes."""
    if "assumed" in changes:
        changes["assumed"] = dict(changes["assumed"])
    return plan(DRIVE, **dict(SHORT, **{"orders": FEW, **changes}))


def test_backward_is_the_other_flank_and_tells_as_much():
    forward, backward = (drive_plan(directions=way) for way in ("forward", "backward"))
    assert (forward.flanks, backward.flanks) == (("A",), ("B",))
    for name in ("driving_amplitude_arcsec", "driven_phase_deg"):
        assert backward.std(name) == pytest.approx(forward.std(name), rel=0.02)
    assert "one direction" in str(backward.parameters["constant_backlash_deg"].reason)


def test_two_speeds_tell_a_delay_from_the_gap():
    found = drive_plan(speed_rpm=(30.0, 60.0), turns=200.0)
    assert found.conditional_on == ()
    # Means of the two flanks at both speeds: offset on A, offset + gap on B, −ω₂ d everywhere.
    speeds = 9 / 16 * REV * np.array([0.5, 1.0])
    samples = 200.0 * 500.0 / np.array([0.5, 1.0])
    rows, weights = [], []
    for gap, sign in ((0.0, 1.0), (1.0, -1.0)):
        for speed, count in zip(speeds, samples, strict=True):
            rows.append([1.0, gap, -sign * speed])
            weights.append(count)
    information = np.array(rows).T @ (np.array(weights)[:, None] * np.array(rows))
    offset, gap, delay = WHITE.std_deg * DEG * np.sqrt(np.diag(np.linalg.inv(information)))
    # Drift and a gap that bends with the speed cost something.
    assert delay < found.std("delay_s") < 3 * delay
    assert gap / DEG < found.std("constant_backlash_deg") < 3 * gap / DEG
    assert offset < gap
    taken = drive_plan(speed_rpm=(30.0, 60.0), turns=200.0, delay="off")
    assert taken.std("constant_backlash_deg") < 0.5 * found.std("constant_backlash_deg")
    assert not taken.parameters["delay_s"].determined


def test_at_one_speed_the_ramps_tell_a_delay_or_nothing_does():
    plain, together = drive_plan(), drive_plan(delay="off")
    gap = "constant_backlash_deg"
    assert plain.parameters["delay_s"].determined and plain.std(gap) > 3 * together.std(gap)
    (told,) = [note for note in plain.notes if "--delay off" in note]
    known = float(re.findall(r"is ([0-9.e-]+)°", told)[0])
    assert known == pytest.approx(together.std(gap), rel=0.2)
    assert any("only the ramps" in note for note in plain.notes)
    none = drive_plan(ramp_s=0.0)
    assert none.conditional_on == ("delay_within_1_ms",)
    assert not none.parameters["delay_s"].determined
    assert any("only the assumption" in note and "second speed" in note for note in none.notes)
    # The gap is as uncertain as a delay of half a sampling interval makes it: |ω₂| d on each flank.
    assert none.std(gap) == pytest.approx(2 * 0.5625 * 360.0 * 0.001, rel=0.05)


def test_a_drive_splits_its_orders_into_common_and_gap():
    found = drive_plan(turns=64.0)
    sigma = WHITE.std_deg * 3600 * np.sqrt(2 / (found.used / 2)) / np.sqrt(2)
    assert found.std("driving_amplitude_arcsec") == pytest.approx(sigma, rel=0.08)
    assert found.std("driven_phase_deg") == pytest.approx(sigma / 60.0 / DEG, rel=0.08)
    assert "no gear geometry" in str(found.parameters["driven_encoder_arcsec"].reason)
    assert found.outcome == "ok"


def test_every_choice_changes_a_standard_error():
    for changes in (
        {"turns": 25.0},
        {"rate_hz": 700.0},
        {"speed_rpm": 40.0},
        {"passes": 4},
        {"noise": PlannedNoise(0.004)},
        {"noise": PlannedNoise(0.003, 0.01)},
        {"noise": PlannedNoise(0.003, 0.0, 0.001)},
        {"orders": HarmonicOrders(driving_orders=(1,), driven_orders=(1, 2), mesh_orders=0)},
        {"ramp_s": 1.0},
        {"directions": "forward"},
    ):
        name = "driven_amplitude_arcsec"
        assert drive_plan(**changes).std(name) != pytest.approx(drive_plan().std(name), rel=1e-8)


def test_dwell_and_assumed_phase_change_what_they_should():
    assert drive_plan(dwell_s=3.0).duration_s == pytest.approx(drive_plan().duration_s + 2.0)
    wider = drive_plan(assumed=(("driving_amplitude_arcsec", 30.0),))
    phase = "driving_phase_deg"
    assert wider.std(phase) == pytest.approx(2 * drive_plan().std(phase), rel=1e-2)
    assert wider.parameters["driving_amplitude_arcsec"].assumed == 30.0


def test_an_amplitude_too_small_to_tell_will_be_an_upper_limit():
    small = drive_plan(assumed=(("driving_amplitude_arcsec", 0.1),))
    amplitude, phase = (small.parameters[f"driving_{n}"] for n in ("amplitude_arcsec", "phase_deg"))
    assert amplitude.determined and not amplitude.significant
    assert "upper limit" in str(amplitude.reason)
    assert phase.std is None
    assert "three standard errors" in str(phase.reason)
    assert "not significant" in str(small)


def test_a_shaft_that_turns_too_little_is_left_out():
    found = plan(Drive(Fraction(1, 20)), turns=10.0, rate_hz=500.0, noise=WHITE, orders=FEW)
    assert found.short == ("driven",)
    assert "turned only 0.5" in str(found.parameters["driven_amplitude_arcsec"].reason)
    assert "too little" in str(found.parameters["constant_backlash_deg"].reason)
    assert found.parameters["driving_amplitude_arcsec"].determined


def test_a_flank_without_a_full_turn_and_a_slow_speed_are_told():
    found = drive_plan(speed_rpm=(60.0, 0.4), turns=4.0, delay="off", rate_hz=50.0)
    assert found.used > 0
    slow = PlannedRun(4.0, (60.0, 0.4), 50.0)
    assert slow.duration_s == pytest.approx(2 * (4.5 + 2 + 600.5 + 2))


def test_wrong_arguments_are_named(unchecked):
    for changes, words in (
        ({"turns": 0.0}, "turns"),
        ({"turns": np.nan}, "turns"),
        ({"turns": 0.3}, "two ramps"),
        ({"rate_hz": -1.0}, "rate_hz"),
        ({"speed_rpm": ()}, "speed_rpm"),
        ({"speed_rpm": (60.0, 0.0)}, "speed_rpm"),
        ({"directions": "sideways"}, "directions"),
        ({"passes": 1}, "passes"),
        ({"passes": 2, "directions": "forward"}, "passes"),
        ({"dwell_s": -1.0}, "dwell_s"),
        ({"delay": "maybe"}, "delay"),
        ({"delay": 2.0}, "delay"),
        ({"assumed": {"delay_s": 2.0}}, "delay_s within"),
        ({"assumed": {"delay_s": np.nan}}, "delay_s within"),
        ({"assumed": {"delay_s": 0.0}, "delay": "off"}, "no delay is fitted"),
        ({"noise": PlannedNoise()}, "noise"),
        ({"assumed": {"nonesuch": 1.0}}, "nonesuch"),
        ({"assumed": {"driving_amplitude_arcsec": -1.0}}, "driving_amplitude_arcsec"),
        ({"eccentricities": Eccentricities()}, "eccentricities"),
    ):
        keywords = dict(SHORT, **changes)
        with pytest.raises(ValueError, match=words):
            plan(DRIVE, **keywords)


def test_runs_that_tell_nothing_have_no_answer():
    with pytest.raises(NoAnswerError, match="full revolution"):
        drive_plan(turns=0.9)
    with pytest.raises(NoAnswerError, match="no log"):
        drive_plan(turns=1e-6, ramp_s=0.0)
    with pytest.raises(UsageError, match="samples"):
        drive_plan(rate_hz=1e9)


def test_frozen_counts_and_aliased_orders_are_told():
    frozen = plan(paper_pair(), **dict(PAPER_RUN, rate_hz=2000.0))
    assert any("45 counts of the driving encoder" in note for note in frozen.notes)
    slow = drive_plan(
        rate_hz=30.0, speed_rpm=600.0, orders=HarmonicOrders(mesh_orders=0), turns=90.0
    )
    assert any("driving orders 2, 3" in note and "alias" in note for note in slow.notes)

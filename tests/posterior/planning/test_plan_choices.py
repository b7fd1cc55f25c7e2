"""Plans of a drive: what every choice changes, and the shortest run that is enough."""

import re
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest

from vttig_jax.base import DEG, NoAnswerError, UsageError
from vttig_jax.pair import Drive, Eccentricities, HarmonicOrders
from vttig_jax.posterior import PlannedNoise, plan, shortest_run
from vttig_jax.posterior.planning.run import PlannedRun
from vttig_jax.rig import paper_pair

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


def test_backward_tells_as_much_and_a_shaft_that_turns_too_little_nothing():
    forward, backward = (drive_plan(directions=way) for way in ("forward", "backward"))
    assert (forward.flanks, backward.flanks) == (("A",), ("B",))
    for name in ("driving_amplitude_arcsec", "driven_phase_deg"):
        assert backward.std(name) == pytest.approx(forward.std(name), rel=0.02)
    assert "one direction" in str(backward.parameters["constant_backlash_deg"].reason)
    found = plan(Drive(Fraction(1, 20)), turns=10.0, rate_hz=500.0, noise=WHITE, orders=FEW)
    assert found.short == ("driven",)
    assert "turned only 0.5" in str(found.parameters["driven_amplitude_arcsec"].reason)
    assert "too little" in str(found.parameters["constant_backlash_deg"].reason)
    assert found.parameters["driving_amplitude_arcsec"].determined


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
        {"orders": HarmonicOrders((1,), (1, 2), 0)},
        {"ramp_s": 1.0},
        {"directions": "forward"},
    ):
        name = "driven_amplitude_arcsec"
        assert drive_plan(**changes).std(name) != pytest.approx(drive_plan().std(name), rel=1e-8)


def test_dwell_and_assumed_amplitudes_change_what_they_should():
    assert drive_plan(dwell_s=3.0).duration_s == pytest.approx(drive_plan().duration_s + 2.0)
    slow = PlannedRun(4.0, (60.0, 0.4), 50.0)
    assert slow.duration_s == pytest.approx(2 * (4.5 + 2 + 600.5 + 2))
    wider = drive_plan(assumed=(("driving_amplitude_arcsec", 30.0),))
    phase = "driving_phase_deg"
    assert wider.std(phase) == pytest.approx(2 * drive_plan().std(phase), rel=1e-2)
    assert wider.parameters["driving_amplitude_arcsec"].assumed == 30.0
    small = drive_plan(assumed=(("driving_amplitude_arcsec", 0.1),))
    amplitude, phase = (small.parameters[f"driving_{n}"] for n in ("amplitude_arcsec", "phase_deg"))
    assert amplitude.determined and not amplitude.significant and phase.std is None
    assert "upper limit" in str(amplitude.reason) and "not significant" in str(small)
    assert "three standard errors" in str(phase.reason)


def test_wrong_arguments_are_named(unchecked):
    wrong: dict[str, list[Any]] = {
        "turns": [0.0, np.nan],
        "rate_hz": [-1.0],
        "speed_rpm": [(), (60.0, 0.0)],
        "directions": ["sideways"],
        "passes": [1],
        "dwell_s": [-1.0],
        "delay": ["maybe", 2.0],
        "noise": [PlannedNoise()],
        "eccentricities": [Eccentricities()],
    }
    cases: list[tuple[str, dict[str, Any]]] = [
        *((name, {name: value}) for name, values in wrong.items() for value in values),
        ("two ramps", {"turns": 0.3}),
        ("passes", {"passes": 2, "directions": "forward"}),
        *(("delay_s within", {"assumed": {"delay_s": value}}) for value in (2.0, np.nan)),
        ("no delay is fitted", {"assumed": {"delay_s": 0.0}, "delay": "off"}),
        ("nonesuch", {"assumed": {"nonesuch": 1.0}}),
        ("driving_amplitude", {"assumed": {"driving_amplitude_arcsec": -1.0}}),
    ]
    for words, changes in cases:
        with pytest.raises(ValueError, match=words):
            plan(DRIVE, **(SHORT | changes))


def test_runs_that_tell_nothing_have_no_answer():
    for_a_part = drive_plan(speed_rpm=(60.0, 0.4), turns=4.0, delay="off", rate_hz=50.0)
    assert for_a_part.used > 0  # at the slow speed no flank has a full turn
    with pytest.raises(NoAnswerError, match="full revolution"):
        drive_plan(turns=0.9)
    with pytest.raises(NoAnswerError, match="no log"):
        drive_plan(turns=1e-6, ramp_s=0.0)
    with pytest.raises(UsageError, match="samples"):
        drive_plan(rate_hz=1e9)


def test_frozen_counts_and_aliased_orders_are_told():
    frozen = plan(paper_pair(), turns=21.0, rate_hz=2000.0, noise=WHITE)
    assert any("45 counts of the driving encoder" in note for note in frozen.notes)
    every = HarmonicOrders(mesh_orders=0)
    slow = drive_plan(rate_hz=30.0, speed_rpm=600.0, orders=every, turns=90.0)
    assert any("driving orders 2, 3" in note and "alias" in note for note in slow.notes)


HOW: dict[str, Any] = {"rate_hz": 200.0, "noise": PlannedNoise(0.003, 0.01), "orders": FEW}
NAME = "driven_amplitude_arcsec"


@pytest.mark.parametrize("wanted", [1.0, 0.2])
def test_it_is_enough_and_one_turn_less_is_not(wanted):
    found = shortest_run(DRIVE, {NAME: wanted}, **HOW)
    turns = found.run.turns
    same, less = (plan(DRIVE, turns=k, **HOW).std(NAME) for k in (turns, turns - 1))
    assert same == found.std(NAME) <= wanted < less
    assert found.parameters[NAME].wanted == wanted and "wanted" in str(found)


@pytest.mark.slow
def test_the_hardest_of_several_wishes_decides():
    easy, hard = {NAME: 1.0}, {"driving_phase_deg": 0.3}
    turns = [shortest_run(DRIVE, w, **HOW).run.turns for w in (easy, hard, easy | hard)]
    assert turns[0] < turns[1] == turns[2]


def test_a_wish_takes_the_least_that_can_be_fitted_or_is_refused_at_once():
    found = shortest_run(DRIVE, {NAME: 1e6}, **HOW)
    assert found.short == ()
    few = plan(DRIVE, turns=found.run.turns - 1, **HOW)
    assert not few.parameters[NAME].determined
    with pytest.raises(NoAnswerError, match=r"no number of turns .* one flank alone"):
        shortest_run(DRIVE, {"constant_backlash_deg": 1.0}, **HOW, directions="forward")
    with pytest.raises(NoAnswerError, match="no gear geometry"):
        shortest_run(DRIVE, {"driving_encoder_arcsec": 1.0}, **HOW)
    for name, value in ((NAME, 0.0), (NAME, float("nan")), ("nonesuch", 1.0)):
        with pytest.raises(ValueError, match=name):
            shortest_run(DRIVE, {name: value}, **HOW)
    with pytest.raises(ValueError, match="empty"):
        shortest_run(DRIVE, {}, **HOW)


@pytest.mark.slow
def test_the_upper_bound_is_stated(monkeypatch):
    monkeypatch.setattr("vttig_jax.posterior.planning.plan.MOST_SAMPLES", 50_000)
    for wanted, most_turns, words in (
        (0.01, 30.0, r"30 turns a pass, as asked, .* instead of 0.01 arcsec"),
        (1e-9, 1e9, "fit in memory"),
        (1.0, 1.0, r"turned only 0\.5"),
    ):
        with pytest.raises(NoAnswerError, match=words):
            shortest_run(DRIVE, {NAME: wanted}, most_turns=most_turns, **HOW)

"""The shortest run: enough, no longer than needed, or refused with the reason."""

from fractions import Fraction
from typing import Any

import pytest

from vttig_jax.base.errors import NoAnswerError
from vttig_jax.pair.gear_pair import Drive
from vttig_jax.pair.schema import HarmonicOrders
from vttig_jax.posterior.planning.noise import PlannedNoise
from vttig_jax.posterior.planning.plan import plan, shortest_run

FEW = HarmonicOrders(driving_orders=(1, 2), driven_orders=(1, 2), mesh_orders=0)
HOW: dict[str, Any] = {"rate_hz": 200.0, "noise": PlannedNoise(0.003, 0.01), "orders": FEW}
DRIVE = Drive(Fraction(9, 16))
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


def test_a_wish_that_any_run_grants_takes_the_least_that_can_be_fitted():
    found = shortest_run(DRIVE, {NAME: 1e6}, **HOW)
    assert found.short == ()
    few = plan(DRIVE, turns=found.run.turns - 1, **HOW)
    assert not few.parameters[NAME].determined


def test_what_turns_cannot_tell_is_refused_at_once_with_the_reason():
    with pytest.raises(NoAnswerError, match=r"no number of turns .* one flank alone"):
        shortest_run(DRIVE, {"constant_backlash_deg": 1.0}, **HOW, directions="forward")
    with pytest.raises(NoAnswerError, match="no gear geometry"):
        shortest_run(DRIVE, {"driving_encoder_arcsec": 1.0}, **HOW)


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


def test_wrong_targets_are_named():
    for name, value in ((NAME, 0.0), (NAME, float("nan")), ("nonesuch", 1.0)):
        with pytest.raises(ValueError, match=name):
            shortest_run(DRIVE, {name: value}, **HOW)
    with pytest.raises(ValueError, match="empty"):
        shortest_run(DRIVE, {}, **HOW)

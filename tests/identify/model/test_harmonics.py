"""Which harmonics a fit holds, and which it drops by name."""

from fractions import Fraction

import pytest

from vttig_jax.identify.model.harmonics import plan_terms

pytestmark = pytest.mark.smoke

PAPER = Fraction(45, 80)


def _names(harmonics):
    return [h.name for h in harmonics]


def test_orders_and_mesh_of_the_paper():
    plan = plan_terms(PAPER, (1, 2, 3), (1, 2), 2, 45)
    assert _names(plan.tied[:2]) == ["driving order 1", "driven order 1"]
    assert _names(plan.free) == [
        "driving order 2",
        "driving order 3",
        "driven order 2",
        "mesh order 1",
        "mesh order 2",
    ]
    assert [h.term for h in plan.free[-2:]] == [(45, 0), (90, 0)]
    assert plan.dropped == ()


def test_second_orders_are_tied_unless_they_are_free():
    both_free = plan_terms(PAPER, (1, 2), (1, 2), 0, 45)
    assert {h.term for h in both_free.tied[2:]} == {(1, 1), (1, -1)}
    neither = plan_terms(PAPER, (1,), (1,), 0, 45)
    assert {h.term for h in neither.tied[2:]} == {(2, 0), (0, 2), (1, 1), (1, -1)}


def test_without_a_first_order_its_second_orders_go_as_well():
    plan = plan_terms(PAPER, (1,), (3,), 0, 45)
    assert {h.term for h in plan.tied} == {(1, 0), (2, 0)}


def test_coinciding_orders_of_the_paper_are_dropped_by_name():
    orders = tuple(range(1, 17))
    plan = plan_terms(PAPER, orders, orders, 0, 45)
    assert len(plan.dropped) == 1
    assert plan.dropped[0].startswith("driven order 16 has the frequency of driving order 9, ")
    assert plan.dropped[0].endswith("stated for driving order 9 are those of both together")
    assert "driven order 16" not in _names(plan.free)
    # One order less and nothing coincides.
    assert plan_terms(PAPER, orders, orders[:-1], 0, 45).dropped == ()


def test_equal_tooth_counts_share_every_order():
    plan = plan_terms(Fraction(1), (1, 2), (1, 2), 1, 30)
    assert _names(plan.tied[:1]) == ["driving order 1"]
    (sentence,) = plan.dropped
    assert sentence.startswith("driven orders 1 and 2 have the frequencies of driving orders 1 and")
    (eight,) = plan_terms(Fraction(1), tuple(range(1, 9)), tuple(range(1, 9)), 0, None).dropped
    assert eight.startswith("driven orders 1 to 8 have the frequencies of driving orders 1 to 8,")
    assert {h.shaft for h in plan.free} == {"driving", "mesh"}


def test_a_mesh_order_can_be_an_order_of_a_shaft():
    plan = plan_terms(Fraction(3, 4), (1, 3), (1, 4), 1, 3)
    (sentence,) = plan.dropped
    assert sentence.startswith("driven order 4 and mesh order 1 have the frequencies of driving")


@pytest.mark.parametrize(
    ("ratio", "teeth"), [((20, 40), 20), ((40, 20), 40), ((20, 60), 20), ((60, 20), 60)]
)
@pytest.mark.parametrize("orders", [(1,), (1, 2), (1, 2, 3, 4)])
def test_no_frequency_appears_twice(ratio, teeth, orders):
    plan = plan_terms(Fraction(*ratio), orders, orders, 1, teeth)
    frequencies = [plan.frequency(term) for term in plan.terms]
    assert len(frequencies) == len(set(frequencies))
    assert 0 not in frequencies


def test_second_order_of_half_ratio_is_left_to_the_first():
    plan = plan_terms(Fraction(20, 40), (1,), (1,), 0, 20)
    # (0, 2) has the frequency of driving order 1, (1, −1) that of driven order 1.
    assert {h.term for h in plan.tied} == {(1, 0), (0, 1), (2, 0), (1, 1)}


def test_a_drive_has_neither_mesh_nor_second_orders():
    plan = plan_terms(Fraction(1, 225), (1, 2), (1,), 3, None)
    assert _names(plan.tied) == ["driving order 1", "driven order 1"]
    assert _names(plan.free) == ["driving order 2"]


def test_frequency_counts_cycles_a_driving_turn():
    plan = plan_terms(PAPER, (1,), (1,), 0, 45)
    assert plan.frequency((1, -1)) == Fraction(7, 16)
    assert plan.frequency((0, -2)) == Fraction(9, 8)
    assert plan.terms == tuple(h.term for h in plan.free + plan.tied)


def test_orders_less_than_a_cycle_apart_over_the_log_are_left_out():
    """Driven order 2 is at 0.9 cycles: 0.4 cycles from driving order 1 over 4 turns, 1 over 10."""
    ratio = Fraction(9, 20)
    plan = plan_terms(ratio, (1, 2), (1, 2), 0, None, turns=4.0)
    assert _names(plan.free) == ["driving order 2"]
    (sentence,) = plan.dropped
    assert sentence.startswith("driven order 2 is left out: over 4 driving revolutions")
    assert sentence.endswith("from a lower order; record more turns")
    longer = plan_terms(ratio, (1, 2), (1, 2), 0, None, turns=10.0)
    assert _names(longer.free) == ["driving order 2", "driven order 2"]
    assert longer.dropped == ()


def test_several_orders_left_out_share_a_sentence():
    plan = plan_terms(Fraction(1, 20), (1,), (1, 2, 3), 0, None, turns=4.0)
    (sentence,) = plan.dropped
    assert sentence.startswith("driven orders 2 and 3 are left out")


@pytest.mark.parametrize("turns", [0.1, 1.0, 4.0])
def test_first_orders_are_never_left_out(turns):
    plan = plan_terms(Fraction(19, 20), (1, 2), (1, 2), 0, None, turns=turns)
    assert _names(plan.tied) == ["driving order 1", "driven order 1"]


def test_a_table_of_one_turn_resolves_its_orders():
    """It lacks its last sample: 359 of 360 degrees."""
    plan = plan_terms(Fraction(1), (1, 2, 3), (), 0, None, turns=359 / 360)
    assert _names(plan.free) == ["driving order 2", "driving order 3"]

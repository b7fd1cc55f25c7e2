"""Orders that look alike at samples locked to the rotation are not both in the model."""

from fractions import Fraction

import numpy as np
import pytest

import vttig_jax
from vttig_jax.base.units import DEG
from vttig_jax.identify.model.harmonics import TermPlan, plan_terms
from vttig_jax.identify.model.sampled_orders import told_apart
from vttig_jax.logs import EncoderLog, find_segments
from vttig_jax.pair import HarmonicOrders, parse_pair_spec
from vttig_jax.pair.load import pair_from_spec

RATIO = "9/16"
SPEC = parse_pair_spec(
    {"drive": {"ratio": RATIO}, "fit": {"driving_orders": [1, 2, 3, 4], "driven_orders": [1]}}
)


def log_of(per_turn: float, *, jitter_deg: float = 0.0, back_deg: float = 0.0) -> EncoderLog:
    """Forty turns and back with so many samples a turn; orders 1 and 2 of 108″ and 72″.

    The samples of the way back are `back_deg` beside those of the way there.
    """
    generator = np.random.default_rng(0)
    there = 360.0 * np.arange(int(40 * per_turn)) / per_turn
    angle = np.concatenate([there, there[::-1] + back_deg])
    angle += generator.normal(0.0, jitter_deg, len(angle))
    flank_b = np.arange(len(angle)) >= len(there)
    error = 0.03 * np.sin(DEG * angle + 0.3) + 0.02 * np.sin(2 * DEG * angle + 1.0)
    error += 0.05 * flank_b + generator.normal(0.0, 1e-3, len(angle))
    time = 0.05 * np.arange(len(angle))
    driven = float(Fraction(RATIO)) * angle + error
    return EncoderLog.from_arrays(time, angle, driven, pair=SPEC, unit="deg")


def apart(log: EncoderLog, orders: tuple[int, ...]) -> TermPlan:
    plan = plan_terms(Fraction(RATIO), orders, (1,), 0, None)
    return told_apart(plan, [log], [find_segments(log).segments])


def free(plan: TermPlan) -> list[int | float]:
    return [harmonic.order for harmonic in plan.free if harmonic.shaft == "driving"]


@pytest.mark.parametrize("back_deg", [0.0, 17.0])
def test_of_two_orders_that_look_alike_the_lower_one_stays(back_deg):
    """Each flank is judged alone: its samples are locked, wherever those of the other lie."""
    plan = apart(log_of(10, back_deg=back_deg), (1, 2, 3, 8, 12))
    assert free(plan) == [2, 3]
    assert "driving orders 8 and 12 look like driving order 2 at" in plan.dropped[-1]


def test_an_order_of_one_phase_and_one_like_a_constant_are_left_out():
    plan = apart(log_of(10), (1, 2, 5, 10))
    assert free(plan) == [2]
    assert plan.dropped[-1].startswith("driving orders 5 and 10 are left out")


@pytest.mark.parametrize(("per_turn", "jitter_deg"), [(10, 3.0), (10.37, 0.0), (16.1, 0.0)])
def test_samples_that_are_not_locked_tell_all_orders_apart(per_turn, jitter_deg):
    orders = (1, 2, 3, 5, 8)
    plan = apart(log_of(per_turn, jitter_deg=jitter_deg), orders)
    assert free(plan) == [2, 3, 5, 8] and plan.dropped == ()


def test_the_first_orders_stay():
    """Order 9 looks like order 1 at ten samples a turn."""
    plan = apart(log_of(10), (1, 9))
    assert [harmonic.term for harmonic in plan.tied] == [(1, 0), (0, 1)]
    assert free(plan) == []


def test_a_long_log_is_compared_at_some_of_its_samples():
    plan = plan_terms(Fraction(RATIO), (1, 2, 8), (1,), 0, None)
    logs = [log_of(10) for _ in range(12)]
    found = told_apart(plan, logs, [find_segments(log).segments for log in logs])
    assert sum(map(len, logs)) > 2 * 4096 and free(found) == [2]


def test_a_fit_of_locked_samples_states_the_amplitude_of_the_lower_order():
    """Both orders together would share it at random, and be undetermined."""
    log, drive = log_of(10), pair_from_spec(SPEC)
    orders = HarmonicOrders((1, 2, 3, 4, 8), (1,), 0)
    found = vttig_jax.fit(log, drive, orders=orders, delay="off")
    assert any("driving order 8 looks like driving order 2" in note for note in found.notes)
    seconds = [one for one in found.orders if (one.shaft, one.order) == ("driving", 2)]
    assert {one.flank for one in seconds} == {"A", "B"}
    for second in seconds:
        assert second.amplitude_arcsec == pytest.approx(72.0, abs=4 * second.std_arcsec)
        assert second.std_arcsec < 1.0

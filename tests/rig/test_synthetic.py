"""The synthetic rig against the exact relation it is built on, and every field of it."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import vttig_jax
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.logs.motion.segments import find_segments
from vttig_jax.pair.gear_pair import Eccentricities, GearPair
from vttig_jax.pair.schema import Encoder
from vttig_jax.rig.imperfections import EncoderError, Noise, OrderError
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_rig
from vttig_jax.rig.synthetic import SyntheticRig, order_model

MOTION = PassMotion(reversal_deg=1200.0, dwell_s=0.3, ramp_s=0.25)


@pytest.fixture(scope="module")
def bare(paper_pair, paper_rig) -> SyntheticRig:
    """No counts, no noise, perfect encoders, nothing but two eccentric gears."""
    return SyntheticRig(paper_pair, paper_rig, MOTION, rate_hz=500.0)


def shifted(pair: GearPair, rig: Eccentricities) -> tuple[Eccentricities, float]:
    """The rig with gear 2's zero where it stands at φ₁ = 0 on flank A, and that angle (rad).

    Where flank A touches at φ₁ = 0 with an absolute φ₂ = c, the log calls that angle zero; the
    absolute phase of the same gear is then θ₂ − c.
    """
    start, moved = 0.0, rig
    for _ in range(20):
        phase = rig.driven_phase_deg - np.asarray(start / DEG)
        moved = eqx.tree_at(lambda e: e.driven_phase_deg, rig, phase)
        start = float(vttig_jax.exact_transmission_error(0.0, pair, moved, "A"))
    return moved, start


@pytest.mark.parametrize("axial_mm", [0.0, 0.1])
def test_transmission_error_is_the_exact_one(bare, axial_mm):
    rig = eqx.tree_at(lambda e: e.axial_mm, bare.eccentricities, np.asarray(axial_mm))
    log = replace(bare, eccentricities=rig).log()
    moved, start = shifted(bare.pair, rig)
    segments = find_segments(log).segments
    assert {segment.flank for segment in segments} == {"A", "B"}
    for segment in segments:
        part = slice(segment.start, segment.stop)
        seen, off = log.transmission_error[part], {}
        for flank in ("A", "B"):
            exact = vttig_jax.exact_transmission_error(
                log.driving_angle[part], bare.pair, moved, flank
            )
            off[flank] = np.abs(seen - np.asarray(exact) + start)
        assert off.pop(segment.flank).max() < 1e-9
        assert off.popitem()[1].min() > 1e-5


def test_both_angles_are_zero_at_the_start_and_time_runs_at_the_rate_to_the_end(bare):
    log = bare.log()
    assert log.driving_angle[0] == log.driven_angle[0] == 0.0
    start = bare.flank_model().transmission_error(0.0, "A")
    assert float(start) == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_allclose(np.diff(log.time), 1 / 500.0, rtol=1e-9)
    assert MOTION.duration_s - log.time[-1] < 1 / 500.0


def test_a_late_driven_channel_lowers_the_error_by_its_speed(bare):
    delay = 0.002
    log, late = bare.log(), replace(bare, delay_s=delay).log()
    speed = np.gradient(log.driven_angle, log.time)
    for segment in find_segments(log).segments:
        part = slice(segment.start + 5, segment.stop - 5)
        moved = late.transmission_error[part] - log.transmission_error[part]
        np.testing.assert_allclose(
            moved, -delay * speed[part], atol=2e-3 * delay * abs(speed).max()
        )
        assert np.sign(moved.mean()) == (-1 if segment.flank == "A" else 1)


CHANGES = {
    "eccentricities": Eccentricities(0.02, 49.5, 0.0273, 79.3, 0.038),
    "motion": replace(MOTION, ripple=0.002),
    "orders": (OrderError("driving", 2, "A", 0.002, 30.0),),
    "driving_encoder": EncoderError(18.0, 10.0),
    "driven_encoder": EncoderError(18.0, 10.0),
    "noise": Noise(0.002),
    "delay_s": 1e-3,
    "rate_hz": 501.0,
}


def test_every_field_changes_the_log(bare):
    wider = eqx.tree_at(lambda p: p.centre_distance_mm, bare.pair, np.asarray(125.3))
    before = bare.log()
    for field, least in (*((name, 0.1 * ARCSEC) for name in CHANGES), ("pair", 1e-7)):
        after = replace(bare, **{field: CHANGES.get(field, wider)}).log()
        size = min(len(before), len(after))
        # On flank A: an order of that flank must show, the crossing of the gap need not.
        part = slice(size // 8, size // 3)
        moved = max(
            np.abs(getattr(before, name)[part] - getattr(after, name)[part]).max()
            for name in ("driving_angle", "transmission_error")
        )
        assert moved > least, field


def test_encoder_errors_show_with_the_signs_of_the_contract(bare):
    """+ E₂ sin(φ₂ + ε₂) − i E₁ sin(φ₁ + ε₁)."""
    plain = bare.log()
    for name, gain, angle in (
        ("driving_encoder", -45 / 80, plain.driving_angle),
        ("driven_encoder", 1.0, plain.driven_angle),
    ):
        seen = replace(bare, **{name: EncoderError(20.0, 40.0)}).log()
        # The first sample is the zero of both readings.
        shape = np.sin(angle + 40 * DEG) - np.sin(40 * DEG)
        moved = seen.transmission_error - plain.transmission_error
        np.testing.assert_allclose(moved / ARCSEC, gain * 20 * shape, atol=1e-6)


def test_same_seed_same_bytes(bare):
    noisy = replace(bare, noise=Noise(0.002, 0.005))
    first, again, other = noisy.log(3), noisy.log(3), noisy.log(4)
    assert first.transmission_error.tobytes() == again.transmission_error.tobytes()
    assert first.transmission_error.tobytes() != other.transmission_error.tobytes()
    assert noisy.log().transmission_error.tobytes() == noisy.log(0).transmission_error.tobytes()
    assert first.source == "synthetic rig, seed 3"


def test_counts_come_from_the_encoders_of_the_pair(bare):
    driving = replace(bare.pair.driving, encoder=Encoder(counts_per_rev=3600))
    driven = replace(bare.pair.driven, encoder=Encoder(counts_per_rev=90_000))
    coarse = eqx.tree_at(lambda p: (p.driving, p.driven), bare.pair, (driving, driven))
    log, smooth = replace(bare, pair=coarse).log(), bare.log()
    assert (log.driving.unit, smooth.driving.unit) == ("counts", "deg")
    lost = smooth.driving_angle - log.driving_angle
    assert 0.09 < np.ptp(lost) / DEG <= 0.1 + 1e-9
    lost = smooth.driven_angle - log.driven_angle
    assert 0.0038 < np.ptp(lost) / DEG <= 0.004 + 1e-9


def test_a_gap_that_closes_is_refused(bare):
    tight = eqx.tree_at(lambda e: e.constant_backlash_deg, bare.eccentricities, np.asarray(0.005))
    with pytest.raises(ValueError, match=r"must keep the gap open, but the backlash is -0\.0"):
        replace(bare, eccentricities=tight).log()


def test_orders_of_the_model():
    """Every harmonic against its own formula, mesh included."""
    pair = paper_rig().pair
    errors = (
        OrderError("driving", 3, "A", 0.002, 30.0),
        OrderError("driven", 2, "A", 0.001, 70.0),
        OrderError("driven", 2, "B", 0.004, 10.0),
        OrderError("mesh", 1, "B", 0.003, 200.0),
    )
    model = order_model(pair, errors)
    first, second = np.linspace(0, 7, 50), np.linspace(1, 9, 50)
    speeds = {"driving": first, "driven": second, "mesh": 45 * first}
    for flank in ("A", "B"):
        expected = sum(
            e.amplitude_deg * DEG * np.sin(e.order * speeds[e.shaft] + e.phase_deg * DEG)
            for e in errors
            if e.flank == flank
        )
        seen = model.at_both_angles(jnp.asarray(first), jnp.asarray(second), flank)
        np.testing.assert_allclose(np.asarray(seen), expected, atol=1e-15)


def test_orders_share_the_start(bare):
    rig = replace(bare, orders=(OrderError("driving", 2, "A", 0.002, 90.0),))
    assert float(rig.flank_model().transmission_error(0.0, "A")) == pytest.approx(0.0, abs=1e-15)
    moved = rig.log().transmission_error - bare.log().transmission_error
    part = slice(100, 900)
    angle = rig.log().driving_angle[part]
    expected = 0.002 * DEG * (np.cos(2 * angle) - 1)
    # The order turns gear 2 a little further: 3e-4 of it comes back through e₂.
    np.testing.assert_allclose(moved[part], expected, atol=1e-7)

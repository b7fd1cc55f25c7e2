"""Encoders, counts, correlated noise, random orders and play against what they promise."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.rig.imperfections import EncoderError, Noise, quantised, random_orders
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_eccentricities, paper_pair, paper_rig
from vttig_jax.rig.synthetic import play

ANGLE = np.linspace(0, 3 * REV, 3001)


def test_reading_of_an_encoder_off_centre():
    reading = EncoderError(20.0, 30.0).reading(ANGLE)
    expected = 20.0 * np.sin(ANGLE + np.pi / 6)
    np.testing.assert_allclose((reading - ANGLE) / ARCSEC, expected, atol=1e-9)
    np.testing.assert_array_equal(EncoderError().reading(ANGLE), ANGLE)


def test_counts_are_whole_counts_passed():
    angle = np.array([-1.5, -1e-9, 0.0, 0.999, 1.0, 360 * 25.0]) * DEG
    counts = quantised(angle, 360)
    assert counts.dtype == np.int64
    np.testing.assert_array_equal(counts, [-2, -1, 0, 0, 1, 9000])
    np.testing.assert_array_equal(quantised(angle[:5] * 1.001, 720), [-4, -1, 0, 1, 2])
    error = ANGLE - quantised(ANGLE, 90_000) * (REV / 90_000)
    assert error.min() > -1e-12
    assert error.max() < REV / 90_000 + 1e-12


RATE = 1000.0


def _correlation(path: np.ndarray, lag: int) -> float:
    return float(path[lag:] @ path[: len(path) - lag] / (path @ path))


def test_correlated_noise_has_its_spread_and_memory_at_any_rate():
    for rate_hz, lags, within in ((1000.0, (5, 20, 40), 0.03), (100.0, (1, 2), 0.02)):
        path = Noise(0.01, 0.02).draw(400_000, rate_hz, np.random.default_rng(1))
        assert path.std() / DEG == pytest.approx(0.01, rel=0.03)
        for lag in lags:
            expected = np.exp(-lag / (0.02 * rate_hz))
            assert _correlation(path, lag) == pytest.approx(expected, abs=within)


def test_white_noise_has_no_memory_and_the_generator_decides():
    path = Noise(0.01, 0.0).draw(100_000, RATE, np.random.default_rng(1))
    assert path.std() / DEG == pytest.approx(0.01, rel=0.02)
    assert abs(_correlation(path, 1)) < 0.02
    assert not Noise().draw(100, RATE, np.random.default_rng(0)).any()
    first, again, other = (
        Noise(1.0, 0.01).draw(10, RATE, np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert not np.allclose(first, other)


def test_noise_is_stationary_from_the_first_sample():
    generator = np.random.default_rng(2)
    paths = np.stack([Noise(1.0, 0.05).draw(100, RATE, generator) for _ in range(4000)]) / DEG
    np.testing.assert_allclose(paths.std(axis=0)[[0, 1, 10, 99]], 1.0, rtol=0.05)


def _orders(seed: int = 5, pitch_rms_deg: float = 0.002, mesh_deg: float = 0.003, highest: int = 8):
    return random_orders(
        np.random.default_rng(seed),
        pitch_rms_deg=pitch_rms_deg,
        mesh_amplitude_deg=mesh_deg,
        highest=highest,
    )


def test_pitch_orders_have_the_rms_and_highest_and_mesh_are_obeyed():
    for flank in ("A", "B"):
        for rms_deg in (0.002, 0.01):
            errors = [
                e for e in _orders(pitch_rms_deg=rms_deg) if e.flank == flank and e.shaft != "mesh"
            ]
            assert {(e.shaft, e.order) for e in errors} == {
                (shaft, k) for shaft in ("driving", "driven") for k in range(2, 9)
            }
            assert np.sqrt(sum(e.amplitude_deg**2 for e in errors) / 2) == pytest.approx(rms_deg)
    errors = _orders(highest=3, mesh_deg=0.004)
    assert max(e.order for e in errors if e.shaft != "mesh") == 3
    mesh = [e for e in errors if e.shaft == "mesh"]
    assert [(e.flank, e.order, e.amplitude_deg) for e in mesh] == [("A", 1, 0.004), ("B", 1, 0.004)]


def test_the_flanks_differ_and_the_seed_repeats():
    errors = _orders()
    sides = [[(e.amplitude_deg, e.phase_deg) for e in errors if e.flank == f] for f in "AB"]
    assert sides[0] != sides[1]
    assert errors == _orders()
    assert errors != _orders(seed=6)


# The paper's rig: its tables, its imperfections, its seeds.


def test_the_tables_of_the_paper():
    pair, rig = paper_pair(), paper_eccentricities()
    assert (pair.driving.teeth, pair.driven.teeth) == (45, 80)
    assert pair.driving.encoder.counts_per_rev == pair.driven.encoder.counts_per_rev == 90_000
    assert float(pair.centre_distance_mm) == 125.12
    assert (float(rig.driving_mm), float(rig.driven_mm)) == (0.0226, 0.0273)
    assert (float(rig.driving_phase_deg), float(rig.driven_phase_deg)) == (49.5, 79.3)


@pytest.mark.parametrize("seed", [0, 1, 17])
def test_imperfections_of_the_issue(seed):
    rig = paper_rig(seed)
    assert (rig.noise.std_deg, rig.noise.correlation_s, rig.rate_hz) == (0.002, 0.00475, 1987.0)
    assert rig.driving_encoder.amplitude_arcsec == rig.driven_encoder.amplitude_arcsec == 18.0
    for flank in ("A", "B"):
        pitch = [e for e in rig.orders if e.flank == flank and e.shaft != "mesh"]
        rms = np.sqrt(sum(e.amplitude_deg**2 for e in pitch) / 2)
        assert rms == pytest.approx(0.002)
    assert [e.amplitude_deg for e in rig.orders if e.shaft == "mesh"] == [0.003, 0.003]
    assert BacklashMap(rig.flank_model(), None, rig.pair).smallest.backlash > 0


def test_the_seed_draws_orders_and_encoder_phases():
    first, again, other = paper_rig(4), paper_rig(4), paper_rig(5)
    assert first.orders == again.orders != other.orders
    assert first.driving_encoder == again.driving_encoder != other.driving_encoder
    assert other.driven_encoder != first.driven_encoder != first.driving_encoder
    motion = PassMotion(reversal_deg=1800.0)
    assert paper_rig(0, motion).motion == motion
    assert paper_rig().motion == PassMotion()


# The play operator against a plain loop.


# Multiples of 1/64: numbers so small that XLA takes them for zero are no angles.
NUMBER = st.integers(-640, 640).map(lambda n: n / 64)
GAP = st.integers(0, 192).map(lambda n: n / 64)
PATH = st.lists(st.tuples(NUMBER, GAP), min_size=40, max_size=40)


@pytest.mark.smoke
@given(PATH, NUMBER)
def test_equals_the_loop(path, start):
    lower, gap = np.array(path).T
    upper, position = lower + gap, start
    looped = [position := min(max(position, a), b) for a, b in zip(lower, upper, strict=True)]
    found = play(jnp.asarray(lower), jnp.asarray(upper), jnp.asarray(start))
    np.testing.assert_array_equal(found, looped)

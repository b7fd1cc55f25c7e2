"""Rigs of a calibration: drawn as stated, contact exact, noise with the memory it claims."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from vttig_jax.posterior.calibration.coverage import uniformity
from vttig_jax.posterior.calibration.program import Program
from vttig_jax.posterior.calibration.rigs import ar_noise
from vttig_jax.posterior.calibration.scenarios import SCENARIOS, Scenario

from vttig_jax.base.units import ARCSEC, DEG, REV
from vttig_jax.kinematics.harmonic import CombinedModel
from vttig_jax.posterior.calibration import rigs
from vttig_jax.rig.imperfections import random_orders

ORDERS = SCENARIOS["orders"]


@functools.cache
def many(scenario: Scenario) -> rigs.Rig:
    program = Program(scenario)
    draw = jax.jit(jax.vmap(lambda key: rigs.draw_rig(key, scenario, program.sizes)))
    return draw(program.keys(0, np.arange(2000)))


def test_offsets_are_flat_in_a_disc():
    drawn = many(ORDERS)
    for vector, radius in [
        (drawn.driving, rigs.LARGEST_ECCENTRICITY_MM),
        (drawn.driven, rigs.LARGEST_ECCENTRICITY_MM),
        (drawn.driving_encoder, 18 * ARCSEC),
    ]:
        share = np.abs(np.asarray(vector)) / radius
        assert uniformity(share**2) > 1e-3
        assert uniformity(share) < 1e-6  # the check can fail
        turn = np.angle(np.asarray(vector)) / REV % 1.0
        assert uniformity(turn) > 1e-3


def test_encoders_on_a_ring_have_one_size():
    program = Program(SCENARIOS["encoders"])
    draw = jax.jit(rigs.draw_rig, static_argnums=1)
    drawn = draw(jax.random.key(2), program.scenario, program.sizes)
    assert abs(complex(drawn.driven_encoder)) == pytest.approx(18 * ARCSEC, rel=1e-12)


def test_orders_are_those_of_random_orders():
    drawn = many(ORDERS)
    terms = rigs.order_terms(ORDERS)
    amplitude = np.hypot(np.asarray(drawn.cosine), np.asarray(drawn.sine)) / DEG
    mesh = [term[0] == 45 for term in terms]
    np.testing.assert_allclose(amplitude[:, :, mesh], 0.003, rtol=1e-12)
    pitch = amplitude[:, :, np.logical_not(mesh)]
    np.testing.assert_allclose(np.sum(pitch**2, axis=2) / 2, 0.002**2, rtol=1e-12)
    generator = np.random.default_rng(0)
    expected = [
        error.amplitude_deg
        for _ in range(500)
        for error in random_orders(generator, pitch_rms_deg=0.002, mesh_amplitude_deg=0.003)
        if error.shaft == "driven" and error.order == 5
    ]
    same = lambda a, b: stats.ks_2samp(a, b).pvalue  # noqa: E731 # pyright: ignore[reportAttributeAccessIssue]
    own = pitch[:, :, terms.index((0, 5))].ravel()
    assert same(own, expected) > 1e-3
    assert same(1.1 * own, expected) < 1e-3  # the check can fail


@pytest.mark.parametrize("name", ["orders", "missing_order"])
def test_the_gap_stays_open(name):
    scenario = SCENARIOS[name].of_length("short")
    driving = jnp.asarray(np.tile(np.arange(0.0, 5760.0, 2.0) * DEG, (2, 1)))

    @jax.jit
    @jax.vmap
    def smallest(rig):
        on_a, on_b = rigs._transmission_errors(rig, scenario, driving)
        return jnp.min(on_b - on_a)

    some = jax.tree.map(lambda values: values[:200], many(scenario))
    gaps = np.asarray(smallest(some))
    assert 0 < gaps.min() < 0.05 * DEG


def test_readings_are_the_exact_contact_plus_encoders():
    scenario = SCENARIOS["orders"].of_length("short")
    program = Program(scenario)
    key = program.keys(3, np.array([0]))[0]
    rig, readings = program.simulated(key)
    model = rigs._contact_model(rig, scenario)
    assert isinstance(model, CombinedModel)
    error = jax.jit(lambda motion, flank: model.transmission_error(motion, flank), static_argnums=1)
    for flank, motion, driving, clean in zip(
        scenario.flanks, program.motion, readings.driving, readings.clean, strict=True
    ):
        driven = 0.5625 * motion + np.asarray(error(motion, flank))
        shown = [
            angle + np.imag(np.asarray(encoder) * np.exp(1j * angle))
            for angle, encoder in [(motion, rig.driving_encoder), (driven, rig.driven_encoder)]
        ]
        np.testing.assert_allclose(driving, shown[0], rtol=0, atol=1e-12)
        np.testing.assert_allclose(clean, shown[1] - 0.5625 * shown[0], rtol=0, atol=1e-11)
    noise = np.asarray(readings.driven - 0.5625 * readings.driving - readings.clean) / DEG
    assert 0.0018 < noise.std() < 0.0022


def test_counts_are_whole_and_within_one_of_the_angle():
    scenario = SCENARIOS["counts"].of_length("short")
    program = Program(scenario)
    _, readings = program.simulated(program.keys(0, np.array([0]))[0])
    counts = np.asarray(readings.driven) * 90_000 / REV
    np.testing.assert_allclose(counts, np.rint(counts), rtol=0, atol=1e-6)
    off = np.asarray(readings.driven - 0.5625 * readings.driving - readings.clean)
    assert np.abs(off).max() < 2.0 * REV / 90_000


@jax.jit
def noise_paths(keys, correlation):
    return jax.vmap(lambda key: ar_noise(key, 90, correlation))(keys)


@pytest.mark.parametrize("correlation", [0.0, 0.7, 0.98])
def test_noise_has_the_correlation_it_claims(correlation):
    keys = jax.random.split(jax.random.key(1), 4000)
    paths = np.asarray(noise_paths(keys, correlation))
    covariance = paths.T @ paths / len(keys)
    lag = np.abs(np.subtract.outer(np.arange(90), np.arange(90)))
    # Entries have a standard error of at most √2/√4000 = 0.022.
    assert np.abs(covariance - correlation ** lag.astype(float)).max() < 0.11

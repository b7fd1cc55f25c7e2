"""Backlash readings beside a fit: as a check, and as data."""

import tracemalloc
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from vttig_jax.base.errors import LogError, UsageError
from vttig_jax.base.units import DEG
from vttig_jax.identify.backlash import backlash_map
from vttig_jax.identify.fit_result import Fit
from vttig_jax.identify.fitting import fit
from vttig_jax.identify.report.checks import ReadingsComparison
from vttig_jax.identify.report.comparisons.backlash_readings import PredictedGap, updated
from vttig_jax.logs.readers.backlash_readings import BacklashReadings
from vttig_jax.rig.fixed_gear import fixed_gear_readings
from vttig_jax.rig.imperfections import EncoderError

ANGLES_DEG = np.arange(0.0, 1800.0, 7.3)


@pytest.fixture(scope="module")
def readings(noisy_rig) -> BacklashReadings:
    return fixed_gear_readings(noisy_rig, ANGLES_DEG, std_deg=0.0005)


def test_as_a_check_they_change_nothing(noisy_log, noisy_rig, readings):
    checked = fit(noisy_log, noisy_rig.pair, readings=readings)
    # A fit by programs that were compiled with other options may differ in the last digits.
    plain = fit(noisy_log, noisy_rig.pair)
    assert checked.to_json()["parameters"] == plain.to_json()["parameters"]
    found = _compared(checked)
    grid = backlash_map(plain)
    expected = (readings.backlash - np.asarray(grid.at(readings.driving_angle))) / DEG
    assert found.mean_deg == pytest.approx(expected.mean(), abs=1e-9)
    assert found.rms_deg == pytest.approx(np.sqrt(np.mean(expected**2)), rel=1e-6)
    assert found.count == len(ANGLES_DEG) and not found.used
    assert "backlash readings (check only)" in str(checked)


def test_wrong_readings_are_seen(noisy_log, noisy_rig, readings):
    shifted = replace(readings, backlash=readings.backlash + 0.01 * DEG)
    found = _compared(fit(noisy_log, noisy_rig.pair, readings=shifted))
    assert found.mean_deg == pytest.approx(0.01, abs=0.002)


def test_as_data_they_narrow_the_fit(noisy_fit, noisy_log, noisy_rig, readings):
    joined = fit(noisy_log, noisy_rig.pair, readings=readings, use_readings=True)
    for name in ("constant_backlash_deg", "driving_eccentricity_mm", "driven_eccentricity_mm"):
        assert _std(joined, name) < _std(noisy_fit, name)
        truth = {
            "constant_backlash_deg": 0.038,
            "driving_eccentricity_mm": 0.0226,
            "driven_eccentricity_mm": 0.0273,
        }[name]
        assert abs(joined.value(name) - truth) < 5 * _std(joined, name)
    assert _compared(joined).used


def test_many_readings_pull_the_backlash_to_theirs(noisy_log, noisy_rig, readings):
    many = 200
    heavy = BacklashReadings.from_arrays(
        np.tile(ANGLES_DEG, many), np.tile(readings.backlash / DEG + 0.002, many)
    )
    plain = fit(noisy_log, noisy_rig.pair)
    pulled = fit(noisy_log, noisy_rig.pair, readings=_thin(heavy), use_readings=True)
    moved = pulled.value("constant_backlash_deg") - plain.value("constant_backlash_deg")
    assert 0 < moved < 0.0025


def _thin(readings: BacklashReadings) -> BacklashReadings:
    return BacklashReadings.from_arrays(
        readings.driving_angle[:800] / DEG, readings.backlash[:800] / DEG
    )


def test_one_flank_gets_its_constant_backlash_from_readings(noisy_rig):
    clean = replace(
        noisy_rig,
        orders=(),
        driving_encoder=EncoderError(),
        driven_encoder=EncoderError(),
    )
    readings = fixed_gear_readings(clean, ANGLES_DEG, std_deg=0.0005)
    options = {"flank": "A", "perfect_encoders": True}
    alone = fit(clean.log(0), clean.pair, **options)
    assert not alone.parameters["constant_backlash_deg"].determined
    joined = fit(clean.log(0), clean.pair, **options, readings=readings, use_readings=True)
    name = "constant_backlash_deg"
    assert joined.parameters[name].determined
    assert abs(joined.value(name) - 0.038) < 4 * _std(joined, name) < 0.004
    truth = np.asarray(clean.flank_model().backlash(ANGLES_DEG * DEG))
    error = np.asarray(backlash_map(joined).at(ANGLES_DEG * DEG)) - truth
    assert np.sqrt(np.mean(error**2)) < 0.001 * DEG


def test_readings_without_a_gap_to_compare_are_refused(noisy_log, noisy_rig, readings):
    with pytest.raises(UsageError, match="one flank alone expects no backlash"):
        fit(noisy_log, noisy_rig.pair, flank="A", readings=readings)
    with pytest.raises(ValueError, match="`readings` must be given"):
        fit(noisy_log, noisy_rig.pair, use_readings=True)


def test_readings_in_another_unit_are_told_and_refused_as_data(noisy_log, noisy_rig, readings):
    wrong = replace(readings, backlash=30.0 * readings.backlash)
    checked = fit(noisy_log, noisy_rig.pair, readings=wrong)
    assert _compared(checked).contradicts
    assert "they contradict it" in str(checked)
    with pytest.raises(LogError, match="check their unit"):
        fit(noisy_log, noisy_rig.pair, readings=wrong, use_readings=True)


def _compared(result: Fit) -> ReadingsComparison:
    assert result.checks.readings is not None
    return result.checks.readings


def _std(result: Fit, name: str) -> float:
    std = result.parameters[name].std
    assert std is not None
    return std


@dataclass(frozen=True)
class _Estimate:
    """What `updated` uses of a solution."""

    values: np.ndarray
    covariance: np.ndarray
    tied: np.ndarray
    jacobian: np.ndarray


def _made(count: int) -> tuple[_Estimate, PredictedGap, SimpleNamespace]:
    """An estimate of parameters of very different sizes, and readings of its gap."""
    generator = np.random.default_rng(0)
    sizes = np.array([1e-5, 1e-9, 1.0, 1e-3])
    mixed = generator.standard_normal((4, 4))
    covariance = np.outer(sizes, sizes) * (mixed @ mixed.T)
    gap = PredictedGap(
        generator.standard_normal(count),
        generator.standard_normal((count, 4)) / sizes * 1e-5,
        1e-6 * generator.standard_normal((count, 3)),
    )
    estimate = _Estimate(sizes, covariance, np.zeros((1, 4)), np.zeros((1, 4, 4)))
    readings = SimpleNamespace(backlash=gap.value + 1e-5 * generator.standard_normal(count))
    return estimate, gap, readings


@pytest.mark.parametrize("count", [2, 5, 40])
def test_the_update_is_that_of_the_dense_formula(count, unchecked):
    estimate, gap, readings = _made(count)
    h, p = gap.slope, estimate.covariance
    off = readings.backlash - gap.value
    total = h @ p @ h.T + gap.root @ gap.root.T + np.var(off, ddof=1) * np.eye(count)
    gain = p @ h.T @ np.linalg.inv(total)
    found = updated(estimate, gap, readings)  # pyright: ignore[reportArgumentType]
    np.testing.assert_allclose(found.values, estimate.values + gain @ off, rtol=1e-6)
    expected = p - gain @ h @ p
    std = np.sqrt(np.diag(p))
    np.testing.assert_allclose(
        found.covariance / np.outer(std, std), expected / np.outer(std, std), atol=1e-7
    )


def test_memory_grows_with_the_number_of_readings_and_not_with_its_square(unchecked):
    estimate, gap, readings = _made(300_000)  # a square of this size takes 720 GB
    tracemalloc.start()
    try:
        updated(estimate, gap, readings)  # pyright: ignore[reportArgumentType]
        assert tracemalloc.get_traced_memory()[1] < 300_000 * 8 * 60
    finally:
        tracemalloc.stop()

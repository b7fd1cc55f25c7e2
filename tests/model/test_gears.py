"""The exact relation as coefficients of harmonics, and eccentricities that were planted."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from tests.model.rigs import PAIRS, exact_log, fitted, gear_pair, gears_of
from vttig_jax.base import ARCSEC
from vttig_jax.kinematics import exact_model
from vttig_jax.model import ENCODERS, GEARS, KINDS, Relation, fitted_gears, parameters_of
from vttig_jax.pair import Eccentricities
from vttig_jax.pair.schema import Flank

TRUTH = {
    "driving_mm": 0.024,
    "driving_phase_deg": 50.0,
    "driven_mm": 0.031,
    "driven_phase_deg": 200.0,
    "constant_backlash_deg": 0.15,
    "driving_encoder": 22.0,
    "driving_encoder_deg": 310.0,
    "driven_encoder": 35.0,
    "driven_encoder_deg": 120.0,
}
FLANKS: tuple[Flank, Flank] = ("A", "B")
WAVES = {("driving", 1): (1, 0), ("driven", 1): (0, 1), ("both", 1): (1, 1), ("both", -1): (1, -1)}


def _relation(pair, both=True, flank: Flank = "A") -> Relation:
    model = exact_model(pair, Eccentricities())
    return Relation((*GEARS, *ENCODERS), tuple(WAVES), both, flank, model, jnp.zeros(()))


def _values(truth: dict) -> np.ndarray:
    """Cartesian parameters: eccentricities by the model's own convention, encoders as sines."""
    encoders = [
        truth[f"{shaft}_encoder"] * ARCSEC * np.exp(1j * np.radians(truth[f"{shaft}_encoder_deg"]))
        for shaft in ("driving", "driven")
    ]
    found = [*map(complex, gears_of(truth).cartesian), *map(complex, encoders)]
    return np.array([part for one in found for part in (one.real, one.imag)])


def _projected(pair, truth: dict, points: int = 32) -> np.ndarray:
    """Coefficients from the exact model on a fine grid of both angles."""
    model = exact_model(pair, gears_of(truth | {"constant_backlash_deg": 0.0}))
    angles = 2 * np.pi * np.arange(points) / points
    one, two = (x.ravel() for x in np.meshgrid(angles, angles, indexing="ij"))
    places = jnp.asarray(one), jnp.asarray(two)
    flanks = [np.asarray(model.at_both_angles(*places, f)) for f in FLANKS]
    encoders = sum(
        gain * truth[f"{shaft}_encoder"] * np.sin(angle + np.radians(truth[f"{shaft}_encoder_deg"]))
        for shaft, angle, gain in (("driving", one, -float(pair.ratio)), ("driven", two, 1.0))
    )
    curves = [np.mean(flanks, axis=0) + encoders * ARCSEC, flanks[1] - flanks[0]]
    found = []
    for n1, n2 in WAVES.values():
        for curve in curves:
            phase = n1 * one + n2 * two
            found += [2 * np.mean(curve * np.cos(phase)), 2 * np.mean(curve * np.sin(phase))]
    return np.array([*found, *(np.mean(curve) for curve in curves)])


@pytest.mark.parametrize("teeth", [*PAIRS, (30, 30)])
def test_coefficients_are_projections_of_the_exact_model(teeth):
    pair = gear_pair(*teeth)
    found = np.asarray(_relation(pair).coefficients(jnp.asarray(_values(TRUTH))))
    expected = _projected(pair, TRUTH)
    np.testing.assert_allclose(found, expected, atol=1e-11)
    other = _projected(pair, TRUTH | {"driving_mm": 0.02401})
    assert np.abs(found - other).max() > 1e-8


@pytest.mark.parametrize("flank", ["A", "B"])
def test_one_flank_has_the_coefficients_of_that_flank(flank):
    pair = gear_pair(45, 80)
    both = np.asarray(_relation(pair).coefficients(jnp.asarray(_values(TRUTH))))
    one = np.asarray(_relation(pair, False, flank).coefficients(jnp.asarray(_values(TRUTH))))
    sign = -0.5 if flank == "A" else 0.5
    mean, difference = both[:-2].reshape(-1, 2, 2).transpose(1, 0, 2)
    np.testing.assert_allclose(one[:-1].reshape(-1, 2), mean + sign * difference, atol=1e-12)
    assert np.abs(one[:-1].reshape(-1, 2) - mean).max() > 1e-6


KEYS = {"eccentricity_mm": "mm", "encoder_arcsec": "encoder", "encoder_phase_deg": "encoder_deg"}
NAMES = {
    f"{shaft}_{name}": f"{shaft}_{key}"
    for shaft in ("driving", "driven")
    for name, key in (KEYS | {"phase_deg": "phase_deg"}).items()
} | {"constant_backlash_deg": "constant_backlash_deg"}
"""Parameter → key of the truth."""


def _off(parameters: Any, truth: dict) -> dict[str, float]:
    """Deviation of every number from the truth in its standard errors."""
    off = {}
    for name, key in NAMES.items():
        one = parameters[name]
        if one.value is not None:
            apart = one.value - truth[key]
            apart = (apart + 180) % 360 - 180 if name.endswith("phase_deg") else apart
            off[name] = abs(apart) / one.std
    return off


# The gap is small, because the model takes driven harmonics at one angle for both flanks.
SMALL = TRUTH | {"constant_backlash_deg": 0.02}


@pytest.mark.parametrize("teeth", PAIRS)
def test_planted_eccentricities_are_recovered(teeth):
    pair = gear_pair(*teeth)
    parameters: Any = parameters_of(fitted(exact_log(pair, SMALL, noise=1e-5), pair), pair)
    off = _off(parameters, SMALL)
    assert set(off) == set(NAMES)
    assert max(off.values()) < 4.0
    assert parameters["driving_eccentricity_mm"].std < 1e-3
    assert parameters["delay_s"].value == pytest.approx(3e-4, abs=2e-5)
    wrong = _off(parameters, SMALL | {"driving_mm": 0.028, "driven_encoder": 50.0})
    assert wrong["driving_eccentricity_mm"] > 6 and wrong["driven_encoder_arcsec"] > 6


def test_a_wide_gap_moves_no_eccentricity():
    """A gap of 1° turns the driven gear by 1° between the flanks: 5 standard errors of 0.17 µm."""
    pair, truth = gear_pair(45, 80), TRUTH | {"constant_backlash_deg": 1.0}
    parameters: Any = parameters_of(fitted(exact_log(pair, truth, noise=3.5e-5), pair), pair)
    assert max(_off(parameters, truth).values()) < 4.0


def test_one_flank_tells_gears_and_no_gap():
    pair = gear_pair(45, 80)
    truth = TRUTH | {"driving_encoder": 0.0, "driven_encoder": 0.0}
    parameters: Any = parameters_of(fitted(exact_log(pair, truth, back=False), pair), pair)
    off = _off(parameters, truth)
    assert set(off) == {n for n in NAMES if "encoder" not in n and "backlash" not in n}
    assert max(off.values()) < 4.0
    assert not parameters["constant_backlash_deg"].determined
    assert not parameters["driving_encoder_arcsec"].determined


def test_equal_gears_have_one_first_order():
    """At 1:1 both first orders have one frequency: nothing is claimed twice, and the gap holds."""
    pair = gear_pair(30, 30)
    fit = fitted(exact_log(pair, TRUTH), pair)
    parameters: Any = parameters_of(fit, pair)
    determined = [n for n in NAMES if parameters[n].value is not None]
    assert not [name for name in determined if name.startswith("driven")]
    covered = parameters["gap_over_angles_covered"]
    model = exact_model(pair, gears_of(TRUTH))
    angles = fit.scope.covered
    gap = [np.asarray(model.transmission_error(angles, f)) for f in FLANKS]
    expected = np.degrees(np.mean(gap[1] - gap[0]))
    assert covered.value == pytest.approx(expected, abs=3e-5 + 4 * covered.std)
    assert covered.std < 1e-3


def test_constants_are_what_the_gears_add():
    pair = gear_pair(45, 80)
    fit = fitted(exact_log(pair, TRUTH), pair)
    gears = fitted_gears(pair, fit)
    assert gears is not None and gears.relation.names == (*GEARS, *ENCODERS)
    np.testing.assert_allclose(gears.constants, _projected(pair, TRUTH)[-2:], atol=2e-6)
    for kind, names in zip(KINDS, (GEARS, ENCODERS), strict=True):
        found = fitted_gears(pair, fit, [kind])
        assert found is not None and found.relation.names == names
    assert fitted_gears(pair, replace(fit, waves=())) is None

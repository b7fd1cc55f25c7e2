"""Harmonics of the exact relation against a dense curve, differences and the closed form."""

from fractions import Fraction

import equinox as eqx
import jax
import numpy as np
import pytest

import vttig_jax
from tests.identify.summaries import layout_of
from vttig_jax.base.units import ARCSEC, DEG
from vttig_jax.identify.model.forward_model import drive_relation, encoder_relation, pair_relation
from vttig_jax.identify.model.harmonics import plan_terms
from vttig_jax.pair.eccentricities import Eccentricities
from vttig_jax.pair.gear_pair import Flank

BOTH: tuple[Flank, ...] = ("A", "B")
PLAN = plan_terms(Fraction(45, 80), (1,), (1,), 0, 45)


def _cartesian(amplitude: float, phase_deg: float) -> tuple[float, float]:
    return amplitude * np.cos(phase_deg * DEG), amplitude * np.sin(phase_deg * DEG)


def _vector(relation, **values: float) -> np.ndarray:
    return np.array([values.get(name, 0.0) for name in relation.names])


@eqx.filter_jit
def _compiled(relation, vector):
    return relation.coefficients(vector)


def _coefficients(relation, vector: np.ndarray) -> np.ndarray:
    """Harmonics of both flanks; one program for each kind of relation."""
    return np.asarray(_compiled(relation, vector))


_exact = jax.jit(vttig_jax.exact_transmission_error, static_argnames="flank")


def _of_rig(rig: Eccentricities) -> dict[str, float]:
    driving = _cartesian(float(rig.driving_mm), float(rig.driving_phase_deg))
    driven = _cartesian(float(rig.driven_mm), float(rig.driven_phase_deg))
    return {
        "driving_x": driving[0],
        "driving_y": driving[1],
        "driven_x": driven[0],
        "driven_y": driven[1],
        "constant_backlash": float(rig.constant_backlash_deg) * DEG,
    }


def _projected(pair, rig, flank: Flank) -> np.ndarray:
    """Least squares of the exact transmission error on the tied harmonics."""
    driving = np.linspace(0, 32 * np.pi, 20_000, endpoint=False)
    error = np.asarray(_exact(driving, pair, rig, flank=flank))
    driven = float(pair.ratio) * driving + error
    every = [np.ones_like(driving)]
    for harmonic in PLAN.tied:
        phase = float(harmonic.term[0]) * driving + float(harmonic.term[1]) * driven
        every += [np.cos(phase), np.sin(phase)]
    return np.linalg.lstsq(np.stack(every, axis=1), error, rcond=None)[0]


@pytest.mark.parametrize("flank", BOTH)
def test_coefficients_are_those_of_the_exact_curve(paper_pair, paper_rig, flank):
    relation = pair_relation(paper_pair, PLAN, layout_of(PLAN), (flank,), encoder_terms=False)
    value = _of_rig(paper_rig)
    value["offset"] = 0.0 if flank == "A" else value["constant_backlash"]
    found = _coefficients(relation, _vector(relation, **value))[0]
    np.testing.assert_allclose(found, _projected(paper_pair, paper_rig, flank), atol=1e-9)
    other = _projected(paper_pair, paper_rig, "B" if flank == "A" else "A")
    assert np.abs(found - other).max() > 1e-5


def test_the_constant_backlash_stands_on_flank_b(paper_pair, paper_rig):
    relation = pair_relation(paper_pair, PLAN, layout_of(PLAN), BOTH, encoder_terms=True)
    found = _coefficients(relation, _vector(relation, **_of_rig(paper_rig)))
    for side, flank in enumerate(BOTH):
        expected = _projected(paper_pair, paper_rig, flank)
        np.testing.assert_allclose(found[side], expected, atol=1e-9)


def test_coinciding_second_orders_go_to_the_first(paper_rig):
    """20/40: (0, 2) turns with the driving gear and (1, −1) with the driven one."""
    pair = vttig_jax.GearPair(
        vttig_jax.Gear(20),
        vttig_jax.Gear(40),
        module_mm=2.0,
        pressure_angles_deg=20.0,
        centre_distance_mm=60.1,
    )
    plan = plan_terms(pair.ratio, (1,), (1,), 0, 20)
    relation = pair_relation(pair, plan, layout_of(plan), ("A",), encoder_terms=False)
    found = _coefficients(relation, _vector(relation, **_of_rig(paper_rig)))[0]
    driving = np.linspace(0, 4 * np.pi, 20_000, endpoint=False)
    error = np.asarray(_exact(driving, pair, paper_rig, flank="A"))
    every = [np.ones_like(driving)]
    for harmonic in plan.tied:
        # The driven angle of a fit holds the transmission error; its own start is free, so the
        # angles of a coinciding order may be told apart by that error only.
        phase = float(harmonic.term[0]) * driving + float(harmonic.term[1]) * (
            0.5 * driving + error
        )
        every += [np.cos(phase), np.sin(phase)]
    expected = np.linalg.lstsq(np.stack(every, axis=1), error, rcond=None)[0]
    np.testing.assert_allclose(found, expected, atol=2e-9)


@pytest.mark.parametrize("size_mm", [1e-5, 1e-4])
def test_small_eccentricities_follow_the_closed_form(paper_pair, size_mm):
    """F₁ = K e₁ exp j(θ₁+α) + c_E, B₁ with −α, driven with α and −α exchanged."""
    alpha = float(paper_pair.working_pressure_angles[0])
    gain = 1 / float(paper_pair.base_radii[1, 0])
    relation = pair_relation(paper_pair, PLAN, layout_of(PLAN), BOTH, encoder_terms=True)
    theta, encoder = (50 * DEG, 80 * DEG), (2e-6, 3e-6)
    value = {}
    for shaft, phase, error in zip(("driving", "driven"), theta, encoder, strict=True):
        value[f"{shaft}_x"] = size_mm * np.cos(phase)
        value[f"{shaft}_y"] = size_mm * np.sin(phase)
        value[f"{shaft}_encoder_x"] = error * np.cos(1.0)
        value[f"{shaft}_encoder_y"] = error * np.sin(1.0)
    found = _coefficients(relation, _vector(relation, **value))
    ratio = 45 / 80
    common = (-ratio * encoder[0] * np.exp(1j), encoder[1] * np.exp(1j))
    for side, sign in ((0, 1.0), (1, -1.0)):
        for shaft, sense in ((0, 1.0), (1, -1.0)):
            # a sin + b cos = Im[(a + jb) e^{jφ}]
            cosine, sine = found[side, 1 + 2 * shaft], found[side, 2 + 2 * shaft]
            tooth = gain * size_mm * np.exp(1j * (theta[shaft] + sign * sense * alpha))
            assert abs(sine + 1j * cosine - tooth - common[shaft]) < 1e-2 * gain * size_mm**2
            wrong = gain * size_mm * np.exp(1j * (theta[shaft] - sign * sense * alpha))
            assert abs(tooth - wrong) > 0.5 * gain * size_mm


def test_encoder_terms_have_the_signs_of_the_contract(paper_pair):
    relation = pair_relation(paper_pair, PLAN, layout_of(PLAN, 1), BOTH, encoder_terms=True)
    size, phase = 20 * ARCSEC, 0.7
    still = _coefficients(relation, _vector(relation))
    for shaft, gain, column in (("driving", -45 / 80, 2), ("driven", 1.0, 4)):
        x, y = size * np.cos(phase), size * np.sin(phase)
        value = {f"{shaft}_encoder_x": x, f"{shaft}_encoder_y": y}
        moved = _coefficients(relation, _vector(relation, **value)) - still
        expected = np.zeros_like(moved)
        # gain · E sin(φ + ε) on both flanks alike.
        expected[:, column] = gain * size * np.sin(phase)
        expected[:, column + 1] = gain * size * np.cos(phase)
        np.testing.assert_allclose(moved, expected, atol=1e-15)


@pytest.mark.parametrize("kind", ["pair", "drive"])
def test_drift_and_offset_columns(paper_pair, kind):
    relation = (
        pair_relation(paper_pair, PLAN, layout_of(PLAN, 2), BOTH, encoder_terms=False)
        if kind == "pair"
        else drive_relation(PLAN, layout_of(PLAN, 2), BOTH)
    )
    value = {"offset": 0.3, "constant_backlash": 0.02, "drift_1": 0.5, "drift_2": -0.7}
    found = _coefficients(relation, _vector(relation, **value))
    np.testing.assert_allclose(found[:, :3], [[0.3, 0.5, -0.7], [0.32, 0.5, -0.7]], atol=1e-15)


def test_gradient_agrees_with_differences(paper_pair, paper_rig):
    relation = pair_relation(paper_pair, PLAN, layout_of(PLAN, 1), BOTH, encoder_terms=True)
    point = _vector(relation, **_of_rig(paper_rig))
    forward = np.asarray(jax.jit(jax.jacfwd(relation.coefficients))(point))
    reverse = np.asarray(jax.jit(jax.jacrev(relation.coefficients))(point))
    np.testing.assert_allclose(forward, reverse, atol=1e-15)
    for index in range(len(point)):
        step = 1e-5 * np.eye(len(point))[index]
        ahead, back = (_coefficients(relation, point + s * step) for s in (1, -1))
        slope = (ahead - back) / 2e-5
        np.testing.assert_allclose(forward[..., index], slope, atol=1e-9)
    assert np.abs(forward - np.roll(forward, 1, axis=-1)).max() > 1e-3


def test_names_follow_flanks_drift_and_encoders(paper_pair):
    full = pair_relation(paper_pair, PLAN, layout_of(PLAN, 1), BOTH, encoder_terms=True)
    assert full.names[:3] == ("offset", "constant_backlash", "drift_1")
    assert len(full.names) == 3 + 8
    one = pair_relation(paper_pair, PLAN, layout_of(PLAN), ("B",), encoder_terms=False)
    assert one.names == ("offset", "driving_x", "driving_y", "driven_x", "driven_y")
    half = plan_terms(Fraction(45, 80), (1,), (), 0, 45)
    gear = pair_relation(paper_pair, half, layout_of(half), ("A",), encoder_terms=True)
    assert gear.names == (
        "offset",
        "driving_encoder_x",
        "driving_encoder_y",
        "driving_x",
        "driving_y",
    )


def test_drive_splits_common_and_different_parts():
    plan = plan_terms(Fraction(1, 225), (1,), (1,), 0, None)
    relation = drive_relation(plan, layout_of(plan), BOTH)
    value = {"driving_x": 1.0, "driving_y": 2.0, "driven_x": 3.0, "driven_y": 4.0}
    value |= {f"{name}_difference": 0.1 * v for name, v in value.items()}
    found = _coefficients(relation, _vector(relation, **value))
    common = np.array([0, 2.0, 1.0, 4.0, 3.0])
    np.testing.assert_allclose(found, [0.95 * common, 1.05 * common], atol=1e-15)
    alone = drive_relation(plan, layout_of(plan), ("B",))
    assert not any("difference" in name for name in alone.names)
    one = _coefficients(alone, _vector(alone, **value))
    np.testing.assert_allclose(one, [common], atol=1e-15)


def test_encoders_on_perfect_gears_take_the_first_orders():
    """E₂ as it is, E₁ through the ratio and with the other sign, the same on both flanks."""
    relation = encoder_relation(PLAN, layout_of(PLAN), BOTH, 0.5625)
    driving, driven = _cartesian(2e-4, 30.0), _cartesian(1e-4, 200.0)
    vector = _vector(
        relation,
        driving_encoder_x=driving[0],
        driving_encoder_y=driving[1],
        driven_encoder_x=driven[0],
        driven_encoder_y=driven[1],
    )
    found = _coefficients(relation, vector)
    angle = np.linspace(0, 32 * np.pi, 500)
    expected = 1e-4 * np.sin(0.5625 * angle + 200.0 * DEG)
    expected = expected - 0.5625 * 2e-4 * np.sin(angle + 30.0 * DEG)
    for row in found:
        curve = row[0] + sum(
            row[1 + 2 * k] * np.cos(phase) + row[2 + 2 * k] * np.sin(phase)
            for k, phase in enumerate((angle, 0.5625 * angle))
        )
        np.testing.assert_allclose(curve, expected, atol=1e-12)


@pytest.mark.parametrize("orders", [((1,), (1,)), ((1,), ()), ((), ())])
def test_it_is_linearised_as_it_is_differentiated(paper_pair, orders):
    """Also where the log tells the first order of one shaft only, or of none."""
    plan = plan_terms(
        Fraction(45, 80),
        driving_orders=orders[0],
        driven_orders=orders[1],
        mesh_orders=0,
        driving_teeth=45,
    )
    relation = pair_relation(paper_pair, plan, layout_of(plan, 1), BOTH, encoder_terms=False)
    point = 0.01 * (1.0 + np.arange(len(relation.names)))
    tied, slopes = relation.linearised(point)
    np.testing.assert_allclose(tied, _coefficients(relation, point), atol=1e-15)
    differentiated = jax.jit(jax.jacfwd(relation.coefficients))(point)
    np.testing.assert_allclose(slopes, differentiated, atol=1e-14)

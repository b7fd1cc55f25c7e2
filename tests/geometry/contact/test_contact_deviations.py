"""Flanks that deviate: by a constant, along the profile, on a single tooth."""

import math

import numpy as np
import pytest

from tests.geometry.pairs import FLANKS, pair_of
from vttig_jax.geometry.contact import contact_model
from vttig_jax.geometry.deviations import Deviations, FlankMap
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.pair.gear_pair import Eccentricities, Flank

PAIR, SPUR = pair_of(), pair_of((0.0, 0.0))
BASE = np.asarray(PAIR.base_radii)[:, 0]
PITCH = 2 * math.pi / 45
ANGLES = np.linspace(-2.0, 2.0, 33) * PITCH
SHIFTED = Eccentricities(axial_mm=0.2)
FLAT = np.array([5.0, 35.0]), np.array([-10.0, 10.0]), np.ones((2, 2))


def flat(um: float) -> FlankMap:
    return FlankMap(FLAT[0], FLAT[1], um * FLAT[2])


def deviations(driving=(0.0, 0.0), driven=(0.0, 0.0), pitches=None) -> Deviations:
    """Constant deviations of flank A and B in µm: always every part, which is compiled once."""
    own = {"driving": np.zeros((2, 45)), "driven": np.zeros((2, 80))} | (pitches or {})
    return Deviations(
        driving=(flat(driving[0]), flat(driving[1])),
        driven=(flat(driven[0]), flat(driven[1])),
        driving_pitch_um=own["driving"],
        driven_pitch_um=own["driven"],
    )


def errors(flank: Flank, given: Deviations, pair=PAIR, rig=SHIFTED) -> np.ndarray:
    model = contact_model(pair, rig, deviations=given, sections=3)
    return np.asarray(model.transmission_error(ANGLES, flank))


@pytest.mark.slow
def test_no_deviation_is_the_exact_relation_and_an_eccentric_gear_feels_one():
    """The driven centre moves on with φ₂: the step is not the same all around, by e/R."""
    drawn = math.degrees(float(PAIR.drawing_backlash))
    assert contact_model(PAIR, deviations=deviations()).highest_order == 45.0
    rig = Eccentricities(0.0226, 49.5, 0.0273, 79.3, drawn, axial_mm=0.2)
    for flank in FLANKS:
        found = errors(flank, deviations(), rig=rig)
        exact = exact_model(PAIR, rig).transmission_error(ANGLES, flank)
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-14)
    step = errors("A", deviations((7.0, 0.0)), rig=rig) - errors("A", deviations(), rig=rig)
    apart = np.abs(step / (7e-3 / BASE[1]) - 1).max()
    assert 1e-5 < apart < 2 * 0.0273 / BASE[1]


@pytest.mark.slow
def test_a_constant_deviation_turns_the_contact_by_itself_over_the_base_radius():
    """Of both gears they add; each flank feels its own alone."""
    both = deviations((4.0, 2.0), (3.0, 1.0))
    for flank, total in zip(FLANKS, (7e-3, -3e-3), strict=True):
        moved = errors(flank, both) - errors(flank, deviations())
        np.testing.assert_allclose(moved, total / BASE[1], rtol=0, atol=1e-15)


@pytest.mark.slow
def test_a_single_tooth_shows_where_it_is_in_mesh():
    """Tooth 1 is between the axes at φ = 0; it carries alone while it stands out."""
    for flank in FLANKS:
        for gear in ("driving", "driven"):
            pitch = np.zeros((2, 45 if gear == "driving" else 80))
            tooth = (
                0 if gear == "driving" or flank == "A" else 1
            )  # flank B meets the driven tooth ahead
            pitch[:, tooth] = 5.0
            true = errors(flank, deviations(), SPUR)
            rise = (errors(flank, deviations(pitches={gear: pitch}), SPUR) - true) * BASE[1] * 1e3
            rise *= 1 if flank == "A" else -1
            ratio = float(SPUR.contact_ratios[0])
            full = np.abs(rise - 5.0) < 1e-9
            assert full.sum() == pytest.approx(ratio * 8, abs=1)  # 8 angles a pitch
            assert rise.min() > -1e-9  # before and after, its tip edge still carries
            assert np.abs(ANGLES[full]).max() < 1.2 * PITCH
            far = np.abs(ANGLES) > 1.7 * PITCH
            np.testing.assert_allclose(rise[far], 0.0, atol=1e-9)
            # One that stays behind leaves the load to its neighbours where they nearly mesh.
            fall = errors(flank, deviations(pitches={gear: -pitch}), SPUR) - true
            fall *= BASE[1] * 1e3 * (1 if flank == "A" else -1)
            assert (
                1
                <= (np.abs(fall + 5.0) < 1e-9).sum()
                <= (fall < -1e-9).sum()
                <= (2 - ratio) * 8 + 1
            )
            assert np.abs(fall).max() < 5.0 + 1e-9

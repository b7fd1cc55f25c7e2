"""What users of gear tools write and ask for: diametral pitch, thinned teeth, the pair in mesh."""

import math

import numpy as np
import pytest

from tests.pair.tables import pair_of_table
from vttig_jax import Eccentricities, Gear, GearPair
from vttig_jax.geometry import (
    contact_model,
    geometric_backlash,
    measure_gear,
    measure_pair,
    tooth_of,
)


def loaded(distance=70.0, driving=0.0, driven=0.0, **size) -> GearPair:
    """Gears of 20 and 50 teeth, whose teeth are thinned by so many mm."""
    thinned = ({"tooth_thinning_mm": thinning} for thinning in (driving, driven))
    gear = {"face_width_mm": 10.0, "helix_angle_deg": 2.0}
    return pair_of_table(
        None, *thinned, teeth=(20, 50), both=gear, centre_distance_mm=distance, **size
    )


def test_a_diametral_pitch_is_a_module():
    inch = loaded(diametral_pitch=12.7)
    assert str(inch) == str(loaded()) and float(inch.module_mm) == 2.0


@pytest.mark.parametrize("distance", [70.0, 70.2])
def test_thinned_teeth_open_the_backlash_by_their_sum(distance):
    thin, full = (loaded(distance=distance, driving=t, driven=t / 4) for t in (0.08, 0.0))
    opened = (thin.drawing_backlash - full.drawing_backlash) * full.reference_radii[1]
    assert opened == pytest.approx(0.1, abs=1e-12)
    assert float(geometric_backlash(thin)) == pytest.approx(float(thin.drawing_backlash), abs=1e-12)
    model, angles = contact_model(thin, Eccentricities()), np.linspace(0.0, 0.4, 5)
    a, b = (np.asarray(model.transmission_error(angles, flank)) for flank in ("A", "B"))
    np.testing.assert_allclose(a, 0.0, atol=1e-12)
    np.testing.assert_allclose(b, float(thin.drawing_backlash), atol=1e-12)
    gears = [measure_gear(tooth_of(pair, "driving")) for pair in (thin, full)]
    slender, whole = (gear.tooth_thickness_mm for gear in gears)
    assert whole - slender == pytest.approx(0.08)


def test_a_pair_in_mesh():
    found = measure_pair(loaded(distance=70.2, driving=0.08))
    working = math.acos(70.0 * math.cos(math.radians(20.0)) / 70.2)
    assert found["working_pressure_angle_deg"]["B"] == pytest.approx(math.degrees(working))
    diameters = found["pitch_diameter_mm"]
    assert diameters["driving"] / 20 == pytest.approx(diameters["driven"] / 50)
    assert sum(diameters.values()) == pytest.approx(2 * 70.2)
    # Backlash along the line of action: what the larger distance opens, and the thinning.
    opening = (
        2 * 70.0 * (math.tan(working) - working - math.tan(math.radians(20.0)) + math.radians(20.0))
    )
    assert found["backlash_mm"] == pytest.approx(opening + 0.08)
    bases = [r * math.cos(math.radians(20.0)) for r in (20.0, 50.0)]
    path = sum(
        math.sqrt((r + 2.0) ** 2 - base**2) for r, base in zip((20.0, 50.0), bases, strict=True)
    )
    path -= 70.2 * math.sin(working)
    assert found["contact_ratio"]["A"] == pytest.approx(path / (2 * math.pi * bases[0] / 20))


def test_the_representation_holds_the_numbers():
    rig = Eccentricities(0.0226, 49.5, axial_mm=0.25)
    again = eval(repr(rig))
    assert repr(again) == repr(rig) and float(again.driving_mm) == 0.0226
    gears = Gear(45, 3.0, 3.0, 20.0), Gear(80, 3.0, 3.0, tooth_thinning_mm=0.05)
    pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0, centre_distance_mm=125.12)
    assert str(eval(repr(pair))) == str(pair) and "125.12" in repr(pair)

"""First touch of unmodified surfaces against the exact relation, which the search does not know."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from tests.geometry.pairs import FLANKS, pair_of
from vttig_jax.geometry.contact import contact_model
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.pair.gear_pair import Eccentricities, GearPair

TABLE_2 = (0.0226, 49.5, 0.0273, 79.3)
HUNTING = np.linspace(0.0, 32 * math.pi, 64)
"""Over the hunting period."""

SOME = np.array([0.0, 1.0, 6.1, 33.3, 50.3, 77.7, 100.0, -7.0])


def rig(e=TABLE_2, backlash_deg=0.0, axial=0.0):
    return Eccentricities(e[0], e[1], e[2], e[3], backlash_deg, axial)


def drawn(pair: GearPair, e=TABLE_2, axial=0.0):
    """With the backlash that the drawn teeth have, as the exact relation takes it."""
    return rig(e, math.degrees(float(pair.drawing_backlash)), axial)


def apart(pair, eccentricities, angles=HUNTING, exact=None, **options):
    """Largest difference on both flanks, rad."""
    contact = contact_model(pair, eccentricities, **options)
    relation = exact_model(pair, exact or eccentricities)
    return max(
        np.abs(
            np.asarray(contact.transmission_error(angles, flank))
            - np.asarray(relation.transmission_error(angles, flank))
        ).max()
        for flank in FLANKS
    )


def test_the_rig_of_the_paper_over_its_hunting_period(paper_pair):
    assert apart(paper_pair, drawn(paper_pair, axial=0.3)) < 1e-14


RIGS = {
    "profile-shifted": (
        pair_of((0.0, 0.0), teeth=(20, 33), shifts=(0.4, 0.3), distance=54.3),
        (0.03, 10.0, 0.02, 70.0),
        0.0,
    ),
    "speeding up": (pair_of(teeth=(80, 45)), (0.2, 10.0, 0.1, 200.0), 0.2),
    "large eccentricities": (pair_of(), (0.2, 49.5, 0.2, 79.3), -0.5),
    "unequal flanks": (
        pair_of(helix=(3.0, 2.0), pressure=(20.0, 25.0)),
        (0.1, 0.0, 0.05, 90.0),
        0.4,
    ),
    "untapered": (pair_of(helix=(0.0, 0.0)), TABLE_2, 3.0),
    "no face widths": (pair_of(widths=(math.nan, math.nan)), TABLE_2, 0.3),
    "interfering": (pair_of(distance=125.0), (0.05, 0.0, 0.05, 0.0), 0.3),
    "tapered the other way": (pair_of(helix=(-2.0, -2.0)), TABLE_2, 0.2),
}


def test_other_rigs():
    for name in RIGS:
        pair, e, axial = RIGS[name]
        assert apart(pair, drawn(pair, e, axial), SOME) < 1e-13


@pytest.mark.slow
def test_sections_that_touch_at_once_add_nothing(paper_pair):
    assert apart(paper_pair, drawn(paper_pair, axial=0.3), SOME, sections=9) < 1e-14


def test_the_backlash_is_that_of_the_drawn_teeth(paper_pair):
    """The j_c of a fit changes nothing."""
    fitted = rig(backlash_deg=0.038, axial=0.1)
    assert apart(paper_pair, fitted, SOME, drawn(paper_pair, axial=0.1)) < 1e-14
    assert apart(paper_pair, fitted, SOME) > 1e-4


def test_axes_that_are_not_where_the_drawing_has_them(paper_pair):
    """The zero of φ₂ stays that of the nominal centre distance."""
    moved = pair_of(distance=125.3)
    nominal, now = (p.working_pressure_angles[0] for p in (paper_pair, moved))
    opened = (math.tan(now) - now - math.tan(nominal) + nominal) * float(1 + paper_pair.ratio)
    contact = contact_model(paper_pair, rig(), centre_distance_mm=125.3)
    # Zero of φ₂ where it is with the axes apart: the driven offset stands elsewhere at φ₂ = 0.
    there = exact_model(moved, drawn(moved, (*TABLE_2[:3], TABLE_2[3] - math.degrees(opened))))
    for flank in FLANKS:
        found = np.asarray(contact.transmission_error(SOME, flank)) + opened
        np.testing.assert_allclose(found, there.transmission_error(SOME, flank), atol=1e-13)


@pytest.mark.slow
def test_the_driven_centre_can_be_held():
    """As the harmonics over both angles need it."""
    pair = pair_of()
    eccentric = drawn(pair, (0.2, 49.5, 0.2, 79.3), 0.1)
    contact, relation = contact_model(pair, eccentric), exact_model(pair, eccentric)
    driving, driven = jnp.meshgrid(jnp.linspace(0, 6, 5), jnp.linspace(0, 6, 7), indexing="ij")
    for flank in FLANKS:
        np.testing.assert_allclose(
            contact.at_both_angles(driving, driven, flank),
            relation.at_both_angles(driving, driven, flank),
            rtol=0,
            atol=1e-13,
        )


def test_neighbouring_rigs_are_told_apart(paper_pair):
    cases: list[dict[str, Any]] = [
        {"e": (0.0227, *TABLE_2[1:])},
        {"e": (*TABLE_2[:3], 79.4)},
        {"axial": 0.1001},
        {"backlash_deg": 0.0629},
    ]
    for changed in cases:
        other = drawn(paper_pair, axial=0.1)
        values = {"axial": 0.1, "backlash_deg": float(other.constant_backlash_deg)}
        assert apart(paper_pair, other, SOME, rig(**(values | changed))) > 5e-8

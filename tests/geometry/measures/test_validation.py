"""Teeth that cannot be measured: one sentence that says where, and the cure."""

import re

import numpy as np
import pytest

from tests.geometry.shop_gears import shop_gear
from vttig_jax.base.errors import PairError
from vttig_jax.geometry.checks import check_measurable

POINTED = {
    "at the other end": (
        shop_gear(helix=(-3.0, -3.0), width=30.0),
        "pointed at z = -15 mm",
        "the face narrower",
    ),
    "by its shift": (shop_gear(12, shift=0.9), "pointed at z = ", "the profile shift lower"),
    "by its addendum": (
        shop_gear(rack={"addendum": 1.8}),
        "pointed at z = ",
        "the profile shift lower or the addendum lower",
    ),
}


def test_pointed_teeth_say_where_their_flanks_meet():
    for name in POINTED:
        tooth, place, cure = POINTED[name]
        with pytest.raises(PairError) as caught:
            check_measurable(tooth)
        message = caught.value.message
        assert place in message and cure in message and caught.value.where == "tip circle"
        z, met, tip = (float(n) for n in re.findall(r"(?:z = |of )(-?[\d.]+) mm", message))
        assert tip == 2 * float(tooth.tip_radius)
        radius, height = np.array([met / 2 - 0.001, met / 2 + 0.001]), np.full(2, z)
        inside, outside = tooth.thickness(radius, height)
        assert inside > 0 > outside


OTHERS = {
    "no space left": (
        shop_gear(
            helix=(3.0, 3.0),
            width=40.0,
            rack={"addendum": 0.3, "clearance": 1.2, "tip_radius": 0.0},
        ),
        0.0,
        "leave no space between them at z = -20 mm",
    ),
    "no tip": (shop_gear(20, shift=-2.5, centre_distance_mm=120.0), 0.0, "inside the base circle"),
    "all fillet": (
        shop_gear(30, rack={"addendum": 0.05, "clearance": 0.25, "tip_radius": 2.0}),
        0.0,
        "leaves no flank below the tip circle",
    ),
}


def test_teeth_that_are_none():
    for name in OTHERS:
        tooth, section, words = OTHERS[name]
        with pytest.raises(PairError) as caught:
            check_measurable(tooth, section)
        assert words in caught.value.message and "\n" not in caught.value.message
        assert caught.value.exit_code == 3


def test_without_face_width_the_section_alone_is_looked_at():
    tooth = shop_gear(helix=(3.0, 3.0), width=None)
    with pytest.raises(PairError, match="pointed at z = 15 mm"):
        check_measurable(tooth, 15.0)

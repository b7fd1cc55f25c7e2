"""Pairs that cannot be brought into contact, and wrong options: one sentence each."""

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.geometry.pairs import pair_of
from vttig_jax.base.errors import PairError
from vttig_jax.geometry.contact import contact_model
from vttig_jax.geometry.deviations import Deviations
from vttig_jax.geometry.form import form_radius
from vttig_jax.geometry.mounting import Misalignment
from vttig_jax.geometry.tooth import tooth_of
from vttig_jax.pair.gear_pair import Eccentricities, Rack

make = partial(pair_of, distance=None)
BAD = {
    "base circles": ({}, {"centre_distance_mm": 117.0}, "lets the base circles overlap"),
    "no width": (
        {"widths": (math.nan, math.nan)},
        {"misalignment": Misalignment(1e-4)},
        "give a face width",
    ),
    "pointed": ({"widths": (36.0, 36.0)}, {}, "pointed at z = 18 mm"),
    "gone": ({"widths": (80.0, 80.0)}, {}, "mm thick on the reference circle"),
    "long teeth": (
        {"rack": Rack(addendum=1.5, clearance=0.1), "helix": (0.0, 0.0)},
        {"tooth_pairs": 2},
        "2 tooth pairs are too few for a contact ratio of",
    ),
    "pitches": (
        {},
        {"deviations": Deviations(driving_pitch_um=np.zeros((2, 80)))},
        r"the shape is \(2, 80\); give one value for each flank and tooth, shape \(2, 45\)",
    ),
}


def test_gears_that_do_not_meet():
    for name in BAD:
        gears, options, sentence = BAD[name]
        with pytest.raises(PairError, match=sentence):
            contact_model(make(**gears), **options)


def test_options_that_are_none(unchecked):
    cases: list[tuple[dict[str, Any], str]] = [
        ({"sections": 0}, "`sections` must be 1 or more, but is 0"),
        ({"tooth_pairs": 0}, "`tooth_pairs` must be 1 or more"),
        ({"points": 2}, "`points` must be 3 or more, but is 2"),
    ]
    for options, sentence in cases:
        with pytest.raises(ValueError, match=sentence):
            contact_model(make(), **options)


def test_a_wrong_flank(unchecked):
    with pytest.raises(ValueError, match='`flank` must be "A" or "B"'):
        contact_model(make()).transmission_error(0.0, "left")  # pyright: ignore


@pytest.mark.slow
def test_long_teeth_are_searched_when_asked():
    pair = make(rack=Rack(addendum=1.5, clearance=0.1), helix=(0.0, 0.0))
    model = contact_model(pair, tooth_pairs=4)
    np.testing.assert_allclose(model.transmission_error(np.linspace(0, 1, 5), "A"), 0, atol=1e-15)


def test_the_flank_of_an_undercut_tooth_begins_at_its_fillet():
    pair = make((0.0, 0.0), teeth=(12, 80))
    model = contact_model(pair, sections=1)
    radius = form_radius(tooth_of(pair, "driving"), "left")
    base = float(pair.base_radii[0, 0])
    np.testing.assert_allclose(model.starts[0], math.sqrt((radius / base) ** 2 - 1), rtol=1e-12)
    traced = jax.jit(lambda x: contact_model(x, sections=1).starts)(pair)
    np.testing.assert_allclose(traced[1], model.starts[1], rtol=1e-12)
    assert traced[0, 0] == 0.0  # on the base circle while nothing is known


def test_sections_are_one_where_all_touch_at_once():
    assert contact_model(make()).search_grid.sections == 1
    assert contact_model(make((0.0, 0.0))).search_grid.sections == 1
    assert contact_model(make(rack=Rack(addendum=0.6))).search_grid.sections == 9  # tips may carry
    assert contact_model(make(), misalignment=Misalignment(1e-5)).search_grid.sections == 9
    assert contact_model(make(), deviations=Deviations()).search_grid.sections == 9
    assert contact_model(make(driven_helix=(3.1, 3.0))).search_grid.sections == 9


def test_half_of_the_numbers_may_be_traced():
    """A pair in which one number is traced and the others are not."""

    def error(distance):
        return contact_model(make(distance=distance), Eccentricities(), sections=1).backlash(0.1)

    assert jax.eval_shape(error, jnp.asarray(125.12)).shape == ()
    assert error(125.12) == contact_model(make(distance=125.12)).backlash(0.1)

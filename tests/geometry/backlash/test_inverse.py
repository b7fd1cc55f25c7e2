"""Axial positions for a wanted backlash: there and back, and what no position gives."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.geometry.backlash.test_drawn_backlash import UNEQUAL, make
from vttig_jax.base.errors import PairError
from vttig_jax.geometry.backlash import axial_for_backlash, geometric_backlash


@pytest.mark.slow
@settings(max_examples=10)
@given(
    helix=st.floats(0.5, 4.0),
    crowning=st.floats(0.0, 20.0),
    distance=st.floats(124.8, 125.6),
    share=st.floats(-0.95, 0.95),
)
def test_there_and_back(helix, crowning, distance, share):
    """The position found has the backlash, and is no farther from s = 0 than the one asked with."""
    pair = make((helix, helix), (crowning, crowning / 2), (20.0, 16.0))
    asked = 18.0 * share
    wanted = float(geometric_backlash(pair, distance, asked))
    found = axial_for_backlash(pair, wanted, distance)
    assert float(geometric_backlash(pair, distance, found)) == pytest.approx(wanted, abs=1e-14)
    assert abs(found) <= abs(asked) + 18.0 / 128


def test_of_two_positions_the_nearer_one():
    """Spur gears, crowned: shifted either way the thickest sections part."""
    pair = make((0.0, 0.0), (20.0, 20.0))
    wanted = float(geometric_backlash(pair, None, 3.0))
    assert abs(axial_for_backlash(pair, wanted)) == pytest.approx(3.0, abs=1e-6)


IMPOSSIBLE = {
    "beyond the stroke": (
        {},
        (math.radians(1.0),),
        {"least_overlap_mm": 15.0},
        r"backlash: 1° cannot be reached; with 15 mm of common face or more \(s from -5 to 5 mm\)"
        r" it is -0\.\d+° to 0\.\d+°\.",
    ),
    "more face than there is": (
        {},
        (0.0,),
        {"least_overlap_mm": 21.0},
        "least_overlap_mm: 21 mm is not between 0 and the narrower face width",
    ),
    "spur gears": (
        {"helix": (0.0, 0.0), "widths": (math.nan, math.nan)},
        (1e-3,),
        {},
        "do not thin along the axis",
    ),
    "base circles that overlap": ({}, (0.0, 115.0), {}, "lies below a base circle"),
    "crowned the wrong way": (
        {"helix": (0.0, 0.0), "crowning": (20.0, 20.0)},
        (-0.01,),
        {},
        "cannot be reached",
    ),
}


def test_what_no_position_gives():
    for name in IMPOSSIBLE:
        gears, values, options, sentence = IMPOSSIBLE[name]
        with pytest.raises(PairError, match=sentence):
            axial_for_backlash(make(**gears), *values, **options)


def test_what_the_stroke_gives_is_what_its_ends_give():
    """The limits in the sentence can be had, a little more can not."""
    pair = make(**UNEQUAL)
    low, high = np.asarray(geometric_backlash(pair, None, np.array([5.0, -5.0])))
    assert axial_for_backlash(pair, float(low), least_overlap_mm=15.0) == pytest.approx(5.0)
    with pytest.raises(PairError, match=f"{math.degrees(low):.4f}° to {math.degrees(high):.4f}°"):
        axial_for_backlash(pair, float(low) - 1e-6, least_overlap_mm=15.0)

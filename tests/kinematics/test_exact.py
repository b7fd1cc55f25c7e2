"""The exact relation against brute-force contact of sampled involutes, and its derivatives."""

from typing import Any

import numpy as np
import pytest

from tests.geometry.pairs import pair_of
from tests.oracles import involute_contact as oracle
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.functions import exact_transmission_error, transmission_error
from vttig_jax.pair.gear_pair import Eccentricities
from vttig_jax.pair.schema import FLANKS

ANGLES = np.array([0.0, 1.0, 6.1, 33.3, 50.3, 77.7, 100.0, -7.0])
"""Over the hunting period of 100.5 rad, and before it."""


def make(
    teeth=(45, 80),
    pressure=(20.0, 20.0),
    helix=(3.0, 3.0),
    distance=125.12,
    e=(0.0226, 0.0273),
    backlash=0.038,
    axial=0.0,
):
    """The same rig for the package and for the oracle."""
    pair = pair_of(helix, teeth=teeth, distance=distance, pressure=pressure)
    rig = Eccentricities(e[0], 49.5, e[1], 79.3, backlash, axial)
    brute = oracle.Rig(
        teeth,
        2.0,
        tuple(np.radians(pressure)),
        distance,
        ((e[0], np.radians(49.5)), (e[1], np.radians(79.3))),
        np.radians(backlash),
        axial,
        tuple(np.tan(np.radians(helix))),
    )
    return pair, rig, brute


RIGS = {
    "paper": {},
    "no backlash": {"backlash": 0.0},
    "driving only": {"e": (0.0226, 0.0)},
    "driven only": {"e": (0.0, 0.0273)},
    "axial shift": {"axial": 0.35},
    "large": {"e": (0.2, 0.2), "axial": -0.5},
    "unequal flanks": {"e": (0.2, 0.15), "pressure": (20.0, 25.0), "helix": (3.0, 2.0)},
    "speeding up": {"teeth": (80, 45), "e": (0.2, 0.1), "axial": 0.2},
    "close": {"distance": 125.0, "e": (0.05, 0.1)},
}


@pytest.mark.parametrize("name", RIGS)
def test_exact_relation_is_contact_of_sampled_involutes(name):
    pair, rig, brute = make(**RIGS[name])
    for flank in FLANKS:
        touched = [oracle.transmission_error(brute, angle, flank) for angle in ANGLES]
        found = exact_transmission_error(ANGLES, pair, rig, flank)
        np.testing.assert_allclose(found, touched, rtol=0, atol=1e-11)


def test_the_oracle_tells_neighbouring_rigs_and_the_closed_form_apart():
    pair, rig, brute = make()
    touched = oracle.transmission_error(brute, ANGLES[1], "B")
    assert abs(float(transmission_error(ANGLES[1], pair, rig, "B")) - touched) > 1e-7
    found = float(exact_transmission_error(ANGLES[1], pair, rig, "B"))
    cases: list[dict[str, Any]] = [{"backlash": 0.04}, {"axial": 0.01}, {"e": (0.0226, 0.0274)}]
    for changed in cases:
        _, _, other = make(**changed)
        assert abs(found - oracle.transmission_error(other, ANGLES[1], "B")) > 1e-8


def test_backlash_and_shift_stand_inside_the_relation():
    """Adding them afterwards is off by up to 4e-7 rad (physics.md §3): they turn C₂."""
    angles = np.linspace(0.0, 32 * np.pi, 2001)
    pair, rig, _ = make(axial=0.35, e=(0.0226, 0.0273))
    _, bare, _ = make(backlash=0.0, e=(0.0226, 0.0273))
    offsets = exact_model(pair, rig).offset
    for side, flank in enumerate(FLANKS):
        after = exact_transmission_error(angles, pair, bare, flank) + offsets[side]
        apart = np.abs(exact_transmission_error(angles, pair, rig, flank) - after).max()
        assert 1e-8 < apart < 4e-7

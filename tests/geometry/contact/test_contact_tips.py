"""First touch of short teeth, where tip edges carry, against contact of sampled involutes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.geometry.pairs import FLANKS, pair_of
from tests.oracles import involute_contact as oracle
from vttig_jax.geometry.contact import Place, contact_model
from vttig_jax.geometry.contact_report import contact_at
from vttig_jax.pair.gear_pair import Eccentricities, Flank, GearPair, Rack

_CLOSE = 1e-10
PITCH = 2 * math.pi / 45
ANGLES = np.array([0.0, 0.11, 0.23, 0.36, 0.48, 0.61, 0.73, 0.88, 9.3, 313.4]) * PITCH
SHORT = oracle.Rig((45, 80), 2.0, (math.radians(20.0), math.radians(20.0)), 125.12, addendum=0.5)
CASES = {
    "short teeth": SHORT,
    "short and eccentric": replace(SHORT, offsets=((0.05, 1.0), (0.06, 2.0))),
    "few teeth": replace(
        SHORT,
        teeth=(17, 20),
        centre_distance=37.1,
        addendum=0.8,
        offsets=((0.01, 0.0), (0.02, 1.0)),
    ),
}


def gears(rig: oracle.Rig) -> GearPair:
    rack = Rack(addendum=rig.addendum)
    return pair_of((0.0, 0.0), teeth=rig.teeth, distance=rig.centre_distance, rack=rack)


def found(rig: oracle.Rig, flank: Flank) -> np.ndarray:
    (e1, phase1), (e2, phase2) = rig.offsets
    offsets = Eccentricities(e1, math.degrees(phase1), e2, math.degrees(phase2))
    return np.asarray(contact_model(gears(rig), offsets).transmission_error(ANGLES, flank))


@pytest.mark.parametrize("flank", FLANKS)
@pytest.mark.parametrize("name", CASES)
def test_sampled_involutes_touch_where_the_surfaces_do(name, flank):
    rig = CASES[name]
    drawn = replace(rig, constant_backlash=float(gears(rig).drawing_backlash))
    touched = [oracle.transmission_error(drawn, angle, flank) for angle in ANGLES]
    np.testing.assert_allclose(found(rig, flank), touched, rtol=0, atol=_CLOSE)
    (e, phase), driven = rig.offsets
    other = found(replace(rig, offsets=((e + 1e-5, phase), driven)), flank)
    assert np.abs(other - touched).max() > 20 * _CLOSE  # the comparison can fail


def test_short_teeth_touch_at_their_tips():
    """Contact ratio 0.87: between two pairs on the flanks, first the one, then the other tip."""
    pair = gears(CASES["short teeth"])
    assert 0.8 < float(pair.contact_ratios[0]) < 0.95
    angles = np.linspace(0.0, PITCH, 64)
    for flank in FLANKS:
        contacts = contact_at(contact_model(pair, sections=1), angles, flank, sections=1)
        places, error = contacts.place, contacts.transmission_error
        on_flank = places == Place.FLANK
        assert abs(on_flank.mean() - float(pair.contact_ratios[0])) < 0.02
        assert set(places) == {Place.FLANK, Place.DRIVING_TIP, Place.DRIVEN_TIP}
        rest = 0.0 if flank == "A" else float(pair.drawing_backlash)
        behind = (error - rest) * (1 if flank == "A" else -1)
        assert np.abs(behind[on_flank]).max() < 1e-14
        assert behind[~on_flank].max() < -1e-8 and behind.min() < -2e-6
        edge = contacts.radius_mm[places == Place.DRIVING_TIP, 0]
        np.testing.assert_allclose(edge, pair.tip_radii[0], rtol=1e-14)
        edge = contacts.radius_mm[places == Place.DRIVEN_TIP, 1]
        np.testing.assert_allclose(edge, pair.tip_radii[1], rtol=1e-12)
        inside = contacts.radius_mm[on_flank]
        assert (inside < np.asarray(pair.tip_radii) * (1 + 1e-12)).all()

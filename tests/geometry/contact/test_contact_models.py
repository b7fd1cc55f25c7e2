"""Contact as any other flank model: maps, TE curves, tables for the simulator, fits."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from tests.geometry.contact.test_contact_exact import SOME, TABLE_2
from tests.geometry.pairs import FLANKS
from vttig_jax.geometry.contact import contact_model
from vttig_jax.geometry.mounting import Misalignment
from vttig_jax.kinematics.backlash_map import BacklashMap
from vttig_jax.kinematics.exact import exact_model
from vttig_jax.kinematics.flank_model import FlankModel
from vttig_jax.kinematics.flank_table import tabulate_flanks
from vttig_jax.pair.gear_pair import Eccentricities


@pytest.fixture(scope="module")
def rig(paper_pair):
    return Eccentricities(*TABLE_2, math.degrees(float(paper_pair.drawing_backlash)))


@pytest.mark.slow
def test_the_backlash_map_of_the_surfaces_is_the_exact_one(paper_pair, rig):
    contact = contact_model(paper_pair, rig)
    assert isinstance(contact, FlankModel)
    found = BacklashMap(contact, None, paper_pair)
    exact = BacklashMap(exact_model(paper_pair, rig), None, paper_pair)
    np.testing.assert_allclose(found.at(SOME), exact.at(SOME), rtol=0, atol=1e-14)
    for one, other in ((found.smallest, exact.smallest), (found.largest, exact.largest)):
        assert one.backlash == pytest.approx(other.backlash, abs=1e-13)
        assert one.tooth_pair == other.tooth_pair
    assert found.safe_closing_mm == pytest.approx(exact.safe_closing_mm, abs=1e-9)


@pytest.mark.slow
def test_the_tooth_mesh_is_in_the_table(paper_pair):
    """A tilted axis: the transmission error has the period of the teeth."""
    model = contact_model(paper_pair, misalignment=Misalignment(0.0, 3e-4), sections=3)
    assert model.highest_order == 45.0
    table = tabulate_flanks(model, 1, per_turn=45 * 16)
    strength = np.abs(np.fft.rfft(table.nodes[:-1, 0]))[1:]
    assert sorted(1 + np.argsort(-strength)[:3]) == [45, 90, 135]
    angles = np.linspace(0.0, 0.3, 33)
    found = np.asarray(table.at(jnp.asarray(angles)).lower)
    error = np.asarray(model.transmission_error(angles, "A"))
    # At its corners one pair of teeth takes over from another.
    assert np.median(np.abs(found - error)) < 0.01 * np.ptp(error)


def test_the_period_of_contact_is_that_of_the_hunting_tooth(paper_pair, rig):
    model = contact_model(paper_pair, rig)
    assert model.highest_order == 1.0
    period = paper_pair.hunting_turns * 2 * math.pi
    for flank in FLANKS:
        np.testing.assert_allclose(
            model.transmission_error(SOME, flank),
            model.transmission_error(SOME + period, flank),
            rtol=0,
            atol=1e-14,
        )

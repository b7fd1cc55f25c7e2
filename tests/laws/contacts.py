"""Rows for the contact of two tooth surfaces and for the backlash of their thickness."""

from collections.abc import Iterator
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from tests.laws.law import Law
from vttig_jax.geometry.backlash import geometric_backlash, section_backlash
from vttig_jax.geometry.contact import contact_model
from vttig_jax.pair.gear_pair import Eccentricities, Gear, GearPair


class Axes(NamedTuple):
    """Where the gears are, beside the first argument; lengths by their names."""

    centre_distance_mm: np.ndarray
    axial_mm: np.ndarray = np.array(0.0)


ANGLES = np.array([0.3, -2.0, 4.17])
SHIFTS = np.array([-2.1, 0.3, 4.0])
HEIGHTS = np.array([-7.0, 1.5, 6.0])
AXES = Axes(np.array(125.3), np.array(0.4))
UNLIKE = GearPair(
    Gear(45, 3.0, 1.5, 20.0),
    Gear(80, 2.0, -1.0, 18.0, profile_shift=0.05),
    module_mm=2.0,
    pressure_angles_deg=(20.0, 22.0),
    centre_distance_mm=125.3,
)
"""Flank A touches at one end of the common face and flank B at the other."""

SPUR = GearPair(
    Gear(45, face_width_mm=20.0),
    Gear(80, face_width_mm=20.0),
    module_mm=2.0,
    pressure_angles_deg=20.0,
)
RIG = Eccentricities(0.0226, 49.5, 0.0273, 79.3, 0.038, 0.2)
KINKS = {
    "e = 0": (ANGLES, UNLIKE, Eccentricities()),
    "everything zero": (np.zeros(3), SPUR, Eccentricities()),
}


def _sections(z, axes, pair):
    return section_backlash(pair, z, axes.centre_distance_mm, axes.axial_mm)


def _backlash(axial, axes, pair):
    return geometric_backlash(pair, axes.centre_distance_mm, axial)


def _model(pair, rig):
    """Few points and one section: it is searched the same way."""
    return contact_model(pair, rig, sections=1, tooth_pairs=2, points=3)


@eqx.filter_jit
def _error(angle, pair, rig):
    return _model(pair, rig).transmission_error(angle, "B")


@eqx.filter_jit
def _held(angle, pair, rig):
    angle = jnp.asarray(angle, float)
    return _model(pair, rig).at_both_angles(angle, 0.5 * angle, "B")


def _of_thickness() -> Iterator[Law]:
    for covers, function, first in (
        ("section_backlash", _sections, HEIGHTS),
        ("geometric_backlash", _backlash, SHIFTS),
    ):
        ties = {"where sections tie": (np.zeros(3), AXES, SPUR)}
        slow = covers == "geometric_backlash"
        yield Law(
            covers, function, (first, AXES, UNLIKE), "rad", ties, first_is_length=True, slow=slow
        )


THICKNESSES = tuple(_of_thickness())
CONTACTS = (
    Law("ContactModel.transmission_error", _error, (ANGLES, UNLIKE, RIG), "rad", KINKS, slow=True),
    Law("ContactModel.at_both_angles", _held, (ANGLES, UNLIKE, RIG), "rad", KINKS, slow=True),
)

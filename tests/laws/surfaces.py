"""Rows for the public functions of the tooth surface."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from tests.laws.law import Law
from vttig_jax.base.arrays import compiled
from vttig_jax.geometry.surface import (
    Part,
    fillet_span,
    flank_roll,
    flank_span,
    tooth_surface,
)
from vttig_jax.geometry.tooth import SIDES, Side, Taper, Tooth


class Roll(NamedTuple):
    """A roll angle beside the first argument."""

    rad: np.ndarray


class Height(NamedTuple):
    """A height beside the first argument; a length by its name."""

    z_mm: np.ndarray


ROLLS = np.array([-0.13, -0.05, 0.07])
HEIGHTS = np.array([-8.0, 1.5, 9.0])
AT = Height(np.array(3.7))
TOOTH = Tooth(
    teeth=45,
    module_mm=2.0,
    pressure_angles_deg=np.array([20.0, 22.0]),
    recession=(Taper(0.05, 0.02, 20.0), Taper(0.03, 0.01, 20.0)),
    addendum_mm=2.0,
    dedendum_mm=2.5,
    fillet_radius_mm=0.6,
    profile_shift_mm=0.3,
    face_width_mm=20.0,
)
SOMEWHERE = np.array([0.7, 0.5, 0.3])
"""A direction that mixes the components of a vector."""

MIXED = np.array([0.8, 0.6])
"""The same for pairs of numbers."""

LEVEL = replace(TOOTH, recession=(Taper(0.0, 0.0, 20.0),) * 2)
JOINT = np.full(3, flank_span(TOOTH, "left")[0])
ON_THE_JOINT = {
    "joint": (JOINT, AT, TOOTH),
    "joint, no recession": (JOINT, AT, LEVEL),
    "middle of the face": (JOINT, Height(np.array(0.0)), TOOTH),
}


def _point(roll, height, tooth, side: Side = "left", part: Part = "flank"):
    return tooth_surface(tooth, roll, height.z_mm, side=side, part=part) @ SOMEWHERE


def _point_at_height(z, roll, tooth, side: Side = "left", part: Part = "flank"):
    return tooth_surface(tooth, roll.rad, z, side=side, part=part) @ SOMEWHERE


@compiled
def _roll_of_radius(radius, tooth):
    return flank_roll(tooth, radius, "left")


@compiled
def _flank_limits(addendum, tooth):
    def limits(length):
        return flank_span(replace(tooth, addendum_mm=length), "right") @ MIXED

    return jnp.vectorize(limits)(jnp.asarray(addendum, float))


@compiled
def _fillet_limits(radius, tooth):
    def limits(length):
        return fillet_span(replace(tooth, fillet_radius_mm=length), "right") @ MIXED

    return jnp.vectorize(limits)(jnp.asarray(radius, float))


def _of_surface(
    covers: str, function: Callable[..., Any], unit: str, part: Part = "flank"
) -> Iterator[Law]:
    for side in SIDES:
        rolls = ROLLS if side == "left" else -ROLLS
        law = partial(function, side=side, part=part)
        kinks = ON_THE_JOINT if side == "left" else {}
        yield Law(covers, law, (rolls, AT, TOOTH), unit, kinks, f"{side} {part}")


def _of_length(
    covers: str,
    function: Callable[..., Any],
    first: np.ndarray,
    unit: str,
    *others: Any,
    slow: bool = False,
):
    arguments = (first, *others, TOOTH)
    return Law(covers, function, arguments, unit, {}, first_is_length=True, slow=slow)


SURFACES = (
    *_of_surface("tooth_surface", _point, "mm"),
    *_of_surface("tooth_surface", _point, "mm", "fillet"),
    _of_length("tooth_surface", _point_at_height, HEIGHTS, "mm", Roll(np.array(0.02))),
    _of_length("flank_roll", _roll_of_radius, np.array([43.8, 45.1, 46.9]), "rad"),
    _of_length("flank_span", _flank_limits, np.array([1.8, 2.0, 2.1]), "rad"),
    _of_length("fillet_span", _fillet_limits, np.array([0.1, 0.4, 0.6]), "rad"),
)

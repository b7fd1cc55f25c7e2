"""Teeth to try the surface on, and what the oracles need to know of them."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import strategies as st

from tests.oracles.rack_envelope import Cutter
from vttig_jax.geometry.surface import tooth_surface
from vttig_jax.geometry.tooth import SIDES, Side, Taper, Tooth


def wave(z):
    """A modification that is no polynomial."""
    return 0.05 * jnp.sin(0.3 * z) + 0.01 * z


def tooth(teeth: int = 45, **changes: Any) -> Tooth:
    """The driving gear of the paper, with unequal flanks."""
    values: dict[str, Any] = {
        "module_mm": 2.0,
        "pressure_angles_deg": np.array([20.0, 22.0]),
        "recession": (Taper(math.tan(math.radians(3.0))), Taper(math.tan(math.radians(2.0)))),
        "addendum_mm": 2.0,
        "dedendum_mm": 2.5,
        "fillet_radius_mm": 0.6,
        "face_width_mm": 20.0,
    }
    return Tooth(teeth=teeth, **(values | changes))


def crowned(slope: float, crowning_mm: float) -> Taper:
    return Taper(slope, crowning_mm, 20.0)


@st.composite
def any_tooth(draw: st.DrawFn) -> Tooth:
    """Gears of 8 to 120 teeth of 1 mm to 5 mm with unequal flanks, shifted, tapered and crowned."""
    module = draw(st.floats(1.0, 5.0))
    angles = np.array([draw(st.floats(14.5, 30.0)) for _ in SIDES])
    clearance = 0.25 * module
    largest = clearance / (1 - math.sin(math.radians(angles.min())))
    slopes = [math.tan(math.radians(draw(st.floats(-5.0, 5.0)))) for _ in SIDES]
    return Tooth(
        teeth=draw(st.integers(8, 120)),
        module_mm=module,
        pressure_angles_deg=angles,
        recession=(crowned(slopes[0], draw(st.floats(0.0, 0.05))), crowned(slopes[1], 0.02)),
        addendum_mm=module,
        dedendum_mm=module + clearance,
        fillet_radius_mm=largest * draw(st.floats(0.0, 1.0)),
        profile_shift_mm=module * draw(st.floats(-0.5, 0.8)),
        face_width_mm=20.0,
    )


def tangents(gear: Tooth, roll: Any, z: Any, side: Side, part: Any) -> np.ndarray:
    """Unit tangents x, y of sections of the surface, in the sense of the roll angle."""
    roll, z = jnp.broadcast_arrays(jnp.asarray(roll, float), jnp.asarray(z, float))
    section = lambda roll: tooth_surface(gear, roll, z, side=side, part=part)  # noqa: E731
    along = np.asarray(jax.jvp(section, (roll,), (jnp.ones_like(roll),))[1])[..., :2]
    return along / np.linalg.norm(along, axis=-1, keepdims=True)


def cutter(gear: Tooth, side: Side, z: float) -> Cutter:
    """The half of the cutter beside one flank, as the brute force takes it (mirrored if right)."""
    index = SIDES.index(side)
    recession = np.asarray(gear.recession[index](np.array([z]))).item()
    return Cutter(
        pitch_radius=gear.teeth * float(gear.module_mm) / 2,
        pressure_angle=math.radians(float(gear.pressure_angles_deg[index])),
        flank_offset=recession - math.pi * float(gear.module_mm) / 4,
        shift=float(gear.profile_shift_mm),
        dedendum=float(gear.dedendum_mm),
        tip_radius=float(gear.fillet_radius_mm),
    )


def clearances(gear: Tooth, side: Side, part: Any, rolls: np.ndarray, z: float) -> np.ndarray:
    """How far the cutter stays away from points of the surface, mm."""
    points = np.asarray(tooth_surface(gear, rolls, z, side=side, part=part))
    mirror = 1.0 if side == "left" else -1.0
    beside = cutter(gear, side, z)
    return np.array([beside.clearance(mirror * x, y) for x, y, _ in points])


def between(span: Any, count: int) -> np.ndarray:
    """Evenly from one limit to the other."""
    low, high = np.asarray(span)
    return np.linspace(low, high, count)

"""The surface of a tooth as pure functions of roll angle and height: points and normals.

Needs 64-bit floats for more than six digits; see `enable_x64`.
"""

from typing import Literal

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ...base.arrays import compiled
from .rack_cutter import Side, contact, rack_side, to_gear, turn_to_gear
from .tooth import Tooth

Part = Literal["root", "fillet", "flank", "tip"]

PARTS: tuple[Part, ...] = ("root", "fillet", "flank", "tip")
"""From the root to the tip."""


@compiled
def tooth_surface(
    tooth: Tooth,
    roll_angle: Real[ArrayLike, "..."],
    z: Real[ArrayLike, "..."],
    *,
    side: Side = "left",
    part: Part = "flank",
) -> Float[Array, "... 3"]:
    """Points of a tooth as the rack generates them, (1), (2), (10)–(15).

        x₂ = x₁ cos φ + y₁ sin φ + r₂ (sin φ − φ cos φ)
        y₂ = −x₁ sin φ + y₁ cos φ + r₂ (cos φ + φ sin φ),    φ = roll ± δ(z)/r₂ (left, right)

    where (x₁, y₁) is the point of the straight flank, of the arc at the tip of the cutter, or of
    its tip or root line whose normal passes through the pitch point at the roll angle φ.

    The roll angle is that of the gear, counted from the position of the rack which has receded with
    the flank at height z: the same roll angle is the same radius in every section, and the limits
    of `flank_span` and `fillet_span` hold for all of them. The φ of the paper is the one above.
    Nothing is clipped: beyond its limits a part goes on as the curve it is, and `section_report`
    says where parts cut each other.

    **Arguments**
    - `tooth`: the gear; `tooth_of` takes it from a pair.
    - `roll_angle`: rad, any shape; see `flank_span`, `fillet_span`, `root_span` and `tip_span`.
    - `z`: height along the axis from the middle of the face, mm, broadcast against `roll_angle`.
    - `side`: "left" or "right" flank; the lands belong to the flank from which they start.
    - `part`: "flank", "fillet", "root" (land) or "tip" (land).

    **Returns** x, y, z in mm in the frame of the tooth (axis z, tooth up along y), shape (..., 3).

    **Raises** `ValueError` for a side or part that is none.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import flank_span
    >>> from vttig_jax.geometry import tooth_surface
    >>> from vttig_jax.geometry import tooth_of
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> tooth = tooth_of(pair, "driving")
    >>> roll = np.linspace(*flank_span(tooth, "left"), 3)
    >>> points = tooth_surface(tooth, roll[:, None], np.array([-10.0, 0.0, 10.0]), side="left")
    >>> points.shape
    (3, 3, 3)
    >>> points[:, 1].round(4)
    Array([[-1.9974, 43.3036,  0.    ],
           [-1.6101, 44.8487,  0.    ],
           [-0.7688, 46.9937,  0.    ]], dtype=float64)

    ```
    """
    rack = rack_side(tooth, side)
    point, _, phi = contact(rack, *_prepared(part, roll_angle, z))
    return jnp.asarray(to_gear(rack, point, phi))


@compiled
def surface_normal(
    tooth: Tooth,
    roll_angle: Real[ArrayLike, "..."],
    z: Real[ArrayLike, "..."],
    *,
    side: Side = "left",
    part: Part = "flank",
) -> Float[Array, "... 3"]:
    """Unit normals out of the tooth, (4) turned by (13) with dδ/dz where (4) has tan β.

    Arguments as `tooth_surface`. It is the rack's normal at the contact, so it is defined also
    where the surface is not regular.

    **Returns** unit vectors in the frame of the tooth, shape (..., 3).

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import flank_roll
    >>> from vttig_jax.geometry import surface_normal
    >>> from vttig_jax.geometry import tooth_of
    >>> vttig_jax.enable_x64()
    >>> gears = Gear(45, 3, 3, 20), Gear(80, 3, 3, 20)
    >>> pair = GearPair(*gears, module_mm=2.0, pressure_angles_deg=20.0)
    >>> tooth = tooth_of(pair, "driving")
    >>> surface_normal(tooth, flank_roll(tooth, np.array(45.0), "left"), 0.0).round(4)
    Array([-0.9499,  0.3086,  0.0492], dtype=float64)

    ```
    """
    rack = rack_side(tooth, side)
    part, roll, height = _prepared(part, roll_angle, z)
    _, steep, phi = contact(rack, part, roll, height)
    inward = rack.normal(steep, height)
    length = jnp.sqrt(jnp.sum(inward**2, axis=-1, keepdims=True))
    return turn_to_gear(-inward / length, phi)


def _prepared(
    part: Part, roll_angle: Real[ArrayLike, "..."], z: Real[ArrayLike, "..."]
) -> tuple[Part, Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Roll angle and height as floats of one shape."""
    if part not in PARTS:
        raise ValueError(
            f'Argument `part` must be "root", "fillet", "flank" or "tip", but is {part!r}.'
        )
    roll, height = jnp.broadcast_arrays(jnp.asarray(roll_angle, float), jnp.asarray(z, float))
    return part, roll, height

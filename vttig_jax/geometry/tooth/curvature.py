"""Fundamental forms and principal curvatures of the tooth surface by automatic differentiation."""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ...base.arrays import compiled
from .rack_cutter import Side
from .surface import Part, surface_normal, tooth_surface
from .tooth import Tooth

Points = Float[Array, "*shape 3"]


class Curvatures(eqx.Module):
    """Curvatures of a surface, positive where it is convex: where its centre is in the material.

    **Arguments**
    - `first`: first fundamental form in the parameters (roll angle in rad, z in mm).
    - `second`: second fundamental form in the same.
    - `principal`: principal curvatures, the larger first, 1/mm.
    """

    first: Float[Array, "*shape 2 2"]
    second: Float[Array, "*shape 2 2"]
    principal: Float[Array, "*shape 2"]

    @property
    def mean(self) -> Float[Array, "*shape"]:
        """Half the sum of the principal curvatures, 1/mm."""
        return self.principal.sum(axis=-1) / 2

    @property
    def gaussian(self) -> Float[Array, "*shape"]:
        """Product of the principal curvatures, 1/mm²; zero on a flank of linear taper."""
        return self.principal.prod(axis=-1)


@compiled
def surface_curvatures(
    tooth: Tooth,
    roll_angle: Real[ArrayLike, "..."],
    z: Real[ArrayLike, "..."],
    *,
    side: Side = "left",
    part: Part = "flank",
) -> Curvatures:
    """Curvatures of a tooth surface X(roll, z) with the normal n out of the tooth.

        I = [Xᵢ · Xⱼ],    II = −[n · Xᵢⱼ],    (II − κ I) v = 0

    Arguments as `tooth_surface`. The recession has to be twice differentiable. Infinite or NaN
    where the surface is not regular: on the base circle, and at the cusp of an undercut flank.

    **Returns** `Curvatures`, each array with the shape of `roll_angle` and `z` in front.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import surface_curvatures
    >>> from vttig_jax.geometry import flank_roll
    >>> from vttig_jax.geometry import tooth_of
    >>> vttig_jax.enable_x64()
    >>> spur = GearPair(
    ...     Gear(45, face_width_mm=20), Gear(80, face_width_mm=20),
    ...     module_mm=2.0, pressure_angles_deg=20.0,
    ... )
    >>> tooth = tooth_of(spur, "driving")
    >>> found = surface_curvatures(tooth, flank_roll(tooth, np.array(45.0), "left"), 0.0)
    >>> (1 / found.principal[0]).round(4).item(), round(45 * np.sin(np.radians(20)), 4).item()
    (15.3909, 15.3909)

    ```
    """
    roll, height = jnp.broadcast_arrays(jnp.asarray(roll_angle, float), jnp.asarray(z, float))
    tangents = partial(_tangents, partial(_surface, tooth, side=side, part=part))
    (along_roll, along_z), bend = jax.linearize(tangents, roll, height)
    (twice_roll, mixed), (_, twice_z) = (bend(*way) for way in _directions(roll))
    outward = surface_normal(tooth, roll, height, side=side, part=part)
    second = _symmetric(*(-_dot(outward, bent) for bent in (twice_roll, mixed, twice_z)))
    first = _symmetric(
        _dot(along_roll, along_roll), _dot(along_roll, along_z), _dot(along_z, along_z)
    )
    return Curvatures(first, second, _principal(first, second))


def _surface(tooth: Tooth, roll: Array, z: Array, *, side: Side, part: Part) -> Points:
    return tooth_surface(tooth, roll, z, side=side, part=part)


def _tangents(surface: Callable[..., Points], roll: Array, z: Array) -> tuple[Points, Points]:
    """Derivatives by roll angle and by z, element by element."""
    _, push = jax.linearize(surface, roll, z)
    along_roll, along_z = (push(*way) for way in _directions(roll))
    return along_roll, along_z


def _directions(roll: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    one, zero = jnp.ones_like(roll), jnp.zeros_like(roll)
    return (one, zero), (zero, one)


def _dot(one: Points, two: Points) -> Float[Array, "*shape"]:
    return jnp.sum(one * two, axis=-1)


def _symmetric(a: Array, b: Array, c: Array) -> Array:
    return jnp.stack([jnp.stack([a, b], axis=-1), jnp.stack([b, c], axis=-1)], axis=-2)


def _principal(first: Array, second: Array) -> Float[Array, "*shape 2"]:
    """Eigenvalues of II in an orthonormal frame of I, whose first axis is along the roll.

    Written out, so that the derivative is finite also where both are equal.
    """
    e, f, g = first[..., 0, 0], first[..., 0, 1], first[..., 1, 1]
    p, q, r = second[..., 0, 0], second[..., 0, 1], second[..., 1, 1]
    skew = f / e
    across = g - f * skew
    a = p / e
    b = (q - skew * p) / jnp.sqrt(e * across)
    c = (r - 2 * skew * q + skew**2 * p) / across
    square = ((a - c) / 2) ** 2 + b**2
    round_ = square == 0
    spread = jnp.where(round_, 0.0, jnp.sqrt(jnp.where(round_, 1.0, square)))
    return jnp.stack([(a + c) / 2 + spread, (a + c) / 2 - spread], axis=-1)

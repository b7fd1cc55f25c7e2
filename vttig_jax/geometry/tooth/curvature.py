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
    """Curvatures of a surface, positive where it is convex (centre of curvature in the material).

    **Arguments**
    - `first`: first fundamental form in the parameters (roll angle in rad, z in mm).
    - `second`: second fundamental form in the same parameters.
    - `principal`: principal curvatures in 1/mm, the larger one first.
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
    """Return the curvatures of a tooth surface X(roll, z); the normal n points out of the tooth.

        I = [Xᵢ · Xⱼ],    II = −[n · Xᵢⱼ],    (II − κ I) v = 0

    Arguments are those of `tooth_surface`. The recession must be twice differentiable. The result
    is infinite or NaN where the surface is singular: on the base circle and at an undercut cusp.

    **Returns** `Curvatures`; its arrays have the broadcast shape of `roll_angle` and `z` in front.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> from vttig_jax.geometry import flank_roll, surface_curvatures, tooth_of
    >>> vttig_jax.enable_x64()
    >>> spur = GearPair(
    ...     Gear(45, face_width_mm=20), Gear(80, face_width_mm=20),
    ...     module_mm=2.0, pressure_angles_deg=20.0,
    ... )
    >>> tooth = tooth_of(spur, "driving")
    >>> result = surface_curvatures(tooth, flank_roll(tooth, np.array(45.0), "left"), 0.0)
    >>> (1 / result.principal[0]).round(4).item(), round(45 * np.sin(np.radians(20)), 4).item()
    (15.3909, 15.3909)

    ```
    """
    roll, height = jnp.broadcast_arrays(jnp.asarray(roll_angle, float), jnp.asarray(z, float))
    tangents = partial(_tangents, partial(_surface, tooth, side=side, part=part))
    (along_roll, along_z), derivative = jax.linearize(tangents, roll, height)
    (by_roll_roll, by_roll_z), (_, by_z_z) = (derivative(*axis) for axis in _directions(roll))
    normal = surface_normal(tooth, roll, height, side=side, part=part)
    second = _symmetric(*(-_dot(normal, vector) for vector in (by_roll_roll, by_roll_z, by_z_z)))
    first = _symmetric(
        _dot(along_roll, along_roll), _dot(along_roll, along_z), _dot(along_z, along_z)
    )
    return Curvatures(first, second, _principal(first, second))


def _surface(tooth: Tooth, roll: Array, z: Array, *, side: Side, part: Part) -> Points:
    return tooth_surface(tooth, roll, z, side=side, part=part)


def _tangents(surface: Callable[..., Points], roll: Array, z: Array) -> tuple[Points, Points]:
    """Return the derivatives with respect to roll angle and z, element by element."""
    _, push = jax.linearize(surface, roll, z)
    along_roll, along_z = (push(*axis) for axis in _directions(roll))
    return along_roll, along_z


def _directions(roll: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    ones, zeros = jnp.ones_like(roll), jnp.zeros_like(roll)
    return (ones, zeros), (zeros, ones)


def _dot(first: Points, second: Points) -> Float[Array, "*shape"]:
    return jnp.sum(first * second, axis=-1)


def _symmetric(a: Array, b: Array, c: Array) -> Array:
    return jnp.stack([jnp.stack([a, b], axis=-1), jnp.stack([b, c], axis=-1)], axis=-2)


def _principal(first: Array, second: Array) -> Float[Array, "*shape 2"]:
    """Return the eigenvalues of II in an orthonormal frame of I; its first axis is along the roll.

    The formula is explicit so that its derivative is finite also where both values are equal.
    """
    e, f, g = first[..., 0, 0], first[..., 0, 1], first[..., 1, 1]
    p, q, r = second[..., 0, 0], second[..., 0, 1], second[..., 1, 1]
    skew = f / e
    across = g - f * skew
    a = p / e
    b = (q - skew * p) / jnp.sqrt(e * across)
    c = (r - 2 * skew * q + skew**2 * p) / across
    square = ((a - c) / 2) ** 2 + b**2
    equal = square == 0
    spread = jnp.where(equal, 0.0, jnp.sqrt(jnp.where(equal, 1.0, square)))
    return jnp.stack([(a + c) / 2 + spread, (a + c) / 2 - spread], axis=-1)

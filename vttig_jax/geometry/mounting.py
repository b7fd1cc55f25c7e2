"""Two gears on their shafts: where axes and body centres stand, which parts of the faces overlap.

The fixed frame has the driving axis as z, with +z that of the driving gear's own frame, and x from
the driving to the driven axis. The driven gear is mounted the other way round: the height in its
own frame is −(z + s) where the axes are parallel, s its axial displacement.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from ..base.arrays import Number, Numbers, float64
from ..base.numerics.sincos import sincos
from .tooth.tooth import Tooth

Scalar = Float[Number, ""]
Values = Float[Array, "..."]
"""Numbers of any shape."""

Plane = tuple[Values, Values]
"""x and y."""


class Misalignment(eqx.Module):
    """Slopes of the driven axis against the driving one, about the middle of the driven face.

    Its direction is (tan ι, tan η, 1) in the fixed frame.

    **Arguments**
    - `inclination_rad`: ι in the plane of the axes, positive where the axes part towards +z.
    - `deviation_rad`: η out of that plane, positive where the driven axis leans towards +y.
    """

    inclination_rad: Scalar = eqx.field(converter=float64, default=0.0)
    deviation_rad: Scalar = eqx.field(converter=float64, default=0.0)

    @property
    def axis(self) -> tuple[Array, Array, Array]:
        """Unit vector along the driven axis."""
        along, across = jnp.tan(self.inclination_rad), jnp.tan(self.deviation_rad)
        length = jnp.sqrt(1 + along**2 + across**2)
        return along / length, across / length, 1 / length


class Mounting(eqx.Module):
    """Where the axes and the centres of the base circles are; lengths in mm.

    **Arguments**
    - `centre_distance`: of the axes, at the middle of the driven face if they are not parallel.
    - `axial`: s, by which the driven gear is shifted towards −z.
    - `driving_offset`, `driven_offset`: e·exp(jθ) of each gear.
    - `half_widths`: b/2 of the driving and the driven gear, NaN where unknown.
    - `misalignment`: None for parallel axes.
    """

    centre_distance: Scalar
    axial: Scalar
    driving_offset: Complex[Array, ""]
    driven_offset: Complex[Array, ""]
    half_widths: Float[Numbers, "2"]
    misalignment: Misalignment | None = None

    def driving_centre(self, driving_angle: Values) -> Plane:
        """Centre of the driving base circle, from the driving axis."""
        return _turned(self.driving_offset, driving_angle)

    def driven_centre(self, driven_angle: Values) -> Plane:
        """Centre of the driven base circle, from the driven axis; that gear turns clockwise."""
        along, across = _turned(self.driven_offset, driven_angle)
        return along, -across

    def seen_from_driven(self, point: Plane, z: Values) -> tuple[Values, Values, Values]:
        """A point of the fixed frame as x and y about the driven axis, and the gear's own height.

        The frame of a tilted axis is the fixed one turned about the normal of both axes.
        """
        x, y, lifted = point[0] - self.centre_distance, point[1], z + self.axial
        if self.misalignment is None:
            return x, y, -lifted
        along, across, up = self.misalignment.axis
        leaning = along * x + across * y
        share = leaning / (1 + up) + lifted
        return x - along * share, y - across * share, -(leaning + up * lifted)

    def face(self, point: Plane | None = None) -> tuple[Values, Values]:
        """Lowest and highest z at which both gears have face, about a point if it is given.

        Both 0 where neither width is known. The lowest is above the highest where nothing overlaps.
        """
        driving, driven = jnp.where(jnp.isnan(self.half_widths), jnp.inf, self.half_widths)
        leaning, up = jnp.zeros(()), jnp.ones(())
        if point is not None and self.misalignment is not None:
            along, across, up = self.misalignment.axis
            leaning = along * (point[0] - self.centre_distance) + across * point[1]
        low = jnp.maximum(-driving, -(driven + leaning) / up - self.axial)
        high = jnp.minimum(driving, (driven - leaning) / up - self.axial)
        return jnp.where(jnp.isinf(low), 0.0, low), jnp.where(jnp.isinf(high), 0.0, high)


def _turned(offset: Complex[Array, ""], angle: Values) -> Plane:
    """Real and imaginary part of offset · exp(j angle)."""
    sine, cosine = sincos(angle)
    real, imaginary = jnp.real(offset), jnp.imag(offset)
    return real * cosine - imaginary * sine, real * sine + imaginary * cosine


def common_face(gears: tuple[Tooth, Tooth], axial: Values) -> tuple[Values, Values]:
    """Lowest and highest z at which both gears have face, axes parallel; see `Mounting.face`."""
    centre = jnp.zeros((), complex)
    half = jnp.stack([jnp.asarray(gear.face_width_mm) / 2 for gear in gears])

    def face(shift: Scalar) -> tuple[Values, Values]:
        return Mounting(jnp.zeros(()), shift, centre, centre, half).face()

    return jnp.vectorize(face)(axial)

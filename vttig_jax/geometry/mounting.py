"""Position of two gears on their shafts: axes, base circle centres and overlap of the faces.

In the fixed frame z is the driving axis, with the sense of the driving gear's z, and x points from
the driving to the driven axis. The driven gear is mounted in the opposite sense: for parallel axes
the height in its frame is −(z + s), where s is its axial displacement.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from ..base.arrays import Numbers, float64
from ..kinematics.exact import turned_offset
from .tooth import Scalar

Values = Float[Array, "..."]
"""Numbers of any shape."""

Plane = tuple[Values, Values]
"""Coordinates x and y, mm."""


class Misalignment(eqx.Module):
    """Tilt of the driven axis relative to the driving one, about the middle of the driven face.

    The driven axis has the direction (tan ι, tan η, 1) in the fixed frame.

    **Arguments**
    - `inclination_rad`: ι in the plane of the axes, positive if the axes diverge towards +z.
    - `deviation_rad`: η out of that plane, positive if the driven axis leans towards +y.
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
    """Position of the axes and of the base circle centres; lengths in mm.

    **Arguments**
    - `centre_distance`: distance of the axes, at the middle of the driven face if not parallel.
    - `axial`: shift s of the driven gear towards −z.
    - `driving_offset`, `driven_offset`: eccentricity e·exp(jθ) of each gear.
    - `half_widths`: b/2 of the driving and the driven gear, NaN where unknown.
    - `misalignment`: tilt of the driven axis, or None for parallel axes.
    """

    centre_distance: Scalar
    axial: Scalar
    driving_offset: Complex[Array, ""]
    driven_offset: Complex[Array, ""]
    half_widths: Float[Numbers, "2"]
    misalignment: Misalignment | None = None

    def driving_centre(self, driving_angle: Values) -> Plane:
        """Return the centre of the driving base circle relative to the driving axis, mm."""
        return turned_offset(self.driving_offset, driving_angle)

    def driven_centre(self, driven_angle: Values) -> Plane:
        """Return the driven base circle centre relative to its axis, mm; φ₂ > 0 is clockwise."""
        along, across = turned_offset(self.driven_offset, driven_angle)
        return along, -across

    def in_driven_frame(self, point: Plane, z: Values) -> tuple[Values, Values, Values]:
        """Return x and y of a point about the driven axis and its height in that gear's frame, mm.

        The frame of a tilted axis is the fixed frame rotated about the common normal of both axes.
        """
        x, y, height = point[0] - self.centre_distance, point[1], z + self.axial
        if self.misalignment is None:
            return x, y, -height
        along, across, up = self.misalignment.axis
        tilt = along * x + across * y
        factor = tilt / (1 + up) + height
        return x - along * factor, y - across * factor, -(tilt + up * height)

    def face(self, point: Plane | None = None) -> tuple[Values, Values]:
        """Return the lowest and highest z of the common face, mm.

        For a tilted driven axis they depend on x and y and hold at `point`, if it is given. Both
        are 0 if neither width is known. If the faces do not overlap, lowest > highest.
        """
        driving, driven = jnp.where(jnp.isnan(self.half_widths), jnp.inf, self.half_widths)
        tilt, up = jnp.zeros(()), jnp.ones(())
        if point is not None and self.misalignment is not None:
            along, across, up = self.misalignment.axis
            tilt = along * (point[0] - self.centre_distance) + across * point[1]
        low = jnp.maximum(-driving, -(driven + tilt) / up - self.axial)
        high = jnp.minimum(driving, (driven - tilt) / up - self.axial)
        return jnp.where(jnp.isinf(low), 0.0, low), jnp.where(jnp.isinf(high), 0.0, high)

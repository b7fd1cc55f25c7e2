"""Exact relation of two eccentric gears on a grid of both shaft angles.

The relation is explicit if both angles are given. It is periodic in both, so that the grid covers a
torus. The arrays have the same shape for every pair, so that one compiled program serves all fits.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.arrays import Numbers
from ...kinematics.exact import ExactModel
from ...kinematics.flank_model import flank_index
from ...pair.gear_pair import Flank

POINTS = 8
"""Points per turn of each shaft. Orders below 4 are exact; only terms of order e⁶ alias to them."""

GEARS = ("driving_x", "driving_y", "driven_x", "driven_y")
"""The coordinates of both eccentricities, mm, in the order in which the functions take them."""


class Torus(eqx.Module):
    """Constants of the exact relation of a gear pair: ratio i, and lengths in mm."""

    ratio: Float[Numbers, ""]
    centre_distance: Float[Numbers, ""]
    base_sum: Float[Numbers, "2"]

    def errors(
        self, gears: Float[Array, "4"], flanks: tuple[Flank, ...] = ("A", "B")
    ) -> Float[Array, "flanks grid"]:
        """Return the transmission error of each flank on the grid, rad, without its offset."""
        model = ExactModel(
            ratio=jnp.asarray(self.ratio),
            centre_distance=jnp.asarray(self.centre_distance),
            base_sum=self.base_sum,
            driving_offset=gears[0] + 1j * gears[1],
            driven_offset=gears[2] + 1j * gears[3],
            offset=jnp.zeros(2),
        )
        driving, driven = (jnp.asarray(angle)[None] for angle in grid())
        sides = np.array([flank_index(flank) for flank in flanks])
        senses = np.where(sides == 0, 1.0, -1.0)[:, None]
        return jnp.asarray(model.turned(driving, driven, self.base_sum[sides][:, None], senses))


def grid() -> tuple[Float[np.ndarray, " grid"], Float[np.ndarray, " grid"]]:
    """Return the driving and driven angles of the grid, rad."""
    angles = 2 * np.pi * np.arange(POINTS) / POINTS
    driving, driven = np.meshgrid(angles, angles, indexing="ij")
    return driving.ravel(), driven.ravel()


@jax.jit
def errors_and_slopes(
    torus: Torus, gears: Float[Array, "4"]
) -> tuple[Float[Array, "2 grid"], Float[Array, "2 grid 4"]]:
    """Return the errors of both flanks and their derivatives with respect to `gears`."""

    # Forward mode gives the value and the derivative together, so the relation is traced once.
    def along(direction: Float[Array, "4"]):
        return jax.jvp(lambda one: torus.errors(one), (gears,), (direction,))

    return jax.vmap(along, out_axes=(None, -1))(jnp.eye(len(GEARS)))

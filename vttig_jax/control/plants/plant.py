"""Base class of the plants, their state, and what they share: friction, walls and contact."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, Numbers, float64
from ..motion.motion import MotionPoint
from .flank_bounds import Bounds, Flanks

ON_A, FREE, ON_B = -1.0, 0.0, 1.0


class Shafts(eqx.Module):
    """State of both shafts at one time.

    - `angle`, `speed`: of the driving shaft, rad and rad/s.
    - `offset`, `drift`: x = φ₂ − i φ₁ and its derivative, rad and rad/s.
    - `side`: loaded flank, `ON_A`, `ON_B`, or `FREE` without contact.
    - `flanks`: both flanks at `angle`, axial displacement zero.
    """

    angle: Float[Array, ""]
    speed: Float[Array, ""]
    offset: Float[Array, ""]
    drift: Float[Array, ""]
    side: Float[Array, ""]
    flanks: Flanks


class Slide(eqx.Module):
    """Axial displacement at the start and end of a step, mm, and its rates there, mm/s."""

    start: Float[Array, ""]
    end: Float[Array, ""]
    start_rate: Float[Array, ""]
    end_rate: Float[Array, ""]


class ContactEvent(eqx.Module):
    """First contact with a flank within the step.

    - `side`: flank, `FREE` without contact.
    - `angle`: driving angle at the contact, rad. - `gap`: remaining backlash there, rad.
    - `share`: share of the step before the contact.
    """

    side: Float[Array, ""]
    angle: Float[Array, ""]
    gap: Float[Array, ""]
    share: Float[Array, ""]


class Drag(eqx.Module):
    """Resisting torque of a shaft: Coulomb, viscous and Stribeck friction and a constant load.

        T = T_load + (T_c + T_s / (1 + (ω/ω_s)²)) sgn ω + b ω

    (Stribeck term: D. P. Hess, A. Soom, J. Tribology 112 (1990) 147). At standstill friction
    takes any value up to T_c + T_s and never turns the shaft.

    **Arguments**
    - `inertia`: kg m². - `coulomb`, `stribeck`, `load`: T_c, T_s, T_load, N m.
    - `viscous`: b, N m s/rad. - `stribeck_speed`: ω_s, rad/s. - `sticky`: whether to include T_s.
    """

    inertia: Float[Number, ""] = eqx.field(converter=float64)
    coulomb: Float[Number, ""] = eqx.field(converter=float64, default=0.0)
    viscous: Float[Number, ""] = eqx.field(converter=float64, default=0.0)
    stribeck: Float[Number, ""] = eqx.field(converter=float64, default=0.0)
    stribeck_speed: Float[Number, ""] = eqx.field(converter=float64, default=1.0)
    load: Float[Number, ""] = eqx.field(converter=float64, default=0.0)
    sticky: bool = eqx.field(static=True, default=True)

    def acceleration(
        self, speed: Float[Array, ""], torque: Float[Array, ""] | float, step: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Return the mean acceleration (rad/s²) in a step (s) at a speed (rad/s), torque (N m)."""
        # Viscous friction lets the speed decay exponentially; dry friction stops the shaft at most.
        inertia, limit = jnp.asarray(self.inertia), jnp.asarray(self.coulomb)
        viscous = jnp.expm1(-self.viscous * step / inertia) * (inertia / step)
        push = jnp.asarray(torque) - self.load + viscous * speed
        if self.sticky:
            limit += self.stribeck / (1 + (speed * (1.0 / self.stribeck_speed)) ** 2)
        stop = push + (inertia / step) * speed
        return (push - jnp.clip(stop, -limit, limit)) * (1.0 / inertia)


class Plant(eqx.Module):
    """Model of both shafts; see `PlayPlant`, `RigidPlant` and `ElasticPlant`."""

    @abstractmethod
    def step(
        self, shafts: Shafts, driving: MotionPoint, slide: Slide, bounds: Bounds, step: Number
    ) -> tuple[Shafts, ContactEvent]:
        """Return both shafts after a step (s) at whose end the driving shaft is at `driving`."""


class Walls(eqx.Module):
    """Offset x on both flanks, rad, and its rates, rad/s."""

    lower: Float[Array, ""]
    upper: Float[Array, ""]
    lower_rate: Float[Array, ""]
    upper_rate: Float[Array, ""]


def walls(
    flanks: Flanks,
    speed: Float[Array, ""],
    closing: Float[Numbers, "2"],
    shift: Float[Array, ""],
    shift_rate: Float[Array, ""],
) -> Walls:
    """Return both limits of the gap at a driving speed (rad/s), axial shift (mm) and its rate."""
    return Walls(
        flanks.lower + closing[0] * shift,
        flanks.upper - closing[1] * shift,
        flanks.lower_slope * speed + closing[0] * shift_rate,
        flanks.upper_slope * speed - closing[1] * shift_rate,
    )


def touching(
    below: Bool[Array, ""], above: Bool[Array, ""], side: Float[Array, ""]
) -> Float[Array, ""]:
    """Return the loaded flank if x is at or beyond a wall; a closed gap keeps the last `side`."""
    loaded = jnp.where(below, ON_A, jnp.where(above, ON_B, FREE))
    return jnp.where(below & above & (side != FREE), side, loaded)


def newly_met(
    below: Bool[Array, ""], above: Bool[Array, ""], side: Float[Array, ""], before: Float[Array, ""]
) -> Float[Array, ""]:
    """Return the newly loaded flank or `FREE`; in a closed gap the one opposite to `before`."""
    return jnp.where(below & above, -before, jnp.where(side == before, FREE, side))

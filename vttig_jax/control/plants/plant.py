"""What every plant keeps: two shafts that go one step further between two moving walls."""

from abc import abstractmethod
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, Numbers, float64
from ..motion.motion import MotionPoint
from .flank_bounds import Bounds, Flanks

ON_A, FREE, ON_B = -1.0, 0.0, 1.0


class Shafts(NamedTuple):
    """Both shafts at one time.

    - `angle`, `speed`: of the driving shaft, rad and rad/s.
    - `offset`, `drift`: x = φ₂ − i φ₁ and its derivative, rad and rad/s.
    - `side`: the flank that carries, `ON_A`, `FREE` or `ON_B`.
    - `flanks`: both flanks at `angle`, axial displacement zero.
    """

    angle: Float[Array, ""]
    speed: Float[Array, ""]
    offset: Float[Array, ""]
    drift: Float[Array, ""]
    side: Float[Array, ""]
    flanks: Flanks


class Slide(NamedTuple):
    """Axial displacement over one step: at its start and end in mm, and its rates there in mm/s."""

    start: Float[Array, ""]
    end: Float[Array, ""]
    start_rate: Float[Array, ""]
    end_rate: Float[Array, ""]


class ContactEvent(NamedTuple):
    """A flank that was met within the step.

    - `side`: which, `FREE` where none was.
    - `angle`: driving angle there, rad. - `gap`: backlash left there, rad.
    - `share`: of the step until then.
    """

    side: Float[Array, ""]
    angle: Float[Array, ""]
    gap: Float[Array, ""]
    share: Float[Array, ""]


class Drag(eqx.Module):
    """What holds a shaft back: Coulomb, viscous and Stribeck friction and a constant load.

        T = T_load + (T_c + T_s / (1 + (ω/ω_s)²)) sgn ω + b ω

    (the last but one by D. P. Hess, A. Soom, J. Tribology 112 (1990) 147). At standstill friction
    takes any value up to T_c + T_s: it never turns the shaft.

    **Arguments**
    - `inertia`: kg m². - `coulomb`, `stribeck`, `load`: N m. - `viscous`: N m s/rad.
    - `stribeck_speed`: ω_s, rad/s. - `sticky`: whether T_s counts at all.
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
        """Of a shaft under another torque over a step of s, rad/s²; friction stops it at most."""
        # Viscous friction alone lets the speed fade exponentially; it never turns the shaft round.
        inertia, most = jnp.asarray(self.inertia), jnp.asarray(self.coulomb)
        fading = jnp.expm1(-self.viscous * step / inertia) * (inertia / step)
        push = jnp.asarray(torque) - self.load + fading * speed
        if self.sticky:
            most += self.stribeck / (1 + (speed * (1.0 / self.stribeck_speed)) ** 2)
        stop = push + (inertia / step) * speed
        return (push - jnp.clip(stop, -most, most)) * (1.0 / inertia)


class Plant(eqx.Module):
    """Moves both shafts one step; see `play_plant`, `rigid_plant` and `elastic_plant`."""

    @abstractmethod
    def step(
        self, shafts: Shafts, ahead: MotionPoint, slide: Slide, bounds: Bounds, step: Number
    ) -> tuple[Shafts, ContactEvent]:
        """Both shafts a step of s later, with the driving shaft where its motion takes it."""


class Walls(NamedTuple):
    """x on both flanks and how fast each moves: rad and rad/s."""

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
    """The flanks at a driving speed in rad/s and an axial displacement in mm that changes."""
    return Walls(
        flanks.lower + closing[0] * shift,
        flanks.upper - closing[1] * shift,
        flanks.lower_slope * speed + closing[0] * shift_rate,
        flanks.upper_slope * speed - closing[1] * shift_rate,
    )


def touching(
    below: Bool[Array, ""], above: Bool[Array, ""], side: Float[Array, ""]
) -> Float[Array, ""]:
    """The flank that carries where x is at or beyond either; in a closed gap it stays the same."""
    one = jnp.where(below, ON_A, jnp.where(above, ON_B, FREE))
    return jnp.where(below & above & (side != FREE), side, one)


def newly_met(
    below: Bool[Array, ""], above: Bool[Array, ""], side: Float[Array, ""], before: Float[Array, ""]
) -> Float[Array, ""]:
    """The flank that is met and did not carry before; a gap that has closed meets the other one."""
    return jnp.where(below & above, -before, jnp.where(side == before, FREE, side))

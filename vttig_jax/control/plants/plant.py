"""Plants: their state, common parts (friction, walls and contact), and those with rigid teeth.

A wall is the position of a flank in the offset x = φ₂ − i φ₁, which limits the driven shaft.
"""

from abc import abstractmethod
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, Numbers, float64
from ...kinematics.flank_table import Bounds, Flanks
from ..fields import Part, Quantity, not_negative, number, positive
from ..hermite import Cubic, cubic, first_root
from ..motion.motion import MotionPoint

ON_A, FREE, ON_B = -1.0, 0.0, 1.0


class Shafts(eqx.Module):
    """State of both shafts at one time.

    - `angle`, `speed`: of the driving shaft, rad and rad/s.
    - `offset`, `drift`: x = φ₂ − i φ₁ and its derivative, rad and rad/s.
    - `side`: loaded flank, `ON_A`, `ON_B`, or `FREE` without contact.
    - `flanks`: both flanks at `angle` for an axial displacement of zero.
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
    """First new contact with a flank within a time step.

    - `side`: the flank (`ON_A` or `ON_B`), or `FREE` if there was no new contact.
    - `angle`: driving angle at the contact, rad.
    - `gap`: backlash at that instant, reduced by the axial displacement, rad.
    """

    side: Float[Array, ""]
    angle: Float[Array, ""]
    gap: Float[Array, ""]


class Drag(eqx.Module):
    """Resisting torque of a shaft: Coulomb, viscous and Stribeck friction and a constant load.

        T = T_load + (T_c + T_s / (1 + (ω/ω_s)²)) sgn ω + b ω

    (Stribeck term: D. P. Hess, A. Soom, J. Tribology 112 (1990) 147). At standstill the friction
    torque balances the other torques up to ±(T_c + T_s); friction never sets the shaft in motion.

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
        """Return the mean acceleration (rad/s²) over a time step (s).

        `speed` is the speed at its start, rad/s; `torque` drives the shaft, N m.
        """
        # With viscous friction the speed decays exponentially. Dry friction can stop the shaft
        # within the step but never reverses its motion.
        inertia, limit = jnp.asarray(self.inertia), jnp.asarray(self.coulomb)
        viscous = jnp.expm1(-self.viscous * step / inertia) * (inertia / step)
        push = jnp.asarray(torque) - self.load + viscous * speed
        if self.sticky:
            limit += self.stribeck / (1 + (speed * (1.0 / self.stribeck_speed)) ** 2)
        stop = push + (inertia / step) * speed
        return (push - jnp.clip(stop, -limit, limit)) * (1.0 / inertia)


class Inertia(Part):
    """Moments of inertia of both shafts, each with all parts that turn with it."""

    driven_kgm2: Quantity = positive(0.01, "driven shaft and parts on it", "kg m^2")
    driving_kgm2: Quantity = positive(
        0.002, "driving shaft and parts on it; servo motor only", "kg m^2"
    )


class Friction(Part):
    """Friction of the driven shaft, see `Drag`, and dry friction of the driving shaft."""

    coulomb_Nm: Quantity = not_negative(0.1, "dry friction of the turning driven shaft", "N m")
    viscous_Nms: Quantity = not_negative(0.0, "viscous friction torque per speed", "N m s/rad")
    stribeck_Nm: Quantity = not_negative(0.0, "additional dry friction at standstill", "N m")
    stribeck_rad_s: Quantity = positive(0.1, "speed at which half of the addition remains", "rad/s")
    driving_Nm: Quantity = not_negative(
        0.05, "dry friction of the driving shaft; servo motor only", "N m"
    )


class Load(Part):
    """Load of the driven shaft."""

    torque_Nm: Quantity = number(
        0.0, "constant load torque; a positive one opposes forward motion", "N m", ge=-1e6, le=1e6
    )


class Mesh(Part):
    """Contact of the flanks, as far as it is the same for all plants."""

    friction_coefficient: Quantity = number(
        0.0, "coefficient of friction between the flanks", "1", ge=0, le=10
    )


class Plant(Part):
    """Model of the driven shaft and the contact; see `Play`, `Rigid` and `Elastic`."""

    def with_shaft(self, drag: Drag, pair: Any) -> "Plant":
        """Return the plant for a driven shaft with this drag, and for these gears."""
        return self

    @abstractmethod
    def step(
        self, shafts: Shafts, driving: MotionPoint, slide: Slide, bounds: Bounds, step: Number
    ) -> tuple[Shafts, ContactEvent]:
        """Return both shafts after a time step (s), and the first new contact in it.

        - `shafts`: state at the start. - `driving`: driving shaft at the end of the step.
        - `slide`: axial displacement during the step. - `bounds`: flanks.
        """


class Walls(eqx.Module):
    """Offset x in contact with flank A (`lower`) and flank B (`upper`), rad; rates in rad/s."""

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
    """Return both limits of the offset x and their rates.

    - `speed`: driving speed, rad/s. - `closing`: see `Bounds`.
    - `shift`, `shift_rate`: axial displacement, mm, and its rate, mm/s.
    """
    return Walls(
        flanks.lower + closing[0] * shift,
        flanks.upper - closing[1] * shift,
        flanks.lower_slope * speed + closing[0] * shift_rate,
        flanks.upper_slope * speed - closing[1] * shift_rate,
    )


def walls_of(
    shafts: Shafts, driving: MotionPoint, slide: Slide, bounds: Bounds, step: Number
) -> tuple[Flanks, Walls, Walls, Cubic, Cubic]:
    """Return the flanks at the end of a step (s), and the walls at its start and at its end.

    The lower and the upper wall during the step follow them.
    """
    flanks, closing = bounds.at(driving.angle), jnp.asarray(bounds.closing)
    now = walls(shafts.flanks, shafts.speed, closing, slide.start, slide.start_rate)
    then = walls(flanks, driving.speed, closing, slide.end, slide.end_rate)
    low = cubic(now.lower, then.lower, now.lower_rate, then.lower_rate, step)
    high = cubic(now.upper, then.upper, now.upper_rate, then.upper_rate, step)
    return flanks, now, then, low, high


def flown(shafts, driving, ratio, slowing, step) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return x and its rate at the end of a step without contact.

    `driving`: driving shaft at the end. `slowing`: acceleration of the driven shaft, rad/s².
    """
    turned = step * (ratio * shafts.speed + shafts.drift + 0.5 * step * slowing)
    return (
        shafts.offset + turned - ratio * (driving.angle - shafts.angle),
        shafts.drift + step * slowing - ratio * (driving.speed - shafts.speed),
    )


def touching(
    below: Bool[Array, ""], above: Bool[Array, ""], side: Float[Array, ""]
) -> Float[Array, ""]:
    """Return the loaded flank, or `FREE` if x lies between the walls.

    `below` and `above`: whether x is at or beyond the wall of flank A or B. If both are true (the
    gap is closed), the last loaded flank `side` is kept.
    """
    loaded = jnp.where(below, ON_A, jnp.where(above, ON_B, FREE))
    return jnp.where(below & above & (side != FREE), side, loaded)


def newly_met(
    below: Bool[Array, ""], above: Bool[Array, ""], side: Float[Array, ""], before: Float[Array, ""]
) -> Float[Array, ""]:
    """Return the flank that has become loaded in this step, or `FREE` if there is none.

    `before` and `side`: loaded flank before and after the step. In a closed gap (`below` and
    `above`) the flank opposite to `before` is the newly loaded one.
    """
    return jnp.where(below & above, -before, jnp.where(side == before, FREE, side))


class Play(Plant):
    """Plant whose driven shaft stands still in the gap and does not rebound from a flank.

    In a step in which the driving shaft turns by Δφ₁, the offset x = φ₂ − i φ₁ becomes
    x ← min(max(x − i Δφ₁, lower wall), upper wall)
    """

    def step(
        self, shafts: Shafts, driving: MotionPoint, slide: Slide, bounds: Bounds, step: Number
    ) -> tuple[Shafts, ContactEvent]:
        """See `Plant.step`."""
        ratio = jnp.asarray(bounds.ratio)
        flanks, _, then, low, high = walls_of(shafts, driving, slide, bounds, step)
        free = shafts.offset - ratio * (driving.angle - shafts.angle)
        below, above = free <= then.lower, free >= then.upper
        side = touching(below, above, shafts.side)
        held = cubic(shafts.offset, free, -ratio * shafts.speed, -ratio * driving.speed, step)
        depth = jax.tree.map(lambda h, a, b: jnp.where(below, h - a, b - h), held, low, high)
        share = first_root(depth)
        way = cubic(shafts.angle, driving.angle, shafts.speed, driving.speed, step)
        met = newly_met(below, above, side, shafts.side)
        touch = ContactEvent(met, way.at(share), high.at(share) - low.at(share))
        offset = jnp.clip(free, then.lower, then.upper)
        rate = jnp.where(
            below, then.lower_rate, jnp.where(above, then.upper_rate, -ratio * driving.speed)
        )
        return Shafts(driving.angle, driving.speed, offset, rate, side, flanks), touch


class Rigid(Plant):
    """Plant with inertia and friction in the gap and Newton's impact law at the flanks.

    In the gap J₂ φ̈₂ = −T with the drag torque T. The driven shaft meets a flank with the relative
    speed w and leaves it with −ε w. If it would meet the flank again within the same step, it stays
    in contact until the flank moves away from it. The instant of the impact is computed within the
    step.

    **Arguments**
    - `restitution`: coefficient of restitution ε, 0 … 1.
    - `drag`: inertia and friction of the driven shaft, which `run` fills in.
    """

    restitution: Quantity = number(
        0.3, "rigid: relative speed after an impact over that before", "1", ge=0, le=1
    )
    drag: Drag = Drag(1.0)

    def with_shaft(self, drag: Drag, pair: Any) -> "Rigid":
        """See `Plant.with_shaft`."""
        return replace(self, drag=drag)

    def step(
        self, shafts: Shafts, driving: MotionPoint, slide: Slide, bounds: Bounds, step: Number
    ) -> tuple[Shafts, ContactEvent]:
        """See `Plant.step`."""
        ratio = jnp.asarray(bounds.ratio)
        step = jnp.asarray(step)
        flanks, _, then, low, high = walls_of(shafts, driving, slide, bounds, step)
        driven_speed = ratio * shafts.speed + shafts.drift
        slowing = self.drag.acceleration(driven_speed, 0.0, step)
        free, drift = flown(shafts, driving, ratio, slowing, step)
        below, above = free <= then.lower, free >= then.upper
        hit = below | above
        wall = jax.tree.map(lambda a, b: jnp.where(below, a, b), low, high)
        inwards = jnp.where(below, 1.0, -1.0)
        flight = cubic(shafts.offset, free, shafts.drift, drift, step)
        clearance = jax.tree.map(lambda f, w: inwards * (f - w), flight, wall)
        share = first_root(clearance)
        rest, rate = (1 - share) * step, 1.0 / step
        approach = clearance.slope(share)
        rebound = (wall.slope(share) - inwards * self.restitution * approach) * rate
        pull = (drift - shafts.drift) * rate
        offset = wall.at(share) + rest * (rebound + 0.5 * rest * pull)
        end = jnp.where(below, then.lower, then.upper)
        end_rate = jnp.where(below, then.lower_rate, then.upper_rate)
        side = touching(below, above, shafts.side)
        # An impact at the end of the step leaves no way that could show whether it meets again.
        leaves = (share > 1 - 1e-9) & (inwards * (rebound - end_rate) > 0)
        again = ~leaves & (inwards * (offset - end) <= 0)
        stays = hit & ((shafts.side == side) | again)

        met = newly_met(below, above, side, shafts.side)
        way = cubic(shafts.angle, driving.angle, shafts.speed, driving.speed, step)
        touch = ContactEvent(met, way.at(share), high.at(share) - low.at(share))
        offset = jnp.where(stays, end, jnp.where(hit, offset, free))
        offset = jnp.clip(offset, then.lower, then.upper)
        drift = jnp.where(stays, end_rate, jnp.where(hit, rebound + rest * pull, drift))
        side = jnp.where(stays, side, FREE)
        return Shafts(driving.angle, driving.speed, offset, drift, side, flanks), touch

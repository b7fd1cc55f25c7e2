"""A servo motor with position and speed loops, and its motion together with both gears.

A force F of flank A turns the driven shaft by F and the driving one by −F k, k = i + ∂TE_A/∂φ₁ (of
B likewise with the other sign): only so no energy comes from nowhere. Between the two it makes

    q̈ = F/m,  m = J₁ J₂/(J₁ + k² J₂),  q = φ₂ − k φ₁

so that the contact is that of one body of inertia m with a wall that moves as the driving shaft
would without it. What the flank did to q is shared: m/J₂ of it moved the driven shaft, −k m/J₁ the
driving one.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number, float64
from ..motion.motion import MotionPoint
from ..plants.elastic import ElasticPlant
from ..plants.flank_bounds import Bounds, Flanks
from ..plants.plant import FREE, ON_B, ContactEvent, Drag, Plant, Shafts, Slide, walls
from .shaft_drive import Missed, ShaftDrive


class Motor(NamedTuple):
    """What the servo keeps.

    - `angle`, `speed`: where it was last told to be, rad and rad/s. - `wound`: ∫ of the error, rad.
    - `limited`: it was at its torque limit.
    """

    angle: Float[Array, ""]
    speed: Float[Array, ""]
    wound: Float[Array, ""]
    limited: Bool[Array, ""]


class Servo(eqx.Module):
    """A cascade that is sampled once in every step of the plant and holds its torque in between.

        e = ω_ref + k_v (φ_ref − φ₁) − ω₁,  T = clip(k_p e + k_i ∫e dt, ±T_max)

    It measures its own shaft without error. Where the limit cuts the torque the integral stands
    still, unless the error unwinds it.

    **Arguments**
    - `speed_gain`: k_p, N m s/rad. - `integral_gain`: k_i, N m/rad. - `position_gain`: k_v, 1/s.
    - `torque_limit`: T_max, N m.
    """

    speed_gain: Float[Number, ""] = eqx.field(converter=float64)
    integral_gain: Float[Number, ""] = eqx.field(converter=float64)
    position_gain: Float[Number, ""] = eqx.field(converter=float64)
    torque_limit: Float[Number, ""] = eqx.field(converter=float64)

    def torque(
        self,
        motor: Motor,
        angle: Float[Array, ""],
        speed: Float[Array, ""],
        step: Float[Array, ""],
    ) -> tuple[Float[Array, ""], Motor]:
        """N m for a step of s of a shaft at an angle and a speed, and what is kept of it."""
        error = motor.speed + self.position_gain * (motor.angle - angle) - speed
        wound = motor.wound + step * error
        asked = self.speed_gain * error + self.integral_gain * wound
        torque = jnp.clip(asked, -self.torque_limit, self.torque_limit)
        limited = torque != asked
        wound = jnp.where(limited & (error * asked >= 0), motor.wound, wound)
        return torque, motor._replace(wound=wound, limited=limited)


Scalar = Float[Array, ""]


class ServoDrive(ShaftDrive):
    """A servo motor with inertia and friction.

    Teeth that stay in contact are one body with both inertias and frictions (`play`, `rigid`), as
    long as the flank has to push; an impact exchanges momentum (`rigid`; in `play` the driven shaft
    has none); `elastic` teeth press both shafts. What the wedge of a closed gap and the actuator do
    to the driving shaft is left out.

    **Arguments**
    - `servo`: its law. - `driving`: inertia and friction of the driving shaft.
    - `driven`: those of the driven shaft; in `play` without inertia.
    """

    servo: Servo
    driving: Drag
    driven: Drag

    def start(self, told: MotionPoint) -> Motor:
        """At rest where it is told to be."""
        return Motor(told.angle, told.speed, jnp.zeros(()), jnp.zeros((), bool))

    def missed(self, state: Any, shafts: Shafts) -> Missed:
        """What is between the shaft and what it was told."""
        return Missed(jnp.abs(state.angle - shafts.angle), state.limited)

    def expected(self, shafts: Shafts, told: MotionPoint, step: Scalar) -> Scalar:
        """Where its speed takes it."""
        return shafts.angle + step * shafts.speed

    def step(
        self,
        state: Any,
        plant: Plant,
        shafts: Shafts,
        told: MotionPoint,
        slide: Slide,
        bounds: Bounds,
        step: Scalar,
    ) -> tuple[Motor, Shafts, ContactEvent]:
        """See `ShaftDrive.step`."""
        torque, motor = self.servo.torque(state, shafts.angle, shafts.speed, step)
        motor = motor._replace(angle=told.angle, speed=told.speed)
        gap = shafts.flanks.upper - shafts.flanks.lower
        shut = gap <= bounds.closing_sum * slide.end
        if isinstance(plant, ElasticPlant):
            ended = self._pressing(torque, shut, plant, shafts, slide, bounds, step)
        else:
            ended = self._touching(torque, shut, plant, shafts, slide, bounds, step)
        return motor, *ended

    def _touching(
        self,
        torque: Scalar,
        shut: Bool[Array, ""],
        plant: Plant,
        shafts: Shafts,
        slide: Slide,
        bounds: Bounds,
        step: Scalar,
    ) -> tuple[Shafts, ContactEvent]:
        """Teeth that do not give: one body in contact, two in flight, an impact in between."""
        side, ratio = shafts.side, jnp.asarray(bounds.ratio)
        slope = ratio + _slope(shafts.flanks, side)
        alone = self.driving.acceleration(shafts.speed, torque, step)
        both = geared(self.driving, self.driven, slope)
        together = both.acceleration(shafts.speed, torque, step)
        # Flank A only ever slows the driving shaft, B only ever drives it on.
        pushed = jnp.where(side > 0, jnp.maximum(alone, together), jnp.minimum(alone, together))
        pushed = jnp.where(shut, together, jnp.where(side == FREE, alone, pushed))
        course = _course(shafts, pushed, step)
        ahead = bounds.at(course.angle)
        # Where the slope of the flank changes, only an impulse between both changes their speeds.
        later = ratio + _slope(ahead, side)
        inertia, heavy = self.driven.inertia, jnp.asarray(self.driving.inertia)
        kept = (heavy + slope * later * inertia) / (heavy + later**2 * inertia)
        carries = shut | ((side != FREE) & (pushed == together))
        speed = jnp.where(carries, kept * course.speed, course.speed)
        course = course._replace(
            speed=speed, angle=shafts.angle + 0.5 * step * (shafts.speed + speed)
        )
        found, touch = plant.step(shafts, course, slide, bounds, step)
        flight = self._flight(shafts, course, self._slowing(shafts, bounds, step), bounds, step)
        met = (touch.side != FREE) & ~carries
        near = jnp.where(touch.side != FREE, touch.side, side)
        ended = self._shared(found, flight, near, met, slide, bounds)
        wall = walls(
            ended.flanks, ended.speed, jnp.asarray(bounds.closing), slide.end, slide.end_rate
        )
        on_b, rests = ended.side > 0, ended.side != FREE
        offset = jnp.where(on_b, wall.upper, wall.lower)
        rate = jnp.where(on_b, wall.upper_rate, wall.lower_rate)
        offset = jnp.where(rests, offset, ended.offset)
        return ended._replace(
            offset=jnp.clip(offset, wall.lower, jnp.maximum(wall.lower, wall.upper)),
            drift=jnp.where(rests, rate, ended.drift),
        ), touch

    def _slowing(self, shafts: Shafts, bounds: Bounds, step: Scalar) -> Scalar:
        """Of the driven shaft in flight, rad/s²; without inertia it does not fly."""
        turning = bounds.ratio * shafts.speed + shafts.drift
        flies = jnp.asarray(self.driven.inertia) > 0
        drag = eqx.tree_at(
            lambda drag: drag.inertia, self.driven, jnp.where(flies, self.driven.inertia, 1.0)
        )
        return jnp.where(flies, drag.acceleration(turning, 0.0, step), 0.0)

    def _pressing(
        self,
        torque: Scalar,
        shut: Bool[Array, ""],
        plant: ElasticPlant,
        shafts: Shafts,
        slide: Slide,
        bounds: Bounds,
        step: Scalar,
    ) -> tuple[Shafts, ContactEvent]:
        """Elastic teeth: both shafts are pressed apart by the flank they are in."""
        ratio, closing = jnp.asarray(bounds.ratio), jnp.asarray(bounds.closing)
        now = walls(shafts.flanks, shafts.speed, closing, slide.start, slide.start_rate)
        nearer = jnp.where(2 * shafts.offset > now.lower + now.upper, ON_B, -ON_B)
        near = jnp.where(shafts.side != FREE, shafts.side, nearer)
        rough = bounds.at(shafts.angle + step * shafts.speed)
        slope = ratio + 0.5 * (_slope(shafts.flanks, near) + _slope(rough, near))
        soft = plant.against(self._inertia(slope))
        force = soft.torque(shafts, now)
        # Friction of a shaft that is pressed stands up to what presses it, as far as it can.
        hold, inertia = jnp.asarray(self.driving.coulomb), jnp.asarray(self.driving.inertia)
        push = jnp.clip(-slope * force, -hold - torque, hold - torque)
        push = jnp.where(force == 0, 0.0, push)
        alone = self.driving.acceleration(shafts.speed, torque + push, step) - push / inertia
        both = geared(self.driving, self.driven, slope)
        together = both.acceleration(shafts.speed, torque, step)
        course = _course(shafts, jnp.where(shut, together, alone), step)
        found, touch = soft.step(shafts, course, slide, bounds, step)
        flight = self._flight(shafts, course, soft.slowing(shafts, now, ratio, step), bounds, step)
        return self._shared(found, flight, near, ~shut, slide, bounds, slope), touch

    def _inertia(self, slope: Scalar) -> Scalar:
        """m: of the motion of both shafts against each other, at the driven one, kg m²."""
        driving, driven = jnp.asarray(self.driving.inertia), self.driven.inertia
        return driving * driven / (driving + slope**2 * driven)

    def _flight(
        self, shafts: Shafts, course: MotionPoint, slowing: Scalar, bounds: Bounds, step: Scalar
    ) -> "_Offset":
        """x and its rate at the end of a step without flanks."""
        turned = step * (bounds.ratio * shafts.speed + shafts.drift + 0.5 * step * slowing)
        return _Offset(
            shafts.offset + turned - bounds.ratio * (course.angle - shafts.angle),
            shafts.drift + step * slowing - bounds.ratio * (course.speed - shafts.speed),
        )

    def _shared(
        self,
        found: Shafts,
        flight: "_Offset",
        near: Scalar,
        met: Bool[Array, ""],
        slide: Slide,
        bounds: Bounds,
        slope: Scalar | None = None,
    ) -> Shafts:
        """Both shafts after what the flank `near` did to x, where it did (`met`)."""
        if slope is None:
            slope = jnp.asarray(bounds.ratio) + _slope(found.flanks, near)
        share = slope * self._inertia(slope) / self.driving.inertia
        way = jnp.where(met, share * (found.offset - flight.angle), 0.0)
        rate = jnp.where(met, share * (found.drift - flight.rate), 0.0)
        lean = slope - bounds.ratio
        angle, speed = found.angle - way, found.speed - rate
        offset, drift = found.offset - lean * way, found.drift - lean * rate
        return Shafts(angle, speed, offset, drift, found.side, bounds.at(angle))


class _Offset(NamedTuple):
    """x and its rate: rad and rad/s."""

    angle: Scalar
    rate: Scalar


def geared(driving: Drag, driven: Drag, slope: Float[Number, ""]) -> Drag:
    """Both shafts as one body, seen from the driving one: φ̇₂ = k φ̇₁."""
    return Drag(
        driving.inertia + slope**2 * driven.inertia,
        driving.coulomb + slope * driven.coulomb,
        driving.viscous + slope**2 * driven.viscous,
        slope * driven.stribeck,
        driven.stribeck_speed / slope,
        slope * driven.load,
        sticky=driven.sticky,
    )


def _slope(flanks: Flanks, side: Scalar) -> Scalar:
    """dTE/dφ₁ of a flank; of A where none carries."""
    return jnp.where(side > 0, flanks.upper_slope, flanks.lower_slope)


def _course(shafts: Shafts, acceleration: Scalar, step: Scalar) -> MotionPoint:
    """The driving shaft a step of s later under a constant acceleration."""
    speed = shafts.speed + step * acceleration
    angle = shafts.angle + 0.5 * step * (shafts.speed + speed)
    return MotionPoint(angle, speed, acceleration)

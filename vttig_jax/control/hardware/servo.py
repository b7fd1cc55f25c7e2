"""Servo motor with position and speed loops, coupled to both gears.

A torque F of flank A acts with F on the driven shaft and with −k F on the driving shaft, where
k = i + ∂TE_A/∂φ₁ (flank B: likewise, with the other sign). This conserves energy, and

    q̈ = F/m,  m = J₁ J₂/(J₁ + k² J₂),  q = φ₂ − k φ₁

so the contact is computed as that of one body of inertia m with a wall that moves as the driving
shaft would move without contact. The contact changes q by Δq. Of this change the driven shaft takes
Δφ₂ = (m/J₂) Δq and the driving shaft Δφ₁ = −(k m/J₁) Δq.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...base.arrays import Number
from ...kinematics.flank_table import Bounds, Flanks
from ..fields import Part, Quantity, not_negative, positive
from ..motion.motion import MotionPoint
from ..plants.elastic import Elastic
from ..plants.plant import FREE, ON_B, ContactEvent, Drag, Plant, Shafts, flown, walls


class Motor(eqx.Module):
    """State of the servo.

    - `angle`, `speed`: last reference, rad and rad/s. - `integral`: ∫e dt (see `Servo`), rad.
    - `limited`: whether the torque was at its limit.
    """

    angle: Float[Array, ""]
    speed: Float[Array, ""]
    integral: Float[Array, ""]
    limited: Bool[Array, ""]


class Servo(Part):
    """Cascade of a position and a speed controller, evaluated once per plant step.

        e = ω_ref + k_v (φ_ref − φ₁) − ω₁,  T = clip(k_p e + k_i ∫e dt, ±T_max)

    The torque is constant during the step. The servo measures the driving shaft without error.
    Anti-windup: at the torque limit the integrator stops unless the error would reduce the torque.

    The fields are k_p, k_i, k_v and T_max.
    """

    speed_gain_Nms: Quantity = positive(1.0, "pi: torque per speed error", "N m s/rad")
    integral_gain_Nm: Quantity = not_negative(
        20.0, "pi: torque per integral of the speed error", "N m/rad"
    )
    position_gain_1_s: Quantity = not_negative(
        20.0, "pi: speed per position error; 0: no position loop", "1/s"
    )
    torque_limit_Nm: Quantity = positive(5.0, "pi: largest torque", "N m")

    def torque(
        self,
        motor: Motor,
        angle: Float[Array, ""],
        speed: Float[Array, ""],
        step: Float[Array, ""],
    ) -> tuple[Float[Array, ""], Motor]:
        """Return the torque (N m) for one time step (s), and the new state.

        `angle` (rad) and `speed` (rad/s) are those of the driving shaft at the start of the step.
        """
        error = motor.speed + self.position_gain_1_s * (motor.angle - angle) - speed
        integral = motor.integral + step * error
        demanded = self.speed_gain_Nms * error + self.integral_gain_Nm * integral
        torque = jnp.clip(demanded, -self.torque_limit_Nm, self.torque_limit_Nm)
        limited = torque != demanded
        integral = jnp.where(limited & (error * demanded >= 0), motor.integral, integral)
        return torque, replace(motor, integral=integral, limited=limited)


Scalar = Float[Array, ""]


class ServoDrive(eqx.Module):
    """Servo motor with inertia and friction, which lets the driving shaft follow the motion.

    With the plants `play` and `rigid`, both shafts move as one body, with the inertia and friction
    of both, while a flank transmits torque. In the plant `rigid` an impact exchanges momentum
    between the shafts; in `play` the driven shaft has no inertia. In the plant `elastic` the teeth
    exert a torque on both shafts. The torque on the driving shaft that the actuator causes by
    closing the gap, and that of the wedge in a closed gap, are not included.

    **Arguments**
    - `servo`: control law. - `driving`: inertia and friction of the driving shaft.
    - `driven`: inertia and friction of the driven shaft; for `play` its inertia is zero.
    """

    servo: Servo
    driving: Drag
    driven: Drag

    def start(self, target: MotionPoint) -> Motor:
        """Return the initial state, with `target` as the first reference."""
        return Motor(target.angle, target.speed, jnp.zeros(()), jnp.zeros((), bool))

    def step(
        self, motor: Motor, plant: Plant, shafts: Shafts, target: MotionPoint, *step: Any
    ) -> tuple[Motor, Shafts, ContactEvent]:
        """Return motor and both shafts after a time step, and the contact event in it.

        - `motor`, `shafts`: at the start. - `target`: goal of the driving shaft at the end.
        - `step`: displacement, flanks and length of the step, the arguments of `Plant.step`.
        """
        slide, bounds, time = step
        torque, motor = self.servo.torque(motor, shafts.angle, shafts.speed, time)
        motor = replace(motor, angle=target.angle, speed=target.speed)
        gap = shafts.flanks.upper - shafts.flanks.lower
        closed = gap <= bounds.closing_sum * slide.end
        moved = self._elastic_step if isinstance(plant, Elastic) else self._rigid_step
        return motor, *moved(torque, closed, plant, shafts, *step)

    def _rigid_step(self, torque, closed, plant, shafts, slide, bounds, step):
        """Return both shafts after a time step with rigid teeth, and the contact event.

        In contact both shafts are one body, in flight two bodies; `torque` is that of the motor.
        """
        side, ratio = shafts.side, jnp.asarray(bounds.ratio)
        slope = ratio + _slope(shafts.flanks, side)
        separate = self.driving.acceleration(shafts.speed, torque, step)
        both = geared(self.driving, self.driven, slope)
        joint = both.acceleration(shafts.speed, torque, step)
        # Flank A can only slow the driving shaft, flank B can only accelerate it.
        pushed = jnp.where(side > 0, jnp.maximum(separate, joint), jnp.minimum(separate, joint))
        pushed = jnp.where(closed, joint, jnp.where(side == FREE, separate, pushed))
        course = _course(shafts, pushed, step)
        # When the slope of the flank changes, an impulse between the shafts adapts both speeds.
        next_slope = ratio + _slope(bounds.at(course.angle), side)
        driven, driving = self.driven.inertia, jnp.asarray(self.driving.inertia)
        kept = (driving + slope * next_slope * driven) / (driving + next_slope**2 * driven)
        carries = closed | ((side != FREE) & (pushed == joint))
        speed = jnp.where(carries, kept * course.speed, course.speed)
        angle = shafts.angle + 0.5 * step * (shafts.speed + speed)
        course = replace(course, speed=speed, angle=angle)
        moved, touch = plant.step(shafts, course, slide, bounds, step)
        flight = flown(shafts, course, bounds.ratio, self._slowing(shafts, bounds, step), step)
        met = (touch.side != FREE) & ~carries
        flank = jnp.where(touch.side != FREE, touch.side, side)
        result = self._shared(moved, flight, flank, met, bounds)
        wall = walls(
            result.flanks, result.speed, jnp.asarray(bounds.closing), slide.end, slide.end_rate
        )
        on_b, rests = result.side > 0, result.side != FREE
        offset = jnp.where(on_b, wall.upper, wall.lower)
        rate = jnp.where(on_b, wall.upper_rate, wall.lower_rate)
        offset = jnp.where(rests, offset, result.offset)
        return replace(
            result,
            offset=jnp.clip(offset, wall.lower, jnp.maximum(wall.lower, wall.upper)),
            drift=jnp.where(rests, rate, result.drift),
        ), touch

    def _slowing(self, shafts: Shafts, bounds: Bounds, step: Scalar) -> Scalar:
        """Return the acceleration of the driven shaft in flight, rad/s²; 0 if it has no inertia."""
        driven_speed = bounds.ratio * shafts.speed + shafts.drift
        heavy = jnp.asarray(self.driven.inertia) > 0
        drag = eqx.tree_at(
            lambda drag: drag.inertia, self.driven, jnp.where(heavy, self.driven.inertia, 1.0)
        )
        return jnp.where(heavy, drag.acceleration(driven_speed, 0.0, step), 0.0)

    def _elastic_step(self, torque, closed, plant, shafts, slide, bounds, step):
        """Return both shafts after a time step with elastic teeth, and the contact event.

        The flank in contact exerts a torque on both shafts; `torque` is that of the motor, N m.
        """
        ratio, closing = jnp.asarray(bounds.ratio), jnp.asarray(bounds.closing)
        now = walls(shafts.flanks, shafts.speed, closing, slide.start, slide.start_rate)
        nearer = jnp.where(2 * shafts.offset > now.lower + now.upper, ON_B, -ON_B)
        flank = jnp.where(shafts.side != FREE, shafts.side, nearer)
        predicted = bounds.at(shafts.angle + step * shafts.speed)
        slope = ratio + 0.5 * (_slope(shafts.flanks, flank) + _slope(predicted, flank))
        coupled = plant.coupled(self._inertia(slope))
        force = coupled.torque(shafts, now)
        # Friction of a loaded shaft opposes the contact torque, up to the Coulomb limit.
        limit, inertia = jnp.asarray(self.driving.coulomb), jnp.asarray(self.driving.inertia)
        push = jnp.clip(-slope * force, -limit - torque, limit - torque)
        push = jnp.where(force == 0, 0.0, push)
        separate = self.driving.acceleration(shafts.speed, torque + push, step) - push / inertia
        both = geared(self.driving, self.driven, slope)
        joint = both.acceleration(shafts.speed, torque, step)
        course = _course(shafts, jnp.where(closed, joint, separate), step)
        moved, touch = coupled.step(shafts, course, slide, bounds, step)
        slowing = coupled.slowing(shafts, now, ratio, step)
        flight = flown(shafts, course, ratio, slowing, step)
        return self._shared(moved, flight, flank, ~closed, bounds, slope), touch

    def _inertia(self, slope: Scalar) -> Scalar:
        """Return m = J₁ J₂/(J₁ + k² J₂), the inertia of the relative motion, kg m² (k: `slope`)."""
        driving, driven = jnp.asarray(self.driving.inertia), self.driven.inertia
        return driving * driven / (driving + slope**2 * driven)

    def _shared(self, moved, flight, flank, met, bounds, slope=None) -> Shafts:
        """Return both shafts after the torque of a flank has moved both of them.

        `moved` is the state in which the flank has moved the driven shaft alone. The flank changed
        x = φ₂ − i φ₁ by the difference between `moved` and `flight`, which is x without contact.
        Of this change, the driving shaft takes −k m/J₁ and the driven shaft keeps m/J₂ (see the
        text of this module). Where `met` is false, nothing is shared.

        **Arguments**
        - `flank`: flank that exerts the torque, `ON_A` or `ON_B`.
        - `slope`: k = i + ∂TE/∂φ₁; by default computed for `flank` at the state `moved`.
        """
        if slope is None:
            slope = jnp.asarray(bounds.ratio) + _slope(moved.flanks, flank)
        share = slope * self._inertia(slope) / self.driving.inertia
        turned = jnp.where(met, share * (moved.offset - flight[0]), 0.0)
        rate = jnp.where(met, share * (moved.drift - flight[1]), 0.0)
        te_slope = slope - bounds.ratio
        angle = moved.angle - turned
        return replace(
            moved,
            angle=angle,
            speed=moved.speed - rate,
            offset=moved.offset - te_slope * turned,
            drift=moved.drift - te_slope * rate,
            flanks=bounds.at(angle),
        )


def geared(driving: Drag, driven: Drag, slope: Float[Number, ""]) -> Drag:
    """Return inertia, friction and load of both shafts as one body, referred to the driving shaft.

    `slope` is k in φ̇₂ = k φ̇₁.
    """
    return Drag(
        inertia=driving.inertia + slope**2 * driven.inertia,
        coulomb=driving.coulomb + slope * driven.coulomb,
        viscous=driving.viscous + slope**2 * driven.viscous,
        stribeck=slope * driven.stribeck,
        stribeck_speed=driven.stribeck_speed / slope,
        load=slope * driven.load,
        sticky=driven.sticky,
    )


def _slope(flanks: Flanks, side: Scalar) -> Scalar:
    """Return dTE/dφ₁ of the flank `side`; for `FREE`, the slope of flank A."""
    return jnp.where(side > 0, flanks.upper_slope, flanks.lower_slope)


def _course(shafts: Shafts, acceleration: Scalar, step: Scalar) -> MotionPoint:
    """Return the driving shaft after a step (s) of constant acceleration (rad/s²)."""
    speed = shafts.speed + step * acceleration
    angle = shafts.angle + 0.5 * step * (shafts.speed + speed)
    return MotionPoint(angle, speed, acceleration)

"""Teeth that give way: a spring and a damper at each flank that never pull."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.arrays import Number, float64
from .bounds import Bounds
from .cubic import Cubic, cubic, first_root
from .motion import MotionPoint
from .plant import Drag, Plant, Shafts, Slide, Touch, newly_met, touching, walls

_LONGEST = 1.0
"""Natural radians a step. The kink of the torque costs accuracy there, no stability: a contact with
ζ ≥ 0.1 loses energy all the same, an undamped one may gain a tenth. From 2 on all may gain."""


class ElasticPlant(Plant):
    """Contact torque c p + d ṗ at a penetration p, the damping at most as large as the spring.

    p is how far x is beyond a flank, rad of the driven shaft; d = 2 ζ √(c J₂). The torque turns the
    driven shaft alone: the driving shaft goes where its motion takes it. Each step is one of the
    classical Runge–Kutta method with both flanks as cubics inside it.

    **Arguments**
    - `drag`: inertia and friction of the driven shaft.
    - `stiffness`: c, N m/rad. - `damping_ratio`: ζ.
    """

    drag: Drag
    stiffness: Float[Number, ""] = eqx.field(converter=float64)
    damping_ratio: Float[Number, ""] = eqx.field(converter=float64)

    def step(
        self, shafts: Shafts, ahead: MotionPoint, slide: Slide, bounds: Bounds, step: Number
    ) -> tuple[Shafts, Touch]:
        """See `Plant.step`."""
        ratio, closing = jnp.asarray(bounds.ratio), jnp.asarray(bounds.closing)
        flanks = bounds.at(ahead.angle)
        now = walls(shafts.flanks, shafts.speed, closing, slide.start, slide.start_rate)
        then = walls(flanks, ahead.speed, closing, slide.end, slide.end_rate)
        low = cubic(now.lower, then.lower, now.lower_rate, then.lower_rate, step)
        high = cubic(now.upper, then.upper, now.upper_rate, then.upper_rate, step)
        way = cubic(shafts.angle, ahead.angle, shafts.speed, ahead.speed, step)

        def rates(share: float, offset: Array, drift: Array) -> tuple[Array, Array]:
            at = jnp.asarray(share)
            turning = ratio * way.slope(at) / step + drift
            torque = self.push(low.at(at) - offset, low.slope(at) / step - drift)
            torque -= self.push(offset - high.at(at), drift - high.slope(at) / step)
            gained = self.drag.acceleration(turning, torque, jnp.asarray(step))
            return drift, gained - ratio * way.bend(at) / step**2

        offset, drift = _runge_kutta(rates, shafts.offset, shafts.drift, jnp.asarray(step))
        below, above = offset <= then.lower, offset >= then.upper
        side = touching(below, above, shafts.side)
        flight = cubic(shafts.offset, offset, shafts.drift, drift, step)
        away = Cubic(
            *(jnp.where(below, f - a, b - f) for f, a, b in zip(flight, low, high, strict=True))
        )
        share = first_root(away)
        met = newly_met(below, above, side, shafts.side)
        touch = Touch(met, way.at(share), high.at(share) - low.at(share))
        return Shafts(ahead.angle, ahead.speed, offset, drift, side, flanks), touch

    def push(
        self, depth: Float[Array, "*shape"], deepening: Float[Array, "*shape"]
    ) -> Float[Array, "*shape"]:
        """Torque of one flank at a penetration in rad that grows by rad/s, never negative."""
        stiffness = jnp.asarray(self.stiffness)
        spring = stiffness * jnp.maximum(depth, 0.0)
        damping = 2 * self.damping_ratio * jnp.sqrt(stiffness * self.drag.inertia)
        return spring + jnp.clip(damping * deepening, -spring, spring)


def mesh_stiffness(c_gamma_N_mm_um: float, face_width_mm: float, base_radius_mm: float) -> float:
    """Stiffness at the driven shaft, N m/rad: c_γ b r_b², c_γ in N/(mm µm) as in ISO 6336.

    **Example**
    ```python
    >>> from vttig_jax.control.elastic_teeth import mesh_stiffness
    >>> f"{mesh_stiffness(20.0, 20.0, 75.18):.3g}"
    '2.26e+06'

    ```
    """
    return 1e6 * c_gamma_N_mm_um * face_width_mm * (1e-3 * base_radius_mm) ** 2


def largest_step(stiffness: float, damping_ratio: float, inertia: float) -> float:
    """Longest step in s that follows a contact, from its fastest natural frequency."""
    overdamped = np.sqrt(max(damping_ratio**2 - 1.0, 0.0))
    fastest = np.sqrt(stiffness / inertia) * max(1.0, damping_ratio + overdamped)
    return float(_LONGEST / fastest)


def _runge_kutta(rates, offset, drift, step):
    """One step of the classical fourth order; `rates` takes the share of the step."""
    x1, v1 = rates(0.0, offset, drift)
    x2, v2 = rates(0.5, offset + 0.5 * step * x1, drift + 0.5 * step * v1)
    x3, v3 = rates(0.5, offset + 0.5 * step * x2, drift + 0.5 * step * v2)
    x4, v4 = rates(1.0, offset + step * x3, drift + step * v3)
    sixth = step / 6
    return offset + sixth * (x1 + 2 * x2 + 2 * x3 + x4), drift + sixth * (v1 + 2 * v2 + 2 * v3 + v4)

"""Plant with rigid teeth: free flight through the gap, and impacts with restitution."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from ...base.arrays import Number
from ...kinematics.flank_table import Bounds
from ..fields import Quantity, number
from ..hermite import cubic, first_root
from ..motion.motion import MotionPoint
from .plant import FREE, ContactEvent, Drag, Plant, Shafts, Slide, newly_met, touching, walls


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
        ratio, closing = jnp.asarray(bounds.ratio), jnp.asarray(bounds.closing)
        step = jnp.asarray(step)
        flanks = bounds.at(driving.angle)
        now = walls(shafts.flanks, shafts.speed, closing, slide.start, slide.start_rate)
        then = walls(flanks, driving.speed, closing, slide.end, slide.end_rate)
        driven_speed = ratio * shafts.speed + shafts.drift
        slowing = self.drag.acceleration(driven_speed, 0.0, step)
        turned = step * (driven_speed + 0.5 * step * slowing)
        free = shafts.offset + turned - ratio * (driving.angle - shafts.angle)
        drift = shafts.drift + step * slowing - ratio * (driving.speed - shafts.speed)

        below, above = free <= then.lower, free >= then.upper
        hit = below | above
        low = cubic(now.lower, then.lower, now.lower_rate, then.lower_rate, step)
        high = cubic(now.upper, then.upper, now.upper_rate, then.upper_rate, step)
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
        touch = ContactEvent(met, way.at(share), high.at(share) - low.at(share), share)
        offset = jnp.where(stays, end, jnp.where(hit, offset, free))
        drift = jnp.where(stays, end_rate, jnp.where(hit, rebound + rest * pull, drift))
        return (
            Shafts(
                angle=driving.angle,
                speed=driving.speed,
                offset=jnp.clip(offset, then.lower, then.upper),
                drift=drift,
                side=jnp.where(stays, side, FREE),
                flanks=flanks,
            ),
            touch,
        )

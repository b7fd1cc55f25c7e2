"""Rigid teeth: the driven shaft flies through the gap, meets a flank, bounces or stays."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Float

from ...base.arrays import Number, float64
from ..hermite import Cubic, cubic, first_root
from ..motion.motion import MotionPoint
from .flank_bounds import Bounds
from .plant import FREE, ContactEvent, Drag, Plant, Shafts, Slide, newly_met, touching, walls


class RigidPlant(Plant):
    """Inertia and friction in the gap, Newton's impact law at the flanks.

    In the gap J₂ φ̈₂ = −drag. At a flank that the driven shaft meets with relative speed w it leaves
    with −ε w; where it would come back within the same step it stays, and moves with the flank
    until the flank falls behind. The instant of the impact is located inside the step.

    **Arguments**
    - `drag`: inertia and friction of the driven shaft.
    - `restitution`: ε, 0 … 1.
    """

    drag: Drag
    restitution: Float[Number, ""] = eqx.field(converter=float64)

    def step(
        self, shafts: Shafts, ahead: MotionPoint, slide: Slide, bounds: Bounds, step: Number
    ) -> tuple[Shafts, ContactEvent]:
        """See `Plant.step`."""
        ratio, closing = jnp.asarray(bounds.ratio), jnp.asarray(bounds.closing)
        step = jnp.asarray(step)
        flanks = bounds.at(ahead.angle)
        now = walls(shafts.flanks, shafts.speed, closing, slide.start, slide.start_rate)
        then = walls(flanks, ahead.speed, closing, slide.end, slide.end_rate)
        turning = ratio * shafts.speed + shafts.drift
        slowing = self.drag.acceleration(turning, 0.0, step)
        turned = step * (turning + 0.5 * step * slowing)
        free = shafts.offset + turned - ratio * (ahead.angle - shafts.angle)
        drift = shafts.drift + step * slowing - ratio * (ahead.speed - shafts.speed)

        below, above = free <= then.lower, free >= then.upper
        hit = below | above
        low = cubic(now.lower, then.lower, now.lower_rate, then.lower_rate, step)
        high = cubic(now.upper, then.upper, now.upper_rate, then.upper_rate, step)
        wall = Cubic(*(jnp.where(below, a, b) for a, b in zip(low, high, strict=True)))
        inwards = jnp.where(below, 1.0, -1.0)
        flight = cubic(shafts.offset, free, shafts.drift, drift, step)
        away = Cubic(*(inwards * (f - w) for f, w in zip(flight, wall, strict=True)))
        share = first_root(away)
        rest, rate = (1 - share) * step, 1.0 / step
        bounced = (wall.slope(share) - inwards * self.restitution * away.slope(share)) * rate
        pull = (drift - shafts.drift) * rate
        offset = wall.at(share) + rest * (bounced + 0.5 * rest * pull)
        reached = jnp.where(below, then.lower, then.upper)
        reached_rate = jnp.where(below, then.lower_rate, then.upper_rate)
        side = touching(below, above, shafts.side)
        stays = hit & ((shafts.side == side) | (inwards * (offset - reached) <= 0))

        met = newly_met(below, above, side, shafts.side)
        way = cubic(shafts.angle, ahead.angle, shafts.speed, ahead.speed, step)
        touch = ContactEvent(met, way.at(share), high.at(share) - low.at(share), share)
        offset = jnp.where(stays, reached, jnp.where(hit, offset, free))
        drift = jnp.where(stays, reached_rate, jnp.where(hit, bounced + rest * pull, drift))
        return (
            Shafts(
                ahead.angle,
                ahead.speed,
                jnp.clip(offset, then.lower, then.upper),
                drift,
                jnp.where(stays, side, FREE),
                flanks,
            ),
            touch,
        )

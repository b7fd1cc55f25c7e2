"""Plant of the play operator: the driven shaft stands still unless a flank pushes it."""

import jax
import jax.numpy as jnp

from ...base.arrays import Number
from ...kinematics.flank_table import Bounds
from ..hermite import cubic, first_root
from ..motion.motion import MotionPoint
from .plant import ContactEvent, Plant, Shafts, Slide, newly_met, touching, walls


class Play(Plant):
    """Plant whose driven shaft stands still in the gap and does not rebound from a flank.

    In a step in which the driving shaft turns by Δφ₁, the offset x = φ₂ − i φ₁ becomes
    x ← min(max(x − i Δφ₁, lower wall), upper wall)
    """

    def step(
        self, shafts: Shafts, driving: MotionPoint, slide: Slide, bounds: Bounds, step: Number
    ) -> tuple[Shafts, ContactEvent]:
        """See `Plant.step`."""
        ratio, closing = jnp.asarray(bounds.ratio), jnp.asarray(bounds.closing)
        flanks = bounds.at(driving.angle)
        now = walls(shafts.flanks, shafts.speed, closing, slide.start, slide.start_rate)
        then = walls(flanks, driving.speed, closing, slide.end, slide.end_rate)
        free = shafts.offset - ratio * (driving.angle - shafts.angle)
        below, above = free <= then.lower, free >= then.upper
        side = touching(below, above, shafts.side)
        held = cubic(shafts.offset, free, -ratio * shafts.speed, -ratio * driving.speed, step)
        low = cubic(now.lower, then.lower, now.lower_rate, then.lower_rate, step)
        high = cubic(now.upper, then.upper, now.upper_rate, then.upper_rate, step)
        depth = jax.tree.map(lambda h, a, b: jnp.where(below, h - a, b - h), held, low, high)
        share = first_root(depth)
        way = cubic(shafts.angle, driving.angle, shafts.speed, driving.speed, step)
        met = newly_met(below, above, side, shafts.side)
        touch = ContactEvent(met, way.at(share), high.at(share) - low.at(share), share)
        offset = jnp.clip(free, then.lower, then.upper)
        rate = jnp.where(
            below, then.lower_rate, jnp.where(above, then.upper_rate, -ratio * driving.speed)
        )
        return Shafts(
            angle=driving.angle,
            speed=driving.speed,
            offset=offset,
            drift=rate,
            side=side,
            flanks=flanks,
        ), touch

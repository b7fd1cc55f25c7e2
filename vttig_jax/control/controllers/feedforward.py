"""Baseline controller: the motor jumps across the gap, and no gear is shifted."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.arrays import Number, float64
from ..plants.flank_bounds import Bounds
from .controller import Command, Controller, Measurement

_STILL = 1e-6
"""Speed below which the motion stands, rad/s: a chosen value above the rounding of recordings."""


class LeadJump(eqx.Module):
    """State of the jump across the gap.

    - `time`: time of the last period, s. - `sense`: last direction of the motion, 1 or −1.
    - `progress`: elapsed share of the jump time. - `advance`: last commanded lead, rad.
    """

    time: Float[Array, ""]
    sense: Float[Array, ""]
    progress: Float[Array, ""]
    advance: Float[Array, ""]


class FeedforwardController(Controller):
    """Controller that lets the driving shaft lead a reversed motion by the gap at its own angle.

        φ₁ = φ_ref − S j(φ₁)/i,  S = p³ (10 − 15 p + 6 p²)

    p rises from 0 to 1 within the jump time once the motion runs backwards, and falls to 0 once it
    runs forwards. With S = 1 on flank B the driven shaft stands where flank A would put it,
    φ₂ = i φ_ref + TE_A(φ₁): this compensates the lost motion, but not the transmission error of the
    flanks. The reversal is read from the motion, as in a motor controller; no encoder is needed.

    **Arguments**
    - `bounds`: flanks of the map that the controller uses. - `jump_s`: time of the jump, s.
    """

    closes: ClassVar[bool] = False
    advances: ClassVar[bool] = True

    bounds: Bounds
    jump_s: Float[Number, ""] = eqx.field(converter=float64)

    def start(self) -> LeadJump:
        """Return the state on flank A without a lead."""
        zero = jnp.zeros(())
        return LeadJump(zero, jnp.ones(()), zero, zero)

    def step(self, state: LeadJump, seen: Measurement) -> tuple[LeadJump, Command]:
        """Return the state after one period and the command of the lead."""
        moving = jnp.abs(seen.reference_speed) > _STILL
        sense = jnp.where(moving, jnp.sign(seen.reference_speed), state.sense)
        period = seen.time - state.time
        progress = jnp.clip(state.progress - sense * period / self.jump_s, 0.0, 1.0)
        share = progress**3 * (10 + progress * (6 * progress - 15))
        # The shaft reaches the commanded lead one period later.
        gap = self.bounds.gap(seen.reference + period * seen.reference_speed + state.advance)
        advance = -share * gap / self.bounds.ratio
        return LeadJump(seen.time, sense, progress, advance), Command(jnp.zeros(()), advance)

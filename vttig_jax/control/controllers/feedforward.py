"""Baseline controller: the motor moves quickly across the gap, and gear 2 is not shifted."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fields import Quantity, number
from .controller import Command, Controller, Measurement

_STILL = 1e-6
"""Reference speed below which the shaft counts as at rest, rad/s; a chosen value.

It lies above the rounding errors of recorded motions."""


class LeadJump(eqx.Module):
    """State of the motor's movement across the gap (the "jump").

    - `time`: time of the last period, s. - `sense`: last direction of the motion, 1 or −1.
    - `progress`: p, the completed part of the jump, 0 … 1. - `advance`: last commanded lead, rad.
    """

    time: Float[Array, ""]
    sense: Float[Array, ""]
    progress: Float[Array, ""]
    advance: Float[Array, ""]


class Feedforward(Controller):
    """Controller that turns the driving shaft by the gap ahead of the reference after a reversal.

        φ₁ = φ_ref − S j(φ₁)/i,  S = p³ (10 − 15 p + 6 p²)

    While the reference moves backwards, p rises from 0 to 1 within the jump time; while it moves
    forwards, p falls to 0. With S = 1 and contact on flank B, the driven shaft is at
    φ₂ = i φ_ref + TE_A(φ₁), as if flank A were in contact: this compensates the lost motion, but
    not the transmission error of the flanks. The controller detects the reversal in the reference
    motion, as a motor controller does, and needs no encoder.
    """

    closes: ClassVar[bool] = False
    advances: ClassVar[bool] = True

    jump_s: Quantity = number(
        0.005, "feedforward: time in which the motor crosses the gap", "s", gt=0, le=1e3
    )

    def start(self) -> LeadJump:
        """Return the state on flank A without a lead."""
        zero = jnp.zeros(())
        return LeadJump(zero, jnp.ones(()), zero, zero)

    def step(self, state: LeadJump, seen: Measurement) -> tuple[LeadJump, Command]:
        """Return the state after one controller period and the command with the lead (rad)."""
        moving = jnp.abs(seen.reference_speed) > _STILL
        sense = jnp.where(moving, jnp.sign(seen.reference_speed), state.sense)
        period = seen.time - state.time
        progress = jnp.clip(state.progress - sense * period / self.jump_s, 0.0, 1.0)
        share = progress**3 * (10 + progress * (6 * progress - 15))
        # The shaft reaches the commanded lead one period later.
        gap = seen.map.gap(seen.reference + period * seen.reference_speed + state.advance)
        advance = -share * gap / seen.map.ratio
        return LeadJump(seen.time, sense, progress, advance), Command(jnp.zeros(()), advance)

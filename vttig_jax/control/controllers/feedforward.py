"""The usual baseline: the motor jumps over the gap, nobody shifts a gear."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.arrays import Number, float64
from ..plants.flank_bounds import Bounds
from .controller import Command, Controller, Measurement

_STILL = 1e-6
"""rad/s below which the motion stands: the rounding of a recorded one has no sense."""


class LeadJump(NamedTuple):
    """How far over the gap the motor is.

    - `time`: of the last period, s. - `sense`: in which the motion last went, 1 or −1.
    - `progress`: share of the time of the jump. - `advance`: rad asked for last.
    """

    time: Float[Array, ""]
    sense: Float[Array, ""]
    progress: Float[Array, ""]
    advance: Float[Array, ""]


class FeedforwardController(Controller):
    """Lets the driving shaft run ahead of a motion that turned, by the gap at its own angle.

        φ₁ = φ_ref − S j(φ₁)/i,  S = p³ (10 − 15 p + 6 p²)

    p goes from 0 to 1 within the time of the jump once the motion goes backwards, and back to 0
    once it goes forwards. With S = 1 on flank B the driven shaft is where flank A would have it,
    φ₂ = i φ_ref + TE_A(φ₁): the lost motion is made up for, the transmission error of the flanks is
    not. It knows the turn from the motion itself, as a motor controller does, and needs no encoder.

    **Arguments**
    - `bounds`: the map the controller believes. - `jump_s`: time of the jump, s.
    """

    closes: ClassVar[bool] = False
    advances: ClassVar[bool] = True

    bounds: Bounds
    jump_s: Float[Number, ""] = eqx.field(converter=float64)

    def start(self) -> LeadJump:
        """On flank A, nothing to make up for."""
        zero = jnp.zeros(())
        return LeadJump(zero, jnp.ones(()), zero, zero)

    def step(self, state: LeadJump, seen: Measurement) -> tuple[LeadJump, Command]:
        """As far as the jump is in this period."""
        goes = jnp.abs(seen.reference_speed) > _STILL
        sense = jnp.where(goes, jnp.sign(seen.reference_speed), state.sense)
        period = seen.time - state.time
        progress = jnp.clip(state.progress - sense * period / self.jump_s, 0.0, 1.0)
        share = progress**3 * (10 + progress * (6 * progress - 15))
        # The command is reached a period later.
        gap = self.bounds.gap(seen.reference + period * seen.reference_speed + state.advance)
        advance = -share * gap / self.bounds.ratio
        return LeadJump(seen.time, sense, progress, advance), Command(jnp.zeros(()), advance)

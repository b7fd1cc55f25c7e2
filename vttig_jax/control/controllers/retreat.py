"""What a controller knows of its actuator: how far it may close the gap while teeth pass."""

import math
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.arrays import Number, Numbers, float64
from ...base.units import REV
from ...kinematics.flank_table import FlankTable, gathered, place_of

_ROWS = 32
"""Rows of the table in a cycle of the highest order: a chosen value.

The table is then within (2π/32)²/8 = 0.5 % of the amplitude of that order."""

_LEVELS = 17
"""Speeds of the table; a chosen value: for waves of 0.1 mm r is then within 0.006 mm."""


class Retreat(eqx.Module):
    """Largest displacement from which the actuator can open the gap again while teeth pass.

        r(φ, ω) = min over x of s(φ + x) + d(x/ω − delay),  x from 0 to a tooth pitch ahead

    s is the displacement that closes the gap, and d(t) the distance that the actuator can move and
    be back after the time t, both ways from standstill to standstill, each in half of the time; d
    is 0 for t < 0. r falls from s(φ) at standstill to the smallest s of the pitch at high speed. It
    is tabulated over φ and u = |ω|/(|ω| + ω₀), so that a step of a simulation needs one look-up.

    **Arguments**
    - `shift`: r at each angle for both senses of motion and all u, mm, shape (rows, 2, levels).
    - `slow`: ω₀, rad/s. - `start`, `step`: angle of the first row and distance of rows, rad.
    - `periodic`: whether the table repeats after its last row.
    """

    shift: Float[Numbers, "rows 2 levels"]
    slow: Float[Number, ""] = eqx.field(converter=float64)
    start: Float[Number, ""] = eqx.field(converter=float64)
    step: Float[Number, ""] = eqx.field(converter=float64)
    periodic: bool = eqx.field(static=True)

    def at(self, angle: Float[Array, ""], speed: Float[Array, ""]) -> Float[Array, ""]:
        """Return r, mm, at a driving angle (rad) and a driving speed (rad/s)."""
        rows = self.shift.shape[0] - 1
        share, row = place_of(angle, self.start, self.step, rows, self.periodic)
        level = (_LEVELS - 1) * (jnp.abs(speed) / (jnp.abs(speed) + jnp.asarray(self.slow)))
        below = jnp.minimum(jnp.floor(level), _LEVELS - 2.0)
        first = _LEVELS * (2 * row + jnp.where(speed < 0, 1, 0)) + below.astype(jnp.int32)
        (a, b), (c, d) = (gathered(self.shift, first + more, 2) for more in (0, 2 * _LEVELS))
        here, there = a + share * (c - a), b + share * (d - b)
        return here + (level - below) * (there - here)


def retreat_of(table: FlankTable, teeth: int, order: float, *limits: Any) -> Retreat:
    """Return the table for the map that the controller believes, of gears with taper.

    **Arguments**
    - `teeth`: number of teeth of the driving gear. - `order`: highest order of the map, cycles per
      driving turn.
    - `limits`: speed and acceleration of the actuator, mm/s and mm/s², and its delay, s.
    """
    count = math.ceil(_ROWS * order / teeth)
    rows = count * math.ceil(float(table.length) * teeth / REV * (1 - 1e-9))
    alike = replace(table, start=0.0)  # lanes may begin at different turns
    shift, slow = _tabulated(alike, rows, count, REV / teeth, *map(jnp.asarray, limits))
    return Retreat(shift, slow, table.start, table.length / rows, table.periodic)


@eqx.filter_jit
def _tabulated(
    table: FlankTable, rows: int, count: int, pitch: float, v: Any, a: Any, delay: Any
) -> Any:
    step = jnp.asarray(table.length) / rows
    closed = table.closed_at(table.gap(step * jnp.arange(rows + 1)))
    ahead = jnp.pad(closed, count, "edge")
    if table.periodic:
        ahead = jnp.pad(closed[:-1], (count, count + 1), "wrap")

    def smallest(rises: Float[Array, "count levels"]) -> Float[Array, "levels 2 rows"]:
        """Return the least of closed + rise from here to a pitch ahead in both senses."""

        def lower(number: Any, least: Any) -> Any:
            there = [
                jax.lax.dynamic_slice(ahead, (count + sign * number,), (rows + 1,))
                for sign in (1, -1)
            ]
            return jnp.minimum(least, jnp.stack(there)[None] + rises[number][:, None, None])

        start = jnp.full((rises.shape[1], 2, rows + 1), jnp.inf)
        return jax.lax.fori_loop(0, count + 1, lower, start)

    # At ω₀ a pitch takes four times as long as a move over the largest fall within a pitch. The
    # speeds of the table are no part of its meaning, so derivatives do not regard them.
    fall = jnp.max(closed[None] - smallest(jnp.zeros((count + 1, 1)))[0])
    move = jnp.where(fall < v**2 / a, 2 * jnp.sqrt(fall / a), v / a + fall / v)
    slow = jax.lax.stop_gradient(pitch / (4 * move))
    u = np.clip(np.linspace(0.0, 1.0, _LEVELS), 1e-9, 1 - 1e-9)
    time = jnp.outer(step * jnp.arange(count + 1), jnp.asarray((1 - u) / u)) / slow
    half = 0.5 * jnp.maximum(time - delay, 0.0)
    rises = jnp.where(half < 2 * v / a, 0.25 * a * half**2, v * (half - v / a))
    # The table must not lie below s(φ), which the controller knows exactly where the shaft stands.
    bow = jnp.max(jnp.abs(jnp.diff(closed, n=2))) / 4
    return jnp.transpose(smallest(rises.at[0].set(bow)), (2, 1, 0)), slow

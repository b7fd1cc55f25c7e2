"""The play operator: a driven shaft that moves only when a flank pushes it."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


@jax.jit
def play(
    lower: Float[Array, " n"], upper: Float[Array, " n"], start: Float[Array, ""]
) -> Float[Array, " n"]:
    """Follow x_t = min(max(x_{t−1}, lower_t), upper_t) from x_{−1} = `start`.

    **Arguments**
    - `lower`, `upper`: bounds with lower ≤ upper, shape (n,): the driven angle on flank A and B.
    - `start`: position before the first sample.
    """

    def follow(position, bounds):
        position = jnp.clip(position, *bounds)
        return position, position

    return jax.lax.scan(follow, start, (lower, upper))[1]

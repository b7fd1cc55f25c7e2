"""Stationary noise with exponential memory, a long path at once."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray


def ar_noise(
    key: PRNGKeyArray, count: int, correlation: Float[Array, ""]
) -> Float[Array, " count"]:
    """x_t = ρ x_{t−1} + √(1 − ρ²) w_t of unit variance, from its stationary start.

    The recursion is linear: within pieces of m ≈ √n samples it is one product with the triangle
    of the powers of ρ, and the ends of the pieces follow from each other the same way with ρᵐ.
    """
    size = int(np.ceil(np.sqrt(count)))
    shocks = jax.random.normal(key, (size, size))
    scale = jnp.full((size, size), jnp.sqrt(1 - correlation**2)).at[0, 0].set(1.0)
    inside = (scale * shocks) @ _powers(correlation, size).T
    ends = _powers(correlation**size, size) @ inside[:, -1]
    before = jnp.concatenate([jnp.zeros(1), ends[:-1]])
    carried = before[:, None] * correlation ** np.arange(1, size + 1)
    return (inside + carried).ravel()[:count]


def _powers(base: Float[Array, ""], size: int) -> Float[Array, "size size"]:
    """Lower triangle of base^(row − column)."""
    distance = np.subtract.outer(np.arange(size), np.arange(size))
    return jnp.where(distance >= 0, base ** np.maximum(distance, 0.0), 0.0)

"""Elementwise fixed points, differentiated implicitly."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

_MOST_ITERATIONS = 60


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def fixed_point(step: Callable[[Any, Any], Any], args: Any) -> Float[Array, "..."]:
    """Solve t = step(t, args) elementwise by iteration, starting at t = 0.

    `step` is a contraction in t; for an eccentric gear it contracts by e₂/R₂ (about 1e-3), so five
    iterations reach the last bit. The derivative follows from the solution alone,

        dt = (∂step/∂args · dargs) / (1 − ∂step/∂t),

    and never from the iterations, so it is exact in forward and reverse mode to any order.
    """
    return _iterated(step, args)


@fixed_point.defjvp
def _(step, primals, tangents):
    (args,), (moving,) = primals, tangents
    value = fixed_point(step, args)
    _, push = jax.linearize(step, value, args)
    forced = push(jnp.zeros_like(value), moving)
    slope = push(jnp.ones_like(value), jax.tree.map(jnp.zeros_like, moving))
    return value, forced / (1 - slope)


@partial(jax.jit, static_argnums=0)
def _iterated(step: Callable[[Any, Any], Any], args: Any) -> Float[Array, "..."]:
    """The iteration, compiled once for each `step`: also outside a compiled function."""

    def unsettled(state):
        value, previous, iteration = state
        scale = jnp.maximum(jnp.abs(value), 1.0)
        moved = jnp.abs(value - previous) > 2 * jnp.finfo(value.dtype).eps * scale
        return (iteration < _MOST_ITERATIONS) & jnp.any(moved)

    def iterate(state):
        value, _, iteration = state
        return step(value, args), value, iteration + 1

    first = jax.eval_shape(step, 0.0, args)
    zero = jnp.zeros(first.shape, first.dtype)
    return jax.lax.while_loop(unsettled, iterate, (zero, zero + jnp.inf, 0))[0]

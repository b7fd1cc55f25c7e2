"""Field converter of the frozen objects: user numbers stay NumPy float64 until compiled."""

from typing import Any

import jax
import numpy as np


def float64(value: Any) -> Any:
    """Return a NumPy float64 array; JAX arrays (and tracers) pass through unchanged.

    A plain Python float would be static under `filter_jit` and recompile for every new value; a
    `jnp.asarray` at construction would be cut to float32 while 64-bit mode is still off.
    """
    return value if isinstance(value, jax.Array) else np.asarray(value, np.float64)

"""Fields that keep NumPy float64 numbers, and public functions that are compiled once."""

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

Numbers = jax.Array | np.ndarray
"""Array type of everything that is NumPy outside a compiled function and JAX inside."""

Number = Numbers | np.float64
"""The same for scalars, which NumPy reduces to its own kind."""


def float64(value: Any) -> Any:
    """Return a NumPy float64 array; JAX arrays (and tracers) pass through unchanged.

    A plain Python float would be static under `filter_jit` and recompile for every new value; a
    `jnp.asarray` at construction would be cut to float32 while 64-bit mode is still off.
    """
    return value if isinstance(value, jax.Array) else np.asarray(value, np.float64)


def namespace(*values: Any) -> Any:
    """`jax.numpy` where a value is a JAX array (or tracer), else `numpy`.

    Formulas of derived quantities written over it keep all digits of user numbers in 32-bit mode
    and cost no compilation outside a compiled function.
    """
    return jnp if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(values)) else np


_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def compiled(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Jit `function` with plain numbers traced like arrays: new values never recompile it."""
    jitted = eqx.filter_jit(function)

    def traced(leaf: Any) -> Any:
        return float64(leaf) if isinstance(leaf, (int, float)) else leaf

    @wraps(function)
    def call(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        args, kwargs = jax.tree.map(traced, (args, kwargs))
        return jitted(*args, **kwargs)

    return call

"""Array types, the converter of float64 fields, and compilation without static numbers."""

from collections.abc import Callable
from functools import wraps
from inspect import signature
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

Numbers = jax.Array | np.ndarray
"""Array that is a NumPy array outside compiled functions and a JAX array inside them."""

Number = Numbers | np.float64
"""Scalar counterpart of `Numbers`; NumPy operations on 0-dimensional arrays give `np.float64`."""


def float64(value: Any) -> Any:
    """Convert to a NumPy float64 array, and return JAX arrays (and tracers) unchanged.

    A plain Python float is static under `filter_jit`, so every new value would recompile the
    function. `jnp.asarray` would round to float32 while the 64-bit mode is off.
    """
    return value if isinstance(value, jax.Array) else np.asarray(value, np.float64)


_PLAIN = (np.ndarray, np.generic, float, int)


def namespace(*values: Any) -> Any:
    """Return `jax.numpy` if a value contains a JAX array (or tracer), else `numpy`.

    Formulas that use this namespace keep all digits of the user's numbers in 32-bit mode, and they
    need no compilation outside a compiled function.
    """
    if all(isinstance(value, _PLAIN) for value in values):
        return np
    return jnp if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(values)) else np


def known(*trees: Any) -> bool:
    """Return whether the pytrees contain only known numbers, none that JAX traces."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees))


def written(self: Any) -> str:
    """Return an object as its constructor would be written, with the numbers of its arrays.

    Arguments that have their default are left out.
    """
    shown = []
    for name, argument in signature(type(self)).parameters.items():
        value = getattr(self, name)
        if isinstance(value, (*_PLAIN, jax.Array)) and known(value):
            value = np.asarray(value).tolist()
            value = tuple(value) if isinstance(value, list) else value
        if repr(value) != repr(argument.default):
            shown.append(f"{name}={value!r}")
    return f"{type(self).__name__}({', '.join(shown)})"


_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def compiled(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Return `function` jitted, with Python numbers among its arguments traced like arrays.

    So a call with new values does not recompile the function.
    """
    jitted = eqx.filter_jit(function)

    def traced(leaf: Any) -> Any:
        return float64(leaf) if isinstance(leaf, (int, float)) else leaf

    @wraps(function)
    def call(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        args, kwargs = jax.tree.map(traced, (args, kwargs))
        return jitted(*args, **kwargs)

    return call

"""Public functions of arrays, compiled once for all numbers."""

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax

from .arrays import float64

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

"""Options of XLA for programs that run once, where this version knows them."""

from functools import cache
from typing import Any

import jax

_OPTIONS = {"xla_cpu_use_fusion_emitters": False}
"""Half the time to compile. Newer versions of XLA have no such option."""


@cache
def fast_to_compile() -> dict[str, Any]:
    """Keyword arguments of `jax.jit`."""
    options: dict[str, Any] = {"compiler_options": _OPTIONS}
    try:
        jax.jit(lambda x: x + 1, **options)(0.0)
    except jax.errors.JaxRuntimeError:
        return {}
    return options

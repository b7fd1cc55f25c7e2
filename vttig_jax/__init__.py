"""Transmission error and backlash of gear pairs, identified from encoder logs, in JAX.

`__all__` lists the stable names. Each is imported when it is first used: `import vttig_jax` itself
imports neither jax nor numpy and configures nothing.
"""

from typing import Any

from .base.facade import lazy_names

_find, _, _names = lazy_names(__name__)
__all__ = ["__version__", *_names]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name != "__version__":
        return _find(name)
    from importlib.metadata import version

    globals()[name] = version("vttig-jax")
    return globals()[name]


def __dir__() -> list[str]:
    return sorted(__all__)

"""Lazy import of the public names of the package and of its rooms at their first use."""

from collections.abc import Callable, Mapping
from importlib import import_module
from sys import modules
from typing import Any


def lazy_names(
    package: str, homes: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a package that imports its names lazily (PEP 562).

    **Arguments**
    - `package`: its `__name__`. - `homes`: public name → dotted submodule, relative to the package.

    **Example**
    ```python
    >>> from vttig_jax.base.facade import lazy_names
    >>> getattr_, dir_ = lazy_names("vttig_jax.base", {"DEG": "units"})
    >>> getattr_("DEG") < 0.02, dir_()
    (True, ['DEG'])

    ```
    """

    def load_name(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{homes[name]}"), name)
        setattr(modules[package], name, value)
        return value

    return load_name, lambda: sorted(homes)


def from_front_door(name: str) -> Any:
    """Return a public name of the package, for methods of results that lead to a higher room."""
    return getattr(import_module(__name__.split(".")[0]), name)

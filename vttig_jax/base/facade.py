"""Lazy import of the public names of the package and of its rooms (subpackages) at first use."""

from collections.abc import Callable
from importlib import import_module
from sys import modules
from typing import Any


def lazy_names(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package that imports lazily (PEP 562).

    The stub of the package, `__init__.pyi`, states its public names, one import per line. Editors
    and type checkers read the same stub. A subpackage (`from . import room as room`) is imported
    lazily too, but it is not in `__all__`.

    **Example**
    ```python
    >>> from vttig_jax.base.facade import lazy_names
    >>> getattr_, dir_, all_ = lazy_names("vttig_jax.base")
    >>> getattr_("DEG") < 0.02, "DEG" in dir_(), "DEG" in all_
    (True, True, True)

    ```
    """
    with open(f"{modules[package].__file__}i", encoding="utf-8") as stub:
        lines = [line.split() for line in stub if line.startswith("from .")]
    homes = {words[-1]: words[1] for words in lines}
    public = sorted(name for name, home in homes.items() if home != ".")

    def load_name(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        if homes[name] == ".":
            return import_module(f"{package}.{name}")
        value = getattr(import_module(homes[name], package), name)
        setattr(modules[package], name, value)
        return value

    return load_name, public.copy, public


def from_front_door(name: str) -> Any:
    """Return the object with the public name `name` of `vttig_jax`.

    Methods of results use it to call code of a higher subpackage that they must not import.
    """
    return getattr(import_module(__name__.split(".")[0]), name)

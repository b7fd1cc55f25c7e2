"""Public names of a room that are imported when they are first used."""

from collections.abc import Callable, Mapping
from importlib import import_module
from sys import modules
from typing import Any


def lazy_names(
    package: str, homes: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a package whose public names live in its submodules (PEP 562).

    **Arguments**
    - `package`: its `__name__`. - `homes`: public name → submodule, dotted, below the package.

    **Example**
    ```python
    >>> from vttig_jax.base.facade import lazy_names
    >>> getattr_, dir_ = lazy_names("vttig_jax.base", {"DEG": "units"})
    >>> getattr_("DEG") < 0.02, dir_()
    (True, ['DEG'])

    ```
    """

    def find(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{homes[name]}"), name)
        setattr(modules[package], name, value)
        return value

    return find, lambda: sorted(homes)

"""Annotations are checked at run time, at the first calls of every function in every test.

A check of shapes takes some 30 µs, and a fit calls small functions a hundred thousand times. A
wrong shape nearly always shows at the first calls.
"""

import functools
import inspect
from collections.abc import Callable
from typing import Any

import jaxtyping

CALLS = 20
"""Number of calls of a function that are checked in each test (chosen value)."""

_check = jaxtyping.jaxtyped
_test = 0
"""Number of the test that runs; functions that have counted in another test count anew."""


def next_test() -> None:
    """Check the first calls of every function again."""
    global _test
    _test += 1


def install(packages: list[str]) -> None:
    """Check the annotations of these packages, which must not have been imported yet."""
    jaxtyping.jaxtyped = first_calls
    jaxtyping.install_import_hook(packages, "beartype.beartype")


def first_calls(function: Any = None, *, typechecker: Any) -> Any:
    """Stand for `jaxtyping.jaxtyped`, whose arguments these are, and check the first calls only.

    Of a dataclass the first constructions are checked.
    """
    if function is None:
        return functools.partial(first_calls, typechecker=typechecker)
    if inspect.isclass(function):
        plain = function.__init__
        made = _check(function, typechecker=typechecker)
        if made.__init__ is not plain:
            made.__init__ = _counted(plain, made.__init__)
        return made
    checked = _check(function, typechecker=typechecker)
    return _counted(function, checked) if inspect.isfunction(function) else checked


def _counted(plain: Callable[..., Any], checked: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that is `checked` at the first calls of a test and `plain` afterwards."""
    test, calls = -1, 0

    @functools.wraps(plain)
    def counted(*args: Any, **keywords: Any) -> Any:
        nonlocal test, calls
        if test != _test:
            test, calls = _test, 0
        calls += 1
        return (checked if calls <= CALLS else plain)(*args, **keywords)

    return counted

"""Cores that a process may use, and the limit of the BLAS libraries to one thread."""

import os
from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def usable_cores() -> int:
    """Return the number of cores that this process may use.

    **Example**
    ```python
    >>> from vttig_jax.base.threads import usable_cores
    >>> usable_cores() >= 1
    True

    ```
    """
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def one_blas_thread(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Limit the BLAS libraries of NumPy and SciPy to one thread while `function` runs.

    The matrices of a log are so small that several threads do not save time. On a busy machine
    the threads wait for each other, and a fit takes up to sixty times as long.

    **Example**
    ```python
    >>> from vttig_jax.base.threads import one_blas_thread
    >>> one_blas_thread(sum)([1, 2])
    3

    ```
    """

    @wraps(function)
    def limited(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        with _controller().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


@cache
def _controller() -> ThreadpoolController:
    """Return the controller of the loaded libraries; SciPy has its own BLAS beside NumPy's."""
    import scipy.linalg  # noqa: F401

    return ThreadpoolController()

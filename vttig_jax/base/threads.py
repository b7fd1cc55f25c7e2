"""Limit of the BLAS libraries to one thread."""

from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


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

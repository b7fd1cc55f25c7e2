"""One thread for small linear algebra."""

from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def one_blas_thread(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Let the BLAS libraries of NumPy and SciPy use one thread while a function runs.

    The matrices of a log are small. A pool of threads gains nothing on them, and on a busy machine
    its threads wait for each other: a fit then takes up to sixty times as long.

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
    """The libraries that are loaded; SciPy brings its own beside that of NumPy."""
    import scipy.linalg  # noqa: F401

    return ThreadpoolController()

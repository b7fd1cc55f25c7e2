"""Blocks of a sweep on a cluster of `dask.distributed`: one block one task."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.util import find_spec

import jax

from ...base.errors import InputError, UsageError
from ...base.files.json_io import dumps
from ...base.runtime import enable_x64, prepare_cpu
from .batching import BatchRunner
from .blocks import Rows, SweepWork
from .cases import Recipe

_RETRIES = 3
"""Workers that a block may take down with it."""

_WAIT_S = 10
"""Until a scheduler answers and has a worker."""


def on_cluster(
    address: str,
    recipe: Recipe,
    todo: Sequence[int],
    done: Callable[[int, Rows], None],
    tick: Callable[[int], None],
) -> int:
    """Run blocks on the workers of a scheduler; a block whose worker is lost goes to another.

    Every worker process compiles and runs on its own. `done` is told each block as it comes.

    **Returns** how many workers there were at the beginning.

    **Raises** `UsageError` without `dask.distributed`, `InputError` for a scheduler that does not
    answer or has no worker, and for a block that fails on the workers.
    """
    if find_spec("distributed") is None:
        raise UsageError(
            "a cluster needs dask.distributed; install it with `pip install vttig-jax[dask]`."
        )
    from distributed import Client, as_completed
    from distributed.comm.addressing import get_address_host_port

    try:
        with suppress(NotImplementedError):  # of a scheduler in this process
            # A `Client` that is refused its address would complain once more when it is collected.
            get_address_host_port(address)
        client = Client(address, timeout=_WAIT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no scheduler answers ({error}); start one with `dask scheduler`.", where=address
        ) from None
    with client, client.as_current():
        try:
            client.wait_for_workers(1, timeout=_WAIT_S)
        except TimeoutError:
            raise InputError(
                f"the scheduler has no workers; start some with `dask worker {address}`.",
                where=address,
            ) from None
        workers = len(client.scheduler_info(n_workers=-1)["workers"])
        shared = client.scatter(recipe, broadcast=True)
        futures = client.map(
            _block, list(todo), recipe=shared, pure=False, retries=_RETRIES, key="vttig-block"
        )
        for future, answer in as_completed(futures, with_results=True, raise_errors=False):
            if future.status != "finished":
                raise InputError(
                    f"a block fails on the workers: {future.exception()}; see their logs, and go on"
                    " with --resume.",
                    where=address,
                )
            number, steps, rows = answer
            done(number, rows)
            tick(steps)
    return workers


def _block(number: int, recipe: Recipe) -> tuple[int, int, Rows]:
    """Number, lane-steps and rows of a block, on a worker."""
    steps = 0

    def tick(done: int) -> None:
        nonlocal steps
        steps += done

    rows = _work(recipe).run(number, tick)
    return number, steps, rows


_WORK: dict[str, SweepWork] = {}
"""What this worker has compiled, by the sweep it is of."""


def _work(recipe: Recipe) -> SweepWork:
    key = dumps(recipe.header)
    if key not in _WORK:
        with suppress(ValueError):  # another sweep has run here
            prepare_cpu()
        enable_x64()
        _WORK.clear()
        _WORK[key] = SweepWork(recipe.cases(), BatchRunner(jax.devices()[:1]))
    return _WORK[key]

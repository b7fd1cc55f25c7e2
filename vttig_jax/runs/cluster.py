"""Execution of blocks on a cluster of `dask.distributed`, one task per block."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.util import find_spec
from typing import Any

from ..base.errors import InputError, UsageError
from ..control.sweeps.table import Rows

_RETRIES = 3
"""Number of times that a block is run again after its worker was lost: a chosen value."""

_WAIT_S = 10
"""Limit of the wait for the scheduler and for its first worker, s: a chosen value."""

_LOST = (
    "the scheduler was lost; start it and its workers again, and continue with --resume if the"
    " sweep has an --out."
)


def run_blocks(
    address: str,
    block: Callable[[int, Any], tuple[int, int, Rows]],
    shared: Any,
    todo: Sequence[int],
    *,
    done: Callable[[int, Rows], None],
    progress: Callable[[int], None],
) -> int:
    """Run blocks on the workers of a scheduler; if a worker is lost, another one runs its block.

    `block(number, shared)` returns the block number, the amount of work for `progress`, and the
    rows of the block. Every worker process compiles its own programs. `done` is called with number
    and rows of each finished block.

    **Returns** the number of workers at the beginning.

    **Raises** `UsageError` without `dask.distributed`, `InputError` for a scheduler that does not
    answer or has no worker, and for a block that fails on the workers.
    """
    if find_spec("distributed") is None:
        raise UsageError(
            "a cluster needs dask.distributed; install it with `pip install vttig-jax[dask]`."
        )
    from distributed import Client, as_completed
    from distributed.comm.addressing import get_address_host_port
    from distributed.comm.core import CommClosedError

    try:
        with suppress(NotImplementedError):  # raised for a scheduler in this process
            # The address is checked first: a failed `Client` logs a second error when collected.
            get_address_host_port(address)
        client = Client(address, timeout=_WAIT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no scheduler answers ({error}); start one with `dask scheduler`.", where=address
        ) from None
    with client, client.as_current():
        try:
            client.wait_for_workers(1, timeout=_WAIT_S)
        except CommClosedError:
            raise InputError(_LOST, where=address) from None
        except TimeoutError:
            raise InputError(
                f"the scheduler has no workers; start some with `dask worker {address}`.",
                where=address,
            ) from None
        workers = len(client.scheduler_info(n_workers=-1)["workers"])
        sent = client.scatter(shared, broadcast=True)
        futures = client.map(
            block, list(todo), shared=sent, pure=False, retries=_RETRIES, key="vttig-block"
        )
        for future, answer in as_completed(futures, with_results=True, raise_errors=False):
            if future.status in ("lost", "cancelled"):
                raise InputError(_LOST, where=address)
            if future.status != "finished":
                raise InputError(
                    f"a block fails on the workers: {future.exception()}; see their logs, and"
                    " continue with --resume.",
                    where=address,
                )
            number, steps, rows = answer
            done(number, rows)
            progress(steps)
    return workers

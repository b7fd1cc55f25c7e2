"""Execution of blocks elsewhere, one task per block: in processes of this machine or on a cluster.

Reading a log and its checks hold Python's lock most of the time, so that threads do not use
several cores for them. A cluster is one of `dask.distributed`.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from importlib.util import find_spec
from typing import Any, NamedTuple

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


class Blocks(NamedTuple):
    """Blocks of rows that are to be computed.

    **Arguments**
    - `run`: function (number of a block, `shared`) → the number, the amount of work for `progress`,
      and the rows of the block. It is imported where it runs, and its arguments are pickled.
    - `shared`: what all blocks need. - `todo`: numbers of the blocks.
    - `done`: called with number and rows of each finished block.
    - `progress`: called with the amount of work of each finished block.
    """

    run: Callable[[int, Any], tuple[int, int, Rows]]
    shared: Any
    todo: Sequence[int]
    done: Callable[[int, Rows], None]
    progress: Callable[[int], None]

    def keep(self, number: int, steps: int, rows: Rows) -> None:
        """Hand on a finished block."""
        self.done(number, rows)
        self.progress(steps)


def run_in_processes(processes: int, blocks: Blocks) -> None:
    """Run blocks in new processes of this machine, which end with the caller, even if it is killed.

    **Raises** `InputError` if a process ends before its block is done.
    """
    # A fork would copy the locks of JAX's threads without the threads that release them.
    spawn = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(processes, mp_context=spawn, initializer=_begin)
    try:
        tasks = [pool.submit(blocks.run, number, blocks.shared) for number in blocks.todo]
        for future in as_completed(tasks):
            blocks.keep(*future.result())
    except BrokenProcessPool:
        raise InputError(
            "a process that fits a block of logs was ended from outside, perhaps because the memory"
            " was full; give fewer --jobs, and continue with --resume if there is an --out."
        ) from None
    except BaseException:
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _begin() -> None:
    """Prepare a new process: one thread of XLA, and its end together with the caller."""
    # XLA starts a thread for each core otherwise, and the last digits depend on their number.
    os.environ["NPROC"] = "1"
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the caller answers Ctrl-C
    threading.Thread(target=_end_with_caller, daemon=True).start()


def _end_with_caller() -> None:
    caller = multiprocessing.parent_process()
    assert caller is not None
    caller.join()
    os._exit(1)


def run_on_cluster(address: str, blocks: Blocks) -> int:
    """Run blocks on the workers of a scheduler; if a worker is lost, another one runs its block.

    Every worker process compiles its own programs.

    **Returns** the number of workers at the beginning.

    **Raises** `UsageError` without `dask.distributed`, `InputError` for a scheduler that does not
    answer or has no worker, and for a block that fails on the workers.
    """
    if find_spec("distributed") is None:
        raise UsageError(
            "a cluster needs dask.distributed; install it with `pip install vttig-jax[dask]`."
        )
    import distributed
    from distributed.comm.addressing import get_address_host_port
    from distributed.comm.core import CommClosedError

    try:
        with suppress(NotImplementedError):  # raised for a scheduler in this process
            # The address is checked first: a failed `Client` logs a second error when collected.
            get_address_host_port(address)
        client = distributed.Client(address, timeout=_WAIT_S, set_as_default=False)
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
        sent, todo = client.scatter(blocks.shared, broadcast=True), list(blocks.todo)
        futures = client.map(
            blocks.run, todo, shared=sent, pure=False, retries=_RETRIES, key="vttig-block"
        )
        answers = distributed.as_completed(futures, with_results=True, raise_errors=False)
        for future, answer in answers:
            if future.status in ("lost", "cancelled"):
                raise InputError(_LOST, where=address)
            if future.status != "finished":
                raise InputError(
                    f"a block fails on the workers: {future.exception()}; see their logs, and"
                    " continue with --resume.",
                    where=address,
                )
            blocks.keep(*answer)
    return workers

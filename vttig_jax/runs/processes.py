"""Execution of blocks in several processes of this machine, one task per block.

Reading a log and its checks hold Python's lock most of the time, so that threads do not use
several cores for them.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from ..base.errors import InputError
from ..control.sweeps.table import Rows


def run_in_processes(
    processes: int,
    block: Callable[[int, Any], tuple[int, int, Rows]],
    shared: Any,
    todo: Sequence[int],
    *,
    done: Callable[[int, Rows], None],
    progress: Callable[[int], None],
) -> None:
    """Run blocks in new processes of this machine.

    `block(number, shared)` returns the block number, the amount of work for `progress`, and the
    rows of the block; it is imported in every process, and its arguments are pickled. `done` is
    called with number and rows of each finished block. The processes end with the caller, even if
    it is killed.

    **Raises** `InputError` if a process ends before its block is done.
    """
    # A fork would copy the locks of JAX's threads without the threads that release them.
    pool = ProcessPoolExecutor(
        processes,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_begin,
    )
    try:
        for future in as_completed([pool.submit(block, number, shared) for number in todo]):
            number, steps, rows = future.result()
            done(number, rows)
            progress(steps)
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

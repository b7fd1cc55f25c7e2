"""Threads that run batches in parallel, one per device; the calling thread reports the progress.

XLA releases the interpreter while it compiles and while it runs, so that threads use all cores, and
programs of different controllers are compiled side by side.
"""

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import TypeVar

_Result = TypeVar("_Result")

Follow = Callable[[int], None]
"""Function that is called with the number of further finished steps."""


class ParallelRuns:
    """Threads for up to `places` simultaneous runs, one per device, used as a context manager.

    An exception in the `with` block, such as Ctrl-C, ends every run at its next progress report.
    """

    def __init__(self, places: int) -> None:
        self._pool = ThreadPoolExecutor(places)
        self._places: SimpleQueue[int] = SimpleQueue()
        for place in range(places):
            self._places.put(place)
        self._steps: SimpleQueue[int] = SimpleQueue()
        self._stopped = threading.Event()

    def __enter__(self) -> "ParallelRuns":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind is not None:
            self._stopped.set()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def start(self, run: Callable[[int, Follow], _Result]) -> "Future[_Result]":
        """Start `run(place, follow)` as soon as one of the places, numbered from 0, is free."""
        future = self._pool.submit(self._run, run)
        future.add_done_callback(lambda _: self._steps.put(0))  # it wakes the waiting caller
        return future

    def result(self, future: "Future[_Result]", progress: Follow) -> _Result:
        """Wait for a run and return its result.

        Meanwhile `progress` is called in this thread with the finished steps of all runs.
        """
        while not future.done():
            progress(self._steps.get())
        while True:
            try:
                progress(self._steps.get_nowait())
            except Empty:
                return future.result()

    def _run(self, run: Callable[[int, Follow], _Result]) -> _Result:
        place = self._places.get()
        try:
            return run(place, self._follow)
        finally:
            self._places.put(place)

    def _follow(self, steps: int) -> None:
        if self._stopped.is_set():
            raise RunStoppedError
        self._steps.put(steps)


class RunStoppedError(Exception):
    """A run was stopped because another one failed or the user interrupted the command."""

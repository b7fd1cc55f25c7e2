"""Threads of a sweep: side by side, followed by the caller, and stopped together."""

import threading

import pytest

from vttig_jax.control.sweeps.parallel import ParallelRuns

_WAIT_S = 30.0
"""Limit of a wait that ends at once unless the code is wrong."""


def test_runs_are_side_by_side_and_each_has_a_place_of_its_own():
    meet = threading.Barrier(2, timeout=_WAIT_S)
    with ParallelRuns(2) as parallel:
        runs = [
            parallel.start(lambda place, follow: (meet.wait(), follow(5), place)[2])
            for _ in range(2)
        ]
        steps: list[int] = []
        assert {parallel.result(run, steps.append) for run in runs} == {0, 1}
    assert sum(steps) == 10


def test_progress_is_called_in_the_thread_that_waits():
    seen = set()
    with ParallelRuns(1) as parallel:
        run = parallel.start(lambda place, follow: follow(1))
        parallel.result(run, lambda steps: seen.add(threading.get_ident()))
    assert seen == {threading.get_ident()}


def test_an_interruption_ends_all_runs_when_they_report():
    reports, going = [0], threading.Event()

    def endless(place, follow):
        while True:
            follow(1)
            reports[0] += 1
            going.set()

    def interrupted():
        with ParallelRuns(2) as parallel:
            parallel.start(endless)
            assert going.wait(_WAIT_S)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert reports[0] > 0 and not [one for one in threading.enumerate() if "ThreadPool" in one.name]


def test_the_error_of_a_run_reaches_the_caller():
    def fails(place, follow):
        raise OSError("full")

    with pytest.raises(OSError, match="full"), ParallelRuns(1) as parallel:
        parallel.result(parallel.start(fails), lambda steps: None)

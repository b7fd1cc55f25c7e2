"""Blocks in processes of this machine: results, failures, and the end of the processes."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from vttig_jax.base.errors import InputError
from vttig_jax.runs.elsewhere import Blocks, run_in_processes


def squared(number, shared):
    """Return the square of shared + number, and note the process."""
    return number, 3, {"square": np.array([(shared + number) ** 2]), "process": os.getpid()}


def failing(number, shared):
    raise ValueError(f"block {number} of {shared}")


def killed(number, shared):
    os.kill(os.getpid(), signal.SIGKILL)


def waiting(number, shared):
    Path(shared).write_text(str(os.getpid()))
    time.sleep(120)


def run(block, shared, *, blocks=4, progress=lambda steps: None):
    found = {}
    run_in_processes(2, Blocks(block, shared, range(blocks), found.__setitem__, progress))
    return found


def test_every_block_is_done_once_in_another_process():
    steps: list[int] = []
    found = run(squared, 10, progress=steps.append)
    assert {number: int(rows["square"][0]) for number, rows in found.items()} == {
        number: (10 + number) ** 2 for number in range(4)
    }
    assert os.getpid() not in {rows["process"] for rows in found.values()} and steps == [3] * 4


def test_an_error_an_interrupt_and_a_kill_end_the_processes():
    def interrupt(steps):
        raise KeyboardInterrupt

    with pytest.raises(ValueError, match=r"block \d of 7"):
        run(failing, 7)
    assert not multiprocessing.active_children()
    with pytest.raises(KeyboardInterrupt):
        run(squared, 1, progress=interrupt)
    assert not multiprocessing.active_children()
    with pytest.raises(InputError, match="fewer --jobs, and continue with --resume"):
        run(killed, None)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system kills in another way")
def test_the_processes_end_with_a_caller_that_is_killed(tmp_path):
    note = tmp_path / "process"
    script = tmp_path / "caller.py"
    script.write_text(
        f"import sys\nsys.path[:0] = {sys.path!r}\n"
        f"from {__name__} import run, waiting\n"
        f"if __name__ == '__main__':\n    run(waiting, {str(note)!r}, blocks=1)\n"
    )
    caller = subprocess.Popen([sys.executable, str(script)])
    try:
        worker = int(_until(lambda: note.exists() and note.read_text()))
    finally:
        caller.kill()
        caller.wait()
    assert _until(lambda: not _runs(worker))


def _until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.05)
    raise AssertionError("it did not happen")


def _runs(process: int) -> bool:
    """Return whether a process runs; one that ended and waits for its parent does not."""
    state = Path(f"/proc/{process}/stat")
    if state.parent.parent.joinpath("self").exists():
        return state.exists() and ") Z " not in state.read_text()
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True

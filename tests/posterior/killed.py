"""Kills a sampler with SIGKILL at many moments and goes on; run as a program, prints JSON.

Its own process, so that it can fork cheaply: no jax and no threads are in it.
"""

import json
import os
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from tests.posterior.densities import Gaussian, plain, same
from vttig_jax.base.files import atomic_write as atomic
from vttig_jax.posterior import checkpoint, run_ensembles
from vttig_jax.posterior.chains import Chains, read_chains


def kill() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def run(path: Path | None, target: Gaussian | None = None) -> Chains:
    resume = path is not None and path.exists()
    return run_ensembles(target or plain(3), steps=600, walkers=16, checkpoint=path, resume=resume)


class Doomed(Gaussian):
    """A density that is killed in its 400th call."""

    def log_density(self, points: np.ndarray) -> np.ndarray:
        if len(self.sizes) == 399:
            kill()
        return super().log_density(points)


def in_the_writing(path: Path) -> None:
    real, done = atomic.write_synced, []

    def write(place: Path, data: bytes) -> None:
        done.append(place)
        if len(done) > 3:
            place.write_bytes(data[: len(data) // 2])
            kill()
        real(place, data)

    atomic.write_synced = write
    run(path)


def around_the_move(path: Path, *, after: bool) -> None:
    moves, real = [], atomic.move

    def move(temporary: Path, target: Path) -> None:
        moves.append(target)
        if after or len(moves) < 3:
            real(temporary, target)
        if len(moves) == 3:
            kill()

    atomic.move = move
    run(path)


def forked(work: Callable[[], object], delay_s: float | None) -> int:
    """Do the work in a process of its own, killed after a while; the signal that ended it."""
    pid = os.fork()
    if pid == 0:
        work()
        os._exit(0)
    if delay_s is not None:
        time.sleep(delay_s)
        os.kill(pid, signal.SIGKILL)
    return os.WTERMSIG(os.waitpid(pid, 0)[1])


def main(folder: Path) -> None:
    checkpoint.SAVE_S, checkpoint.SLOWER = 0.0, 0.0  # a generation every block
    began = time.monotonic()
    whole = run(None)
    delays = (time.monotonic() - began) * np.random.default_rng().uniform(0.02, 0.1, 2)
    path = folder / "posterior.h5"
    moments: list[tuple[Callable[[], object], float | None]] = [
        (partial(run, path, Doomed(np.zeros(3), np.eye(3))), None),
        (partial(in_the_writing, path), None),
        (partial(around_the_move, path, after=False), None),
        (partial(around_the_move, path, after=True), None),
        *((partial(run, path), delay) for delay in delays),
    ]
    signals, steps, left_over = [], [], 0
    for work, delay_s in moments:
        signals.append(forked(work, delay_s))
        left_over += any(folder.glob(".posterior.h5.*.tmp"))
        steps.append(read_chains(path).diagnosis.steps if path.exists() else 0)
    alike = same(run(path), whole) and same(read_chains(path), whole)
    files = sorted(item.name for item in folder.iterdir())
    found = {"signals": signals, "steps": steps, "left_over": left_over, "same": alike}
    print(json.dumps(found | {"files": files}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

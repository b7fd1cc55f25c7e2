"""Counts of a study, and the worker processes and inputs that its calls use."""

import argparse
import collections
import multiprocessing
import multiprocessing.pool
import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from .calls import Ended, preload
from .inputs import write_inputs

_TASKS_A_WORKER = 20  # calls of a worker process before a new one takes its place; chosen value


@dataclass
class Tally:
    """Counts of all calls of a study.

    **Arguments**
    - `codes`: exit code → number of calls. - `faults`: fault → number of calls.
    - `longest_s`: longest time of the processor. - `largest_bytes`: largest resident memory.
    """

    codes: collections.Counter[str] = field(default_factory=collections.Counter)
    faults: collections.Counter[str] = field(default_factory=collections.Counter)
    longest_s: float = 0.0
    largest_bytes: int = 0

    def add(self, ends: Iterable[Ended], faults: Iterable[str]) -> None:
        """Count calls and their faults."""
        for ended in ends:
            self.codes[str(ended.code)] += 1
            self.longest_s = max(self.longest_s, ended.cpu_s)
            self.largest_bytes = max(self.largest_bytes, ended.peak_bytes)
        self.faults.update(faults)

    def record(self) -> dict:
        """Return the counts for the file of results."""
        return {
            "calls": sum(self.codes.values()),
            "exit_codes": dict(self.codes),
            "longest_cpu_s": round(self.longest_s, 1),
            "largest_gib": round(self.largest_bytes / 2**30, 2),
            "faults": dict(self.faults),
        }


def options(description: str | None, counted: str, number: int) -> argparse.ArgumentParser:
    """Return a parser with the options of a study of so many texts or inputs."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument(f"--{counted}s", type=int, default=number, dest="number")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time")
    parser.add_argument("--only", type=int, help=f"number of the one {counted} to examine")
    return parser


@contextmanager
def workers(jobs: int) -> Iterator[tuple[Path, multiprocessing.pool.Pool]]:
    """Yield a folder with valid inputs of all commands, and a pool of forked processes."""
    preload()
    with tempfile.TemporaryDirectory() as parent:
        os.environ["VTTIG_CACHE"] = str(Path(parent) / "cache")
        base = Path(parent) / "base"
        base.mkdir()
        write_inputs(base)
        context = multiprocessing.get_context("fork")
        with context.Pool(jobs, maxtasksperchild=_TASKS_A_WORKER) as pool:
            yield base, pool

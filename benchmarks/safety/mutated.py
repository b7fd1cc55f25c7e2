"""Damage logs, pairs, scenarios and sweeps at random, and count how the commands end.

    python -m benchmarks.safety.mutated [--inputs 500]

Two inputs of five are logs as text, two are logs in nine binary formats (arrays damaged before they
are saved, or bytes of the file afterwards), one is a TOML file. Wanted are exit codes of the
contract, one sentence, no traceback, no message of a library, at most 60 s of the processor unless
the command said before how long it takes, and at most 2 GiB. Writes results/mutated.json; the exit
code is 1 if any fault was found.
"""

import collections
import contextlib
import resource
import shutil
import sys
import tempfile
from pathlib import Path
from random import Random

import numpy as np

from tests.logs.binary_logs import WRITERS
from tests.logs.mutations import damaged_arrays, damaged_bytes, damaged_text

from ..environment import write
from .calls import LIMIT_S, Ended, call
from .study import Tally, options, workers

_PLAN = ["plan", "--pair", "gears.toml", "--noise-std-deg", "0.01", "--turns", "21"]
TOML = {
    "pair.toml": [[verb, "log.csv", "--pair", "pair.toml"] for verb in ("inspect", "fit")],
    "gears.toml": [["measure", "gears.toml"], _PLAN],
    "scenario.toml": [["simulate", "scenario.toml"]],
    "sweep.toml": [["sweep", "sweep.toml"]],
}
"""Name of a file → the calls that read it."""


def damaged(number: int, folder: Path, draw: Random) -> tuple[str, list[list[str]]]:
    """Write one damaged input; return its kind and the calls that read it."""
    stated = ["--ratio", "2:1"] if draw.random() < 0.5 else ["--pair", "plain.toml"]
    if number % 5 == 4:
        name = draw.choice(list(TOML))
        path = folder / name
        text = path.read_text()
        spoiled = damaged_bytes(text.encode(), draw) if draw.random() < 0.2 else None
        path.write_bytes(damaged_text(text, draw) if spoiled is None else spoiled)
        return name, [draw.choice(TOML[name])]
    if number % 5 < 2:
        suffix = ".csv"
        text = (folder / "log.csv").read_text()
        spoiled = damaged_text(text, draw)
        data = damaged_bytes(spoiled, draw) if draw.random() < 0.3 else spoiled
    else:
        suffix = list(WRITERS)[number // 5 % len(WRITERS)]
        rows = np.loadtxt(folder / "log.csv", delimiter=",", skiprows=1)
        arrays = {"time_s": rows[:, 0], "driving_deg": rows[:, 1], "driven_deg": rows[:, 2]}
        data = WRITERS[suffix](arrays)
        if draw.random() < 0.5:
            with contextlib.suppress(Exception):  # some formats cannot hold some arrays
                data = WRITERS[suffix](damaged_arrays(arrays, draw))
        else:
            data = damaged_bytes(data, draw)
    (folder / f"other{suffix}").write_bytes(data)
    verbs = ["inspect"] if draw.random() < 0.6 else ["inspect", "fit"]
    return suffix, [[verb, f"other{suffix}", *stated] for verb in verbs]


def faults_of(ended: Ended) -> list[str]:
    """Return the faults of a call; a long one is none if the command told its time before."""
    told = b"to run: " in ended.err
    return [
        fault
        for fault in ended.faults()
        if not (told and (fault == "over 60 s" or fault.startswith("signal 24")))
    ]


def _limited() -> None:
    seconds = int(LIMIT_S) + 5
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _one(task: tuple[int, int, Path]) -> tuple[str, list[Ended], list[str]]:
    number, seed, base = task
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "f"
        shutil.copytree(base, folder)
        kind, planned = damaged(number, folder, Random(f"{seed} {number}"))
        ends = [call(arguments, folder, before=_limited) for arguments in planned]
    found = []
    for ended in ends:
        faults = [f"{kind} {ended.arguments[0]}: {fault}" for fault in faults_of(ended)]
        found += faults
        if faults:
            print(number, faults, ended.code, ended.err[-700:], flush=True)
    return kind, ends, found


def main() -> int:
    """Run the study, print its counts and write them."""
    asked = options(__doc__, "input", 500).parse_args()
    tally = Tally()
    kinds: collections.Counter[str] = collections.Counter()
    numbers = range(asked.number) if asked.only is None else [asked.only]
    with workers(asked.jobs) as (base, pool):
        tasks = [(number, asked.seed, base) for number in numbers]
        for kind, ends, found in pool.imap_unordered(_one, tasks):
            kinds[kind] += 1
            tally.add(ends, found)
    record = {"inputs": dict(kinds)} | tally.record()
    print(record)
    if asked.only is None:
        write("mutated.json", record)
    return int(bool(tally.faults))


if __name__ == "__main__":
    sys.exit(main())

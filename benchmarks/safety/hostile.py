"""Put hostile texts into all places that all commands read, and count what goes wrong.

    python -m benchmarks.safety.hostile [--texts 400]

Every text stands in one of the places of `places.py`, whose calls cover all commands: a third of
them in places whose calls build on each other, and every 80th also in the commands that compile for
long. What reaches the terminal is searched for control and
direction characters and tracebacks, and every written file is read back by another program. Writes
results/hostile.json; the exit code is 1 if any fault was found.
"""

import argparse
import collections
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

from ..environment import write
from .calls import Ended, call, preload
from .inputs import write_inputs
from .places import INDEPENDENT, PLACES, Place, in_slow_commands
from .texts import texts
from .written import rejected

SLOW_EVERY, FULL_EVERY = 80, 3
CALLS = 6  # parts into which the independent calls of a place are divided, one for each text


def examine(text: str, place: Place, base: Path, turn: int) -> tuple[list[Ended], list[str]]:
    """Make the calls of one place in a copy of the inputs; return their ends and all faults."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "f"
        shutil.copytree(base, folder)
        planned = place(text, folder)
        if place in INDEPENDENT:
            planned = planned[turn % CALLS :: CALLS]
        known = {path for path in folder.rglob("*") if path.is_file()}
        ends, faults = [], []
        for arguments in planned:
            ended = call(arguments, folder)
            ends.append(ended)
            faults += [f"{arguments[0]}: {fault}" for fault in ended.faults()]
        return ends, faults + [f"file {fault}" for fault in rejected(folder, known)]


def _one(task: tuple[int, str, Path]) -> tuple[list[Ended], list[str]]:
    """Examine one text in its place, and print what is wrong."""
    number, text, base = task
    turn, position = divmod(number, len(PLACES))
    places = [PLACES[position]]
    if turn % FULL_EVERY and places[0] not in INDEPENDENT:
        places = [INDEPENDENT[number % len(INDEPENDENT)]]
    places += [in_slow_commands] * (number % SLOW_EVERY == 0)
    all_ends, all_faults = [], []
    for place in places:
        ends, faults = examine(text, place, base, number // len(PLACES))
        if faults:
            print(f"{number} {place.__name__} {text[:80]!r}: {faults}", flush=True)
            for ended in ends:
                if ended.faults():
                    print("   ", ended.arguments, ended.code, ended.err[-600:], flush=True)
        all_ends += ends
        all_faults += faults
    return all_ends, all_faults


def main() -> int:
    """Run the study, print its counts and write them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--texts", type=int, default=400)
    parser.add_argument("--minutes", type=float, default=240.0, help="end after this time")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time")
    parser.add_argument("--only", type=int, help="number of the one text to examine")
    asked = parser.parse_args()
    preload()
    codes: collections.Counter[str] = collections.Counter()
    verbs: collections.Counter[str] = collections.Counter()
    faults: collections.Counter[str] = collections.Counter()
    done, longest, largest = 0, 0.0, 0
    with tempfile.TemporaryDirectory() as parent:
        os.environ["VTTIG_CACHE"] = str(Path(parent) / "cache")
        base = Path(parent) / "base"
        base.mkdir()
        write_inputs(base)
        numbers = range(asked.texts) if asked.only is None else [asked.only]
        found = texts(asked.texts, asked.seed)
        tasks = [(number, found[number], base) for number in numbers]
        with multiprocessing.get_context("fork").Pool(asked.jobs, maxtasksperchild=20) as pool:
            until = time.monotonic() + 60 * asked.minutes
            for ends, faulty in pool.imap_unordered(_one, tasks):
                done += 1
                for ended in ends:
                    codes[str(ended.code)] += 1
                    verbs[ended.arguments[0] if ended.arguments[0].isascii() else "?"] += 1
                    longest = max(longest, ended.cpu_s)
                    largest = max(largest, ended.peak_bytes)
                faults.update(faulty)
                if time.monotonic() > until:
                    pool.terminate()
                    break
    print(f"{sum(codes.values())} calls, faults: {dict(faults)}; codes: {dict(codes)}")
    if asked.only is None:
        record = {
            "texts": done,
            "calls": sum(codes.values()),
            "exit_codes": dict(codes),
            "verbs": {name: count for name, count in verbs.items() if count > 9},
            "longest_cpu_s": round(longest, 1),
            "largest_gib": round(largest / 2**30, 2),
            "faults": dict(faults),
        }
        write("hostile.json", record)
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())

"""Put hostile texts into all places that all commands read, and count what goes wrong.

    python -m benchmarks.safety.hostile [--texts 400]

Every text stands in one of the places of `places.py`, whose calls cover all commands: a third of
them in places whose calls build on each other, and every 80th also in the commands that compile for
long. What reaches the terminal is searched for control and
direction characters and tracebacks, and every written file is read back by another program. Writes
results/hostile.json; the exit code is 1 if any fault was found.
"""

import collections
import shutil
import sys
import tempfile
import time
from pathlib import Path

from ..environment import write
from .calls import Ended, call
from .places import INDEPENDENT, PLACES, Place, in_slow_commands
from .study import Tally, options, workers
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
    parser = options(__doc__, "text", 400)
    parser.add_argument("--minutes", type=float, default=240.0, help="end after this time")
    asked = parser.parse_args()
    tally, done = Tally(), 0
    verbs: collections.Counter[str] = collections.Counter()
    found = texts(asked.number, asked.seed)
    numbers = range(asked.number) if asked.only is None else [asked.only]
    until = time.monotonic() + 60 * asked.minutes
    with workers(asked.jobs) as (base, pool):
        tasks = [(number, found[number], base) for number in numbers]
        for ends, faults in pool.imap_unordered(_one, tasks):
            done += 1
            tally.add(ends, faults)
            verbs.update(ended.arguments[0] for ended in ends if ended.arguments[0].isascii())
            if time.monotonic() > until:
                pool.terminate()
                break
    often = {name: count for name, count in verbs.items() if count > 9}
    record = {"texts": done, "verbs": often} | tally.record()
    print(record)
    if asked.only is None:
        write("hostile.json", record)
    return int(bool(tally.faults))


if __name__ == "__main__":
    sys.exit(main())

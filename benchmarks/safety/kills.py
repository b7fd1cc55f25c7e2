"""Kill whole commands at random and aimed moments, and count what their folder then holds.

    python -m benchmarks.safety.kills --verb fit --kills 100
    python -m benchmarks.safety.kills --verb sample --kills 40

Half of the kills come after a random time, half at one of the calls of `os.replace`, `os.rename`,
`os.fsync`, `os.mkdir` and `os.unlink`, before or after it. `fit` writes into a new folder or
replaces another fit with --overwrite, with pictures. The folder has to hold the old, the new or no
result; without a result the command is repeated (with --resume where the command has it), and its
result has to be that of an undisturbed run, bit for bit. What a kill has left byte by byte as an
earlier one is not repeated again. Adds its counts to results/kills.json.
"""

import argparse
import collections
import hashlib
import json
import os
import re
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

from ..environment import RESULTS, write
from .calls import call, preload
from .verbs import VERBS, Verb, left_over, reference, write_all

CALLS = ("replace", "rename", "fsync", "mkdir", "unlink")

_RANDOM = re.compile(r"[0-9a-f]{16}|(?<=\.new-)\w+")
"""Random parts of temporary names."""


def aimed(number: int, *, after: bool) -> Callable[[], None]:
    """Return a function that lets its process kill itself at the call with this number."""

    def patch() -> None:
        seen = [0]

        def wrapped(function: Callable[..., Any]) -> Callable[..., Any]:
            def counted(*arguments: Any, **keywords: Any) -> Any:
                seen[0] += 1
                here = seen[0] == number
                if here and not after:
                    os.kill(os.getpid(), signal.SIGKILL)
                result = function(*arguments, **keywords)
                if here:
                    os.kill(os.getpid(), signal.SIGKILL)
                return result

            return counted

        for name in CALLS:
            setattr(os, name, wrapped(getattr(os, name)))

    return patch


def timed(delay_s: float) -> Callable[[], None]:
    """Return a function that lets its process be killed after a time of the processor."""

    def patch() -> None:
        signal.signal(signal.SIGPROF, lambda *_: os.kill(os.getpid(), signal.SIGKILL))
        signal.setitimer(signal.ITIMER_PROF, delay_s)

    return patch


def left_state(out: Path) -> str:
    """Return the digest of all names and bytes below a folder, without random parts of names."""
    digest = hashlib.sha256()
    for path in sorted(out.rglob("*"), key=lambda path: _RANDOM.sub("", str(path))):
        digest.update(_RANDOM.sub("", str(path.relative_to(out))).encode())
        digest.update(path.read_bytes() if path.is_file() else b"folder")
    return digest.hexdigest() if out.exists() else "nothing"


def one(
    verb: Verb, base: Path, draw: Random, whole_s: float, repeated: set[str]
) -> tuple[str, str]:
    """Kill one call; return how it was killed, and what became of the folder."""
    overwrite = not verb.resumes and draw.random() < 0.5
    out, seen = base / "killed", base / "seen"
    shutil.rmtree(out, ignore_errors=True)
    options = []
    if overwrite:
        shutil.copytree(base / "old", out)
        options = ["--overwrite"]
    if draw.random() < 0.5:
        how, stop = "random", timed(draw.uniform(0.0, whole_s))
    else:
        how, stop = "aimed", aimed(draw.randint(1, 40), after=draw.random() < 0.5)

    def before() -> None:
        verb.before()
        stop()

    arguments = [*verb.arguments, "--out", "killed"]
    ended = call([*arguments, *options], base, before=before)
    how = f"{how}, {'overwrite' if overwrite else 'new'}"
    how += ", killed" if ended.code == -signal.SIGKILL else ", ended"
    state = f"{overwrite} {left_state(out)}"
    shutil.rmtree(seen, ignore_errors=True)
    if out.exists():
        shutil.copytree(out, seen)
    found = verb.content(seen)  # a reader settles the copy, and the command below the folder itself
    old, new = ((base / f"{name}.digest").read_text() for name in ("old", "new"))
    if found not in (old, new, "none") or (found == "none" and overwrite):
        return how, f"FAULT {found}"
    holds = {new: "new", old: "old"}.get(found, "none")
    if holds == "new":
        return how, holds
    if state in repeated:
        return how, f"{holds}, as one before"
    repeated.add(state)
    again = ["--resume"] if verb.resumes else options
    ended = call([*arguments, *again], base, before=verb.before)
    if verb.content(out) != new:
        return how, f"FAULT repeated: exit {ended.code} {ended.err[-200:]!r}"
    if left := left_over(out):
        return how, f"FAULT left {left}"
    return how, f"{holds}, then new"


def main() -> int:
    """Run the study of one command, print its counts and write them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--verb", choices=VERBS, default="fit")
    parser.add_argument("--kills", type=int, default=40)
    parser.add_argument("--minutes", type=float, default=60.0, help="end after this time")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    preload()
    verb, draw = VERBS[asked.verb], Random(f"{asked.seed} {asked.verb}")
    counts: collections.Counter[str] = collections.Counter()
    with tempfile.TemporaryDirectory() as parent:
        os.environ["VTTIG_CACHE"] = str(Path(parent) / "cache")
        base = Path(parent) / "base"
        base.mkdir()
        write_all(base)
        (base / "old.digest").write_text(reference(verb, base, "old", old=True))
        (base / "new.digest").write_text(reference(verb, base, "new"))
        ended = call([*verb.arguments, "--out", "warm"], base, before=verb.before)
        until, repeated = time.monotonic() + 60 * asked.minutes, set[str]()
        while counts["killed"] < asked.kills and time.monotonic() < until:
            how, holds = one(verb, base, draw, ended.cpu_s, repeated)
            counts["killed"] += how.endswith("killed")
            counts[f"{how}: {holds}"] += 1
            counts["faults"] += holds.startswith("FAULT")
            print(f"{counts['killed']} of {asked.kills}, {how}: {holds}", flush=True)
    for name, count in sorted(counts.items()):
        print(f"{count:5d}  {name}")
    path = RESULTS / "kills.json"
    record = json.loads(path.read_text()) if path.exists() else {}
    record.pop("environment", None)
    write("kills.json", record | {asked.verb: dict(sorted(counts.items()))})
    return int(counts["faults"] > 0)


if __name__ == "__main__":
    sys.exit(main())

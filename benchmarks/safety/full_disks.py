"""Let commands write to disks that are full after so many bytes or files; count what is left.

    python -m benchmarks.safety.full_disks [--sizes 8] [--only map --only export]

Needs Linux and the right to mount (root): every call has a file system in memory of its own. Half
of the disks are short of bytes, half of inodes, in steps from nothing to what the result needs. A
call has to succeed, or to end with exit code 3 and one sentence and to leave no result; `fit` on a
folder with another result has to leave that one. Adds its counts to results/full_disks.json.
"""

import argparse
import collections
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from ..environment import RESULTS, write
from .calls import Ended, call, preload
from .verbs import VERBS, write_all

FILES = {
    "map": ("map", "run", "--out", "disk/map.csv"),
    "export": ("export", "run", "--out", "disk/x.json", "--constant-backlash-deg", "0.03"),
    "surface": ("surface", "gears.toml", "--gear", "driving", "--out", "disk/s.svg"),
    "simulate": ("simulate", "scenario.toml", "--trace", "disk/trace.csv"),
    "write-pair": ("inspect", "log.csv", "--ratio", "2:1", "--write-pair", "disk/pair.toml"),
}
"""Name → call that writes files and no run folder."""

BEFORE = {f"run/{name}" for name in ("fit.json", "summary.npz", "run.toml", "posterior.h5")}
"""What `sample` writes before its report."""


def on_disk(
    arguments: tuple[str, ...],
    base: Path,
    before: Callable[[], None],
    *,
    kib: int,
    inodes: int,
    old: Path | None,
) -> tuple[Ended, list[str]]:
    """Make a call with a small file system at `disk`; return its end and the names on the disk."""
    disk = base / "disk"
    disk.mkdir(exist_ok=True)
    options = f"size={kib}k,nr_inodes={inodes}"
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(disk)], check=True)
    try:
        if old is not None:
            done = subprocess.run(["cp", "-r", str(old), str(disk / "run")], capture_output=True)
            if done.returncode:
                raise ValueError("the old result does not fit")
        ended = call(arguments, base, before=before)
        names = [str(one.relative_to(disk)) for one in disk.rglob("*") if one.is_file()]
        if old is not None:
            same = subprocess.run(["diff", "-r", str(old), str(disk / "run")], capture_output=True)
            names.append("old" if same.returncode == 0 else "changed")
        return ended, names
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def size_of(place: Path) -> tuple[int, int]:
    """Return the size of a result in KiB, and its files and folders."""
    files = list(place.rglob("*")) if place.is_dir() else [place]
    return sum(4 + one.stat().st_size // 1024 for one in files), len(files) + 1


def main() -> int:
    """Run the study, print its counts and write them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, default=8, help="disks of each kind for each command")
    parser.add_argument("--only", action="append", help="this command; repeatable")
    asked = parser.parse_args()
    preload()
    counts: collections.Counter[str] = collections.Counter()
    with tempfile.TemporaryDirectory() as parent:
        os.environ["VTTIG_CACHE"] = str(Path(parent) / "cache")
        base = Path(parent) / "base"
        base.mkdir()
        write_all(base)
        planned = {name: (*verb.arguments, "--out", "disk/run") for name, verb in VERBS.items()}
        planned["fit --overwrite"] = (*VERBS["fit"].arguments, "--out", "disk/run", "--overwrite")
        if call([*VERBS["fit"].old, "--out", "old"], base).code:
            raise RuntimeError("the old result could not be made")
        for name, arguments in (planned | FILES).items():
            if asked.only and name not in asked.only:
                continue
            verb = VERBS.get(name.split(" ")[0])
            before = verb.before if verb else lambda: None
            old = base / "old" if name == "fit --overwrite" else None
            taken = size_of(old) if old else (0, 0)
            needs = (512, 12)
            for step in range(2 * asked.sizes):
                share = (step // 2 + 1) / asked.sizes
                kib, inodes = (taken[0] + int(needs[0] * share), 1000)
                if step % 2:
                    kib, inodes = 16384, taken[1] + 2 + int(needs[1] * share)
                ended, names = on_disk(arguments, base, before, kib=kib, inodes=inodes, old=old)
                # `sample` writes its fit first, and `--resume` goes on from there.
                empty = not set(names) - BEFORE if name == "sample" else not names
                empty = names[-1] == "old" if old else empty
                good = ended.code in (0, 5) or (ended.code == 3 and empty and not ended.faults())
                verdict = "written" if ended.code in (0, 5) else "refused"
                counts[f"{name}: {verdict if good else 'FAULT'}"] += 1
                if not good:
                    print(name, kib, inodes, ended.code, names, ended.err[-300:], flush=True)
    done = {name.split(":")[0] for name in counts}
    for name, count in sorted(counts.items()):
        print(f"{count:5d}  {name}")
    path = RESULTS / "full_disks.json"
    record = json.loads(path.read_text()) if path.exists() else {}
    record.pop("environment", None)
    kept = {key: count for key, count in record.items() if key.split(":")[0] not in done}
    write("full_disks.json", dict(sorted((kept | counts).items())))
    return int(any("FAULT" in name for name in counts))


if __name__ == "__main__":
    sys.exit(main())

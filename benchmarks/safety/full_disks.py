"""Let commands write to disks that are full after so many bytes or files; count what is left.

    python -m benchmarks.safety.full_disks [--sizes 4] [--only map --only export]

Needs Linux and the right to mount (root): every call has a file system in memory of its own. Half
of the disks are short of bytes, half of inodes, in steps from almost nothing to a little more than
the result takes. A call has to write the result that it writes on a roomy disk, or to end with exit
code 3 and one sentence. A refused call has to leave nothing, and `fit` on a folder with another
result has to leave that one. A command with --resume may leave a part: on the disk, made larger, it
has to end with the result of the roomy disk, bit for bit. Adds its counts to
results/full_disks.json.
"""

import argparse
import collections
import contextlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ..environment import RESULTS, write
from .calls import Ended, call, preload
from .kills import left_state
from .verbs import VERBS, Verb, left_over, write_all

FILES = {
    "map": ("map", "run", "--out", "disk/map.csv"),
    "export": ("export", "run", "--out", "disk/x.json", "--constant-backlash-deg", "0.03"),
    "surface": ("surface", "gears.toml", "--gear", "driving", "--out", "disk/s.svg"),
    "simulate": ("simulate", "scenario.toml", "--trace", "disk/trace.csv"),
    "write-pair": ("inspect", "log.csv", "--ratio", "2:1", "--write-pair", "disk/pair.toml"),
}
"""Name → call that writes files and no run folder."""

ROOMY = 65536, 4096
"""KiB and inodes of a disk on which everything fits."""

MARGIN = 1.25
"""Largest disk as a multiple of what the result takes; temporary files need a part of it."""


@dataclass(frozen=True)
class Case:
    """A call, the command with a run folder that it belongs to, and the result that it replaces.

    **Arguments**
    - `arguments`: of the call; it writes below `disk` in the folder `base`.
    - `verb`: None for a call of `FILES`. - `old`: folder of another result, copied to the disk.
    """

    arguments: tuple[str, ...]
    base: Path
    verb: Verb | None
    old: Path | None = None

    @property
    def disk(self) -> Path:
        """Folder at which the disk is mounted."""
        return self.base / "disk"

    def call(self, *more: str) -> Ended:
        """Make the call."""
        before = self.verb.before if self.verb else lambda: None
        return call([*self.arguments, *more], self.base, before=before)

    def content(self) -> str:
        """Return a digest of the result on the disk."""
        return self.verb.content(self.disk / "run") if self.verb else left_state(self.disk)

    @contextlib.contextmanager
    def mounted(self, kib: int, inodes: int) -> Iterator[None]:
        """Mount a disk of this size with the old result on it."""
        self.disk.mkdir(exist_ok=True)
        options = f"size={kib}k,nr_inodes={inodes}"
        mount = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(self.disk)]
        subprocess.run(mount, check=True)
        try:
            if self.old is not None:
                subprocess.run(["cp", "-r", str(self.old), str(self.disk / "run")], check=True)
            yield
        finally:
            subprocess.run(["umount", str(self.disk)], check=True)

    def used(self) -> tuple[int, int]:
        """Return the KiB and the inodes that are in use on the mounted disk."""
        seen = os.statvfs(self.disk)
        blocks = seen.f_blocks - seen.f_bfree
        return blocks * seen.f_frsize // 1024, seen.f_files - seen.f_ffree

    def good(self, ended: Ended, wanted: str) -> bool:
        """Return whether the call left what it may leave; `wanted` is the result when it ends."""
        if ended.code in (0, 5):
            return self.content() == wanted
        if ended.code != 3 or ended.faults():
            return False
        if self.old is not None:
            return not subprocess.run(
                ["diff", "-r", str(self.old), str(self.disk / "run")], capture_output=True
            ).returncode
        if self.verb is None or not self.verb.resumes:
            return not any(self.disk.rglob("*"))
        kib, inodes = ROOMY
        options = f"remount,size={kib}k,nr_inodes={inodes}"
        subprocess.run(["mount", "-o", options, str(self.disk)], check=True)
        again = self.call("--resume")
        return again.code in (0, 5) and self.content() == wanted and not left_over(self.disk)


def study(case: Case, sizes: int, told: Callable[[str], None]) -> collections.Counter[str]:
    """Make the call on a roomy disk and on small ones; return verdicts and their numbers."""
    counts: collections.Counter[str] = collections.Counter()
    taken = (0, 1)
    with case.mounted(*ROOMY):
        if case.old is not None:
            taken = case.used()
        ended = case.call()
        if ended.code not in (0, 5):
            raise RuntimeError(ended.err.decode())
        wanted = case.content()
        kib, inodes = case.used()
    for step in range(2 * sizes):
        share = MARGIN * (step // 2 + 0.5) / sizes
        small = (taken[0] + max(4, int(kib * share)), ROOMY[1])
        if step % 2:
            small = (ROOMY[0], taken[1] + max(1, int((inodes - 1) * share)))
        with case.mounted(*small):
            ended = case.call()
            verdict = "written" if ended.code in (0, 5) else "refused"
            if not case.good(ended, wanted):
                left = [str(path.relative_to(case.disk)) for path in case.disk.rglob("*")]
                told(f"{small} exit {ended.code}, left {left}: {ended.err[-300:]!r}")
                verdict = "FAULT"
        counts[verdict] += 1
    return counts


def main() -> int:
    """Run the study, print its counts and write them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, default=4, help="disks of each kind for each command")
    parser.add_argument("--only", action="append", help="this command; repeatable")
    asked = parser.parse_args()
    preload()
    counts: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as parent:
        os.environ["VTTIG_CACHE"] = str(Path(parent) / "cache")
        base = Path(parent) / "base"
        base.mkdir()
        write_all(base)
        if call([*VERBS["fit"].old, "--out", "old"], base).code:
            raise RuntimeError("the old result could not be made")
        run = ("--out", "disk/run")
        cases = {name: Case((*verb.arguments, *run), base, verb) for name, verb in VERBS.items()}
        cases["fit --overwrite"] = Case(
            (*VERBS["fit"].arguments, *run, "--overwrite"), base, VERBS["fit"], base / "old"
        )
        cases |= {name: Case(arguments, base, None) for name, arguments in FILES.items()}
        for name, case in cases.items():
            if asked.only and name not in asked.only:
                continue
            found = study(case, asked.sizes, lambda text, name=name: print(name, text, flush=True))
            counts |= {f"{name}: {verdict}": count for verdict, count in found.items()}
            print(name, dict(found), flush=True)
    done = {key.split(":")[0] for key in counts}
    path = RESULTS / "full_disks.json"
    record = json.loads(path.read_text()) if path.exists() else {}
    record.pop("environment", None)
    kept = {key: count for key, count in record.items() if key.split(":")[0] not in done}
    write("full_disks.json", dict(sorted((kept | counts).items())))
    return int(any("FAULT" in key for key in counts))


if __name__ == "__main__":
    sys.exit(main())

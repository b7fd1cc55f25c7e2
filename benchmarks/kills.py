"""Kill the writing of a fit at random moments, and count what the folder then holds.

    python -m benchmarks.kills --kills 100

Every kill is a SIGKILL of a forked process that writes one of two fits into a run folder. Half of
the folders are new, half hold the other fit. Afterwards the folder is read as `vttig export` reads
it, and a folder without a result is written again without `overwrite`. The exit code is 1 if any
folder held a mixture, was refused without a result, or kept temporary files.
"""

import argparse
import collections
import os
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import vttig_jax
from tests.cli.drive import write_drive, write_pair
from vttig_jax.base.errors import UsageError
from vttig_jax.identify.fit_result import Fit
from vttig_jax.runs.run import open_run


def fits(folder: Path) -> tuple[Fit, Fit]:
    """Fits of two logs of a drive."""
    pair = vttig_jax.load_pair(write_pair(folder / "pair.toml"))
    logs = [
        vttig_jax.read_log(write_drive(folder / f"{seed}.csv", seed=seed), pair) for seed in (0, 1)
    ]
    return vttig_jax.fit(logs[0], pair), vttig_jax.fit(logs[1], pair)


def killed(fit: Fit, folder: Path, delay_s: float, *, overwrite: bool) -> bool:
    """Write a fit in a forked process and kill it after a while; whether it was killed."""
    child = os.fork()
    if child == 0:
        fit.save(folder, overwrite=overwrite, figures=False)
        os._exit(0)
    time.sleep(delay_s)
    os.kill(child, signal.SIGKILL)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def found(folder: Path, old: Fit, new: Fit) -> str:
    """Name what a folder holds: "none", "old", "new" or "mixture"."""
    try:
        seen = open_run(folder).fit
    except UsageError:
        return "none"
    for name, fit in (("old", old), ("new", new)):
        same = seen.to_json() == fit.to_json() and seen.sha256 == fit.sha256
        if same and np.array_equal(seen.covariance, fit.covariance):
            return name
    return "mixture"


def main() -> int:
    """Run the study and print its counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    vttig_jax.enable_x64()
    moments = np.random.default_rng(asked.seed)
    counts: collections.Counter[str] = collections.Counter()
    with tempfile.TemporaryDirectory() as parent:
        place = Path(parent)
        old, new = fits(place)
        began = time.monotonic()
        old.save(place / "old", figures=False)
        whole_s = time.monotonic() - began
        for number in range(asked.kills):
            folder, overwrite = place / str(number), bool(number % 2)
            if overwrite:
                shutil.copytree(place / "old", folder)
            was = killed(new, folder, moments.uniform(0, 1.2 * whole_s), overwrite=overwrite)
            holds = found(folder, old, new)
            counts[f"{'overwrite' if overwrite else 'new'}: {'killed' if was else 'ended'}"] += 1
            counts[f"{'overwrite' if overwrite else 'new'}: {holds}"] += 1
            if holds == "none":
                new.save(folder, figures=False)
                holds = found(folder, old, new)
                counts["written again without overwrite"] += 1
            left = [path.name for path in folder.iterdir() if path.name.startswith(".new")]
            bad = holds == "mixture" or bool(left) or (holds == "none")
            counts["failures"] += bad
    for name, count in sorted(counts.items()):
        print(f"{count:5d}  {name}")
    return int(counts["failures"] > 0)


if __name__ == "__main__":
    sys.exit(main())

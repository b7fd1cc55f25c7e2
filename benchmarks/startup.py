"""`vttig fit` on a 90 000-line CSV, and `vttig measure`, beside the imports they cannot do without.

    python -m benchmarks.startup [--rounds 7]

Each runs in a process of its own. Rounds alternate between the commands, so that whatever else the
machine does meets all of them. `fit_first` starts without compiled programs of an earlier run and
`fit` finds them in a cache of this study. Wall time and process time (user and system) are stated;
the ratios are of process times, which a busy machine changes less. Writes results/startup.json.
"""

import argparse
import hashlib
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import tomli_w

import vttig_jax
from vttig_jax.pair.gear_pair import spec_of
from vttig_jax.pair.pair_file import spec_table
from vttig_jax.rig.paper import paper_rig

from .environment import write

LINES = 90_000
IMPORT = "import jax, optimistix"
IMPORT_JAX = "import jax"
BOUNDS = {
    "fit_first_over_import": 3.0,
    "fit_over_import": 2.2,
    "inspect_s": 0.8,
    "measure_over_import_jax": 3.0,
    "help_s": 0.25,
}


def make_log(folder: Path) -> tuple[Path, Path]:
    """The paper's run as CSV, its last dwell cut so that exactly `LINES` samples are left."""
    vttig_jax.enable_x64()
    rig = paper_rig()
    log = rig.log()
    assert log.driven is not None and len(log) >= LINES
    columns = np.stack([log.time, log.driving.reading, log.driven.reading], axis=1)[:LINES]
    header = "time_s,driving_counts,driven_counts"
    path, pair = folder / "log.csv", folder / "pair.toml"
    np.savetxt(path, columns, ["%.7f", "%d", "%d"], ",", header=header, comments="")
    pair.write_text(tomli_w.dumps(spec_table(spec_of(rig.pair))))
    return path, pair


def seconds(command: list[str], cache: Path) -> tuple[float, float]:
    """Wall and process time of a command that has to succeed.

    Unless it only imports, it has to print something.
    """
    start, before = time.perf_counter(), os.times()
    environment = {**os.environ, "VTTIG_CACHE": str(cache)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    taken, after = time.perf_counter() - start, os.times()
    if done.returncode != 0 or ("-c" not in command and not done.stdout):
        sys.exit(f"{command[-1]}: exit {done.returncode}\n{done.stderr}")
    spent = after.children_user + after.children_system
    return taken, spent - before.children_user - before.children_system


def measure(rounds: int) -> dict:
    """Medians of `rounds` alternating runs, after one that fills the disk cache."""
    vttig = str(Path(sys.executable).with_name("vttig"))
    with tempfile.TemporaryDirectory() as name:
        log, pair = make_log(Path(name))
        fit = [vttig, "fit", str(log), "--pair", str(pair)]
        commands = {
            "import": [sys.executable, "-c", IMPORT],
            "import_jax": [sys.executable, "-c", IMPORT_JAX],
            "help": [vttig, "--help"],
            "inspect": [vttig, "inspect", str(log), "--pair", str(pair)],
            "fit_first": fit,
            "fit": fit,
            "measure": [vttig, "measure", str(pair)],
        }
        digest = hashlib.sha256(log.read_bytes()).hexdigest()
        wall: dict[str, list[float]] = {key: [] for key in commands}
        process: dict[str, list[float]] = {key: [] for key in commands}
        cache = Path(name) / "programs"
        for turn in range(rounds + 1):
            for key, command in commands.items():
                if key == "fit_first":
                    shutil.rmtree(cache, ignore_errors=True)
                taken, spent = seconds(command, cache)
                if turn:
                    wall[key].append(taken)
                    process[key].append(spent)
    medians = {key: statistics.median(values) for key, values in process.items()}
    ratios = {key: value / medians["import"] for key, value in medians.items()}
    return {
        "lines": LINES,
        "log_sha256": digest,
        "rounds": rounds,
        "wall_s": {k: [round(v, 4) for v in values] for k, values in wall.items()},
        "median_wall_s": {k: round(statistics.median(v), 4) for k, v in wall.items()},
        "median_s": {k: round(v, 4) for k, v in medians.items()},
        "ratio_to_import": {k: round(v, 3) for k, v in ratios.items()},
        "met": {
            "fit_first_over_import": ratios["fit_first"] <= BOUNDS["fit_first_over_import"],
            "fit_over_import": ratios["fit"] <= BOUNDS["fit_over_import"],
            "inspect_s": medians["inspect"] <= BOUNDS["inspect_s"],
            "measure_over_import_jax": (
                medians["measure"] <= BOUNDS["measure_over_import_jax"] * medians["import_jax"]
            ),
            "help_s": medians["help"] <= BOUNDS["help_s"],
        },
        "bounds": BOUNDS,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    record = measure(parser.parse_args().rounds)
    write("startup.json", record)
    for key, value in record["median_s"].items():
        ratio, wall = record["ratio_to_import"][key], record["median_wall_s"][key]
        print(f"{key:10} {value:7.3f} s  {ratio:6.2f} × import  ({wall:.3f} s of wall time)")

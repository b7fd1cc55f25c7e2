"""`vttig fit` on a 90 000-line CSV, and `vttig measure`, beside the imports they cannot do without.

    python -m benchmarks.startup [--rounds 7]

Each runs in a process of its own. Rounds alternate between the commands, so that whatever else the
machine does meets all of them. Writes results/startup.json.
"""

import argparse
import hashlib
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import tomli_w

import vttig_jax
from vttig_jax.pair.load import pair_spec
from vttig_jax.pair.pair_file import spec_table
from vttig_jax.rig.paper import paper_rig

from .environment import write

LINES = 90_000
IMPORT = "import jax, optimistix"
IMPORT_JAX = "import jax"
BOUNDS = {"fit_over_import": 4.0, "measure_over_import_jax": 3.0, "help_s": 0.25}


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
    pair.write_text(tomli_w.dumps(spec_table(pair_spec(rig.pair))))
    return path, pair


def seconds(command: list[str]) -> float:
    """Wall time of a command that has to succeed and, unless it only imports, to say something."""
    start = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    taken = time.perf_counter() - start
    if done.returncode != 0 or ("-c" not in command and not done.stdout):
        sys.exit(f"{command[-1]}: exit {done.returncode}\n{done.stderr}")
    return taken


def measure(rounds: int) -> dict:
    """Medians of `rounds` alternating runs, after one that fills the disk cache."""
    vttig = str(Path(sys.executable).with_name("vttig"))
    with tempfile.TemporaryDirectory() as name:
        log, pair = make_log(Path(name))
        commands = {
            "import": [sys.executable, "-c", IMPORT],
            "import_jax": [sys.executable, "-c", IMPORT_JAX],
            "help": [vttig, "--help"],
            "inspect": [vttig, "inspect", str(log), "--pair", str(pair)],
            "fit": [vttig, "fit", str(log), "--pair", str(pair)],
            "measure": [vttig, "measure", str(pair)],
        }
        digest = hashlib.sha256(log.read_bytes()).hexdigest()
        times: dict[str, list[float]] = {key: [] for key in commands}
        for turn in range(rounds + 1):
            for key, command in commands.items():
                taken = seconds(command)
                if turn:
                    times[key].append(taken)
    medians = {key: statistics.median(values) for key, values in times.items()}
    ratios = {key: value / medians["import"] for key, value in medians.items()}
    return {
        "lines": LINES,
        "log_sha256": digest,
        "rounds": rounds,
        "seconds": {k: [round(v, 4) for v in values] for k, values in times.items()},
        "median_s": {k: round(v, 4) for k, v in medians.items()},
        "ratio_to_import": {k: round(v, 3) for k, v in ratios.items()},
        "met": {
            "fit_over_import": ratios["fit"] <= BOUNDS["fit_over_import"],
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
        print(f"{key:10} {value:7.3f} s  {record['ratio_to_import'][key]:6.2f} × import")

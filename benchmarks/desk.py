"""What a user waits for at the desk: warm fits of short and long logs, and the memory of a fit.

    python -m benchmarks.desk [--rows 72000x21 …] [--rounds 5] [--memory 1000000x250 …]

- Warm fits: `vttig_jax.fit` of a fresh log (no angle computed yet) with orders 1 to 8 and mesh,
  all checks read, beside the peer: NumPy's plain least squares of the first orders of the same log,
  from counts, with an offset for each direction (cosine and sine of both angles, Gram matrix,
  solution). Rounds alternate. A row is named by its samples and its turns each way, `72000x21`.
- Memory: peak of a process that fits a log of so many samples and turns each way, above what it
  held before it had the columns, in multiples of the columns (time and two counters, 24 bytes a
  sample); from arrays, and from a CSV file. Linux only.

Gates before any time is taken: eccentricities and constant backlash of the fit lie within 4.5
standard errors of the truth, and the peer's coefficients are those of `numpy.linalg.lstsq`. Times
are process times, because the machine may be busy. Writes results/desk.json.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import vttig_jax
from vttig_jax.logs.encoder_log import EncoderLog
from vttig_jax.rig.motion import PassMotion
from vttig_jax.rig.paper import paper_eccentricities, paper_pair, paper_rig
from vttig_jax.rig.synthetic import SyntheticRig

from .environment import RESULTS, write

ROWS = ("72000x21", "20000x10", "60000x1500", "180000x4500", "1000000x250")
LARGEST_Z = 4.5
BYTES = 24  # of a sample: time and both counters


def rig_of(samples: int, turns: float) -> SyntheticRig:
    """The paper's rig at 60 rpm, sampled so that its run there and back has so many samples."""
    motion = PassMotion(speed_rpm=60.0, reversal_deg=360.0 * turns)
    return replace(paper_rig(motion=motion), rate_hz=(samples - 1) / motion.duration_s)


def fresh(log: EncoderLog) -> EncoderLog:
    """The log as it is right after reading: no angle is computed yet."""
    assert log.driven is not None
    return replace(log, driving=replace(log.driving), driven=replace(log.driven))


def fitted(log: EncoderLog, rig: SyntheticRig) -> vttig_jax.Fit:
    """The fit of a fresh log with all its checks."""
    found = vttig_jax.fit(fresh(log), rig.pair)
    found.checks.to_json()
    return found


def peer(log: EncoderLog) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Plain least squares of the first orders: its columns, TE and coefficients."""
    log = fresh(log)
    driving, driven, error = log.driving_angle, log.driven_angle, log.transmission_error
    forward = np.gradient(driving) >= 0
    columns = np.empty((len(error), 6))
    columns[:, 0], columns[:, 1] = np.cos(driving), np.sin(driving)
    columns[:, 2], columns[:, 3] = np.cos(driven), np.sin(driven)
    columns[:, 4], columns[:, 5] = forward, ~forward
    return columns, error, np.linalg.solve(columns.T @ columns, columns.T @ error)


def gate(found: vttig_jax.Fit, log: EncoderLog) -> float:
    """Largest distance of a parameter from its truth, in standard errors; the peer is exact."""
    columns, error, solution = peer(log)
    exact = np.linalg.lstsq(columns, error, rcond=None)[0]
    np.testing.assert_allclose(solution, exact, rtol=1e-6, atol=1e-9)
    truth = paper_eccentricities()
    worst = 0.0
    for name in ("driving_eccentricity_mm", "driven_eccentricity_mm", "constant_backlash_deg"):
        one = found.parameters[name]
        wanted = float(getattr(truth, name.replace("_eccentricity", "")))
        if one.value is not None and one.std is not None:
            worst = max(worst, abs(one.value - wanted) / one.std)
    assert worst < LARGEST_Z, f"{worst:.1f} standard errors off"
    return worst


def warm(row: str, rounds: int) -> dict[str, Any]:
    """Process times of the fit and of the peer, alternating, after the gate."""
    samples, turns = row.split("x")
    rig = rig_of(int(samples), float(turns))
    log = rig.log()
    worst = gate(fitted(log, rig), log)
    fits, peers = [], []
    for _ in range(rounds):
        for times, work in ((peers, lambda: peer(log)), (fits, lambda: fitted(log, rig))):
            start = time.process_time()
            work()
            times.append(time.process_time() - start)
    return {
        "samples": len(log),
        "turns_each_way": float(turns),
        "largest_z": round(worst, 2),
        "fit_s": round(statistics.median(fits), 4),
        "least_fit_s": round(min(fits), 4),
        "peer_s": round(statistics.median(peers), 5),
        "ratio": round(float(np.median(np.divide(fits, peers))), 1),
    }


def _status(name: str) -> int:
    """A number of /proc/self/status in bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name + ":"):
            return int(line.split()[1]) * 1024
    raise LookupError(name)


def child(source: Path) -> None:
    """Fit one log in this process and print the peak above what it held before."""
    vttig_jax.enable_x64()
    small = rig_of(20_000, 10)
    fitted(small.log(), small)
    Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here
    before, pair = _status("VmRSS"), paper_pair()
    if source.suffix == ".npz":
        with np.load(source) as arrays:
            columns = [arrays[name] for name in ("time", "driving", "driven")]
        log = EncoderLog.from_arrays(*columns, pair=pair, unit="counts")
        del columns
    else:
        log = vttig_jax.read_log(source, pair)
    read = _status("VmHWM")
    start = time.process_time()
    found = vttig_jax.fit(log, pair)
    found.checks.to_json()
    size = BYTES * len(log)
    record = {
        "samples": len(log),
        "outcome": found.outcome,
        "driving_mm": found.value("driving_eccentricity_mm"),
        "own_mib": round(before / 2**20),
        "reading": round((read - before) / size, 2),
        "peak": round((_status("VmHWM") - before) / size, 2),
        "fit_s": round(time.process_time() - start, 2),
    }
    print(json.dumps(record))


def memory(row: str) -> dict[str, Any]:
    """Peaks from arrays and from CSV in processes of their own; both must give one answer."""
    import pyarrow as pa
    from pyarrow import csv

    samples, turns = row.split("x")
    rig = rig_of(int(samples), float(turns))
    log = rig.log()
    assert log.driven is not None
    columns = {"time": log.time, "driving": log.driving.reading, "driven": log.driven.reading}
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        arrays, text = Path(folder) / "log.npz", Path(folder) / "log.csv"
        np.savez(arrays, allow_pickle=False, **columns)
        names = ["time_s", "driving_counts", "driven_counts"]
        csv.write_csv(pa.table(list(columns.values()), names=names), text)
        for name, path in (("arrays", arrays), ("csv", text)):
            command = [sys.executable, "-m", "benchmarks.desk", "--child", str(path)]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            found[name] = json.loads(done.stdout)
    assert found["arrays"]["driving_mm"] == found["csv"]["driving_mm"]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", nargs="*", default=ROWS)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--memory", nargs="*", default=["1000000x250", "20000000x250"])
    parser.add_argument("--only", choices=("warm", "memory"))
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.child is not None:
        child(chosen.child)
        return
    vttig_jax.enable_x64()
    path = RESULTS / "desk.json"
    record = json.loads(path.read_text()) if path.exists() else {}
    record.pop("environment", None)
    if chosen.only != "memory":
        for row in chosen.rows:
            record.setdefault("warm", {})[row] = warm(row, chosen.rounds)
            write("desk.json", record)
            print(row, record["warm"][row], flush=True)
    if chosen.only != "warm":
        record["memory"] = {}
        for row in chosen.memory:
            record["memory"][row] = memory(row)
            write("desk.json", record)
            print(row, record["memory"][row], flush=True)


if __name__ == "__main__":
    main()

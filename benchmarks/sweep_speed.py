"""A hundred thousand reversals of ten seconds: the time of a sweep, and the same numbers as a CPU.

    python -m benchmarks.sweep_speed [--cases 100000] [--platform cpu] [--gate 600]

Rigs drawn around that of the paper turn at angles from 360° to 1350° with three controllers, at
57.46 rpm and 1 kHz: 9900 steps a case. First the table of `--gate` cases is compared with that of a
process that has only the CPU, to 1e-9 relative in every column (the gate). Then the sweep is timed,
in process time and in wall time, with the parts that `vttig sweep` prints; the table is written to
a temporary folder. Writes results/sweep_speed.json.
"""

import argparse
import dataclasses
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

import vttig_jax
from vttig_jax.control import Maps, parse_scenario_spec
from vttig_jax.kinematics import FlankModel, exact_model
from vttig_jax.pair.gear_pair import Eccentricities
from vttig_jax.rig import paper_eccentricities, paper_pair
from vttig_jax.runs.sweeps import sweep_in_folder

from .environment import write

RIGS, CONTROLLERS = 50, ("none", "acceleration", "predictive")
CLOSE = 1e-9
_TURNS_DEG = (360.0, 1350.0)
_SPREAD = {"driving_mm": 2e-4, "driven_mm": 2e-4, "constant_backlash_deg": 1e-3}
"""Standard deviations of the drawn rigs (chosen)."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=100_000)
    parser.add_argument("--gate", type=int, default=600, help="cases that are compared")
    parser.add_argument("--platform", choices=("cpu", "gpu"), default="cpu")
    parser.add_argument("--table", type=Path, help="only write the columns of --cases to this file")
    chosen = parser.parse_args()
    _prepare(chosen.platform)
    if chosen.table is not None:
        np.savez(chosen.table, allow_pickle=False, **_swept(chosen.cases).columns)
        return
    record: dict[str, Any] = {"platform": chosen.platform}
    record["gate"] = _gate(chosen.gate)
    assert record["gate"]["largest_difference"] <= CLOSE, record["gate"]
    began = time.process_time(), time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        table = _swept(chosen.cases, Path(folder) / "swept")
        spent = time.process_time() - began[0], time.perf_counter() - began[1]
    found = table.to_json()
    parts = ("lane_steps", "run_s", "compile_s", "devices")
    record |= {"cases": len(table.columns["case"]), "process_s": spent[0], "wall_s": spent[1]}
    record |= {name: found[name] for name in parts} | {"outcomes": table.outcomes}
    write("sweep_speed.json", record)
    for name, value in record.items():
        print(f"{name}: {value}")


def _prepare(platform: str) -> None:
    """Choose the platform; a CPU has all cores that this process may use."""
    if platform == "cpu":
        jax.config.update("jax_platforms", "cpu")
        vttig_jax.prepare_cpu(devices=len(os.sched_getaffinity(0)))
    else:
        jax.config.update("jax_platforms", "cuda")
    vttig_jax.enable_x64()


def _swept(cases: int, out: Path | None = None) -> vttig_jax.SweepTable:
    """Sweep over rigs, turns and controllers, at least `cases` cases."""
    generator = np.random.default_rng(0)
    middle = paper_eccentricities()
    rigs = []
    for _ in range(RIGS):
        moved = {name: std * generator.standard_normal() for name, std in _SPREAD.items()}
        values = {name: float(getattr(middle, name)) + by for name, by in moved.items()}
        rigs.append(dataclasses.replace(middle, **values))
    turns = max(2, -(-cases // (RIGS * len(CONTROLLERS))))
    axes = {
        "motion.reversal_deg": {"from": _TURNS_DEG[0], "to": _TURNS_DEG[1], "num": turns},
        "controller": list(CONTROLLERS),
    }
    given = {"pair": "pair.toml", "rig": {"from": "drawn", "draws": RIGS}, "sweep": axes}
    spec = parse_scenario_spec(given | {"motion": {"speed_rpm": 57.46}})
    draws = jax.tree.map(lambda *leaves: np.stack(leaves), *map(_map, rigs))
    maps = Maps({"drawn": _map(middle)}, draws, RIGS)
    return sweep_in_folder(spec, paper_pair(), Path(), None, maps, out=out)


def _map(rig: Eccentricities) -> FlankModel:
    return exact_model(paper_pair(), rig)


def _gate(cases: int) -> dict[str, Any]:
    """Largest relative difference of any column from a process that has only the CPU."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "table.npz"
        arguments = ["--cases", str(cases), "--platform", "cpu", "--table", str(place)]
        command = [sys.executable, "-m", "benchmarks.sweep_speed", *arguments]
        subprocess.run(command, check=True, cwd=Path(__file__).parents[1])
        wanted = dict(np.load(place))
    found = _swept(cases).columns
    worst, where = 0.0, ""
    for name, own in found.items():
        other = wanted[name]
        if own.dtype.kind not in "f":
            different = 0.0 if np.array_equal(own, other) else np.inf
        elif not np.array_equal(np.isnan(own), np.isnan(other)):
            different = np.inf
        else:
            size = np.maximum(np.nanmax(np.abs(other), initial=0.0), 1e-300)
            different = float(np.nanmax(np.abs(own - other), initial=0.0) / size)
        if different > worst:
            worst, where = different, name
    return {"cases": len(found["case"]), "largest_difference": worst, "in": where}


if __name__ == "__main__":
    main()

"""The base case through the simulator and through the step in C, in turns."""

import statistics
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from vttig_jax.control.simulation.case import Accumulators

from . import step_in_c
from .simulation_cases import (
    CLOSE,
    LANES,
    BatchRunner,
    cases_of,
    ns_per_lane_step,
    periods_for,
    process_seconds,
    ratio,
    stack_of,
    summary,
)

_BLOCKS = (64, 128, 512)


def base_and_c(rounds: int) -> dict[str, Any]:
    """The base case and the same in C, compiled in three ways, for several blocks of lanes."""
    cases = cases_of(LANES)
    stack, periods = stack_of(cases), periods_for(cases)
    lanes = BatchRunner(jax.devices()[:1])
    record: dict[str, Any] = {"lanes": LANES, "periods": periods}
    _, tally = lanes.run(stack, periods)
    record["compile_s"] = round(lanes.compile_s, 2)
    with tempfile.TemporaryDirectory() as folder:
        programs, record["c"] = _c_programs(Path(folder))
        runs: dict[str, Callable[[], Any]] = {}
        expected = step_in_c.scanned(cases, periods)
        _require_same(expected, tally)
        for name, program in programs.items():
            memory = program.prepared(cases)
            differs = step_in_c.difference(program.run(memory, periods), expected)
            worst = max(differs, key=lambda field: differs[field])
            print(f"C {name}: differs by {differs[worst]:.2g} ({worst})")
            if not differs[worst] <= CLOSE:
                raise SystemExit(f"The C step differs: {differs}")
            record["c"][name] |= {"differs": differs[worst]}
            runs[name] = lambda program=program, memory=memory: program.run(memory, periods)
        ours: list[float] = []
        theirs: dict[str, list[float]] = {name: [] for name in runs}
        for _ in range(rounds):
            ours += ns_per_lane_step(lanes, stack, 1, periods, 1)
            for name, run in runs.items():
                theirs[name].append(1e9 * process_seconds(run) / (LANES * periods))
    record["ours_ns"] = summary(ours)
    print("ours", record["ours_ns"], "ns per lane-step")
    for flags, most in (("fast", 1.2), ("wide", 1.5), ("narrow", None)):
        some = {name: ns for name, ns in theirs.items() if name.startswith(flags)}
        for name, ns in some.items():
            record["c"][name] |= {"ns": summary(ns)}
            print(f"C {name}", summary(ns), record["c"][name]["vectors_bytes"])
        if some:
            best = min(some, key=lambda name: statistics.median(some[name]))
            times = ratio(ours, some[best])
            record[f"times_c_{flags}"] = {"block": best, "times": times, "asked": most}
            print(f"ours over C {best}: {times} times, asked {most}")
    return record


def _c_programs(folder: Path) -> tuple[dict[str, step_in_c.StepInC], dict[str, Any]]:
    """Compiled for both sets of flags and several blocks of lanes; or why there are none."""
    programs, said = {}, {}
    kinds = ("fast", step_in_c.FAST), ("wide", step_in_c.WIDE), ("narrow", step_in_c.NARROW)
    for name, flags in kinds:
        for block in _BLOCKS:
            try:
                program = step_in_c.StepInC(folder, flags, block)
            except RuntimeError as error:
                print(f"The rows in C are left out: {error}")
                return {}, {"left_out": str(error)}
            programs[f"{name}, {block} lanes"] = program
            said[f"{name}, {block} lanes"] = {
                "flags": " ".join((*flags, step_in_c.LOOPS)),
                "vectors_bytes": program.vector_loops,
            }
    return programs, said


def _require_same(expected: np.ndarray, tally: Accumulators) -> None:
    """The scan that C is compared with is the one that is timed."""
    for name in step_in_c.METRICS:
        timed = np.nan_to_num(np.asarray(getattr(tally, name), float), nan=step_in_c.NEVER)
        known = expected[step_in_c.FIELDS.index(name)]
        assert np.allclose(timed, known, rtol=CLOSE, atol=CLOSE), name

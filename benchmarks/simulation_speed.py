"""The simulator's step: beside C, beside MuJoCo, on two cores, and what each option adds.

    OMP_NUM_THREADS=1 taskset -c 0 python -m benchmarks.simulation_speed      # 5 min, needs cc
    OMP_NUM_THREADS=1 taskset -c 0 python -m benchmarks.simulation_speed --only c sines

The base case: float64, rigid plant, trapezoid, two quantised encoders, the paper's controller, all
metrics, 1 kHz, closed flanks, 512 lanes that turn at other angles, one core. The C step
(`simulation_step.c`) computes the same, and has to arrive at the same numbers to 1e-9 before it is
timed. Rows that are compared run in turns; ratios are medians of those of each round.
Rows on two cores start processes that leave the `taskset` of this one.

Writes results/simulation_speed.json, where no rows are left out.
"""

import argparse
import statistics
import time
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import vttig_jax
from vttig_jax.control.hardware import encoder as sensing
from vttig_jax.control.simulation.case import initial_state, run_periods
from vttig_jax.kinematics import flank_table as bounds

from .environment import write
from .simulation_beside_c import base_and_c
from .simulation_cases import (
    CLOSE,
    LANES,
    BatchRunner,
    cases_of,
    ns_per_lane_step,
    periods_for,
    ratio,
    seconds,
    stack_of,
    summary,
)
from .simulation_worker import asked

_SIZES = (64, 128, 256, 512, 1024, 2048, 4096, 8192)
_CALLS = "--xla_backend_extra_options=xla_cpu_use_multi_output_fusion"
"""Without the option that makes XLA compile a loop into one function, not one a kernel."""
_OPTIONS: Mapping[str, Mapping[str, Any]] = {
    "flanks exact": {"flanks": "exact"},
    "plant play": {"plant": "play"},
    "plant elastic, 4 kHz (a step of the plant)": {
        "plant": "elastic",
        "sampling.plant_hz": 4000.0,
    },
    "controller none": {"controller": "none"},
    "controller predictive": {"controller": "predictive"},
    "encoder amplitude": {
        "driving_encoder.amplitude_arcsec": 18.0,
        "driven_encoder.amplitude_arcsec": 18.0,
    },
    "encoder noise": {"driving_encoder.noise_arcsec": 2.0, "driven_encoder.noise_arcsec": 2.0},
    "motion s_curve": {"motion.kind": "s_curve"},
    "friction Stribeck": {"friction.stribeck_Nm": 0.05},
    "actuator delay 8 ms": {"actuator.delay_s": 0.008},
    "observer difference": {"judgement.observer": "difference"},
}


def sines(rounds: int) -> dict[str, Any]:
    """Row 3: the same with `jnp.sin` and `jnp.cos`, and with them as JAX comes, unprepared."""
    cases = cases_of(LANES)
    stack, periods = stack_of(cases), periods_for(cases)
    ours, theirs = BatchRunner(jax.devices()[:1]), BatchRunner(jax.devices()[:1])
    _, expected = ours.run(stack, periods)
    kept = bounds.sincos
    jax.clear_caches()
    bounds.sincos = sensing.sincos = lambda x: (jnp.sin(x), jnp.cos(x))
    try:
        _, tally = theirs.run(stack, periods)
        for name, one in vars(expected).items():
            other = getattr(tally, name)
            one, other = np.asarray(one, float), np.asarray(other, float)
            assert np.allclose(one, other, rtol=CLOSE, atol=CLOSE, equal_nan=True), name
        found: tuple[list[float], list[float]] = ([], [])
        for _ in range(rounds):
            found[0].extend(ns_per_lane_step(ours, stack, 1, 1024, 1))
            found[1].extend(ns_per_lane_step(theirs, stack, 1, 1024, 1))
    finally:
        bounds.sincos = sensing.sincos = kept
        jax.clear_caches()
    record = {"ns": summary(found[1]), "times_ours": ratio(found[1], found[0]), "asked": 10}
    plain = asked("lanes", sizes=[LANES], rounds=3, library_sines=True, prepared=False, wide=False)
    record["unprepared_ns"] = summary(plain[str(LANES)])
    print("jnp.sin and jnp.cos", record)
    return record


def tables(rounds: int) -> dict[str, Any]:
    """Row 2: flanks in a table, of the exact relation and of a map with a mesh order."""
    maps = {"exact": "eccentricities", "mesh orders": "rig"}
    base, lanes = stack_of(cases_of(LANES)), BatchRunner(jax.devices()[:1])
    record: dict[str, Any] = {}
    for name, source in maps.items():
        cases = cases_of(LANES, {"flanks": "exact", "plant_map": source, "controller_map": source})
        stack = stack_of(cases)
        _require_counted(lanes, stack, 1)
        record[name] = _surcharge(
            [
                (
                    ns_per_lane_step(lanes, stack, 1, 2048, 1)[0],
                    ns_per_lane_step(lanes, base, 1, 2048, 1)[0],
                )
                for _ in range(rounds)
            ]
        )
        record[name] |= {"nodes": len(cases[0].bounds.nodes)}  # pyright: ignore[reportAttributeAccessIssue]
        print(f"table, {name}", record[name])
    return record


def cores(rounds: int) -> dict[str, Any]:
    """Row 4."""
    found = asked("cores", "0,1", rounds=rounds, lanes=2 * LANES, periods=4096)
    assert found["differs"] <= CLOSE, found
    record = {
        "one_ns": summary(found["1"]),
        "two_ns": summary(found["2"]),
        "times": ratio(found["1"], found["2"]),
        "asked": 1.5,
    }
    print("two cores", record)
    return record


def sweeps(rounds: int) -> dict[str, Any]:
    """Row 5."""
    record: dict[str, Any] = {}
    for flanks in ("closed", "exact"):
        found = asked("sweep", "0,1", rounds=min(rounds, 5), flanks=flanks)
        assert found["differs"] <= CLOSE, found
        assert found["new_values_compile_s"] == 0, found
        record[flanks] = found | {"again_s": summary(found["again_s"]), "asked_s": 2.0}
        print(f"sweep, {flanks} flanks", record[flanks])
    sizes = {str(long): asked("memory", seconds_long=long)["MiB"] for long in (10.0, 100.0)}
    record["peak_memory_MiB"] = sizes
    print("peak memory by length of the run, MiB", sizes)
    return record


def options(rounds: int) -> dict[str, Any]:
    """Row 6: each beside the base, in turns."""
    base = cases_of(LANES)
    stack, lanes = stack_of(base), BatchRunner(jax.devices()[:1])
    record: dict[str, Any] = {}
    rows = {name: cases_of(LANES, values) for name, values in _OPTIONS.items()}
    stacks = {name: (stack_of(cases), cases[0].substeps) for name, cases in rows.items()}
    stacks["every number its own lane's"] = stack_of(base, apart=True), 1
    for name, (other, substeps) in stacks.items():
        before, periods = lanes.compile_s, 2048 // substeps
        _require_counted(lanes, other, substeps)
        record[name] = _surcharge(
            [
                (
                    ns_per_lane_step(lanes, other, substeps, periods, 1)[0],
                    ns_per_lane_step(lanes, stack, 1, 2048, 1)[0],
                )
                for _ in range(rounds)
            ]
        ) | {"compile_s": round(lanes.compile_s - before, 2)}
        print(name, record[name])
    record["trace of every period"] = _trace(rounds)
    print("trace of every period", record["trace of every period"])
    return record


def _require_counted(lanes: BatchRunner, stack: Any, substeps: int) -> None:
    """Every lane counts its periods and shows numbers."""
    periods = 1024
    _, tally = lanes.run(stack, periods)
    assert (tally.samples == periods).all() and np.isfinite(tally.total).all()


def _trace(rounds: int) -> dict[str, Any]:
    """A sample of every period is kept, 10 numbers each: beside none."""
    cases = jax.tree.map(lambda *x: np.stack([np.asarray(y) for y in x]), *cases_of(LANES))
    periods = jnp.arange(256)
    wide: Any = {"compiler_options": {"xla_cpu_prefer_vector_width": 512}}
    both = [
        jax.jit(
            jax.vmap(lambda case, kept=kept: run_periods(case, initial_state(case), periods, kept)),
            **wide,
        )
        for kept in (True, False)
    ]
    for run in both:
        jax.block_until_ready(run(cases))
    taken = [
        [1e9 * seconds(lambda: jax.block_until_ready(run(cases))) / (256 * LANES) for run in both]  # noqa: B023
        for _ in range(rounds)
    ]
    return _surcharge([(trace, without) for trace, without in taken])


def _surcharge(pairs: list[tuple[float, float]]) -> dict[str, Any]:
    return {
        "ns": summary([one for one, _ in pairs]),
        "over_base_ns": round(statistics.median(one - base for one, base in pairs), 2),
        "times_base": round(statistics.median(one / base for one, base in pairs), 3),
    }


def mujoco(rounds: int) -> dict[str, Any]:
    """Row 7: simulated seconds per second, one core each."""
    if not find_spec("mujoco"):
        print("MuJoCo is not installed; its row is left out")
        return {"left_out": "mujoco is not installed"}
    from .elastic_accuracy import Case, mujoco_run

    stack, lanes = stack_of(cases_of(LANES)), BatchRunner(jax.devices()[:1])
    ours, theirs = [], []
    for _ in range(max(3, rounds // 2)):
        ours += ns_per_lane_step(lanes, stack, 1, 2048, 1)
        theirs.append(mujoco_run(Case(moving=False), 2e-5)[1])
    times = [taken / (ns * 1e-9 / 1e-3) for ns, taken in zip(ours, theirs, strict=True)]
    record = {
        "ours_simulated_s_per_s": round(1e6 / statistics.median(ours)),
        "mujoco_simulated_s_per_s": round(1 / statistics.median(theirs), 2),
        "mujoco_us_per_step": round(2e-5 * 1e6 * statistics.median(theirs), 2),
        "times": round(statistics.median(times)),
        "asked": 1000,
    }
    print("MuJoCo", record)
    return record


def lanes(rounds: int) -> dict[str, Any]:
    """Row 8."""
    record: dict[str, Any] = {}
    found = asked("lanes", sizes=_SIZES, rounds=rounds)
    record["by_lanes_ns"] = {size: summary(ns) for size, ns in found.items()}
    print("ns by lanes", {size: row["median"] for size, row in record["by_lanes_ns"].items()})
    kinds: dict[str, Mapping[str, Any]] = {
        "as prepared": {},
        "without prepare_cpu": {"prepared": False},
        "without vectors of 512 bits": {"wide": False},
        "without either": {"prepared": False, "wide": False},
        "a call for every kernel": {"flags": _CALLS},
        "a call for every kernel, 64 lanes": {"flags": _CALLS, "sizes": [64]},
    }
    record["options_of_xla_ns"] = {
        name: summary(*asked("lanes", **{"sizes": [LANES], "rounds": rounds, **kind}).values())
        for name, kind in kinds.items()
    }
    print("ns by options of XLA", record["options_of_xla_ns"])
    return record


_ROWS: Mapping[str, Callable[[int], dict[str, Any]]] = {
    "c": base_and_c,
    "tables": tables,
    "sines": sines,
    "cores": cores,
    "sweeps": sweeps,
    "options": options,
    "mujoco": mujoco,
    "lanes": lanes,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--only", nargs="+", choices=_ROWS, help="some rows; writes nothing")
    chosen = parser.parse_args()
    vttig_jax.prepare_cpu(1)
    vttig_jax.enable_x64()
    record: dict[str, Any] = {"options": {"rounds": chosen.rounds}}
    for name in chosen.only or _ROWS:
        clock = time.perf_counter()
        record[name] = _ROWS[name](chosen.rounds)
        print(f"-- {name}: {time.perf_counter() - clock:.0f} s\n", flush=True)
    if not chosen.only:
        write("simulation_speed.json", record)


if __name__ == "__main__":
    main()

"""What `simulation_speed` measures in a process of its own: other cores, options of XLA, memory.

    python -m benchmarks.simulation_worker TASK '{"JSON": "of its arguments"}'

The last line printed is a JSON object.
"""

import inspect
import json
import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import vttig_jax
from vttig_jax.control.hardware import encoder as sensing
from vttig_jax.control.scenario.spec import ScenarioSpec, parse_scenario_spec, spec_table
from vttig_jax.control.sweeps import sweep as lanes_module
from vttig_jax.kinematics import flank_table as bounds

from .simulation_cases import (
    BASE,
    PAIR,
    BatchRunner,
    cases_of,
    ns_per_lane_step,
    seconds,
    spec_of,
    stack_of,
    width_of,
)

SWEEP_TURNS = {"from": 7300.0, "to": 7660.0, "num": 1000}
"""At the speed of the base case, runs of 43.9 to 46.0 s."""


def asked(task: str, cores: str = "0", flags: str | None = None, **arguments: Any) -> Any:
    """Run a task in a process of its own on these cores; `flags`: XLA_FLAGS."""
    environment = {key: value for key, value in os.environ.items() if key != "XLA_FLAGS"}
    environment |= {"XLA_FLAGS": flags} if flags else {}
    command = ["taskset", "-c", cores, sys.executable, "-m", __name__, task, json.dumps(arguments)]
    place = Path(__file__).parents[1]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=place)
    if done.returncode:
        raise RuntimeError(f"{task} {arguments} failed:\n{done.stderr[-3000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def lanes_task(
    sizes: list[int], rounds: int, wide: bool = True, library_sines: bool = False
) -> dict[str, Any]:
    """ns per lane-step for numbers of lanes.

    `wide`: vectors of 512 bits; `library_sines`: `jnp.sin` and `jnp.cos` instead of polynomials.
    """
    if library_sines:
        bounds.sincos = sensing.sincos = lambda x: (jnp.sin(x), jnp.cos(x))
    if not wide:
        plain = inspect.unwrap(lanes_module._on_lanes)
        lanes_module._on_lanes = jax.jit(plain, static_argnums=(0, 1))
    lanes, found = BatchRunner(jax.devices()[:1]), {}
    for size in sizes:
        cases = cases_of(size)
        stack, runs = stack_of(cases), max(1, 2048 // size)
        found[str(size)] = ns_per_lane_step(lanes, stack, 1, runs * 1024, rounds)
    return found


def cores_task(rounds: int, lanes: int, periods: int) -> dict[str, Any]:
    """ns per lane-step in one device and on two, in turns; and whether both say the same."""
    stack = stack_of(cases_of(lanes))
    runners = {count: BatchRunner(jax.devices()[:count]) for count in (1, 2)}
    said = [runner.run(stack, periods)[1] for runner in runners.values()]
    differs = max(
        float(np.nanmax(np.abs(np.asarray(a, float) - np.asarray(b, float)), initial=0.0))
        for a, b in zip(*map(jax.tree.leaves, said), strict=True)
    )
    found: dict[str, Any] = {"1": [], "2": [], "differs": differs}
    for _ in range(rounds):
        for count, runner in runners.items():
            taken = seconds(lambda runner=runner: runner.run(stack, periods))
            found[str(count)].append(1e9 * taken / (width_of(stack) * periods))
    return found


def sweep_task(rounds: int, flanks: str) -> dict[str, Any]:
    """Seconds of `sweep` over 1000 reversals of 45 s: the first call, and those after it."""
    spec = _sweep_spec(flanks)
    tables: list[Any] = []
    first = seconds(lambda: tables.append(vttig_jax.sweep(spec, PAIR)))
    taken = [seconds(lambda: vttig_jax.sweep(spec, PAIR)) for _ in range(rounds)]
    table = vttig_jax.sweep(_sweep_spec(flanks, **_OTHER), PAIR)
    last = vttig_jax.sweep(spec, PAIR)
    case = vttig_jax.simulate(
        spec_of({"flanks": flanks, "motion.reversal_deg": SWEEP_TURNS["to"]}), PAIR
    )
    names = ("jump_deg", "residual_gap_deg", "interference_mm", "detection_deg")
    differs = max(abs(case.metrics[name] - last.columns[name][-1]) for name in names)
    return {
        "cases": len(last.columns["case"]),
        "lane_steps": last.lane_steps,
        "first_s": first,
        "again_s": taken,
        "compile_s": tables[0].compile_s,
        "new_values_compile_s": table.compile_s,
        "differs": differs,
    }


_OTHER = {
    "eccentricities.driving_mm": 0.02,
    "eccentricities.constant_backlash_deg": 0.05,
    "judgement.threshold_rad_s2": 1.5,
    "motion.speed_rpm": 58.1,
    "mesh.restitution": 0.5,
    "actuator.stroke_mm": 5.0,
    "driving_encoder.counts_per_rev": 20_000,
}
"""New values of every kind."""


def _sweep_spec(flanks: str, **values: Any) -> ScenarioSpec:
    table = spec_table(spec_of({**BASE, "flanks": flanks, **values}))
    return parse_scenario_spec({**table, "sweep": {"motion.reversal_deg": SWEEP_TURNS}})


def memory_task(seconds_long: float) -> dict[str, float]:
    """Largest resident memory of a process that runs 256 lanes for so long, MiB."""
    turn = 344.0 * (seconds_long / 2 - 1.0)
    cases = cases_of(256, turns=(turn, turn + 10.0))
    lanes = BatchRunner(jax.devices()[:1])
    lanes.run(stack_of(cases), round(1000 * seconds_long))
    return {"MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}


_TASKS = {
    "lanes": lanes_task,
    "cores": cores_task,
    "sweep": sweep_task,
    "memory": memory_task,
}


def main() -> None:
    task, arguments = sys.argv[1], json.loads(sys.argv[2])
    if arguments.pop("prepared", True):
        vttig_jax.prepare_cpu(len(os.sched_getaffinity(0)))
    vttig_jax.enable_x64()
    print(json.dumps(_TASKS[task](**arguments)))


if __name__ == "__main__":
    main()

"""Sweep over the product of named axes: thousands of cases, run block by block."""

import time
from collections.abc import Callable
from contextlib import closing
from functools import lru_cache
from pathlib import Path

import jax
import numpy as np

from ...base.runtime import require_x64
from ...pair.gear_pair import Drive, GearPair
from ..controllers.controller import Controller
from ..scenario.axes import SCENARIO_FILE
from ..scenario.spec import ScenarioSpec
from ..simulation.build import Maps
from .batching import BatchRunner
from .blocks import REFUSED, Rows, SweepWork
from .cases import recipe_of
from .estimate import SweepCost, estimate
from .store import TABLE, Memory, SweepFolder
from .table import SweepTable, finished_sweep

_REASONS, _EXAMINED = 5, 500
"""Largest number of reported reasons for refusal, and of refused cases examined to find them."""


def sweep(
    spec: str | Path | ScenarioSpec,
    pair: GearPair | Drive | None = None,
    *,
    folder: str | Path | None = None,
    controller: Controller | None = None,
    maps: Maps = Maps(),
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    devices: int | None = None,
    dask: str | None = None,
    announce: Callable[[SweepCost], None] | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> SweepTable:
    """Simulate every case of a sweep: the Cartesian product of its axes.

    Cases that share a compiled program run in parallel lanes, a few hundred per device, in blocks
    of a few thousand. A case whose values contradict each other gets the outcome `refused`; the
    sweep continues. Call `vttig_jax.prepare_cpu(devices=…)` first to use several cores; a step then
    also takes half of the time.

    **Arguments**
    - `spec`: a sweep file (TOML) or its specification.
    - `pair`, `folder`, `controller`: as for `simulate`.
    - `maps`: flank models of the maps that the file names, and of the draws of `rig`, which
      `vttig_jax.sweep` reads; all cases are run for each draw.
    - `out`: folder for `sweep.parquet`, which is written block by block.
    - `resume`: continue with the blocks that are missing in `out`. If `out` holds no sweep, start
      from the beginning; if it holds the complete table, return that table.
    - `overwrite`: replace the sweep in `out`.
    - `devices`: number of JAX devices, by default all.
    - `dask`: address of a dask.distributed scheduler, whose workers get the blocks.
    - `announce`: is called with the expected size before the sweep starts.
    - `progress`: is called with the finished and the expected lane-steps.

    **Raises** `ScenarioError`, `PairError`, `InputError` for a sweep that is larger than memory or
    disk, `UsageError` for a folder that may not be written, and `ValueError` without 64-bit floats.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.control import parse_scenario_spec
    >>> from vttig_jax.rig import paper_pair
    >>> vttig_jax.enable_x64()
    >>> rig = {"driving_mm": 0.0226, "driving_phase_deg": 49.5, "driven_mm": 0.0273}
    >>> rig |= {"driven_phase_deg": 79.3, "constant_backlash_deg": 0.038}
    >>> axes = {"motion.reversal_deg": [360.0, 540.0], "controller": ["none", "predictive"]}
    >>> given = {"pair": "pair.toml", "eccentricities": rig, "motion": {"dwell_s": 0.1}}
    >>> spec = parse_scenario_spec(given | {"sweep": axes})
    >>> table = vttig_jax.sweep(spec, paper_pair())
    >>> table.columns["residual_gap_deg"].round(4).tolist()
    [0.0332, 0.0008, 0.0589, 0.0008]

    ```
    """
    require_x64("sweep")
    if (resume or overwrite) and out is None:
        raise ValueError("Argument `out` must name a folder for `resume` and `overwrite`.")
    recipe = recipe_of(spec, pair, folder, controller, maps)
    if resume and out is not None and (done := finished_sweep(recipe, Path(out))):
        return done
    with SCENARIO_FILE.error_context("" if isinstance(spec, ScenarioSpec) else str(spec)):
        work = SweepWork(recipe.cases(), _runner(devices))
    path = None if out is None else Path(out)
    compiled = work.runner.compile_s
    header = recipe.header | {"block": work.block_size}
    store = Memory() if path is None else SweepFolder(path, header, resume, overwrite)
    with store:
        expected = estimate(work, path)
        todo = [number for number in range(work.blocks) if number not in store.done]
        share = len(todo) / work.blocks
        expected = expected._replace(lane_steps=share * expected.lane_steps)
        if announce is not None:
            announce(expected)
        finished = 0

        def add_steps(steps: int) -> None:
            nonlocal finished
            finished += steps
            if progress is not None:
                progress(finished, expected.lane_steps)

        writing = 0.0

        def write(number: int, rows: Rows) -> None:
            nonlocal writing
            started = time.perf_counter()
            store.write(number, rows)
            writing += time.perf_counter() - started

        began, before = time.perf_counter(), work.runner.compile_s
        busy = work.runner.device_s
        workers = len(work.runner.devices)
        if dask is not None:
            from .cluster import on_cluster

            workers = on_cluster(dask, recipe, todo, write, add_steps)
        else:
            with closing(work.run_blocks(todo, add_steps)) as blocks:
                for number, rows in blocks:
                    write(number, rows)
        spent = time.perf_counter() - began - (work.runner.compile_s - before)
        joining = time.perf_counter()
        columns = store.finish(work.blocks)
        writing += time.perf_counter() - joining
    return SweepTable(
        spec=recipe.spec,
        pair=recipe.pair.name,
        columns=columns,
        axes=work.cases.axes,
        lane_steps=finished,
        run_s=spent,
        compile_s=work.runner.compile_s - compiled,
        devices=workers,
        build_s=work.build_s,
        device_s=(work.runner.device_s - busy) / len(work.runner.devices),
        write_s=writing,
        refusals=_refusals(work, columns),
        path=None if path is None else path / TABLE,
        closing=work.cases.closing,
    )


@lru_cache
def _runner(devices: int | None) -> BatchRunner:
    """Return a cached runner on the first `devices` JAX devices, or on all of them for None.

    **Raises** `ValueError` for a number of devices that JAX does not have.
    """
    available = jax.devices()
    if devices is not None and not 1 <= devices <= len(available):
        raise ValueError(
            f"Argument `devices` must be 1 … {len(available)}, the devices of JAX, but is"
            f" {devices}; for more cores call `vttig_jax.prepare_cpu(devices=…)` before JAX starts."
        )
    return BatchRunner(available[:devices])


def _refusals(work: SweepWork, columns: Rows) -> tuple[tuple[int, str], ...]:
    """Return the first examined refused case of each reason, as pairs (case number, reason)."""
    refused = columns["case"][columns["outcome"] == REFUSED]
    examined = refused[np.linspace(0, len(refused) - 1, min(len(refused), _EXAMINED)).astype(int)]
    reasons: dict[str, int] = {}
    for number in examined.tolist():
        reasons.setdefault(str(work.cases.case(number)), number)
        if len(reasons) == _REASONS:
            break
    return tuple((number, reason) for reason, number in reasons.items())

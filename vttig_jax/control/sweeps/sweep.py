"""Sweep over the product of named axes: thousands of cases, run block by block."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, closing
from functools import lru_cache
from pathlib import Path
from typing import Any

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
from .table import SweepTable

_REASONS, _EXAMINED = 5, 500
"""Largest number of reported reasons for refusal, and of refused cases examined to find them."""


def sweep(
    spec: str | Path | ScenarioSpec,
    pair: GearPair | Drive | None = None,
    *,
    folder: str | Path | None = None,
    controller: Controller | None = None,
    maps: Maps = Maps(),
    devices: int | None = None,
    store: Callable[[dict[str, Any]], Any] | None = None,
    elsewhere: Callable[..., int] | None = None,
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
    - `devices`: number of JAX devices, by default all.
    - `store`: header of the sweep → where its blocks are kept; by default in memory.
    - `elsewhere`: runs blocks in other processes: (recipe, numbers of blocks, function that keeps
      one, progress) → number of workers. `vttig_jax.sweep` gives both for a folder and a cluster.
    - `announce`: is called with the expected size before the sweep starts.
    - `progress`: is called with the finished and the expected lane-steps.

    **Raises** `ScenarioError`, `PairError`, `InputError` for a sweep that is larger than memory,
    and `ValueError` without 64-bit floats.

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
    recipe = recipe_of(spec, pair, folder, controller, maps)
    with SCENARIO_FILE.error_context("" if isinstance(spec, ScenarioSpec) else str(spec)):
        work = SweepWork(recipe.cases(), _runner(devices))
    compiled = work.runner.compile_s
    kept = (store or Memory)(recipe.header | {"block": work.block_size})
    with kept:
        expected = estimate(work)
        todo = [number for number in range(work.blocks) if number not in kept.done]
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
            kept.write(number, rows)
            writing += time.perf_counter() - started

        began, before = time.perf_counter(), work.runner.compile_s
        busy = work.runner.device_s
        workers = len(work.runner.devices)
        if elsewhere is not None:
            workers = elsewhere(recipe, todo, write, add_steps)
        else:
            with closing(work.run_blocks(todo, add_steps)) as blocks:
                for number, rows in blocks:
                    write(number, rows)
        spent = time.perf_counter() - began - (work.runner.compile_s - before)
        joining = time.perf_counter()
        columns = kept.finish(work.blocks)
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
        closing=work.cases.closing,
    )


class Memory(AbstractContextManager["Memory"]):
    """Store that keeps the blocks of a sweep in memory."""

    def __init__(self, header: dict[str, Any]) -> None:
        self._blocks: dict[int, Rows] = {}

    def __exit__(self, *_: object) -> None:
        self._blocks.clear()

    @property
    def done(self) -> set[int]:
        """Numbers of the blocks that are kept."""
        return set(self._blocks)

    def write(self, number: int, rows: Rows) -> None:
        """Keep a block."""
        self._blocks[number] = rows

    def finish(self, blocks: int) -> Rows:
        """Return the columns of all blocks, concatenated."""
        parts = [self._blocks[number] for number in range(blocks)]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


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

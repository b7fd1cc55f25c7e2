"""Sweep over the product of named axes: thousands of cases, run block by block."""

import os
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ...base.errors import InputError
from ...base.runtime import require_x64
from ...pair.gear_pair import Drive, GearPair
from ..controllers.controller import Controller
from ..scenario.axes import SCENARIO_FILE
from ..scenario.spec import ScenarioSpec
from ..simulation.build import Maps
from ..simulation.metrics import METRICS
from .cases import cases_of
from .table import SweepTable
from .work import REFUSED, Rows, SweepWork, compiled_s

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
    announce: Callable[[str, float], None] | None = None,
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
    - `elsewhere`: runs blocks in other processes: (cases, numbers of blocks, function that keeps
      one, progress) → number of workers. `vttig_jax.sweep` gives both for a folder and a cluster.
    - `announce`: is called with the expected size, as text and in lane-steps, before it starts.
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
    cases = cases_of(spec, pair, folder, controller, maps)
    began, before = time.perf_counter(), compiled_s()
    with SCENARIO_FILE.error_context("" if isinstance(spec, ScenarioSpec) else str(spec)):
        work = SweepWork(cases, _devices(devices))
    _require_memory(len(cases), 2 + len(METRICS) + len(cases.axes))
    finished, writing = 0, 0.0
    with (store or Memory)(cases.header | {"block": work.block_size}) as kept:
        todo = [number for number in range(work.blocks) if number not in kept.done]
        expected = len(todo) / work.blocks * work.expected_steps
        if announce is not None:
            announce(f"{len(cases)} cases, {expected:.3g} lane-steps", expected)

        def add_steps(steps: int) -> None:
            nonlocal finished
            finished += steps
            if progress is not None:
                progress(finished, expected)

        def write(number: int, rows: Rows) -> None:
            nonlocal writing
            started = time.perf_counter()
            kept.write(number, rows)
            writing += time.perf_counter() - started

        workers = len(work.devices)
        if elsewhere is not None:
            workers = elsewhere(cases, todo, write, add_steps)
        else:
            for number in todo:
                write(number, work.run(number, add_steps))
        compiling = compiled_s() - before
        spent, joining = time.perf_counter() - began - compiling, time.perf_counter()
        columns = kept.finish(work.blocks)
        writing += time.perf_counter() - joining
    return SweepTable(
        spec=cases.spec,
        pair=cases.pair.name,
        columns=columns,
        axes=cases.axes,
        lane_steps=finished,
        run_s=spent,
        compile_s=compiling,
        devices=workers,
        build_s=work.build_s,
        device_s=work.device_s,
        write_s=writing,
        refusals=_refusals(work, columns),
        closing=cases.closing,
    )


def _devices(count: int | None) -> list[Any]:
    """Return the first `count` JAX devices, or all of them for None.

    **Raises** `ValueError` for a number of devices that JAX does not have.
    """
    available = jax.devices()
    if count is not None and not 1 <= count <= len(available):
        raise ValueError(
            f"Argument `devices` must be 1 … {len(available)}, the devices of JAX, but is"
            f" {count}; for more cores call `vttig_jax.prepare_cpu(devices=…)` before JAX starts."
        )
    return available[:count]


def _require_memory(count: int, columns: int) -> None:
    """Raise `InputError` for a table that is, with a copy of it, larger than the memory."""
    if not hasattr(os, "sysconf"):  # on Windows
        return
    needed = 16e-9 * count * columns
    available = 1e-9 * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if needed > available:
        raise InputError(
            f"{count} cases need {needed:.3g} GB of memory, but there are {available:.3g};"
            " split an axis into several sweeps.",
            where="sweep",
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

"""Batches of cases. A batch is run by one compiled program with one case per lane.

Each device runs one batch at a time.
"""

import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...base.arrays import Numbers
from ..simulation.accumulators import Accumulators
from ..simulation.case import State, initial_state, run_periods
from ..simulation.metrics import MetricInputs, metric_inputs_of
from .case_leaves import CaseLeaves, CaseStructure

STEPS = 1024
"""Plant steps in one compiled call: a chosen value."""

LANES = 512
"""Largest number of lanes on one device, so that their state fits its cache; a chosen value."""

_FEWEST = 8
"""Smallest number of lanes: a 512-bit vector holds 8 float64 numbers."""


class CaseBatch(NamedTuple):
    """Cases of one structure, one per lane.

    - `structure`: see `CaseStructure`. - `leaves`: arrays of the cases, each either with a first
      axis over the lanes or shared by all lanes. - `batched`: which arrays have this axis.
    - `lanes`: number of lanes, including those filled with copies.
    """

    structure: CaseStructure
    batched: tuple[bool, ...]
    leaves: tuple[Any, ...]
    lanes: int


def batch_of(cases: Sequence[CaseLeaves], batched: tuple[bool, ...], lanes: int) -> CaseBatch:
    """Return a batch of the cases; copies of the last case fill the remaining lanes.

    An array that differs between the cases gets a lane axis even if `batched` is false for it.
    """
    filled = [*cases, *[cases[-1]] * (lanes - len(cases))]
    columns = list(zip(*(case.leaves for case in filled), strict=True))
    has_axis = tuple(b or _differs(column) for b, column in zip(batched, columns, strict=True))
    leaves = tuple(
        np.stack([np.asarray(leaf) for leaf in column]) if differs else column[0]
        for column, differs in zip(columns, has_axis, strict=True)
    )
    return CaseBatch(cases[0].structure, has_axis, leaves, lanes)


def _differs(column: Sequence[Numbers]) -> bool:
    """Return whether one of the arrays differs from the first."""
    return any(
        leaf is not column[0] and not np.array_equal(leaf, column[0], equal_nan=True)
        for leaf in column
    )


def varying(cases: Sequence[CaseLeaves]) -> tuple[bool, ...]:
    """Return, for each array of a case, whether it differs between cases of one structure."""
    return tuple(map(_differs, zip(*(case.leaves for case in cases), strict=True)))


def lanes_for(cases: int, devices: int) -> int:
    """Return the number of lanes of a batch: a power of two, so that few programs are compiled.

    It is small enough that every device gets a batch if there are enough cases.
    """
    lanes = _FEWEST
    while lanes < LANES and lanes * devices < cases:
        lanes *= 2
    return lanes


class BatchRunner:
    """Runner of batches on devices, one batch per device at a time; threads may share a runner.

    Processor cores that are JAX devices share their memory, so all of them use programs compiled
    once for the first core. For each GPU the programs are compiled separately.

    - `compile_s`: time in which any thread compiled, s.
    - `device_s`: sum over all threads of the time in which they ran batches, s.

    **Arguments**
    - `devices`: devices of JAX, by default all.
    """

    def __init__(self, devices: Sequence[Any] | None = None) -> None:
        self.devices = list(devices or jax.devices())
        self.compile_s = self.device_s = 0.0
        self._lock, self._counted = threading.Lock(), 0.0
        self._programs: dict[Any, threading.Lock] = {}
        self._compiled: set[Any] = set()

    def run(
        self,
        batch: CaseBatch,
        periods: int,
        progress: Callable[[int, int], None] | None = None,
        place: int = 0,
    ) -> tuple[MetricInputs, Accumulators]:
        """Run a batch on the device number `place`; return metric inputs and accumulators per lane.

        `periods` as in `Case`. After each compiled call `progress` is called in this thread with
        the numbers of finished periods before and after it.
        """
        device = self.devices[0 if self.devices[0].platform == "cpu" else place]
        chunk = max(STEPS // batch.structure.substeps, 1)
        program, leaves = batch[:2], jax.device_put(batch.leaves, device)

        def advanced(state: State, first: int) -> State:
            number = jax.device_put(np.asarray(first), device)
            return jax.block_until_ready(_continue_lanes(*program, chunk, leaves, state, number))

        key = (*program, batch.lanes, chunk, device.id)
        with self._programs.setdefault(key, threading.Lock()):
            began = time.perf_counter()
            state, inputs = _start_lanes(*program, batch.lanes, leaves)
            if key not in self._compiled:  # other threads wait until it is
                advanced(state, 0)
                self._compiled.add(key)
                self._count_compilation(began)
        began = time.perf_counter()
        for first in range(0, periods, chunk):
            state = advanced(state, first)
            if progress is not None:
                progress(first, min(first + chunk, periods))
        with self._lock:
            self.device_s += time.perf_counter() - began
        return jax.tree.map(np.asarray, (inputs, state.accumulators))

    def _count_compilation(self, began: float) -> None:
        """Add the time since `began` in which no compilation was counted yet."""
        with self._lock:
            now = time.perf_counter()
            self.compile_s += now - max(began, self._counted)
            self._counted = now


@partial(jax.jit, static_argnums=(0, 1, 2))
def _start_lanes(
    structure: CaseStructure, batched: tuple[bool, ...], lanes: int, leaves: Any
) -> tuple[State, MetricInputs]:
    def start(leaves: Any) -> tuple[State, MetricInputs]:
        case = structure.case(leaves)
        return initial_state(case), metric_inputs_of(case)

    return jax.vmap(start, in_axes=(_axes(batched),), axis_size=lanes)(leaves)


@partial(
    jax.jit,
    static_argnums=(0, 1, 2),
    compiler_options={"xla_cpu_prefer_vector_width": 512},
)
def _continue_lanes(
    structure: CaseStructure,
    batched: tuple[bool, ...],
    chunk: int,
    leaves: Any,
    state: State,
    first: Any,
) -> State:
    def run(leaves: Any, state: State) -> State:
        return run_periods(structure.case(leaves), state, first + jnp.arange(chunk))

    return jax.vmap(run, in_axes=(_axes(batched), 0))(leaves, state)


def _axes(batched: tuple[bool, ...]) -> tuple[int | None, ...]:
    return tuple(0 if has_axis else None for has_axis in batched)

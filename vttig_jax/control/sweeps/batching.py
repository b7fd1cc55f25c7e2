"""Batches of cases. A batch is run by one compiled program with one case per lane.

Each device runs one batch at a time.
"""

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
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
    leaves, has_axis = list[Any](), list[bool]()
    for index, needed in enumerate(batched):
        column = [case.leaves[index] for case in filled]
        first = column[0]
        differs = needed or any(not _same(leaf, first) for leaf in column)
        has_axis.append(differs)
        leaves.append(np.stack([np.asarray(leaf) for leaf in column]) if differs else first)
    return CaseBatch(cases[0].structure, tuple(has_axis), tuple(leaves), lanes)


def _same(first: Numbers, second: Numbers) -> bool:
    return first is second or bool(np.array_equal(first, second, equal_nan=True))


def varying(samples: Sequence[CaseLeaves]) -> tuple[bool, ...]:
    """Return, for each array of a case, whether it differs between the cases `samples`.

    All cases must have one structure.
    """
    first = samples[0].leaves
    return tuple(
        any(not _same(sample.leaves[index], leaf) for sample in samples[1:])
        for index, leaf in enumerate(first)
    )


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
        self.compile_s = 0.0
        self.device_s = 0.0
        self._compiled: dict[Any, Future[Callable[..., Any]]] = {}
        self._lock = threading.Lock()
        self._compiling, self._began = 0, 0.0

    def run(
        self,
        batch: CaseBatch,
        periods: int,
        substeps: int,
        progress: Callable[[int, int], None] | None = None,
        place: int = 0,
    ) -> tuple[MetricInputs, Accumulators]:
        """Run a batch on the device number `place`; return metric inputs and accumulators per lane.

        `periods` and `substeps` as in `Case`. After each compiled call `progress` is called in this
        thread with the numbers of finished periods before and after it.
        """
        device = self.devices[0 if self.devices[0].platform == "cpu" else place]
        chunk = max(STEPS // substeps, 1)
        lanes, leaves = jax.device_put((np.arange(batch.lanes), batch.leaves), device)
        start = self._program(_start_lanes, batch, (), (leaves, lanes), device)
        began = time.perf_counter()
        state, inputs = start(leaves, lanes)
        run = None
        for first in range(0, periods, chunk):
            arguments = leaves, state, jax.device_put(np.asarray(first), device)
            if run is None:
                self._add_device_time(began)
                run = self._program(_continue_lanes, batch, (chunk,), arguments, device)
                began = time.perf_counter()
            state = jax.block_until_ready(run(*arguments))
            if progress is not None:
                progress(first, min(first + chunk, periods))
        self._add_device_time(began)
        return jax.tree.map(np.asarray, (inputs, state.accumulators))

    def _add_device_time(self, began: float) -> None:
        with self._lock:
            self.device_s += time.perf_counter() - began

    def _program(
        self,
        function: Any,
        batch: CaseBatch,
        choices: tuple[Any, ...],
        args: tuple[Any, ...],
        device: Any,
    ) -> Callable[..., Any]:
        """Return a compiled program; if several threads need the same one, only one compiles it."""
        key = function, batch.structure, batch.batched, batch.lanes, choices, device.id
        with self._lock:
            own, known = Future[Callable[..., Any]](), self._compiled.get(key)
            if known is None:
                self._compiled[key] = own
                if not self._compiling:
                    self._began = time.perf_counter()
                self._compiling += 1
        if known is not None:
            return known.result()
        try:
            own.set_result(
                function.lower(batch.structure, batch.batched, *choices, *args).compile()
            )
        except BaseException as error:
            with self._lock:  # before the waiting threads go on, so that one of them may try again
                del self._compiled[key]
            own.set_exception(error)
            raise
        finally:
            with self._lock:
                self._compiling -= 1
                if not self._compiling:
                    self.compile_s += time.perf_counter() - self._began
        return own.result()


@partial(jax.jit, static_argnums=(0, 1))
def _start_lanes(
    structure: CaseStructure, batched: tuple[bool, ...], leaves: Any, lane: Any
) -> tuple[State, MetricInputs]:
    def start(leaves: Any, lane: Any) -> tuple[State, MetricInputs]:
        case = jax.tree.unflatten(structure.tree, leaves)
        return initial_state(case), metric_inputs_of(case)

    return jax.vmap(start, in_axes=(_axes(batched), 0))(leaves, lane)


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
    def run(leaves: Any, state: State, first: Any) -> State:
        case = jax.tree.unflatten(structure.tree, leaves)
        return run_periods(case, state, first + jnp.arange(chunk))

    return jax.vmap(run, in_axes=(_axes(batched), 0, None))(leaves, state, first)


def _axes(batched: tuple[bool, ...]) -> tuple[int | None, ...]:
    return tuple(0 if has_axis else None for has_axis in batched)

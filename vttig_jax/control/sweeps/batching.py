"""Batches of cases: one compiled program, one case per lane, lanes distributed over devices."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh
from jax.sharding import PartitionSpec as P

from ..simulation.accumulators import Accumulators
from ..simulation.case import Case, State, initial_state, run_periods
from ..simulation.metrics import MetricInputs, metric_inputs_of

STEPS = 1024
"""Plant steps in one compiled call: a chosen value."""

LANES = 512
"""Limit of lanes on one device, so that their state stays in its cache: a chosen value."""

_FEWEST = 8
"""Least number of lanes: the float64 numbers in a vector of 512 bits."""


class CaseStructure(NamedTuple):
    """Structure of cases that share one compiled program; it is hashable.

    - `tree`: tree with all static choices. - `shapes`: shapes of the numbers.
    """

    tree: Any
    shapes: tuple[tuple[int, ...], ...]


class CaseLeaves(NamedTuple):
    """Structure of one case, and its numbers in the order of the tree."""

    structure: CaseStructure
    leaves: tuple[Any, ...]


def leaves_of(case: Case) -> CaseLeaves:
    """Split a case into its structure and its numbers."""
    leaves, tree = jax.tree.flatten(case)
    leaves = tuple(leaf if isinstance(leaf, np.ndarray) else np.asarray(leaf) for leaf in leaves)
    return CaseLeaves(CaseStructure(tree, tuple(leaf.shape for leaf in leaves)), leaves)


class CaseBatch(NamedTuple):
    """Cases of one structure in lanes.

    - `batched`: for each number, whether it has a lane axis. - `leaves`: numbers, with a first axis
      over the lanes or shared by all lanes. - `lanes`: number of lanes, fillers included.
    """

    structure: CaseStructure
    batched: tuple[bool, ...]
    leaves: tuple[Any, ...]
    lanes: int


def batch_of(cases: Sequence[CaseLeaves], batched: tuple[bool, ...], lanes: int) -> CaseBatch:
    """Put cases into lanes; copies of the last case fill the remaining lanes.

    A number that differs between the cases gets a lane axis even where `batched` is false.
    """
    filled = [*cases, *[cases[-1]] * (lanes - len(cases))]
    leaves, has_axis = list[Any](), list[bool]()
    for index, needed in enumerate(batched):
        column = [case.leaves[index] for case in filled]
        first = column[0]
        differs = needed or any(leaf is not first and not _same(leaf, first) for leaf in column)
        has_axis.append(differs)
        leaves.append(np.stack(column) if differs else first)
    return CaseBatch(cases[0].structure, tuple(has_axis), tuple(leaves), lanes)


def _same(first: np.ndarray, second: np.ndarray) -> bool:
    return bool(np.array_equal(first, second, equal_nan=True))


def varying(samples: Sequence[CaseLeaves]) -> tuple[bool, ...]:
    """Return for each number whether it differs between cases of one structure."""
    first = samples[0].leaves
    return tuple(
        any(not _same(sample.leaves[index], leaf) for sample in samples[1:])
        for index, leaf in enumerate(first)
    )


def lanes_for(cases: int, devices: int) -> int:
    """Return the number of lanes: a power of two per device, so that few programs are compiled."""
    lanes = _FEWEST
    while lanes < LANES and lanes * devices < cases:
        lanes *= 2
    return lanes * devices


class BatchRunner:
    """Runner of batches on devices; `compile_s` is the total time of compilation, s.

    **Arguments**
    - `devices`: devices of JAX, by default all.
    """

    def __init__(self, devices: Sequence[Any] | None = None) -> None:
        self.devices = list(devices or jax.devices())
        self.compile_s = 0.0
        self._mesh = Mesh(np.array(self.devices), ("lane",), axis_types=(AxisType.Auto,))
        self._compiled: dict[Any, Callable[..., Any]] = {}

    def run(
        self,
        batch: CaseBatch,
        periods: int,
        substeps: int,
        progress: Callable[[int, int], None] | None = None,
    ) -> tuple[MetricInputs, Accumulators]:
        """Run all lanes; `progress` is called with start and end of the finished periods."""
        chunk = max(STEPS // substeps, 1)
        leaves = tuple(map(jnp.asarray, batch.leaves))
        state, inputs = self._call(_start_lanes, batch, (), (leaves, jnp.arange(batch.lanes)))
        for first in range(0, periods, chunk):
            arguments = leaves, state, jnp.asarray(first)
            state = self._call(_continue_lanes, batch, (chunk,), arguments)
            jax.block_until_ready(state)  # Ctrl-C is handled here
            if progress is not None:
                progress(first, min(first + chunk, periods))
        return jax.tree.map(np.asarray, (inputs, state.accumulators))

    def _call(
        self, function: Any, batch: CaseBatch, choices: tuple[Any, ...], args: tuple[Any, ...]
    ) -> Any:
        key = function, batch.structure, batch.batched, batch.lanes, choices
        if key not in self._compiled:
            began = time.perf_counter()
            static = self._mesh, batch.structure, batch.batched, *choices
            self._compiled[key] = function.lower(*static, *args).compile()
            self.compile_s += time.perf_counter() - began
        return self._compiled[key](*args)


@partial(jax.jit, static_argnums=(0, 1, 2))
def _start_lanes(
    mesh: Mesh, structure: CaseStructure, batched: tuple[bool, ...], leaves: Any, lane: Any
) -> Any:
    def start(leaves: Any, lane: Any) -> tuple[State, MetricInputs]:
        case = jax.tree.unflatten(structure.tree, leaves)
        return initial_state(case), metric_inputs_of(case)

    return _over_lanes(mesh, start, (_axes(batched), 0))(leaves, lane)


@partial(
    jax.jit,
    static_argnums=(0, 1, 2, 3),
    compiler_options={"xla_cpu_prefer_vector_width": 512},
)
def _continue_lanes(
    mesh: Mesh,
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

    return _over_lanes(mesh, run, (_axes(batched), 0, None))(leaves, state, first)


def _axes(batched: tuple[bool, ...]) -> tuple[int | None, ...]:
    return tuple(0 if has_axis else None for has_axis in batched)


def _over_lanes(mesh: Mesh, call: Callable[..., Any], axes: tuple[Any, ...]) -> Callable[..., Any]:
    """Map a function of one lane over all lanes and devices; `axes` as `in_axes` of `vmap`."""
    specs = jax.tree.map(
        lambda axis: P() if axis is None else P("lane"), axes, is_leaf=lambda axis: axis is None
    )
    lanes = jax.vmap(call, in_axes=axes)
    # The check is off, because results that depend on no lane stay unbatched inside.
    return jax.shard_map(lanes, mesh=mesh, in_specs=specs, out_specs=P("lane"), check_vma=False)

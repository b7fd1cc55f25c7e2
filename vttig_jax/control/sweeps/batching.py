"""Many cases at once: one compiled program, a case in every lane, lanes spread over devices."""

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
from ..simulation.case import Case, State, finished, started
from ..simulation.metrics import MetricInputs, facts_of

STEPS = 1024
"""Steps of the plant in one compiled call."""

LANES = 512
"""Most lanes a device runs at once: their state stays in its cache."""

_FEWEST = 8
"""Lanes that a vector holds."""


class CaseStructure(NamedTuple):
    """What cases have in common that run as one compiled program; hashable.

    - `tree`: their structure with all choices that are no numbers. - `shapes`: of their numbers.
    """

    tree: Any
    shapes: tuple[tuple[int, ...], ...]


class CaseLeaves(NamedTuple):
    """The numbers of one case, in the order of its tree."""

    program: CaseStructure
    leaves: tuple[Any, ...]


def numbers_of(case: Case) -> CaseLeaves:
    """Take a case apart into its program and its numbers."""
    leaves, tree = jax.tree.flatten(case)
    leaves = tuple(leaf if isinstance(leaf, np.ndarray) else np.asarray(leaf) for leaf in leaves)
    return CaseLeaves(CaseStructure(tree, tuple(leaf.shape for leaf in leaves)), leaves)


class CaseBatch(NamedTuple):
    """Cases of one program side by side.

    - `leaves`: numbers, those of all lanes stacked along a first axis where `own` says so, a single
      one where all lanes share it. - `lanes`: how many, those that fill up included.
    """

    program: CaseStructure
    own: tuple[bool, ...]
    leaves: tuple[Any, ...]
    lanes: int


def stacked(cases: Sequence[CaseLeaves], own: tuple[bool, ...], lanes: int) -> CaseBatch:
    """Put cases side by side; the last one fills the lanes that are left.

    A number that differs between the cases gets lanes of its own even where `own` does not say so.
    """
    filled = [*cases, *[cases[-1]] * (lanes - len(cases))]
    program, leaves, apart = cases[0].program, list[Any](), list[bool]()
    for place, needed in enumerate(own):
        column = [case.leaves[place] for case in filled]
        first = column[0]
        differs = needed or any(leaf is not first and not _same(leaf, first) for leaf in column)
        apart.append(differs)
        leaves.append(np.stack(column) if differs else first)
    return CaseBatch(program, tuple(apart), tuple(leaves), lanes)


def _same(one: np.ndarray, other: np.ndarray) -> bool:
    return bool(np.array_equal(one, other, equal_nan=True))


def varying(samples: Sequence[CaseLeaves]) -> tuple[bool, ...]:
    """Which numbers differ between cases of one program."""
    first = samples[0].leaves
    return tuple(
        any(not _same(sample.leaves[place], leaf) for sample in samples[1:])
        for place, leaf in enumerate(first)
    )


def lanes_for(cases: int, devices: int) -> int:
    """Lanes that so many cases take: a power of two a device, so that few programs are compiled."""
    lanes = _FEWEST
    while lanes < LANES and lanes * devices < cases:
        lanes *= 2
    return lanes * devices


class BatchRunner:
    """Runs stacks on devices.

    **Arguments**
    - `devices`: all of JAX's by default.

    `compile_s` adds up what compilation took.
    """

    def __init__(self, devices: Sequence[Any] | None = None) -> None:
        self.devices = list(devices or jax.devices())
        self.compile_s = 0.0
        self._mesh = Mesh(np.array(self.devices), ("lane",), axis_types=(AxisType.Auto,))
        self._compiled: dict[Any, Callable[..., Any]] = {}

    def run(
        self,
        stack: CaseBatch,
        periods: int,
        substeps: int,
        tick: Callable[[int, int], None] | None = None,
    ) -> tuple[MetricInputs, Accumulators]:
        """All lanes from their first period to their last; `tick` is told which periods it did."""
        chunk = max(STEPS // substeps, 1)
        leaves = tuple(map(jnp.asarray, stack.leaves))
        state, facts = self._call(_start, stack, (), leaves, jnp.arange(stack.lanes))
        for first in range(0, periods, chunk):
            state = self._call(_go_on, stack, (chunk,), leaves, state, jnp.asarray(first))
            jax.block_until_ready(state)  # Ctrl-C lands here
            if tick is not None:
                tick(first, min(first + chunk, periods))
        return jax.tree.map(np.asarray, (facts, state.tally))

    def _call(self, function: Any, stack: CaseBatch, choices: tuple[Any, ...], *given: Any) -> Any:
        key = function, stack.program, stack.own, stack.lanes, choices
        if key not in self._compiled:
            began = time.perf_counter()
            static = self._mesh, stack.program, stack.own, *choices
            self._compiled[key] = function.lower(*static, *given).compile()
            self.compile_s += time.perf_counter() - began
        return self._compiled[key](*given)


@partial(jax.jit, static_argnums=(0, 1, 2))
def _start(
    mesh: Mesh, program: CaseStructure, own: tuple[bool, ...], leaves: Any, lane: Any
) -> Any:
    def one(leaves: Any, lane: Any) -> tuple[State, MetricInputs]:
        case = jax.tree.unflatten(program.tree, leaves)
        return started(case), facts_of(case)

    return _spread(mesh, one, (_axes(own), 0))(leaves, lane)


@partial(
    jax.jit,
    static_argnums=(0, 1, 2, 3),
    compiler_options={"xla_cpu_prefer_vector_width": 512},
)
def _go_on(
    mesh: Mesh,
    program: CaseStructure,
    own: tuple[bool, ...],
    chunk: int,
    leaves: Any,
    state: State,
    first: Any,
) -> State:
    def one(leaves: Any, state: State, first: Any) -> State:
        case = jax.tree.unflatten(program.tree, leaves)
        return finished(case, state, first + jnp.arange(chunk))

    return _spread(mesh, one, (_axes(own), 0, None))(leaves, state, first)


def _axes(own: tuple[bool, ...]) -> tuple[int | None, ...]:
    return tuple(0 if apart else None for apart in own)


def _spread(mesh: Mesh, one: Callable[..., Any], axes: tuple[Any, ...]) -> Callable[..., Any]:
    """A function of one lane over all lanes, every device its share; `axes` as `in_axes`."""
    specs = jax.tree.map(
        lambda axis: P() if axis is None else P("lane"), axes, is_leaf=lambda axis: axis is None
    )
    batched = jax.vmap(one, in_axes=axes)
    # What no lane changes stays unbatched inside, which the check of varying axes does not know.
    return jax.shard_map(batched, mesh=mesh, in_specs=specs, out_specs=P("lane"), check_vma=False)

"""Work of a sweep: blocks of cases, which run side by side as lanes of compiled programs.

A program is `vmap` of the loop over the periods, shared out to the devices by `shard_map`. Cases
that differ in texts, plant steps or queue of commands have programs of their own. All other numbers
are arrays over the lanes, from the axes of the sweep to the leaves of the case.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec
from msgspec import structs

from ...base.errors import InputError
from ...base.units import REV
from ...kinematics.flank_table import FlankTable
from ..plants.plant import Drag
from ..scenario.spec import KEYS, ScenarioSpec, with_numbers
from ..simulation.accumulators import Accumulators
from ..simulation.build import motion_of, scenario_of
from ..simulation.case import State, initial_state, run_periods
from ..simulation.metrics import METRICS, MetricInputs, metric_inputs_of, metrics_of, outcomes_of
from ..simulation.prepare import (
    Fixed,
    covers,
    delay_of,
    drawn_tables,
    ends_of,
    located_turns,
    prepared,
    queue_of,
    substeps_of,
)
from ..simulation.simulate import CHUNK
from .cases import SweepCases

Rows = dict[str, np.ndarray]
"""Columns of a table: `case`, the axes, the metrics, `outcome`."""

REFUSED = "refused"
"""Outcome of a case whose values contradict each other, so that it is not simulated."""

_FEWEST, LANES = 8, 512
"""Smallest and largest number of lanes on a device: a 512-bit vector holds 8 numbers, and the state
of 512 lanes fits the cache of a core; chosen values."""

_BLOCK_STEPS = 1 << 28
"""Largest number of lane-steps in a block, about ten seconds; a chosen value.

A lane-step is one plant step of one case. An interruption loses at most the running block."""

_LEAST, _MOST = 64, 4 * LANES
"""Smallest and largest number of cases of one program in a block; chosen values."""

_MOST_KINDS = 16
"""Largest number of text combinations that is used for the block size; a chosen value."""

_SAMPLED = 64
"""Number of cases whose run length is examined beforehand; a chosen value."""

_compiled_s = [0.0]


@jax.monitoring.register_event_duration_secs_listener
def _count_compilation(event: str, duration_secs: float, **_: Any) -> None:
    if event == "/jax/core/compile/backend_compile_duration":
        _compiled_s[0] += duration_secs


def compiled_s() -> float:
    """Return the time in which XLA has compiled programs in this process, s."""
    return _compiled_s[0]


def mesh_of(devices: Sequence[Any]) -> Mesh:
    """Return the devices as a mesh over which lanes are shared out."""
    return Mesh(np.array(devices), ("lanes",), axis_types=(AxisType.Auto,))


class Lanes(NamedTuple):
    """Cases side by side.

    - `structure`: tree of a case. - `mapped`: which of its leaves have a first axis over the lanes;
      all lanes share the others. - `leaves`: see above. - `width`: number of lanes.
    """

    structure: Any
    mapped: tuple[bool, ...]
    leaves: tuple[Any, ...]
    width: int

    def run(
        self,
        periods: np.ndarray,
        mesh: Mesh,
        progress: Callable[[int], None] = lambda steps: None,
    ) -> tuple[MetricInputs, Accumulators]:
        """Run the lanes; return the inputs of the metrics and the accumulators of each.

        `periods` are those of the lanes that count; `progress` gets their finished plant steps.
        """
        program = self.structure, self.mapped, mesh
        places = tuple(NamedSharding(mesh, spec) for spec in _specs(self.mapped))
        leaves = jax.device_put(self.leaves, places)
        state, inputs = _start(*program, self.width // mesh.size, leaves)
        substeps = jax.tree.unflatten(self.structure, leaves).substeps
        chunk = max(CHUNK // substeps, 1)
        for first in range(0, int(periods.max()), chunk):
            state = jax.block_until_ready(_advance(*program, chunk, leaves, state, first))
            done = np.minimum(periods, first + chunk) - np.minimum(periods, first)
            progress(int(done.sum()) * substeps)
        return jax.tree.map(np.asarray, (inputs, state.accumulators))


class _Kind(NamedTuple):
    """What the cases of one program have in common: texts, plant steps in a period, queue."""

    texts: tuple[str, ...]
    turn: str
    substeps: int
    queue: int


class SweepWork:
    """Blocks of a sweep, ready to run on some devices, by default all of JAX.

    **Raises** the `InputError` of the first case if no case that is examined can run.
    """

    def __init__(self, cases: SweepCases, devices: Sequence[Any] | None = None) -> None:
        self.cases = cases
        self.devices = list(devices or jax.devices())
        self.build_s = self.device_s = 0.0
        """Time in which cases were built, and in which they ran, s."""
        self._mesh = mesh_of(self.devices)
        self._substeps = lru_cache(4096)(self._find_substeps)
        maps: Any = cases.maps
        self._drawn = lru_cache(8)(partial(drawn_tables, maps.draws, cases.pair, maps.number))
        count = len(cases)
        sampled = sorted({count * place // _SAMPLED for place in range(_SAMPLED)})
        steps = [self._steps(number) for number in sampled]
        possible = (number for number, work in zip(sampled, steps, strict=True) if work)
        if all(isinstance(cases.case(number), InputError) for number in possible):
            refused = cases.case(0)
            assert isinstance(refused, InputError)
            raise refused
        self.expected_steps = count * float(np.mean(steps))
        """Lane-steps of all cases, from the lengths of some of them."""
        kinds = min(len({_texts(cases.values(number)) for number in sampled}), _MOST_KINDS)
        size = int(np.clip(_BLOCK_STEPS * count / (kinds * self.expected_steps), _LEAST, _MOST))
        self.block_size = kinds << (size.bit_length() - 1)
        """Cases in a block, independent of the number of devices so that a sweep can be resumed."""

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return -(-len(self.cases) // self.block_size)

    def _steps(self, number: int) -> float:
        """Return the lane-steps of a case, 0 if it cannot run."""
        try:
            spec = self.cases.spec_of(number)
            motion = motion_of(spec.motion, self.cases.folder).pieces
            periods = float(motion.duration_s) * spec.sampling.controller_hz
            return periods * self._substeps_of(spec)
        except InputError:
            return 0.0

    def run(self, number: int, progress: Callable[[int], None] = lambda steps: None) -> Rows:
        """Return the rows of a block; `progress` gets the number of further finished lane-steps.

        Lanes that are only filled with copies are not counted.
        """
        first = number * self.block_size
        return self.rows(range(first, min(first + self.block_size, len(self.cases))), progress)

    def rows(
        self,
        numbers: Sequence[int],
        progress: Callable[[int], None] = lambda steps: None,
        settings: Mapping[str, np.ndarray] = MappingProxyType({}),
    ) -> Rows:
        """Return the rows of cases with these numbers, and with other values of some keys for each.

        `progress` as for `run`.
        """
        rows: Rows = {name: np.full(len(numbers), np.nan) for name in METRICS}
        outcome = np.full(len(numbers), REFUSED, dtype="<U9")
        for kind, specs in self._kinds(numbers, settings).items():
            for indices, inputs, accumulators in self._ran(
                kind, specs, numbers, settings, progress
            ):
                for name, values in metrics_of(inputs, accumulators).items():
                    rows[name][indices] = values
                outcome[indices] = outcomes_of(inputs, accumulators)
        return self.cases.columns(numbers) | rows | {"outcome": outcome}

    def _kinds(
        self, numbers: Sequence[int], settings: Mapping[str, np.ndarray]
    ) -> dict[_Kind, dict[int, tuple[ScenarioSpec, int]]]:
        """Return the cases of a block that can run: kind → index → scenario, error of its turn."""
        began = time.perf_counter()
        kinds: dict[_Kind, dict[int, tuple[ScenarioSpec, int]]] = {}
        for index, number in enumerate(numbers):
            try:
                own = {name: float(values[index]) for name, values in settings.items()}
                spec = with_numbers(self.cases.spec_of(number), own)
                substeps, turns = self._substeps_of(spec), 0
                turn = spec.judgement.turn
                if turn == "located" and spec.controller != "none":
                    located = located_turns(self.cases.scenario(number))
                    turn, turns = ("unknown", 0) if located is None else (turn, located)
            except InputError:
                continue
            delay = delay_of(spec.actuator.delay_s, spec.sampling.controller_hz)
            kind = _Kind(_texts(self.cases.values(number)), turn, substeps, queue_of(delay))
            kinds.setdefault(kind, {})[index] = spec, turns
        self.build_s += time.perf_counter() - began
        return kinds

    def _ran(
        self,
        kind: _Kind,
        specs: dict[int, tuple[ScenarioSpec, int]],
        numbers: Sequence[int],
        settings: Mapping[str, np.ndarray],
        progress: Callable[[int], None],
    ) -> Iterator[tuple[np.ndarray, MetricInputs, Accumulators]]:
        """Yield indices and results of the cases of one kind, those of similar length together."""
        spec = next(iter(specs.values()))[0]
        spec = structs.replace(spec, judgement=structs.replace(spec.judgement, turn=kind.turn))
        indices = np.array(list(specs))
        columns = self.cases.columns([numbers[index] for index in indices])
        columns = {name: values for name, values in columns.items() if values.dtype.kind != "U"}
        columns |= {name: values[indices] for name, values in settings.items()}
        if kind.turn == "located":
            columns["turns"] = np.array([turns for _, turns in specs.values()])
        courses = self._courses(spec, columns)
        scenario = self._scenario(spec)
        maps = [
            m for m in (scenario.plant_map, scenario.controller_map) if isinstance(m, FlankTable)
        ]
        inside = np.all([covers(m, courses["low"], courses["high"]) for m in maps], axis=0)
        order = np.lexsort((indices, courses["periods"]))
        order = order[np.broadcast_to(inside, order.shape)[order]]
        if not len(order):
            return
        travel = float(courses["low"][order].min()), float(courses["high"][order].max())
        fixed = Fixed(kind.substeps, kind.queue, None, travel)
        columns["sense"] = courses["sense"]
        lanes = lanes_for(len(order), len(self.devices)) * len(self.devices)
        for first in range(0, len(order), lanes):
            chosen = order[first : first + lanes]
            filled = np.pad(chosen, (0, lanes - len(chosen)), "edge")
            began = time.perf_counter()
            try:
                row = {name: values[filled] for name, values in columns.items()}
                side, fits = self._lanes(spec, row, fixed)
            except InputError:  # the same for all cases of the kind
                return
            finally:
                self.build_s += time.perf_counter() - began
            began, before = time.perf_counter(), compiled_s()
            results = side.run(courses["periods"][chosen], self._mesh, progress)
            self.device_s += time.perf_counter() - began - (compiled_s() - before)
            fits = fits[: len(chosen)]
            inputs, accumulators = jax.tree.map(
                lambda values, fits=fits: values[: len(fits)][fits], results
            )
            yield indices[chosen][fits], inputs, accumulators

    def _lanes(self, spec: ScenarioSpec, columns: Rows, fixed: Fixed) -> tuple["Lanes", np.ndarray]:
        """Return cases side by side, and whether the flanks of each do not cross."""
        drawn = self._drawn(fixed.travel) if self.cases.maps.number else None
        found: list[Any] = []

        def build(row: dict[str, Any]) -> Any:
            plant = None
            if drawn is not None:
                tables, smallest = drawn
                place = row["draw"] * (tables.intervals + 1)
                plant = replace(tables, first=place), jnp.asarray(smallest)[row["draw"]]
            scenario = self._scenario(spec, row)
            case, gaps = prepared(
                scenario, fixed, drawn=plant, sense=row["sense"], turns=row.get("turns")
            )
            leaves, structure = jax.tree.flatten(case)
            mapped = tuple(isinstance(leaf, Tracer) for leaf in leaves)
            found.append((structure, mapped, leaves))
            gap = [jnp.asarray(gap) for gap in gaps.values() if gap is not None]
            fits = jnp.all(jnp.stack([jnp.min(one) >= 0 for one in gap] + [jnp.asarray(True)]))
            return [leaf for leaf in leaves if isinstance(leaf, Tracer)], fits

        values, fits = jax.vmap(build)(jax.tree.map(jnp.asarray, columns))
        structure, mapped, leaves = found[-1]
        rest = iter(values)
        leaves = tuple(
            next(rest) if own else leaf for own, leaf in zip(mapped, leaves, strict=True)
        )
        return Lanes(structure, mapped, leaves, len(columns["case"])), np.asarray(fits)

    def _courses(self, spec: ScenarioSpec, columns: Rows) -> Rows:
        """Return travel (turns), direction and number of periods of the motion of every case."""
        folder = self.cases.folder

        def course(row: dict[str, Any]) -> Any:
            case = with_numbers(spec, _settings(row))
            motion = motion_of(case.motion, folder).pieces
            low, high, sense = ends_of(motion)
            length = jnp.asarray(motion.duration_s) / (1.0 / case.sampling.controller_hz)
            periods = jnp.floor(length * (1 + 1e-12)) + 1
            return {"low": low / REV, "high": high / REV, "sense": sense, "periods": periods}

        return jax.tree.map(np.asarray, jax.vmap(course)(jax.tree.map(jnp.asarray, columns)))

    def _scenario(self, spec: ScenarioSpec, row: dict[str, Any] | None = None) -> Any:
        spec = with_numbers(spec, _settings(row or {}))
        return scenario_of(spec, *self.cases.inputs)

    def _substeps_of(self, spec: ScenarioSpec) -> int:
        return self._substeps(spec.plant, spec.mesh, spec.sampling, spec.servo, spec.inertia)

    def _find_substeps(self, plant: str, *tables: Any) -> int:
        names = ("mesh", "sampling", "servo", "inertia")
        given = dict(zip(names, tables, strict=True))
        scenario = self._scenario(
            structs.replace(self.cases.spec, plant=plant, sweep=None, **given)
        )
        shaft = scenario.plant.with_shaft(Drag(scenario.inertia.driven_kgm2), scenario.pair)
        return substeps_of(scenario, shaft)


def _texts(values: dict[str, Any]) -> tuple[str, ...]:
    return tuple(value for value in values.values() if isinstance(value, str))


def _settings(row: dict[str, Any]) -> dict[str, Any]:
    """Return the values of a row of columns that are keys of a scenario."""
    return {name: value for name, value in row.items() if name in KEYS}


def lanes_for(cases: int, devices: int) -> int:
    """Return the number of lanes of a device: a power of two, so that few programs are compiled."""
    lanes = 1 << max(math.ceil(cases / devices) - 1, 0).bit_length()
    return min(max(lanes, _FEWEST), LANES)


def _specs(mapped: tuple[bool, ...]) -> tuple[Any, ...]:
    return tuple(PartitionSpec("lanes") if own else PartitionSpec() for own in mapped)


def _axes(mapped: tuple[bool, ...]) -> tuple[int | None, ...]:
    return tuple(0 if own else None for own in mapped)


@partial(jax.jit, static_argnums=(0, 1, 2, 3))
def _start(
    structure: Any, mapped: tuple[bool, ...], mesh: Mesh, lanes: int, leaves: Any
) -> tuple[State, MetricInputs]:
    def start(leaves: Any) -> tuple[State, MetricInputs]:
        case = jax.tree.unflatten(structure, leaves)
        return initial_state(case), metric_inputs_of(case)

    side_by_side = jax.vmap(start, in_axes=(_axes(mapped),), axis_size=lanes)
    return _shared_out(side_by_side, mesh, (_specs(mapped),))(leaves)


@partial(
    jax.jit,
    static_argnums=(0, 1, 2, 3),
    compiler_options={"xla_cpu_prefer_vector_width": 512},
)
def _advance(
    structure: Any,
    mapped: tuple[bool, ...],
    mesh: Mesh,
    chunk: int,
    leaves: Any,
    state: State,
    first: Any,
) -> State:
    def run(leaves: Any, state: State, first: Any) -> State:
        return run_periods(jax.tree.unflatten(structure, leaves), state, first + jnp.arange(chunk))

    side_by_side = jax.vmap(run, in_axes=(_axes(mapped), 0, None))
    specs = _specs(mapped), PartitionSpec("lanes"), PartitionSpec()
    return _shared_out(side_by_side, mesh, specs)(leaves, state, first)


def _shared_out(function: Any, mesh: Mesh, specs: Any) -> Any:
    return jax.shard_map(
        function, mesh=mesh, in_specs=specs, out_specs=PartitionSpec("lanes"), check_vma=False
    )

"""Sweep over the product of named axes: thousands of cases, which run side by side block by block.

A program is `vmap` of the loop over the periods, shared out to the devices by `shard_map`. Cases
that differ in texts, plant steps or queue of commands have programs of their own. All other numbers
are arrays over the lanes, from the axes of the sweep to the leaves of the case.
"""

import hashlib
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from ...base.errors import InputError, ScenarioError
from ...base.files.limits import free_bytes
from ...base.runtime import require_x64
from ...base.units import REV
from ...kinematics.flank_table import FlankTable
from ...pair.gear_pair import Drive, GearPair
from ..controllers.controller import Controller
from ..motion.motion import Reversal
from ..scenario import spec as specs
from ..scenario.scenario import Scenario
from ..scenario.spec import KEYS, ScenarioSpec
from ..simulation import prepare
from ..simulation.case import (
    METRICS,
    OUTCOMES,
    Accumulators,
    Case,
    Metrics,
    State,
    initial_state,
    metrics_of,
    run_periods,
)
from ..simulation.prepare import Fixed, Maps
from ..simulation.simulate import CHUNK
from .table import DRAW, REFUSED, Rows, SweepTable, grouped

_REASONS, _EXAMINED = 5, 500
"""Largest number of reported reasons for refusal, and of refused cases examined to find them."""

_PACKAGES = ("vttig-jax", "jax", "numpy")

_FEWEST, LANES = 8, 512
"""Smallest and largest number of lanes on a device: a 512-bit vector holds 8 numbers, and the state
of 512 lanes fits the cache of a core; chosen values."""

_BLOCK_STEPS = 1 << 28
"""Largest number of lane-steps in a block, about ten seconds; a chosen value.

A lane-step is one plant step of one case. An interruption loses at most the running block."""

_LEAST, _MOST = 64, 4 * LANES
"""Smallest and largest number of cases of one program in a block; chosen values."""

_MOST_TEXTS = 16
"""Largest number of text combinations that is used for the block size; a chosen value."""

_SAMPLED = 64
"""Number of cases whose run length is examined beforehand; a chosen value."""

_compiled_s = [0.0]


@jax.monitoring.register_event_duration_secs_listener
def _count_compilation(event: str, duration_secs: float, **_: Any) -> None:
    if event == "/jax/core/compile/backend_compile_duration":
        _compiled_s[0] += duration_secs


@dataclass(frozen=True)
class SweepCases:
    """Cases of a sweep, numbered from 0; any process can build them from these inputs.

    **Arguments**
    - `spec`: specification of the sweep. - `pair`: gears. - `folder`: folder of recorded motions.
    - `controller`: controller of the user that replaces that of the file.
    - `maps`: flank models of the maps that the file names; all cases are run for each draw.
    """

    spec: ScenarioSpec
    pair: GearPair | Drive
    folder: Path = Path()
    controller: Controller | None = None
    maps: Maps = Maps()

    @property
    def inputs(self) -> tuple[Any, ...]:
        """Arguments of `scenario_of` after the scenario."""
        return self.pair, self.folder, self.controller, self.maps

    @property
    def closing(self) -> float:
        """Decrease of the backlash per axial displacement, rad/mm; 0 without taper."""
        return float(np.sum(prepare.closings_of(self.pair)))

    @cached_property
    def _groups(self) -> list[dict[str, np.ndarray]]:
        """Axes that advance together, with their values; the slowest first, `draw` before all."""
        sweep = self.spec.sweep
        assert sweep is not None  # checked by `load_sweep_spec`
        draws = [{DRAW: np.arange(self.maps.number)}] if self.maps.number else []
        return draws + [
            {name: np.array(sweep.values(name)) for name in group} for group in sweep.groups
        ]

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes in file order; with draws, the axis `draw` comes first."""
        assert self.spec.sweep is not None
        return ((DRAW,) if self.maps.number else ()) + tuple(self.spec.sweep.axes)

    @cached_property
    def _lengths(self) -> tuple[int, ...]:
        return tuple(len(next(iter(group.values()))) for group in self._groups)

    def __len__(self) -> int:
        return math.prod(self._lengths)

    def columns(self, numbers: Sequence[int]) -> dict[str, np.ndarray]:
        """Return the columns of some cases: `case`, their numbers, and the value of every axis."""
        places = np.unravel_index(numbers, self._lengths or (1,))
        rows = zip(self._groups, places, strict=False)
        found = {name: values[i] for group, i in rows for name, values in group.items()}
        return {"case": np.array(numbers, np.int64)} | {name: found[name] for name in self.axes}

    def spec_of(self, number: int) -> ScenarioSpec:
        """Return the scenario of a case.

        **Raises** `ScenarioError` for values that contradict each other.
        """
        columns = self.columns([number])
        values = {name: columns[name].item() for name in self.axes if name != DRAW}
        return specs.with_values(self.spec, values)

    def draw_of(self, number: int) -> int:
        """Return the number of the draw in a case, 0 without draws."""
        return number * self.maps.number // len(self)  # the draws vary slowest

    def scenario(self, number: int) -> Scenario:
        """Return the objects of a case."""
        return prepare.scenario_of(self.spec_of(number), *self.inputs, draw=self.draw_of(number))

    def refusal(self, number: int) -> InputError | None:
        """Return the error that prevents a case; None if it can run."""
        try:
            prepare.prepared_case(self.spec_of(number), *self.inputs, draw=self.draw_of(number))
        except InputError as error:
            return error
        return None

    @property
    def header(self) -> dict[str, Any]:
        """Record of the inputs of the sweep; a sweep can be resumed only with an equal record."""
        return {
            "schema": "vttig.sweep_parts/1",
            "versions": {name: version(name) for name in _PACKAGES},
            "pair": _digest(self.pair),
            "maps": _digest((dict(self.maps.named), self.maps.draws, self.maps.number)),
            "controller": _digest(self.controller),
            "scenario": specs.spec_table(self.spec),
        }


def cases_of(
    spec: ScenarioSpec,
    pair: GearPair | Drive | None = None,
    folder: str | Path | None = None,
    controller: Controller | None = None,
    maps: Maps = Maps(),
) -> SweepCases:
    """Validate the inputs of a sweep, and read its gears; see `sweep`."""
    if spec.sweep is None:
        raise ScenarioError("missing; a sweep names its axes in [sweep].", where="sweep")
    if controller is not None and "controller" in spec.sweep.axes:
        raise ScenarioError(
            "is an axis, but a controller of your own is given; remove one of them.",
            where="sweep.controller",
        )
    folder = Path(folder or "")
    pair = prepare.load_gears(folder / spec.pair) if pair is None else pair
    return SweepCases(spec, pair, folder, controller, maps)


def _digest(tree: Any) -> str:
    """Return the SHA-256 digest of the structure of a pytree and of all its numbers."""
    leaves, structure = jax.tree.flatten(tree)
    digest = hashlib.sha256(str(structure).encode())
    for leaf in leaves:
        if callable(leaf):  # a function of the user, which no other process can compare
            digest.update(repr(leaf).encode())
        else:
            numbers = np.asarray(leaf)
            digest.update(numbers.astype(np.result_type(numbers, np.float64)).tobytes())
    return digest.hexdigest()


def compiled_s() -> float:
    """Return the time in which XLA has compiled programs in this process, s."""
    return _compiled_s[0]


def mesh_of(devices: Sequence[Any]) -> Mesh:
    """Return the devices as a mesh over which lanes are shared out."""
    return Mesh(np.array(devices), ("lanes",), axis_types=(AxisType.Auto,))


class Lanes(NamedTuple):
    """Cases side by side: `mapped` has the numbers of each lane, `shared` those of all lanes."""

    mapped: Any
    shared: Any

    def run(
        self,
        periods: np.ndarray,
        mesh: Mesh,
        progress: Callable[[int], None] = lambda steps: None,
    ) -> tuple[Metrics, Accumulators]:
        """Run the lanes; return metrics, outcomes and accumulators of each.

        `periods` are those of the lanes that count; `progress` gets their finished plant steps.
        """
        places = NamedSharding(mesh, PartitionSpec("lanes")), NamedSharding(mesh, PartitionSpec())
        case = jax.device_put(self.mapped, places[0]), jax.device_put(self.shared, places[1])
        state, substeps = _on_lanes(_started, mesh, *case, ()), self.shared.substeps
        chunk = max(CHUNK // substeps, 1)
        for first in range(0, int(periods.max()), chunk):
            numbers = np.arange(first, first + chunk)
            state, _ = jax.block_until_ready(_on_lanes(run_periods, mesh, *case, state, numbers))
            done = np.minimum(periods, first + chunk) - np.minimum(periods, first)
            progress(int(done.sum()) * substeps)
        found = _on_lanes(metrics_of, mesh, *case, state.accumulators)
        return jax.tree.map(np.asarray, (found, state.accumulators))


def _started(case: Case, _: tuple[()]) -> State:
    return initial_state(case)


@partial(
    jax.jit,
    static_argnums=(0, 1),
    compiler_options={"xla_cpu_prefer_vector_width": 512},
)
def _on_lanes(function: Any, mesh: Mesh, mapped: Any, shared: Any, state: Any, *all_: Any) -> Any:
    """Return `function(case, state, *all_)` of all lanes, shared out to the devices."""

    def device(mapped: Any, shared: Any, state: Any, all_: Any) -> Any:
        def lane(mapped: Any, state: Any) -> Any:
            return function(eqx.combine(mapped, shared), state, *all_)

        return jax.vmap(lane)(mapped, state)

    own, same = PartitionSpec("lanes"), PartitionSpec()
    sharded = jax.shard_map(
        device, mesh=mesh, in_specs=(own, same, own, same), out_specs=own, check_vma=False
    )
    return sharded(mapped, shared, state, all_)


class SweepWork:
    """Blocks of a sweep, ready to run on some devices, by default all of JAX.

    **Raises** the `InputError` of the first case if no case that is examined can run.
    """

    def __init__(self, cases: SweepCases, devices: Sequence[Any] | None = None) -> None:
        self.cases = cases
        self.devices = list(devices or jax.devices())
        self._mesh = mesh_of(self.devices)
        maps: Any = cases.maps
        drawn = partial(prepare.drawn_tables, maps.draws, cases.pair, maps.number)
        self._drawn = lru_cache(8)(drawn)
        count = len(cases)
        sampled = sorted({count * place // _SAMPLED for place in range(_SAMPLED)})
        columns = cases.columns(sampled)
        programs = list(self._programs(columns))
        possible = [number for *_, one in programs for number in one["case"].tolist()]
        if not possible or all(map(cases.refusal, possible)):
            refused = cases.refusal(0)
            assert refused is not None
            raise refused
        steps = sum(float((one["substeps"] * one["periods"]).sum()) for *_, one in programs)
        self.expected_steps = count * steps / len(sampled)
        """Lane-steps of all cases, from the lengths of some of them."""
        texts = min(len(set(_texts_of(columns))), _MOST_TEXTS)
        size = int(np.clip(_BLOCK_STEPS * count / (texts * self.expected_steps), _LEAST, _MOST))
        self.block_size = texts << (size.bit_length() - 1)
        """Cases in a block, independent of the number of devices so that a sweep can be resumed."""

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return -(-len(self.cases) // self.block_size)

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
        columns = self.cases.columns(numbers)
        rows: Rows = {name: np.full(len(numbers), np.nan) for name in METRICS}
        outcome = np.full(len(numbers), REFUSED, dtype="<U9")
        for program in self._programs(columns | dict(settings)):
            for places, (values, codes) in self._ran(*program, progress):
                for name, column in values.items():
                    rows[name][places] = column
                outcome[places] = np.asarray(OUTCOMES)[codes]
        return columns | rows | {"outcome": outcome}

    def _programs(self, columns: Rows) -> Iterator[tuple[ScenarioSpec, Fixed, Rows]]:
        """Yield the cases that can run, those that share a program together.

        **Yields** the scenario with their texts, their static choices, and their numbers: values of
        the axes, what `_courses` finds, and their places among the given cases.
        """
        numbers = {name: values for name, values in columns.items() if values.dtype.kind != "U"}
        numbers["place"] = np.arange(len(columns["case"]))
        for texts, with_texts in grouped(_texts_of(columns)):
            try:
                spec = specs.with_keys(self.cases.spec, dict(texts))
                specs.check_choices(spec)
                able = self._able(spec, _rows_of(numbers, with_texts))
            except InputError:  # the same for all of these cases
                continue
            kinds = zip(
                *(able[name].tolist() for name in ("substeps", "queue", "lost")), strict=True
            )
            for (substeps, queue, lost), alike in grouped(list(kinds)):
                own = specs.with_numbers(spec, {"judgement.turn": "unknown"}) if lost else spec
                some = _rows_of(able, alike)
                travel = float(some["low"].min()), float(some["high"].max())
                yield own, Fixed(int(substeps), queue, travel=travel), some

    def _able(self, spec: ScenarioSpec, columns: Rows) -> Rows:
        """Return those of the cases with the same texts that can run, with their courses.

        `turns` is the error of a located turn, and `lost` whether the turn is not found.
        """
        columns = columns | self._courses(spec, columns)
        columns = _rows_of(columns, columns["fit"])
        columns["queue"] = np.array([prepare.queue_of(delay) for delay in columns["delay"]], int)
        columns["lost"] = np.zeros(len(columns["case"]), bool)
        if spec.judgement.turn == "located" and spec.controller != "none":
            scenarios = map(self.cases.scenario, columns["case"].tolist())
            found = [prepare.located_turns(scenario) for scenario in scenarios]
            columns["lost"] = np.array([turns is None for turns in found], bool)
            columns["turns"] = np.array([turns or 0 for turns in found], int)
        return columns

    def _ran(
        self, spec: ScenarioSpec, fixed: Fixed, columns: Rows, progress: Callable[[int], None]
    ) -> Iterator[tuple[np.ndarray, Metrics]]:
        """Yield places and results of the cases of a program, those of similar length together."""
        order = np.argsort(columns["periods"], kind="stable")
        # A power of two on each device, so that few programs are compiled.
        each = 1 << max(math.ceil(len(order) / len(self.devices)) - 1, 0).bit_length()
        lanes = min(max(each, _FEWEST), LANES) * len(self.devices)
        for first in range(0, len(order), lanes):
            chosen = order[first : first + lanes]
            row = _rows_of(columns, np.pad(chosen, (0, lanes - len(chosen)), "edge"))
            side, fits = self._lanes(spec, row, fixed)
            found, _ = side.run(columns["periods"][chosen], self._mesh, progress)
            kept = np.flatnonzero(fits[: len(chosen)])
            yield (
                columns["place"][chosen[kept]],
                jax.tree.map(lambda values, kept=kept: values[kept], found),
            )

    def _lanes(self, spec: ScenarioSpec, columns: Rows, fixed: Fixed) -> tuple[Lanes, np.ndarray]:
        """Return cases side by side, and whether the flanks of each do not cross."""
        drawn = self._drawn(fixed.travel) if self.cases.maps.number else None
        shared: list[Any] = []

        def build(row: dict[str, Any]) -> Any:
            plant = None
            if drawn is not None:
                tables, smallest = drawn
                place = row[DRAW] * (tables.intervals + 1)
                plant = replace(tables, first=place), jnp.asarray(smallest)[row[DRAW]]
            own = fixed._replace(drawn=plant, sense=row["sense"], turns=row.get("turns"))
            case, gaps = prepare.prepared(self._scenario(spec, row), own)
            mapped, rest = eqx.partition(case, lambda leaf: isinstance(leaf, Tracer))
            shared.append(rest)
            return mapped, jnp.all(jnp.stack([jnp.asarray(True), *(gap >= 0 for gap in gaps)]))

        mapped, fits = jax.vmap(build)(jax.tree.map(jnp.asarray, columns))
        return Lanes(mapped, shared[-1]), np.asarray(fits)

    def _courses(self, spec: ScenarioSpec, columns: Rows) -> Rows:
        """Return what the run of every case needs: travel (turns), direction, periods, steps."""

        def course(row: dict[str, Any]) -> Any:
            s = self._scenario(spec, row)
            motion, steps = s.motion.pieces, prepare.plant_steps(s, prepare.shafted(s)[0])
            low, high, sense = prepare.ends_of(motion)
            hertz = jnp.asarray(s.sampling.controller_hz)
            periods = jnp.floor(motion.duration_s / (1.0 / hertz) * (1 + 1e-12)) + 1
            found = {"low": low / REV, "high": high / REV, "sense": sense, "periods": periods}
            found |= {"delay": prepare.delay_of(s.actuator.delay_s, hertz), "substeps": steps.asked}
            fit = steps.fit & s.sampling.fits
            if isinstance(s.motion, Reversal):
                fit &= s.motion.fits
            for one in (s.plant_map, s.controller_map):
                if isinstance(one, FlankTable):
                    fit &= prepare.covers(one, found["low"], found["high"])
            return found | {"fit": fit}

        found = jax.vmap(course)(jax.tree.map(jnp.asarray, columns))
        return jax.tree.map(np.array, found)

    def _scenario(self, spec: ScenarioSpec, row: Mapping[str, Any] = MappingProxyType({})) -> Any:
        """Return the objects of a scenario with the values of a row that are keys of it."""
        keys = {name: value for name, value in row.items() if name in KEYS}
        return prepare.scenario_of(specs.with_numbers(spec, keys), *self.cases.inputs)


def _texts_of(columns: Rows) -> list[tuple[tuple[str, str], ...]]:
    """Return the keys of every case that hold texts, and their values."""
    texts = {name: values.tolist() for name, values in columns.items() if values.dtype.kind == "U"}
    rows = zip(*texts.values(), strict=True) if texts else [()] * len(columns["case"])
    return [tuple(zip(texts, row, strict=True)) for row in rows]


def _rows_of(columns: Rows, chosen: np.ndarray) -> Rows:
    return {name: values[chosen] for name, values in columns.items()}


def sweep(
    spec: ScenarioSpec,
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
    - `spec`: the specification of a sweep; `vttig_jax.sweep` takes files too.
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
    available = jax.devices()
    if devices is not None and not 1 <= devices <= len(available):
        raise ValueError(
            f"Argument `devices` must be 1 … {len(available)}, the devices of JAX, but is"
            f" {devices}; for more cores call `vttig_jax.prepare_cpu(devices=…)` before JAX starts."
        )
    work = SweepWork(cases, available[:devices])
    # The table, and a copy of it.
    needed = 16e-9 * len(cases) * (2 + len(METRICS) + len(cases.axes))
    if needed > (free := 1e-9 * free_bytes()):
        raise InputError(
            f"{len(cases)} cases need {needed:.3g} GB of memory, but {free:.3g} GB are free; split"
            " an axis into several sweeps.",
            where="sweep",
        )
    finished = 0
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

        workers = len(work.devices)
        if elsewhere is not None:
            workers = elsewhere(cases, todo, kept.write, add_steps)
        else:
            for number in todo:
                kept.write(number, work.run(number, add_steps))
        compiling = compiled_s() - before
        spent = time.perf_counter() - began - compiling
        columns = kept.finish(work.blocks)
    return SweepTable(
        spec=cases.spec,
        pair=cases.pair.name,
        columns=columns,
        axes=cases.axes,
        lane_steps=finished,
        run_s=spent,
        compile_s=compiling,
        devices=workers,
        refusals=_refusals(work, columns),
        closing=cases.closing,
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
        reasons.setdefault(str(work.cases.refusal(number)), number)
        if len(reasons) == _REASONS:
            break
    return tuple((number, reason) for reason, number in reasons.items())

"""Cases of a sweep by their numbers, and the recipe from which any process can build them."""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ...base.errors import InputError, ScenarioError
from ...pair.gear_pair import Drive, GearPair
from ..controllers.controller import Controller
from ..scenario.axes import SCENARIO_FILE, Value
from ..scenario.scenario import Scenario
from ..scenario.spec import KEYS, ScenarioSpec, load_sweep_spec, spec_table, with_values
from ..simulation.build import Maps, rig_named, scenario_of
from ..simulation.case import Case
from ..simulation.prepare import closing_of, prepared
from ..simulation.simulate import load_gears

DRAW = "draw"
"""Name of the axis of maps drawn from a posterior; this axis varies slowest."""

MOST_VALUES = 16
"""Most values of a listed axis for which a report has a row each; a chosen value."""


_PACKAGES = ("vttig-jax", "jax", "numpy")


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
        return float(np.sum(closing_of(self.pair)))

    @cached_property
    def _values(self) -> dict[str, np.ndarray]:
        """Axis → its values; with draws, the axis `draw` comes first."""
        assert self.spec.sweep is not None  # checked by `load_sweep_spec`
        draws = {DRAW: np.arange(self.maps.number)} if self.maps.number else {}
        return draws | {
            name: np.array(self.spec.sweep.values(name), _kind(name))
            for name in self.spec.sweep.axes
        }

    @cached_property
    def _groups(self) -> tuple[tuple[str, ...], ...]:
        """Groups of axes that advance together, slowest first."""
        assert self.spec.sweep is not None
        return (((DRAW,),) if self.maps.number else ()) + self.spec.sweep.groups

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes in file order; with draws, the axis `draw` comes first."""
        return tuple(self._values)

    @cached_property
    def _lengths(self) -> tuple[int, ...]:
        return tuple(len(self._values[group[0]]) for group in self._groups)

    def __len__(self) -> int:
        return math.prod(self._lengths)

    def columns(self, numbers: Sequence[int]) -> dict[str, np.ndarray]:
        """Return the columns of some cases: `case`, their numbers, and the value of every axis."""
        places = dict(
            zip(self._groups, np.unravel_index(numbers, self._lengths or (1,)), strict=False)
        )
        found = {name: self._values[name][i] for group, i in places.items() for name in group}
        return {"case": np.array(numbers, np.int64)} | {name: found[name] for name in self.axes}

    def values(self, number: int) -> dict[str, Value]:
        """Return the value of every axis in the case with this number."""
        columns = self.columns([number])
        return {name: columns[name].item() for name in self.axes}

    def spec_of(self, number: int) -> ScenarioSpec:
        """Return the scenario of a case.

        **Raises** `ScenarioError` for values that contradict each other.
        """
        values: dict[str, Any] = self.values(number)
        values.pop(DRAW, None)
        return with_values(self.spec, values)

    def scenario(self, number: int) -> Scenario:
        """Return the objects of a case."""
        draw: Any = self.values(number).get(DRAW, 0)
        return scenario_of(self.spec_of(number), *self.inputs, draw=draw)

    def case(self, number: int) -> Case | InputError:
        """Return a case ready to run, or the error that prevents it."""
        try:
            with rig_named(self.spec):
                return prepared(self.scenario(number))[0]
        except InputError as error:
            return error

    @property
    def header(self) -> dict[str, Any]:
        """Record of the inputs of the sweep; a sweep can be resumed only with an equal record."""
        return {
            "schema": "vttig.sweep_parts/1",
            "versions": {name: version(name) for name in _PACKAGES},
            "pair": _digest(self.pair),
            "maps": _digest((dict(self.maps.named), self.maps.draws, self.maps.number)),
            "controller": _digest(self.controller),
            "scenario": spec_table(self.spec),
        }


def _kind(axis: str) -> type:
    return next((kind for kind in (float, int) if kind in KEYS[axis].types), str)


def cases_of(
    spec: str | Path | ScenarioSpec,
    pair: GearPair | Drive | None = None,
    folder: str | Path | None = None,
    controller: Controller | None = None,
    maps: Maps = Maps(),
) -> SweepCases:
    """Read and validate the inputs of a sweep; see `sweep`."""
    source = "" if isinstance(spec, ScenarioSpec) else str(spec)
    whole = spec if isinstance(spec, ScenarioSpec) else load_sweep_spec(spec)
    with SCENARIO_FILE.error_context(source):
        if whole.sweep is None:
            raise ScenarioError("missing; a sweep names its axes in [sweep].", where="sweep")
        if controller is not None and "controller" in whole.sweep.axes:
            raise ScenarioError(
                "is an axis, but a controller of your own is given; remove one of them.",
                where="sweep.controller",
            )
        folder = Path(source).parent if folder is None else Path(folder)
        pair = load_gears(folder / whole.pair) if pair is None else pair
    return SweepCases(whole, pair, folder, controller, maps)


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

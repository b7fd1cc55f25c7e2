"""Cases of a sweep by their numbers, and the recipe from which any process can build them."""

import hashlib
import math
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ...base.errors import InputError, ScenarioError
from ...pair.gear_pair import Drive, GearPair
from ..controllers.controller import Controller
from ..scenario.axes import SCENARIO_FILE, Value
from ..scenario.spec import KEYS, ScenarioSpec, load_sweep_spec, spec_table, with_values
from ..simulation.build import FileParts, Maps
from ..simulation.case import Case
from ..simulation.simulate import load_gears
from .case_leaves import CaseLeaves, leaves_of

DRAW = "draw"
"""Name of the axis of maps drawn from a posterior; this axis varies slowest."""

MOST_VALUES = 16
"""All values of a text axis are examined, and a report has a row for each value of a listed axis,
if there are at most this number of them; chosen value."""


class SweepCases:
    """Cases of a sweep, numbered from 0; a case is built when it is requested.

    **Arguments**
    - `spec`: specification of the sweep. - `pair`: gears. - `folder`: folder of recorded motions.
    - `controller`: controller of the user that replaces that of the file.
    - `maps`: flank models of the maps that the file names; all cases are run for each draw.
    """

    def __init__(
        self,
        spec: ScenarioSpec,
        pair: GearPair | Drive,
        folder: Path = Path(),
        controller: Controller | None = None,
        maps: Maps = Maps(),
    ) -> None:
        assert spec.sweep is not None  # checked by `load_sweep_spec`
        self.spec = spec
        self.draws = maps.number
        self._sweep = spec.sweep
        self._groups = spec.sweep.groups
        self._values = {name: spec.sweep.values(name) for name in spec.sweep.axes}
        self._lengths = [len(self._values[group[0]]) for group in self._groups]
        if self.draws:
            self._lengths.insert(0, self.draws)
        self._parts = FileParts(pair, folder, controller, maps)
        self._flat: dict[int, Any] = {}

    @property
    def closing(self) -> float:
        """Decrease of the backlash per axial displacement, rad/mm; 0 without taper."""
        return self._parts.closing

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes in file order; with draws, the axis `draw` comes first."""
        return (*([DRAW] if self.draws else []), *self._sweep.axes)

    def length(self, axis: str) -> int:
        """Return the number of values of an axis."""
        return self.draws if axis == DRAW else len(self._values[axis])

    def kind(self, axis: str) -> type:
        """Return the type of the values of an axis: `str`, `int` or `float`."""
        types = (int,) if axis == DRAW else KEYS[axis].types
        return next((kind for kind in (float, int) if kind in types), str)

    def __len__(self) -> int:
        return math.prod(self._lengths)

    @property
    def text_combinations(self) -> int:
        """Number of combinations of text values; each needs a compiled program."""
        return math.prod(
            length
            for group, length in zip(self._groups, self._lengths[bool(self.draws) :], strict=True)
            if length <= MOST_VALUES and any(self.kind(name) is str for name in group)
        )

    def values(self, number: int) -> dict[str, Value]:
        """Return the value of every axis in the case with this number."""
        indices = self._indices(number)
        values: dict[str, Value] = {DRAW: indices.pop(0)} if self.draws else {}
        for group, index in zip(self._groups, indices, strict=True):
            values |= {name: self._values[name][index] for name in group}
        return {name: values[name] for name in self.axes}

    def spec_of(self, number: int) -> ScenarioSpec:
        """Return the scenario of a case.

        **Raises** `ScenarioError` for values that contradict each other.
        """
        values: dict[str, Any] = self.values(number)
        values.pop(DRAW, None)
        return with_values(self.spec, values)

    def case(self, number: int) -> Case | InputError:
        """Return a case ready to run, or the error that prevents it."""
        try:
            return self._parts.case(self.spec_of(number), self._draw(number))
        except InputError as error:
            return error

    def leaves(self, number: int) -> CaseLeaves | InputError:
        """Return structure and leaves of a case, or the error that prevents it."""
        try:
            fields = self._parts.fields(self.spec_of(number), self._draw(number))
            return leaves_of(fields, self._flat)
        except InputError as error:
            return error

    def representative_cases(self) -> list[int]:
        """Return the numbers of cases in which one axis at a time differs from the first case.

        A numeric axis takes its second and last value, a text axis all its values. The last case of
        the sweep is included.
        """
        numbers = {0: None, len(self) - 1: None}
        stride = len(self)
        names = [(DRAW,), *self._groups] if self.draws else list(self._groups)
        for group, length in zip(names, self._lengths, strict=True):
            stride //= length
            texts = any(self.kind(name) is str for name in group)
            indices = range(length) if texts and length <= MOST_VALUES else (1, length - 1)
            numbers |= {index * stride: None for index in indices if index < length}
        return list(numbers)

    def _draw(self, number: int) -> int:
        return self._indices(number)[0] if self.draws else 0

    def _indices(self, number: int) -> list[int]:
        """Return the index of the value on each axis, or group of axes that advance together.

        The axis that varies slowest comes first.
        """
        indices = []
        for length in reversed(self._lengths):
            number, index = divmod(number, length)
            indices.append(index)
        return indices[::-1]


_PACKAGES = ("vttig-jax", "jax", "numpy")


@dataclass(frozen=True)
class Recipe:
    """Inputs of a sweep, with the arguments of `sweep`; `folder` holds recorded motions."""

    spec: ScenarioSpec
    pair: GearPair | Drive
    folder: Path
    controller: Controller | None = None
    maps: Maps = Maps()

    def cases(self) -> SweepCases:
        """Return the cases of the sweep."""
        return SweepCases(self.spec, self.pair, self.folder, self.controller, self.maps)

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


def recipe_of(
    spec: str | Path | ScenarioSpec,
    pair: GearPair | Drive | None = None,
    folder: str | Path | None = None,
    controller: Controller | None = None,
    maps: Maps = Maps(),
) -> Recipe:
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
    return Recipe(whole, pair, folder, controller, maps)


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

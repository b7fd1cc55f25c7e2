"""The cases of a sweep by number, and the recipe from which another process builds them."""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np
from msgspec.structs import replace

from ...base.errors import InputError, ScenarioError
from ...base.files.toml_io import plain_table
from ...pair.eccentricities import Eccentricities
from ...pair.gear_pair import GearPair
from ..controllers.controller import Controller
from ..scenario.axes import SCENARIO_FILE, Value
from ..scenario.spec import KEYS, ScenarioSpec, load_sweep_spec, spec_table, with_values
from ..scenario.tables import MapTable
from ..simulation.build import Builder
from ..simulation.case import Case
from ..simulation.simulate import gears

DRAW = "draw"
"""Axis of the rigs of a posterior: slowest of all."""

_MOST_TEXTS = 16
"""Values of an axis of texts up to which all are looked at."""

_RIG = (
    "driving_mm",
    "driving_phase_deg",
    "driven_mm",
    "driven_phase_deg",
    "constant_backlash_deg",
)


class SweepCases:
    """Every case of a sweep, made when it is asked for.

    **Arguments**
    - `spec`: of a sweep file. - `pair`: what its `pair` names. - `folder`: for recorded motions.
    - `rigs`: instead of the eccentricities of the file; one case each of all others.
    - `controller`: one of your own instead of that of the file.
    """

    def __init__(
        self,
        spec: ScenarioSpec,
        pair: GearPair,
        folder: Path = Path(),
        rigs: Sequence[Eccentricities] = (),
        controller: Controller | None = None,
    ) -> None:
        assert spec.sweep is not None  # held by `load_sweep_spec`
        self.spec = spec
        self.rigs = tuple(rigs)
        self._sweep = spec.sweep
        self._groups = spec.sweep.groups
        self._values = {name: spec.sweep.values(name) for name in spec.sweep.axes}
        self._lengths = [len(self._values[group[0]]) for group in self._groups]
        if rigs:
            self._lengths.insert(0, len(self.rigs))
        self._builder = Builder(pair, folder, controller)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes in file order, `draw` first."""
        return (*([DRAW] if self.rigs else []), *self._sweep.axes)

    def length(self, axis: str) -> int:
        """Number of values of an axis."""
        return len(self.rigs) if axis == DRAW else len(self._values[axis])

    def kind(self, axis: str) -> type:
        """`str`, `int` or `float`: what the values of an axis are."""
        types = (int,) if axis == DRAW else KEYS[axis].types
        return next((kind for kind in (float, int) if kind in types), str)

    def __len__(self) -> int:
        return math.prod(self._lengths)

    @property
    def kinds(self) -> int:
        """Number of combinations of the texts, which choose among compiled programs."""
        return math.prod(
            length
            for group, length in zip(self._groups, self._lengths[bool(self.rigs) :], strict=True)
            if length <= _MOST_TEXTS and any(self.kind(name) is str for name in group)
        )

    def values(self, number: int) -> dict[str, Value]:
        """Value of every axis in a case."""
        places = self._places(number)
        found: dict[str, Value] = {DRAW: places.pop(0)} if self.rigs else {}
        for group, place in zip(self._groups, places, strict=True):
            found |= {name: self._values[name][place] for name in group}
        return {name: found[name] for name in self.axes}

    def spec_of(self, number: int) -> ScenarioSpec:
        """The scenario of a case.

        **Raises** `ScenarioError` for values that do not go together.
        """
        values: dict[str, Any] = self.values(number)
        if self.rigs:
            rig = self.rigs[values.pop(DRAW)]
            values |= {f"eccentricities.{name}": value for name, value in rig_table(rig).items()}
        return with_values(self.spec, values)

    def case(self, number: int) -> Case | InputError:
        """A case ready to run, or why it cannot."""
        try:
            return self._builder.case(self.spec_of(number))
        except InputError as error:
            return error

    def samples(self) -> list[int]:
        """Cases that show everything an axis changes: its ends, and every text it takes."""
        found = {0: None, len(self) - 1: None}
        stride = len(self)
        names = [(DRAW,), *self._groups] if self.rigs else list(self._groups)
        for group, length in zip(names, self._lengths, strict=True):
            stride //= length
            texts = any(self.kind(name) is str for name in group)
            places = range(length) if texts and length <= _MOST_TEXTS else (1, length - 1)
            found |= {place * stride: None for place in places if place < length}
        return list(found)

    def _places(self, number: int) -> list[int]:
        """Place on each axis, slowest first."""
        places = []
        for length in reversed(self._lengths):
            number, place = divmod(number, length)
            places.append(place)
        return places[::-1]


def rig_table(rig: Eccentricities) -> dict[str, float]:
    """A rig as keys of [eccentricities] or [map]."""
    return {name: float(getattr(rig, name)) for name in _RIG}


_PACKAGES = ("vttig-jax", "jax", "numpy")


@dataclass(frozen=True)
class Recipe:
    """See `sweep` for what the fields are; `folder` is where recorded motions lie."""

    spec: ScenarioSpec
    pair: GearPair
    folder: Path
    rigs: tuple[Eccentricities, ...] = ()
    controller: Controller | None = None

    def cases(self) -> SweepCases:
        """The cases of the sweep."""
        return SweepCases(self.spec, self.pair, self.folder, self.rigs, self.controller)

    @property
    def header(self) -> dict[str, Any]:
        """What must agree for a sweep to be continued."""
        return {
            "schema": "vttig.sweep_parts/1",
            "versions": {name: version(name) for name in _PACKAGES},
            "pair": _digest(self.pair),
            "rigs": _digest(self.rigs),
            "controller": _digest(self.controller),
            "scenario": spec_table(self.spec),
        }


def recipe_of(
    spec: str | Path | ScenarioSpec,
    pair: GearPair | None = None,
    folder: str | Path | None = None,
    rigs: Sequence[Eccentricities] = (),
    believed: Eccentricities | None = None,
    controller: Controller | None = None,
) -> Recipe:
    """What a sweep is made of, read and validated; see `sweep`."""
    source = "" if isinstance(spec, ScenarioSpec) else str(spec)
    whole = spec if isinstance(spec, ScenarioSpec) else load_sweep_spec(spec)
    with SCENARIO_FILE.placed(source):
        if whole.sweep is None:
            raise ScenarioError("missing; a sweep names its axes in [sweep].", where="sweep")
        if whole.rig is not None and not rigs:
            raise ScenarioError(
                "names a posterior, which `vttig sweep` draws from; in Python give"
                " rigs=vttig_jax.rig_draws(posterior, 200), believed=fit.eccentricities().",
                where="rig",
            )
        if controller is not None and "controller" in whole.sweep.axes:
            raise ScenarioError(
                "an axis, but a controller of your own is given; remove one of them.",
                where="sweep.controller",
            )
        if believed is not None:
            known = plain_table(whole.map)
            whole = replace(whole, map=MapTable(**(rig_table(believed) | known)))
        home = Path(source).parent if folder is None else Path(folder)
        found = gears(home / whole.pair) if pair is None else pair
    return Recipe(whole, found, home, tuple(rigs), controller)


def _digest(tree: Any) -> str:
    """SHA-256 of a structure and all its numbers."""
    leaves, structure = jax.tree.flatten(tree)
    found = hashlib.sha256(str(structure).encode())
    for leaf in leaves:
        found.update(np.asarray(leaf, np.float64).tobytes())
    return found.hexdigest()

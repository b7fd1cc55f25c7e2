"""The cases of a sweep by number: the Cartesian product of its axes, and rigs from draws."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..base.errors import InputError
from ..pair.eccentricities import Eccentricities
from ..pair.gears import GearPair
from .build import Builder
from .case import Case
from .controller import Controller
from .spec import KEYS, ScenarioSpec, with_values
from .spec_axes import Value

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

"""Parts of a scenario from the values of its file; a sweep makes each of them only once."""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any, NamedTuple

import jax
import numpy as np
from msgspec import Struct, structs

from ...base.errors import ScenarioError
from ...base.files.toml_io import plain_table
from ...kinematics.flank_model import FlankModel
from ...kinematics.flank_table import Bounds, nodes_per_turn
from ...pair.eccentricities import Eccentricities
from ...pair.gear_pair import Drive, GearPair
from ..controllers.controller import Controller
from ..fields import number_fields
from ..hardware.actuator import Actuator
from ..hardware.encoder import Encoder
from ..hardware.servo import Servo
from ..motion.motion import Motion
from ..motion.profiles import Reversal
from ..motion.recorded import RecordedMotion, read_motion
from ..motion.sine import Sine
from ..plants.plant import Friction, Inertia, Load, Mesh
from ..scenario.scenario import Sampling, Scenario
from ..scenario.spec import (
    ECCENTRICITIES,
    KEYS,
    ScenarioSpec,
    believed_flanks,
    parse_scenario_spec,
)
from ..scenario.tables import (
    CONTROLLERS,
    EVENTS,
    OBSERVERS,
    PLANTS,
    EccentricityTable,
    name_of,
    part_of,
)
from .case import Case
from .prepare import MOST_ROWS, Make, Span, closing_of, gaps_of, prepared, table_of, tables_of

_CACHED_PARTS, _CACHED_TABLES = 4096, 512
"""Largest numbers of parts and of flank tables that are remembered; chosen values."""

_PLAIN = {
    "inertia": Inertia,
    "friction": Friction,
    "load": Load,
    "mesh": Mesh,
    "driving_encoder": Encoder,
    "driven_encoder": Encoder,
    "actuator": Actuator,
    "sampling": Sampling,
}
"""Parts whose numbers are those of the table with the same name."""


class Maps(NamedTuple):
    """Flank models that a scenario names instead of its [eccentricities].

    - `named`: run folder or map file as the scenario writes it → its flank model.
    - `draws`: models drawn from a posterior, stacked along a first axis; the plants of a sweep.
    - `number`: number of draws.
    """

    named: Mapping[str, FlankModel] = MappingProxyType({})
    draws: FlankModel | None = None
    number: int = 0


def motion_of(table: Any, folder: Path) -> Motion | Reversal:
    """Return the motion of the driving shaft; `folder` is that of recorded motions."""
    if table.kind == "recorded":
        return read_motion(folder / table.file)
    if table.kind == "sine":
        return part_of(Sine, table)
    return part_of(EVENTS[table.event], table, shape=table.kind)


def scenario_of(spec: ScenarioSpec, pair: GearPair | Drive, *further: Any) -> Scenario:
    """Return the objects that a validated scenario describes.

    The arguments after `spec` are those of `FileParts`.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.control import parse_scenario_spec, scenario_of
    >>> from vttig_jax.rig import paper_pair
    >>> vttig_jax.enable_x64()
    >>> rig = {"driving_mm": 0.0226, "driving_phase_deg": 49.5, "driven_mm": 0.0273}
    >>> rig |= {"driven_phase_deg": 79.3, "constant_backlash_deg": 0.038}
    >>> given = {"pair": "pair.toml", "eccentricities": rig, "controller": "predictive"}
    >>> scenario_of(parse_scenario_spec(given), paper_pair()).controller.margin_mm.item()
    0.01

    ```
    """
    parts = FileParts(pair, *further)
    keys = parts.keys_of(spec)
    return Scenario(**{name: parts.part(name, key) for name, key in keys.items()})


def spec_of(scenario: Scenario) -> ScenarioSpec:
    """Return the file of a scenario, whose numbers are checked; parts of the user have no table.

    **Raises** `ScenarioError` for numbers out of range and for parts that contradict each other.
    """
    s = scenario
    parts = [(name, getattr(s, name)) for name in (*_PLAIN, "motion", "servo")]
    parts += [("mesh", s.plant), ("judgement", s.controller), ("judgement", s.observer)]
    table: dict[str, Any] = {"pair": s.pair.name or "pair.toml", "flanks": s.flanks}
    for place, part in parts:
        values = table.setdefault(place, {})
        for name, _, _, signed in [] if part is None else number_fields(part):
            value, entry = getattr(part, name), KEYS.get(f"{place}.{name}")
            if entry is not None and value is not None:
                number = int(value) if int in entry.types else float(value)
                values[name] = abs(number) if signed else number
    table["seed"] = int(s.seed)
    table["judgement"] |= {"turn": s.turn}
    table["servo"] |= {"motor": "prescribed" if s.servo is None else "pi"}
    for rig, key in ((s.eccentricities, "eccentricities"), (s.controller_map, "map")):
        if isinstance(rig, Eccentricities):
            names = EccentricityTable.__struct_fields__
            table[key] = {name: float(getattr(rig, name)) for name in names}
    if s.plant_map is not None:
        table["plant_map"] = type(s.plant_map).__name__
    if isinstance(s.controller_map, FlankModel):
        table["controller_map"] = type(s.controller_map).__name__
    if s.map_backlash_deg is not None:
        table["map"] = {"constant_backlash_deg": float(s.map_backlash_deg)}
    spec = parse_scenario_spec(table)
    named = {"plant": name_of(s.plant, PLANTS), "controller": name_of(s.controller, CONTROLLERS)}
    judgement = structs.replace(spec.judgement, observer=name_of(s.observer, OBSERVERS))
    motion: dict[str, Any] = {"kind": name_of(s.motion, {"sine": Sine, "recorded": RecordedMotion})}
    if isinstance(s.motion, Reversal):
        motion = {"kind": s.motion.shape, "event": s.motion.event}
    if isinstance(s.motion, (Reversal, Sine)):
        motion["reversal_deg"] = float(s.motion.reversal_deg)
    motion = structs.replace(spec.motion, **motion)
    return structs.replace(spec, judgement=judgement, motion=motion, **named)


def case_of(spec: ScenarioSpec, pair: GearPair | Drive, *further: Any, **named: Any) -> Case:
    """Return the case of a validated scenario; further arguments are those of `FileParts`."""
    return FileParts(pair, *further, **named).case(spec)


def case_of_scenario(scenario: Scenario, like: Case | None = None) -> Case:
    """Return the case of a scenario; see `prepared`."""

    def make(function: Any, *names: str, **choices: Any) -> Any:
        parts = SimpleNamespace(**{name: getattr(scenario, name) for name in names})
        return function(parts, **choices)

    return Case(**prepared(make, like))


class FileParts:
    """Parts of the scenarios of one gear pair, remembered by the values that make them.

    **Arguments**
    - `pair`: gears, or a drive without gears. - `folder`: folder of recorded motions.
    - `controller`: controller of the user, instead of those of the scenarios.
    - `maps`: flank models that the scenarios name.
    """

    def __init__(
        self,
        pair: GearPair | Drive,
        folder: Path = Path(),
        controller: Controller | None = None,
        maps: Maps = Maps(),
    ) -> None:
        self.pair = pair
        self.folder = folder
        self.controller = controller
        self.maps = maps
        self.closing = float(np.sum(closing_of(pair)))
        self.part = lru_cache(_CACHED_PARTS)(self._part)
        self._result = lru_cache(_CACHED_PARTS)(self._call)
        # Tables are large, and cases that share one must have the same object.
        self._table = lru_cache(_CACHED_TABLES)(self._call)
        self._draws = lru_cache(8)(self._draw_tables)
        self._drawn = lru_cache(_CACHED_PARTS)(self._draw)

    def fields(self, spec: ScenarioSpec, draw: int = 0) -> dict[str, Any]:
        """Return the fields of the case of a scenario, whose plant is drawn if there are draws.

        In one object equal parts of several cases are one object.

        **Raises** `ScenarioError` as `prepared` does.
        """
        try:
            return prepared(self._make(self.keys_of(spec), draw))
        except ScenarioError as error:
            rig = spec.rig is not None and error.where == "plant_map"
            raise ScenarioError(error.message, where="rig" if rig else error.where) from None

    def case(self, spec: ScenarioSpec, draw: int = 0) -> Case:
        """Return the case of a scenario; see `fields`."""
        return Case(**self.fields(spec, draw))

    def keys_of(self, spec: ScenarioSpec) -> dict[str, tuple[Any, ...]]:
        """Return for each part of a scenario the values that make it."""
        plant = spec.plant_map if spec.rig is None else spec.rig.run
        believed = believed_flanks(spec)
        controller_map = (_believed(spec),) if believed == ECCENTRICITIES else (believed, spec.map)
        return {
            "pair": (),
            "eccentricities": (spec.eccentricities,),
            "motion": (spec.motion,),
            "plant": (PLANTS[spec.plant], spec.mesh),
            "controller": (CONTROLLERS[spec.controller], spec.judgement),
            "servo": (Servo if spec.servo.motor == "pi" else None, spec.servo),
            **{name: (kind, getattr(spec, name)) for name, kind in _PLAIN.items()},
            "observer": (OBSERVERS[spec.judgement.observer], spec.judgement),
            "plant_map": (None,) if plant == ECCENTRICITIES else (plant, spec.rig is not None),
            "controller_map": controller_map,
            "map_backlash_deg": (
                spec.map.constant_backlash_deg if len(controller_map) == 2 else None,
            ),
            "seed": (spec.seed,),
            "flanks": (spec.flanks,),
            "turn": (spec.judgement.turn,),
        }

    def _part(self, name: str, key: tuple[Any, ...]) -> Any:
        """Return one part from the values that make it."""
        if name == "pair":
            return self.pair
        if name == "controller" and self.controller is not None:
            return self.controller
        if name == "motion":
            return motion_of(key[0], self.folder)
        if name == "plant_map" and key[1:] == (True,) and self.maps.draws is not None:
            return jax.tree.map(lambda leaf: leaf[0], self.maps.draws)
        if name in ("plant_map", "controller_map") and isinstance(key[0], str):
            return self._named(name, *key)
        if name == "seed":
            return np.asarray(key[0])
        if isinstance(key[0], Struct):
            return Eccentricities(**plain_table(key[0]))
        if len(key) == 2 and key[0] is not None:  # the class of a part, and its table
            return part_of(*key)
        return key[0]

    def _named(self, where: str, name: str, table: Any) -> FlankModel:
        if isinstance(table, Struct) and set(plain_table(table)) - {"constant_backlash_deg"}:
            raise ScenarioError(
                f"eccentricities of [map] mean nothing in the map {name!r}; give only its"
                " constant_backlash_deg, or write [eccentricities].",
                where="map",
            )
        if name not in self.maps.named:
            raise ScenarioError(
                f"{name!r} is a run folder or a map file, which `vttig simulate` and"
                " `vttig_jax.simulate` read; here give its flank model as `maps`.",
                where=where,
            )
        return self.maps.named[name]

    def _make(self, keys: dict[str, tuple[Any, ...]], draw: int) -> Make:
        drawn = self.maps.draws is not None and keys["plant_map"][1:] == (True,)

        def make(function: Any, *names: str, **choices: Any) -> Any:
            if drawn and choices.get("which") == "plant_map":
                if function is table_of:
                    return self._drawn(choices["span"], draw)
                choices["maps"] = self.maps.number
            given = tuple(zip(names, map(keys.__getitem__, names), strict=True))
            remembered = self._table if function is table_of else self._result
            return remembered(function, given, *choices.items())

        return make

    def _call(self, function: Any, given: tuple[Any, ...], *choices: tuple[str, Any]) -> Any:
        parts = SimpleNamespace(**{name: self.part(name, key) for name, key in given})
        return function(parts, **dict(choices))

    def _draw(self, span: Span, draw: int) -> tuple[Bounds, float, None]:
        """Return the flanks of a draw, and the smallest gap at its nodes, rad; see `table_of`."""
        tables, smallest = self._draws(span)
        return tables.of_map(draw), float(smallest[draw]), None  # no controller believes it

    def _draw_tables(self, span: Span) -> tuple[Any, np.ndarray]:
        """Return one table of all draws, and the smallest gap of each at the nodes, rad."""
        draws, number = self.maps.draws, self.maps.number
        assert draws is not None
        one = jax.tree.map(lambda leaf: leaf[0], draws)
        rows = number * span[1] * nodes_per_turn(one)
        if rows > MOST_ROWS:
            raise ScenarioError(
                f"the maps of {number} draws over {span[1]} driving turns need {rows:.2g} nodes,"
                f" more than {MOST_ROWS:.2g}; take fewer draws (rig.draws) or a shorter motion.",
                where="rig",
            )
        tables = tables_of(draws, span, nodes_per_turn(one))
        first = jax.tree.map(lambda leaf: np.asarray(leaf[0]), tables)
        nodes, closing = tables.nodes.reshape(-1, 4), closing_of(self.pair)
        return replace(first, nodes=nodes, closing=closing), gaps_of(tables).min(axis=-1)


def _believed(spec: ScenarioSpec) -> Any:
    """Return the eccentricities of the controller's map if [map] changes them."""
    assert spec.eccentricities is not None  # checked where the scenario is read
    changed = plain_table(spec.map)
    return structs.replace(spec.eccentricities, **changed) if changed else None

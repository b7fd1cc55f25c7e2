"""Parts of a scenario from the values of its file; a sweep makes each of them only once."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import numpy as np
from msgspec import structs

from ...base.errors import ScenarioError
from ...kinematics.flank_model import FlankModel
from ...pair.gear_pair import Drive, Eccentricities, GearPair
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
from .prepare import prepared

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


def scenario_of(
    spec: ScenarioSpec,
    pair: GearPair | Drive,
    folder: Path = Path(),
    controller: Controller | None = None,
    maps: Maps = Maps(),
    draw: int = 0,
) -> Scenario:
    """Return the objects that a validated scenario describes; JAX may trace its numbers.

    **Arguments**
    - `pair`: gears, or a drive without gears. - `folder`: folder of recorded motions.
    - `controller`: controller of the user, instead of that of the scenario.
    - `maps`: flank models that the scenario names. - `draw`: number of the draw of the plant.

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

    def named(where: str, name: str) -> FlankModel | None:
        if name == ECCENTRICITIES:
            return None
        if name not in maps.named:
            raise ScenarioError(
                f"{name!r} is a run folder or a map file, which `vttig simulate` and"
                " `vttig_jax.simulate` read; here give its flank model as `maps`.",
                where=where,
            )
        return maps.named[name]

    rig = None if spec.eccentricities is None else structs.asdict(spec.eccentricities)
    changed = {name: x for name, x in structs.asdict(spec.map).items() if x is not None}
    believed: Any = named("controller_map", believed_flanks(spec))
    if believed is None:
        believed = Eccentricities(**(rig or {}) | changed) if changed else None
    elif changed.keys() - {"constant_backlash_deg"}:
        raise ScenarioError(
            f"eccentricities of [map] mean nothing in the map {believed_flanks(spec)!r}; give only"
            " its constant_backlash_deg, or write [eccentricities].",
            where="map",
        )
    if spec.rig is not None and maps.draws is not None:
        plant = jax.tree.map(lambda leaf: leaf[draw], maps.draws)
    else:
        plant = named("plant_map", spec.plant_map if spec.rig is None else spec.rig.run)
    return Scenario(
        pair,
        None if rig is None else Eccentricities(**rig),
        motion_of(spec.motion, folder),
        part_of(PLANTS[spec.plant], spec.mesh),
        controller or part_of(CONTROLLERS[spec.controller], spec.judgement),
        part_of(Servo, spec.servo) if spec.servo.motor == "pi" else None,
        **{name: part_of(kind, getattr(spec, name)) for name, kind in _PLAIN.items()},
        observer=part_of(OBSERVERS[spec.judgement.observer], spec.judgement),
        plant_map=plant,
        controller_map=believed,
        map_backlash_deg=(
            np.asarray(changed["constant_backlash_deg"])
            if changed and isinstance(believed, FlankModel)
            else None
        ),
        seed=spec.seed,
        flanks=spec.flanks,
        turn=spec.judgement.turn,
    )


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
    """Return the case of a validated scenario; further arguments are those of `scenario_of`."""
    with rig_named(spec):
        return prepared(scenario_of(spec, pair, *further, **named))[0]


@contextmanager
def rig_named(spec: ScenarioSpec) -> Iterator[None]:
    """Let errors of the map of the plant name the key `rig` if the scenario has it."""
    try:
        yield
    except ScenarioError as error:
        rig = spec.rig is not None and error.where == "plant_map"
        raise ScenarioError(error.message, where="rig" if rig else error.where) from None

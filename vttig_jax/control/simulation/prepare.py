"""Preparation of a case: from a file to its objects, and from these to all that a run needs.

Terms of this module:
- believed flanks: those that the controller computes with. They are the flanks of the plant unless
  the scenario gives the controller a map of its own, or the driving turn is located wrongly.
- lead (`lead_s`): time from an encoder reading to the position of the actuator that results from
  it, by which the controller looks ahead: the delay of the actuator and `_LOOP_PERIODS` periods.
- queue: commands on their way to an actuator with a delay; its length is a number of periods.
- retreat: how far the actuator may close the gap and still open it in time for teeth that pass; a
  table for maps with waves as short as the teeth, see `Retreat`.
- substeps: steps of the plant in one period of the controller.
- located turn: turn within the hunting period that the encoders tell; its error is the located
  minus the true turn, and `turns` hands it to the believed flanks.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from msgspec import structs

from ...base.arrays import float64, known, namespace
from ...base.errors import ScenarioError
from ...base.units import DEG, REV
from ...kinematics.exact import exact_model
from ...kinematics.first_order import closed_model
from ...kinematics.flank_model import FlankModel
from ...kinematics.flank_table import (
    Bounds,
    FirstOrderBounds,
    FlankTable,
    nodes_per_turn,
    tabulate_flanks,
)
from ...kinematics.turn_location import locate
from ...pair.gear_pair import Drive, Eccentricities, GearPair, load_pair
from ..controllers.controller import Controller, LostController, NoController
from ..controllers.retreat import retreat_of
from ..fields import may_be_positive
from ..hardware.actuator import Thrust, can_back_drive
from ..hardware.encoder import noise_draws
from ..hardware.servo import Servo, ServoDrive
from ..motion.motion import Motion, Reversal, Sine
from ..motion.recorded import read_motion
from ..plants.elastic import Elastic, largest_step
from ..plants.plant import Drag, Plant, Play
from ..scenario.scenario import (
    CONTROLLERS,
    EVENTS,
    OBSERVERS,
    PLANTS,
    Scenario,
    name_of,
    part_of,
)
from ..scenario.spec import ECCENTRICITIES, ScenarioSpec, believed_flanks
from .case import TIMES, Case

_LOOP_PERIODS = 3.0
"""Delay from an encoder reading to the resulting actuator position, in controller periods."""

_WHOLE_ROWS, _MOST_ROWS = 1 << 18, 1 << 25
"""Most nodes of a table of the hunting period (8 MB), and of all tables (1 GB): chosen values."""

_MOST_TURNS, _PER_TURN = 128, 64
"""Turns and angles a turn at which the gap of first orders is judged: chosen values."""

_LONG_WAVES = 12
"""Length of waves, in tooth pitches, from which on the predictive controller does not look at the
teeth that pass: a chosen value."""

_CERTAINTY = 0.999
"""Lowest probability at which a controller accepts a located turn; a chosen value."""

_LEAST_STD = 1e-9
"""Lower limit of the assumed standard deviation, rad, for encoders without errors; a chosen value.
"""

Travel = tuple[float, float]
"""Smallest and largest driving angle of a motion, turns."""


class Fixed(NamedTuple):
    """Choices of a case; those that are None follow from the numbers of the scenario.

    The first four are static, and have to be given where JAX traces the numbers from which they
    follow.

    - `substeps`: plant steps in a period. - `queue`: length of the queue of commands.
    - `limited`: whether the actuator has a force limit. - `travel`: that of all motions.
    - `drawn`: flanks of the plant and their smallest gap, instead of `plant_map`.
    - `sense`: 1 if the run begins forwards, −1 if backwards.
    - `turns`: error of the turn that the controller has located.
    """

    substeps: int | None = None
    queue: int | None = None
    limited: bool | None = None
    travel: Travel | None = None
    drawn: Any = None
    sense: Any = None
    turns: Any = None


def prepared(s: Scenario, fixed: Fixed = Fixed()) -> tuple[Case, list[Any]]:
    """Return the case of a scenario, and its gaps; a pure function of all its numbers.

    The gaps are the smallest of the plant, and the mean of the map that the controller believes,
    rad. Known ones are checked here.

    **Raises** `ScenarioError` for a controller that shifts gears without taper, for a map that is
    shorter than the motion or whose flanks cross, and for a step of the plant that is too long for
    the stiffness of the mesh or the gain of the servo; `ValueError` for a choice that would follow
    from a traced number.
    """
    motion, travel, sense, turns = s.motion.pieces, fixed.travel, fixed.sense, fixed.turns
    if sense is None:
        low, high, sense = ends_of(motion)
        if travel is None and known(low, high):
            travel = float(low) / REV, float(high) / REV
    if fixed.drawn is None:
        bounds, gap, order = _table_of(s, "plant_map", travel, 0)
    else:
        bounds, gap, order = *fixed.drawn, 0.0
    gaps = [gap]
    controller = _chosen(s)
    blind = isinstance(controller, NoController)
    if turns is None and s.turn == "located" and not blind:
        turns = located_turns(s)
        if turns is None:
            controller, blind = LostController(), True
    believed: Any = bounds
    retreat, machine = None, _machine(s, fixed)
    same = turns is None and fixed.drawn is None and _believes_plant(s)
    if not blind and not same:
        believed, gap, order = _table_of(s, "controller_map", travel, 0 if turns is None else turns)
        gaps.append(gap)
    teeth = s.pair.driving.teeth if isinstance(s.pair, GearPair) else None
    if not blind and controller.closes and teeth is not None and order * _LONG_WAVES >= teeth:
        if not known(believed.step):
            raise _traced("step of its map", "the number of rows in a tooth pitch")
        limits = s.actuator.speed_mm_s, s.actuator.acceleration_mm_s2, machine["lead_s"]
        retreat = retreat_of(believed, teeth, order, *limits)
    case = Case(
        motion=motion,
        bounds=bounds,
        believed=believed,
        controller=controller,
        observer=s.observer,
        sense=sense,
        retreat=retreat,
        seed=s.seed,
        noisy=any(may_be_positive(e.noise_arcsec) for e in (s.driving_encoder, s.driven_encoder)),
        **machine,
        **_encoders(s),
    )
    return case, [gap for gap in gaps if gap is not None]


def ends_of(motion: Motion) -> tuple[Any, Any, Any]:
    """Return smallest and largest angle of a motion, rad, and the direction before its braking."""
    if not known(motion):
        return _ends(motion)
    with jax.ensure_compile_time_eval():
        return jax.tree.map(np.asarray, _ends(motion))


@eqx.filter_jit
def _ends(motion: Motion) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
    angle = motion.at(jnp.linspace(0.0, 1.0, TIMES) * jnp.asarray(motion.duration_s)).angle
    change = motion.at(jnp.asarray(motion.braking_s)).angle - angle[0]
    return angle.min(), angle.max(), jnp.where(change < 0, -1.0, 1.0)


def _model(s: Scenario, which: str) -> tuple[FlankModel, bool]:
    """Return a flank model, and whether it is a map rather than that of eccentricities."""
    given, rig = s.plant_map, s.eccentricities
    if which == "controller_map":
        given = given if s.controller_map is None and rig is None else s.controller_map
        rig = given if isinstance(given, Eccentricities) else rig
    if isinstance(given, FlankModel):
        return given, True
    if rig is None:
        raise ScenarioError(
            "missing; give the eccentricities of the gears, or `plant_map`.", where="eccentricities"
        )
    if not isinstance(s.pair, GearPair):
        raise ScenarioError(
            "names a [drive] without gears, in which eccentricities mean nothing; write"
            ' plant_map = "RUN" with the run folder of a fit of this drive.',
            where="pair",
        )
    return (exact_model if s.flanks == "exact" else closed_model)(s.pair, rig), False


def _believes_plant(s: Scenario) -> bool:
    if s.map_backlash_deg is not None or s.controller_map is not None:
        return s.map_backlash_deg is None and s.controller_map is s.plant_map
    return s.plant_map is None or s.eccentricities is None


def _span_of(
    pair: Any, model: FlankModel, travel: Travel | None, maps: int = 1
) -> tuple[int, int, bool]:
    """Return first turn and number of turns of the table of some maps, and whether it repeats.

    The table has the hunting period, or at least the travel where the period is too long. The
    number of turns is then a power of two, so that motions share compiled programs.
    """
    hunting = pair.hunting_turns
    rows = hunting * nodes_per_turn(model)
    if rows <= _WHOLE_ROWS and rows * maps <= _MOST_ROWS:
        return 0, hunting, True
    if travel is None:
        raise _traced("motion", "the part of the hunting period that its flank table covers")
    first = math.floor(travel[0]) - 1
    count = 1 << (math.ceil(travel[1]) - first).bit_length()
    return (0, hunting, True) if count >= hunting else (first, count, False)


def _traced(name: str, what: str) -> ValueError:
    return ValueError(
        f"Argument `scenario` must have a known {name}, which decides {what}, but JAX traces it;"
        " give `like`, a scenario of known numbers of the same kind."
    )


def covers(table: FlankTable, low: Any, high: Any) -> Any:
    """Return whether a table holds the flanks from one driving angle to another, turns."""
    ends = np.array([table.start, table.start + table.length]) / REV
    near = 1e-6 / 360
    return table.periodic | ((ends[0] < low + near) & (high < ends[1] + near))


def closings_of(pair: Any) -> Any:
    """Return the change of TE per axial displacement on both flanks, rad/mm; 0 for a drive."""
    return pair.taper / pair.reference_radii[1] if isinstance(pair, GearPair) else np.zeros(2)


def _table_of(
    s: Scenario, which: str, travel: Travel | None, turns: Any
) -> tuple[Bounds, Any, float]:
    """Return the flanks, `turns` driving turns on, the gap that is checked, and the highest order.

    The gap is the smallest of the plant, or the mean of a map that the controller believes. The
    highest order of a map that is a table already is taken as that of the teeth.

    A map that is a table already is used as it is; **raises** `ScenarioError` if it is shorter than
    the motion, and for flanks that cross.
    """
    model, given = _model(s, which)
    plant, order = which == "plant_map", 0.0
    gap: Any = None
    if isinstance(model, FlankTable):
        order = float(s.pair.driving.teeth) if isinstance(s.pair, GearPair) else 0.0
        if travel is not None and not covers(model, *travel):
            ends = float(model.start) / DEG, float(model.start + model.length) / DEG
            asked = 360 * travel[0], 360 * travel[1]
            of_map, of_motion = (f"{low:z.2f}° … {high:z.2f}°" for low, high in (ends, asked))
            raise ScenarioError(
                f"the map covers {of_map} of the driving angle, but the motion {of_motion};"
                " take a longer map (`vttig map --span-rev`) or a shorter motion.",
                where=which,
            )
    elif not isinstance(model, FirstOrderBounds):
        order, per_turn = model.highest_order, nodes_per_turn(model)
        first, count, periodic = _span_of(s.pair, model, travel)
        start = float64(first if periodic else first + turns)
        model = _tabulated(model, count, periodic, start, per_turn)
        model = replace(model, step=REV / per_turn)  # known, also where JAX traces the model
    bounds = replace(model, closing=closings_of(s.pair)).turned(turns)
    if plant or (given and isinstance(bounds, FlankTable)):
        angles, gaps = _gaps_of(bounds, s.pair)
        gap = jnp.min(gaps) if plant else jnp.mean(gaps)
        if known(gap) and not gap >= 0:
            place = "on the average"
            if plant:
                place = f"at {float(angles[jnp.argmin(gaps)]) / DEG:.1f}° of the driving shaft"
            raise ScenarioError(
                f"flank B lies {-gap / DEG:.5f}° before flank A {place}, where no gap is"
                " left; take a larger backlash (constant_backlash_deg), or a map with its flanks"
                " in order.",
                where="eccentricities" if plant and s.plant_map is None else which,
            )
    if not plant and given and s.map_backlash_deg is not None:
        if isinstance(bounds, FlankTable):
            nodes = jnp.asarray(bounds.nodes)
            bounds = replace(bounds, nodes=nodes.at[:, 2].add(s.map_backlash_deg * DEG - gap))
        else:
            offset = jnp.asarray(bounds.offset)
            widened = offset.at[1].set(offset[0] + s.map_backlash_deg * DEG)
            bounds = replace(bounds, offset=widened)
    return bounds, gap, order


def _gaps_of(bounds: Bounds, pair: Any) -> tuple[Any, Any]:
    """Return some driving angles and the gap at each, rad.

    They are the nodes of a table, or angles over the hunting period, at most `_MOST_TURNS` turns.
    """
    if isinstance(bounds, FlankTable):
        angles = bounds.start + np.arange(len(bounds.nodes)) * bounds.step
        return angles, bounds.nodes[:, 2] - bounds.nodes[:, 0]
    turns = min(pair.hunting_turns, _MOST_TURNS)
    angles = jnp.linspace(0.0, REV * turns, _PER_TURN * turns + 1)
    return angles, bounds.gap(angles)


@eqx.filter_jit
def _tabulated(model: FlankModel, count: int, periodic: bool, first: Any, per: int) -> FlankTable:
    return tabulate_flanks(model, count, periodic=periodic, first_turn=first, per_turn=per)


def drawn_tables(
    models: FlankModel, pair: Any, number: int, travel: Travel
) -> tuple[FlankTable, np.ndarray]:
    """Return the table of the first of some stacked models, and the smallest gap of each, rad.

    The nodes of all of them follow each other in it; see `FlankTable.first`.

    **Raises** `ScenarioError` for tables that would be too large.
    """
    one = jax.tree.map(lambda leaf: leaf[0], models)
    per = nodes_per_turn(one)
    first, count, periodic = _span_of(pair, one, travel, number)
    rows = number * count * per
    if rows > _MOST_ROWS:
        raise ScenarioError(
            f"the maps of {number} draws over {count} driving turns need {rows:.2g} nodes, more"
            f" than {_MOST_ROWS:.2g}; take fewer draws (rig.draws) or a shorter motion.",
            where="rig",
        )
    tables = _tables(models, count, periodic, float64(first), per)
    one = jax.tree.map(lambda leaf: np.asarray(leaf[0]), tables)
    nodes = np.asarray(tables.nodes)
    smallest = (nodes[..., 2] - nodes[..., 0]).min(axis=-1)
    return replace(one, nodes=nodes.reshape(-1, 4), closing=closings_of(pair)), smallest


@eqx.filter_jit
def _tables(models: FlankModel, count: int, periodic: bool, first: Any, per: int) -> FlankTable:
    return jax.lax.map(lambda model: _tabulated(model, count, periodic, first, per), models)


class PlantSteps(NamedTuple):
    """Plant steps in a controller period, numbers or arrays.

    - `asked`: their number. - `needed`: the least for the mesh. - `load`: length of a step by the
      longest one for the servo.
    """

    asked: Any
    needed: Any
    load: Any

    @property
    def fit(self) -> Any:
        """Whether the steps are short enough."""
        return (self.asked >= self.needed) & (self.load <= 1 + 1e-12)


def plant_steps(s: Scenario, plant: Plant) -> PlantSteps:
    """Return the plant steps in a controller period; a pure function of all numbers."""
    hertz, plant_hz, needed = jnp.asarray(s.sampling.controller_hz), s.sampling.plant_hz, 1.0
    asked, load = jnp.maximum(jnp.rint(plant_hz / hertz), 1.0), 0.0
    if isinstance(plant, Elastic):
        longest = largest_step(plant.stiffness, plant.damping_ratio, s.inertia.driven_kgm2)
        needed = jnp.ceil(1.0 / (hertz * longest) * (1 - 1e-12))
        asked = jnp.where(jnp.asarray(plant_hz) > 0, asked, needed)
    if s.servo is not None:
        load = s.servo.speed_gain_Nms / s.inertia.driving_kgm2 / (hertz * asked)
    return PlantSteps(asked, needed, load)


def _substeps_of(s: Scenario, plant: Plant) -> int:
    """Return the number of plant steps in a controller period.

    **Raises** `ScenarioError` for steps that are too long for the mesh or for the servo.
    """
    if not known(s.sampling):
        raise _traced("sampling", "the number of plant steps in a period")
    s.sampling.check()
    if not known(plant) and isinstance(plant, Elastic):
        if not s.sampling.plant_hz:
            raise _traced("stiffness of the mesh", "the number of plant steps in a period")
        plant = Play()
    with jax.ensure_compile_time_eval():
        steps = plant_steps(s if known(s.servo, s.inertia) else replace(s, servo=None), plant)
        steps = PlantSteps(*map(float, steps))
    if steps.fit:
        return int(steps.asked)
    hertz = float(s.sampling.controller_hz)
    what, inertia, least, cure = "the stiffness of the mesh", "driven", hertz * steps.needed, ""
    if steps.asked >= steps.needed and s.servo is not None:
        what, inertia, cure = "servo.speed_gain_Nms", "driving", ", or lower the gain"
        least = math.ceil(float(s.servo.speed_gain_Nms / s.inertia.driving_kgm2))
    raise ScenarioError(
        f"steps of {1 / (hertz * steps.asked):.3g} s are too long for {what} and for"
        f" inertia.{inertia}_kgm2; take plant_hz = {least:g} or more{cure}.",
        where="sampling.plant_hz",
    )


def delay_of(delay_s: Any, hertz: Any) -> Any:
    """Return a delay in whole periods of the controller."""
    delay = delay_s * hertz * (1 - 1e-12)
    return namespace(delay).ceil(delay)


def queue_of(delay: Any) -> int:
    """Return the length of the queue of commands for a delay in periods.

    It is a power of two, so that most new delays need no new compiled program.
    """
    return 1 << (max(int(delay), 1) - 1).bit_length()


def shafted(s: Scenario) -> tuple[Plant, Drag]:
    """Return the plant of a scenario with its driven shaft, and the drag of this shaft."""
    friction = s.friction
    drag = Drag(
        inertia=s.inertia.driven_kgm2,
        coulomb=friction.coulomb_Nm,
        viscous=friction.viscous_Nms,
        stribeck=friction.stribeck_Nm,
        stribeck_speed=friction.stribeck_rad_s,
        load=s.load.torque_Nm,
        sticky=may_be_positive(friction.stribeck_Nm),
    )
    plant = s.plant.with_shaft(drag, s.pair)
    return plant, replace(drag, inertia=0.0) if isinstance(plant, Play) else drag


def _machine(s: Scenario, fixed: Fixed) -> dict[str, Any]:
    """Return plant, drive and actuator, whose masses, friction and contact belong together."""
    pair, limit, limited, queue = s.pair, s.actuator.force_limit_N, fixed.limited, fixed.queue
    plant, drag = shafted(s)
    drive, thrust, sliding = None, None, s.mesh.friction_coefficient
    if s.servo is not None:
        driving = Drag(s.inertia.driving_kgm2, s.friction.driving_Nm)
        drive = ServoDrive(s.servo, driving, drag)
    taper = pair.taper if isinstance(pair, GearPair) else np.zeros(2)
    back_drivable = can_back_drive(taper, sliding)
    if isinstance(pair, GearPair) and (may_be_positive(limit) if limited is None else limited):
        radius_m, ratio = 1e-3 * pair.reference_radii[1], float(pair.ratio)
        thrust = Thrust(drag, taper, sliding, radius_m, ratio)
        if s.servo is not None:
            force = s.servo.torque_limit_Nm / (ratio * radius_m) * (taper.max() - sliding)
            back_drivable = back_drivable & ((force >= limit) | (limit <= 0))
    hertz = s.sampling.controller_hz
    delay = delay_of(s.actuator.delay_s, hertz)
    if queue is None and not known(delay):
        raise _traced("delay of the actuator", "the length of the queue of its commands")
    return {
        "plant": plant,
        "drive": drive,
        "actuator": replace(
            s.actuator,
            delay=delay,
            periods=queue or queue_of(delay),
            back_drivable=back_drivable,
            thrust=thrust,
        ),
        "substeps": _substeps_of(s, plant) if fixed.substeps is None else fixed.substeps,
        "period": float64(1.0 / hertz),
        "lead_s": float64((delay + _LOOP_PERIODS) / hertz),
    }


def _encoders(s: Scenario) -> dict[str, Any]:
    """Return the encoders, by which the controller sees the shafts."""
    encoders = {}
    for name in ("driving", "driven"):
        encoder = getattr(s, f"{name}_encoder")
        counts = encoder.counts_per_rev
        if counts is None and isinstance(s.pair, GearPair):
            counts = getattr(s.pair, name).encoder.counts_per_rev
        encoders[f"{name}_encoder"] = replace(
            encoder,
            counts_per_rev=0.0 if counts is None else counts,
            eccentric=may_be_positive(encoder.amplitude_arcsec),
        )
    return encoders


def located_turns(s: Scenario) -> int | None:
    """Return the error of the driving turn that the controller locates; None if it cannot.

    A controller needs the turn at its start, because the map differs from turn to turn. The error
    is the located turn minus the true one. Before the run both encoders are read once, modulo one
    turn, while the driven shaft rests on flank A. The location uses the true standard deviation of
    a reading, √(count²/12 + E²/2 + noise²), and counts with the probability `_CERTAINTY`.
    """
    believed, rig = (_model(s, which)[0] for which in ("controller_map", "plant_map"))
    motion, sensors = s.motion.pieces, tuple(_encoders(s).values())
    if not known(believed, rig, sensors, motion):
        raise ValueError('Argument `turn` must be "known" in a scenario that JAX traces.')
    with jax.ensure_compile_time_eval():
        angle, ratio = float(motion.at(0.0).angle), float(s.pair.ratio)
        true = angle, ratio * angle + float(rig.transmission_error(angle, "A"))
        draws = noise_draws(jax.random.key(int(s.seed)), jnp.zeros((), int))
        driving, driven = (
            float(sensor.read(jnp.asarray(place), draw))
            for sensor, place, draw in zip(sensors, true, draws, strict=True)
        )
        variances = [float(sensor.variance) for sensor in sensors]
        std = max(np.sqrt(variances[1] + ratio**2 * variances[0]), _LEAST_STD)
        found = locate(driving % REV, driven % REV, s.pair.ratio, believed, std_rad=std)
    if found.probability < _CERTAINTY or not found.fits:
        return None
    return found.turn - int(driving // REV) % found.hunting_turns


def _chosen(s: Scenario) -> Controller:
    """Return the controller, or a `LostController` if it does not know its driving turn.

    **Raises** `ScenarioError` for a controller that shifts gears without taper.
    """
    if s.turn == "unknown" and not isinstance(s.controller, NoController):
        return LostController()
    if not s.controller.closes or (isinstance(s.pair, GearPair) and not known(s.pair)):
        return s.controller
    if closings_of(s.pair).sum() > 0:
        return s.controller
    why = "this drive has no gears"
    if isinstance(s.pair, GearPair):
        why = f"the helix angles of both flanks add up to {float(s.pair.taper.sum()):g} in tan β"
    raise ScenarioError(
        f"the controller {name_of(s.controller, CONTROLLERS)!r} shifts a gear along its axis to"
        f' close the gap, but {why}; choose "none" or "feedforward", or gears that thin along the'
        " axis (`helix_angle_deg`).",
        where="controller",
    )


_PLAIN = ("inertia", "friction", "load", "mesh", "driving_encoder", "driven_encoder", "actuator")
_PLAIN += ("sampling",)
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
        **{name: part_of(type(getattr(Scenario, name)), getattr(spec, name)) for name in _PLAIN},
        observer=part_of(OBSERVERS[spec.judgement.observer], spec.judgement),
        plant_map=plant,
        controller_map=believed,
        map_backlash_deg=(
            float64(changed["constant_backlash_deg"])
            if changed and isinstance(believed, FlankModel)
            else None
        ),
        seed=spec.seed,
        flanks=spec.flanks,
        turn=spec.judgement.turn,
    )


def prepared_case(
    scenario: ScenarioSpec | Scenario,
    pair: GearPair | Drive | None = None,
    folder: str | Path | None = None,
    controller: Controller | None = None,
    maps: Maps = Maps(),
    draw: int = 0,
) -> tuple[Scenario, Case]:
    """Return the objects of a scenario and its case; further arguments as for `scenario_of`."""
    if isinstance(scenario, Scenario):
        scenario = scenario if controller is None else replace(scenario, controller=controller)
        return scenario, prepared(scenario)[0]
    folder = Path(folder or "")
    pair = load_gears(folder / scenario.pair) if pair is None else pair
    try:
        objects = scenario_of(scenario, pair, folder, controller, maps, draw)
        return objects, prepared(objects)[0]
    except ScenarioError as error:  # the map of the plant is that of the key `rig` if it is given
        rig = scenario.rig is not None and error.where == "plant_map"
        raise ScenarioError(error.message, where="rig" if rig else error.where) from None


def load_gears(path: Path) -> GearPair | Drive:
    """Read the gears of a pair file; **raises** `ScenarioError` for a missing file."""
    if not path.is_file():
        raise ScenarioError(
            f"there is no file {path}; name the pair file, relative to the scenario.", where="pair"
        )
    return load_pair(path)

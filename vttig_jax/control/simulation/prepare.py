"""Preparation of a case: all that a run computes from a scenario before its first period."""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.arrays import float64, known, namespace
from ...base.errors import ScenarioError
from ...base.units import DEG, REV
from ...kinematics.exact import exact_model
from ...kinematics.first_order import ClosedModel, closed_model
from ...kinematics.flank_model import FlankModel
from ...kinematics.flank_table import (
    Bounds,
    FlankTable,
    first_order_bounds,
    nodes_per_turn,
    tabulate_flanks,
)
from ...pair.gear_pair import Eccentricities, GearPair
from ..controllers.controller import Controller, NoController
from ..controllers.retreat import Retreat, retreat_of
from ..controllers.turn_location import LostController, turn_error
from ..fields import may_be_positive
from ..hardware.actuator import Thrust, can_back_drive
from ..hardware.encoder import Encoder
from ..hardware.servo import ServoDrive
from ..motion.motion import Motion
from ..plants.elastic import Elastic, largest_step
from ..plants.plant import Drag, Plant
from ..plants.play import Play
from ..scenario.scenario import Scenario
from ..scenario.tables import CONTROLLERS, name_of
from .case import Case

_LOOP_PERIODS = 3.0
"""Delay from an encoder reading to the resulting actuator position, in controller periods."""

_WHOLE_ROWS, _MOST_ROWS = 1 << 18, 1 << 25
"""Most nodes of a table of the hunting period (8 MB), and of all tables (1 GB): chosen values."""

_LONG_WAVES = 12
"""Length of waves, in tooth pitches, from which on the predictive controller does not look at the
teeth that pass: a chosen value."""

TIMES = 4097
"""Times of a motion at which its travel is read: a chosen value."""

Travel = tuple[float, float]
"""Smallest and largest driving angle of a motion, turns."""

Span = tuple[int, int, bool]
"""First driving turn of a table, number of turns, and whether the table is periodic."""


class Fixed(NamedTuple):
    """Static choices; those that are None follow from the numbers of the scenario.

    - `substeps`: plant steps in a period. - `queue`: length of the queue of commands.
    - `limited`: whether the actuator has a force limit. - `travel`: that of all motions.
    """

    substeps: int | None = None
    queue: int | None = None
    limited: bool | None = None
    travel: Travel | None = None


def prepared(
    s: Scenario,
    fixed: Fixed = Fixed(),
    *,
    drawn: Any = None,
    sense: Any = None,
    turns: Any = None,
) -> tuple[Case, dict[str, Any]]:
    """Return the case of a scenario, and its gaps; a pure function of all its numbers.

    The gaps are the smallest of the map of the plant, and the mean of what the controller believes,
    rad; None for eccentricities. Known ones are checked here.

    **Arguments**
    - `fixed`: static choices where JAX traces the numbers from which they follow.
    - `drawn`: flanks of the plant and their smallest gap, instead of `plant_map`.
    - `sense`: 1 if the run begins forwards, −1 if backwards; by default that of the motion.
    - `turns`: error of the turn that the controller has located, instead of locating it.

    **Raises** `ScenarioError` for a controller that shifts gears without taper, for a map that is
    shorter than the motion or whose flanks cross, and for a step of the plant that is too long for
    the stiffness of the mesh or the gain of the servo; `ValueError` for a choice that would follow
    from a traced number.
    """
    motion, travel = s.motion.pieces, fixed.travel
    if sense is None:
        low, high, sense = ends_of(motion)
        if travel is None and known(low, high):
            travel = float(low) / REV, float(high) / REV
    gaps: dict[str, Any] = {}

    def flanks(which: str, place: str, turns: Any = 0) -> tuple[Bounds, float]:
        bounds, gap, order = table_of(s, which, travel, turns)
        if gap is not None and known(gap) and not gap >= 0:
            raise ScenarioError(
                f"flank B lies {-gap / DEG:.5f}° before flank A {place}, where no gap is"
                " left; take a map with a larger backlash (constant_backlash_deg), or with its"
                " flanks in order.",
                where=which,
            )
        gaps[which] = gap
        return bounds, order

    order = 0.0
    if drawn is None:
        bounds, order = flanks("plant_map", "at one angle")
    else:
        bounds, gaps["plant_map"] = drawn
    sensing = _sensing(s)
    controller = _chosen(s)
    blind = isinstance(controller, (LostController, NoController))
    if turns is None and s.turn == "located" and not blind:
        turns = _located(s, bounds, sensing, motion)
        if turns is None:
            controller, blind = LostController(), True
    believed, retreat, machine = bounds, None, _machine(s, fixed)
    if not blind and (turns is not None or drawn is not None or not _believes_plant(s)):
        believed, order = flanks("controller_map", "on the average", 0 if turns is None else turns)
    if not blind and controller.closes:
        retreat = _retreat(s, believed, order, machine["lead_s"])
    case = Case(
        motion=motion,
        bounds=bounds,
        believed=believed,
        controller=controller,
        sense=sense,
        retreat=retreat,
        **machine,
        **sensing,
    )
    return case, gaps


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


def span_of(pair: Any, model: FlankModel, travel: Travel | None, maps: int = 1) -> Span:
    """Return the span of a table of flanks, or of the tables of several maps.

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


def _require_travel(table: FlankTable, travel: Travel, where: str) -> None:
    if not covers(table, *travel):
        ends = float(table.start) / DEG, float(table.start + table.length) / DEG
        asked = 360 * travel[0], 360 * travel[1]
        map_ends, motion_ends = (f"{low:z.2f}° … {high:z.2f}°" for low, high in (ends, asked))
        raise ScenarioError(
            f"the map covers {map_ends} of the driving angle, but the motion {motion_ends};"
            " take a longer map (`vttig map --span-rev`) or a shorter motion.",
            where=where,
        )


def closing_of(pair: Any) -> Any:
    """Return the change of TE per axial displacement on both flanks, rad/mm; 0 for a drive."""
    return pair.taper / pair.reference_radii[1] if isinstance(pair, GearPair) else np.zeros(2)


def _taper(pair: Any) -> Any:
    return pair.taper if isinstance(pair, GearPair) else np.zeros(2)


def table_of(
    s: Scenario, which: str, travel: Travel | None, turns: Any
) -> tuple[Bounds, Any, float]:
    """Return the flanks, `turns` driving turns on, the gap that is checked, and the highest order.

    The highest order of a map that is a table already is taken as that of the teeth.

    A map that is a table already is used as it is; **raises** `ScenarioError` if it is shorter than
    the motion.
    """
    model, given = _model(s, which)
    if isinstance(model, ClosedModel):
        return first_order_bounds(model, closing_of(s.pair)).turned(turns), None, 0.0
    order = float(s.pair.driving.teeth) if isinstance(s.pair, GearPair) else 0.0
    if isinstance(model, FlankTable):
        if travel is not None:
            _require_travel(model, travel, which)
    else:
        order, per_turn = model.highest_order, nodes_per_turn(model)
        first, count, periodic = span_of(s.pair, model, travel)
        start = float64(first if periodic else first + turns)
        model = _tabulated(model, count, periodic, start, per_turn)
        model = replace(model, step=REV / per_turn)  # known, also where JAX traces the model
    bounds = replace(model, closing=closing_of(s.pair)).turned(turns)
    judged = jnp.min if which == "plant_map" else jnp.mean
    gap = judged(gaps_of(bounds)) if given else None
    if which == "controller_map" and given and s.map_backlash_deg is not None:
        nodes = jnp.asarray(bounds.nodes)
        shift = s.map_backlash_deg * DEG - jnp.mean(nodes[:, 2] - nodes[:, 0])
        bounds = replace(bounds, nodes=nodes.at[:, 2].add(shift))
    return bounds, gap, order


def _retreat(s: Scenario, believed: Any, order: float, delay: Any) -> Retreat | None:
    """Return what the controller knows of its actuator, if its map has waves as short as teeth."""
    if not isinstance(s.pair, GearPair) or order * _LONG_WAVES < s.pair.driving.teeth:
        return None
    if not known(believed.step):
        raise _traced("step of its map", "the number of rows in a tooth pitch")
    limits = s.actuator.speed_mm_s, s.actuator.acceleration_mm_s2, delay
    return retreat_of(believed, s.pair.driving.teeth, order, *limits)


def gaps_of(table: Any) -> Any:
    """Return the gap at the nodes of a table, or of tables that share a first axis, rad."""
    return table.nodes[..., 2] - table.nodes[..., 0]


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
    first, count, periodic = span_of(pair, one, travel, number)
    rows = number * count * per
    if rows > _MOST_ROWS:
        raise ScenarioError(
            f"the maps of {number} draws over {count} driving turns need {rows:.2g} nodes, more"
            f" than {_MOST_ROWS:.2g}; take fewer draws (rig.draws) or a shorter motion.",
            where="rig",
        )
    tables = _tables(models, count, periodic, float64(first), per)
    one = jax.tree.map(lambda leaf: np.asarray(leaf[0]), tables)
    smallest = np.asarray(gaps_of(tables).min(axis=-1))
    nodes = np.asarray(tables.nodes).reshape(-1, 4)
    return replace(one, nodes=nodes, closing=closing_of(pair)), smallest


@eqx.filter_jit
def _tables(models: FlankModel, count: int, periodic: bool, first: Any, per: int) -> FlankTable:
    return jax.lax.map(lambda model: _tabulated(model, count, periodic, first, per), models)


def substeps_of(s: Scenario, plant: Plant) -> int:
    """Return the number of plant steps in a controller period.

    **Raises** `ScenarioError` for steps that are too long for the mesh or for the servo.
    """
    if not known(s.sampling):
        raise _traced("sampling", "the number of plant steps in a period")
    hertz = float(s.sampling.controller_hz)
    substeps = round(float(s.sampling.plant_hz) / hertz) or 1
    if isinstance(plant, Elastic) and known(plant):
        stiffness, mass = float(plant.stiffness), float(s.inertia.driven_kgm2)
        longest = largest_step(stiffness, float(plant.damping_ratio), mass)
        needed = math.ceil(1.0 / (hertz * longest) * (1 - 1e-12))
        substeps = substeps if s.sampling.plant_hz else needed
        if substeps < needed:
            raise ScenarioError(
                f"a step of {1 / (hertz * substeps):.3g} s is too long for a mesh of"
                f" {stiffness:.3g} N m/rad on {mass:g} kg m²; the longest is"
                f" {longest:.3g} s: take plant_hz = {hertz * needed:g}.",
                where="sampling.plant_hz",
            )
    elif isinstance(plant, Elastic) and not s.sampling.plant_hz:
        raise _traced("stiffness of the mesh", "the number of plant steps in a period")
    if s.servo is not None and known(s.servo, s.inertia):
        gain, mass = float(s.servo.speed_gain_Nms), float(s.inertia.driving_kgm2)
        step, fastest = 1 / (hertz * substeps), gain / mass
        if step * fastest > 1 + 1e-12:
            raise ScenarioError(
                f"steps of {step:.3g} s are too long for a servo of {gain:g}"
                f" N m s/rad on {mass:g} kg m²; take {math.ceil(fastest):g} Hz"
                " or more, or lower servo.speed_gain_Nms.",
                where="sampling.plant_hz",
            )
    return substeps


def delay_of(delay_s: Any, hertz: Any) -> Any:
    """Return a delay in whole periods of the controller."""
    delay = delay_s * hertz * (1 - 1e-12)
    return namespace(delay).ceil(delay)


def queue_of(delay: Any) -> int:
    """Return the length of the queue of commands for a delay in periods.

    It is a power of two, so that most new delays need no new compiled program.
    """
    return 1 << (max(int(delay), 1) - 1).bit_length()


def _machine(s: Scenario, fixed: Fixed) -> dict[str, Any]:
    """Return plant, drive and actuator, whose masses, friction and contact belong together."""
    substeps, queue, limited, _ = fixed
    pair, friction, limit = s.pair, s.friction, s.actuator.force_limit_N
    drag = Drag(
        inertia=s.inertia.driven_kgm2,
        coulomb=friction.coulomb_Nm,
        viscous=friction.viscous_Nms,
        stribeck=friction.stribeck_Nm,
        stribeck_speed=friction.stribeck_rad_s,
        load=s.load.torque_Nm,
        sticky=may_be_positive(friction.stribeck_Nm),
    )
    plant = s.plant.with_shaft(drag, pair)
    if isinstance(plant, Play):  # whose driven shaft has no inertia
        drag = replace(drag, inertia=0.0)
    drive = None
    if s.servo is not None:
        drive = ServoDrive(s.servo, Drag(s.inertia.driving_kgm2, friction.driving_Nm), drag)
    taper, sliding = _taper(pair), s.mesh.friction_coefficient
    thrust, back_drivable = None, can_back_drive(taper, sliding)
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
        "substeps": substeps_of(s, plant) if substeps is None else substeps,
        "period": float64(1.0 / hertz),
        "lead_s": float64((delay + _LOOP_PERIODS) / hertz),
    }


def _sensing(s: Scenario) -> dict[str, Any]:
    """Return encoders and observer, by which the controller sees the shafts."""
    encoders = {}
    for shaft in ("driving", "driven"):
        encoder: Encoder = getattr(s, f"{shaft}_encoder")
        counts = encoder.counts_per_rev
        if counts is None and isinstance(s.pair, GearPair):
            counts = getattr(s.pair, shaft).encoder.counts_per_rev
        encoders[f"{shaft}_encoder"] = replace(
            encoder,
            counts_per_rev=0.0 if counts is None else counts,
            eccentric=may_be_positive(encoder.amplitude_arcsec),
        )
    noisy = any(may_be_positive(encoder.noise_arcsec) for encoder in encoders.values())
    return {**encoders, "observer": s.observer, "seed": s.seed, "noisy": noisy}


def located_turns(s: Scenario) -> int | None:
    """Return the error of the driving turn that the controller locates; None if it cannot."""
    motion = s.motion.pieces
    low, high, _ = ends_of(motion)
    bounds = table_of(s, "plant_map", (float(low) / REV, float(high) / REV), 0)[0]
    return _located(s, bounds, _sensing(s), motion)


def _located(s: Scenario, bounds: Bounds, sensing: dict[str, Any], motion: Motion) -> int | None:
    """Return the error of the driving turn that the controller locates; None if it cannot."""
    believed, _ = _model(s, "controller_map")
    sensors = sensing["driving_encoder"], sensing["driven_encoder"]
    if not known(believed, bounds, sensors, motion):
        raise ValueError('Argument `turn` must be "known" in a scenario that JAX traces.')
    with jax.ensure_compile_time_eval():
        return turn_error(
            s.pair,
            believed=believed,
            rig=bounds,
            sensors=sensors,
            angle=float(motion.at(jnp.zeros(())).angle),
            seed=int(s.seed),
        )


def _chosen(s: Scenario) -> Controller:
    """Return the controller, or a `LostController` if it does not know its driving turn.

    **Raises** `ScenarioError` for a controller that shifts gears without taper.
    """
    if s.turn == "unknown" and not isinstance(s.controller, NoController):
        return LostController()
    if not s.controller.closes or (isinstance(s.pair, GearPair) and not known(s.pair)):
        return s.controller
    if closing_of(s.pair).sum() > 0:
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

"""Construction of a case from a scenario: motion, motor, plant, actuator and controller."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from msgspec import structs

from ...base.arrays import Numbers, float64
from ...base.errors import ScenarioError
from ...base.files.toml_io import plain_table
from ...base.units import ARCSEC, DEG, REV
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
from ...pair.eccentricities import Eccentricities
from ...pair.gear_pair import Drive, GearPair
from ..controllers.acceleration import AccelerationController
from ..controllers.controller import Controller, NoController
from ..controllers.feedforward import FeedforwardController
from ..controllers.predictive import PredictiveController, Retreat
from ..controllers.turn_location import LostController, turn_error
from ..hardware.actuator import Actuator, Thrust, can_back_drive
from ..hardware.encoder import Sensor
from ..hardware.observer import AlphaBetaGamma, FilteredDifference, Observer
from ..hardware.servo import Servo, ServoDrive
from ..hardware.shaft_drive import Prescribed, ShaftDrive
from ..motion.motion import Motion
from ..motion.profiles import motion_of
from ..motion.recorded import read_motion
from ..plants.elastic import ElasticPlant, largest_step, mesh_stiffness
from ..plants.plant import Drag, Plant
from ..plants.play import PlayPlant
from ..plants.rigid import RigidPlant
from ..scenario.spec import ECCENTRICITIES, ScenarioSpec, believed_flanks
from ..scenario.tables import (
    ActuatorTable,
    EccentricityTable,
    EncoderTable,
    FrictionTable,
    InertiaTable,
    JudgementTable,
    LoadTable,
    MeshTable,
    MotionTable,
    SamplingTable,
    ServoTable,
)
from .case import Case

_OBSERVERS: dict[str, Callable[[float], Observer]] = {
    "alpha_beta_gamma": AlphaBetaGamma,
    "difference": FilteredDifference,
}
_CACHED_PARTS, _CACHED_TABLES = 4096, 512
"""Largest numbers of parts of cases and of their flanks that a builder caches; chosen values."""
_LOOP_PERIODS = 3.0
"""Delay from an encoder reading to the resulting actuator position, in controller periods."""
_POINTS = 12
"""Points in a cycle of the highest order, up to a tooth pitch, at which the predictive controller
looks ahead: with 8, a wave of 0.16 mm leaves an interference of 0.001 mm; a chosen value."""


class _Machine(NamedTuple):
    """Plant with its steps in a controller period, drive, actuator, and its lead in a period, s."""

    substeps: int
    plant: Plant
    drive: ShaftDrive
    actuator: Actuator
    lead_s: float


Travel = tuple[float, float]
"""Smallest and largest driving angle of a motion, turns."""

_Span = tuple[int, int, bool]
_Source = str | tuple[EccentricityTable | None, str]
"""A named map; or eccentricities with the kind of their flanks, "exact" or "closed"."""

_WHOLE_ROWS, _MOST_ROWS = 1 << 18, 1 << 25
"""Most nodes of a table of the hunting period (8 MB), and of all tables (1 GB): chosen values."""


class Maps(NamedTuple):
    """Flank models that a scenario names instead of its [eccentricities].

    - `named`: run folder or map file as the scenario writes it → its flank model.
    - `draws`: models drawn from a posterior, stacked along a first axis; the plants of a sweep.
    - `number`: number of draws.
    """

    named: Mapping[str, FlankModel] = MappingProxyType({})
    draws: FlankModel | None = None
    number: int = 0


def case_of(
    spec: ScenarioSpec,
    pair: GearPair | Drive,
    folder: Path = Path(),
    controller: Controller | None = None,
    maps: Maps = Maps(),
) -> Case:
    """Build the case of a validated scenario; see `Builder`."""
    return Builder(pair, folder, controller, maps).case(spec)


class CaseParts(NamedTuple):
    """Fields of a `Case` by name. In one builder, equal parts of several cases are one object."""

    motion: Motion
    bounds: Bounds
    plant: Plant
    actuator: Actuator
    observer: Observer
    controller: Controller
    driving_sensor: Sensor
    driven_sensor: Sensor
    period: Any
    sense: Any
    seed: Any
    substeps: int
    noisy: bool
    drive: ShaftDrive


def scenario_motion(table: MotionTable, folder: Path) -> Motion:
    """Return the motion of the driving shaft; `folder` is that of recorded motions."""
    if table.kind == "recorded":
        return read_motion(folder / table.file)
    return motion_of(
        table.kind,
        event=table.event,
        speed_rpm=table.speed_rpm,
        reversal_deg=table.reversal_deg,
        dwell_s=table.dwell_s,
        ramp_s=table.ramp_s,
        slow_share=table.slow_share,
        stop_s=table.stop_s,
    )


class Builder:
    """Builder of the cases of one gear pair; it builds a part that several cases share only once.

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
        self.taper = pair.taper if isinstance(pair, GearPair) else np.zeros(2)
        self.closing = np.zeros(2)
        if isinstance(pair, GearPair):
            self.closing = np.asarray(pair.taper / pair.reference_radii[1])
        self._part = lru_cache(_CACHED_PARTS)(lambda make, *arguments: make(*arguments))
        # Tables are large, and cases that share one must have the same object.
        self._bounds = lru_cache(_CACHED_TABLES)(self._make_bounds)
        self._draw_tables = lru_cache(_CACHED_TABLES)(self._make_draw_tables)

    def case(self, spec: ScenarioSpec, draw: int = 0) -> Case:
        """Build the case of a validated scenario, whose plant is drawn if there are draws.

        **Raises** `ScenarioError` for a controller that shifts gears without taper, for a map that
        is shorter than the motion or whose flanks cross, and for a step of the plant that is too
        long for the stiffness of the mesh.
        """
        return Case(**self.parts(spec, draw)._asdict())

    def parts(self, spec: ScenarioSpec, draw: int = 0) -> CaseParts:
        """Return the parts of a case; see `case`."""
        motion, sense = self._part(self._motion, spec.motion)
        travel = self._part(self._travel, spec.motion)
        bounds = self._plant_bounds(spec, travel, draw)
        masses = spec.servo, spec.inertia, spec.friction, spec.load, spec.mesh
        machine: _Machine = self._part(
            self._machine, spec.plant, *masses, spec.actuator, spec.sampling
        )
        sensors = (spec.driving_encoder, False), (spec.driven_encoder, True)
        driving, driven = (self._part(self._sensor, *sensor) for sensor in sensors)
        return CaseParts(
            motion=motion,
            bounds=bounds,
            plant=machine.plant,
            drive=machine.drive,
            actuator=machine.actuator,
            observer=self._part(_OBSERVERS[spec.judgement.observer], spec.judgement.bandwidth_hz),
            controller=self._located(
                spec, bounds, motion, travel, (driving, driven), machine.lead_s
            ),
            driving_sensor=driving,
            driven_sensor=driven,
            period=self._part(float64, 1.0 / spec.sampling.controller_hz),
            sense=self._part(float64, sense),
            seed=self._part(np.asarray, spec.seed),
            substeps=machine.substeps,
            noisy=any(table.noise_arcsec > 0 for table, _ in sensors),
        )

    def _motion(self, table: MotionTable) -> tuple[Motion, float]:
        """Return the motion and the direction, 1 or −1, in which it begins."""
        motion = scenario_motion(table, self.folder)
        return motion, _sense(motion) if table.kind == "recorded" else 1.0

    def _travel(self, table: MotionTable) -> Travel:
        """Return the smallest and the largest driving angle of the motion, turns."""
        low, high = _ends(self._part(self._motion, table)[0])
        return float(low) / REV, float(high) / REV

    def _model(self, rig: EccentricityTable | None, flanks: str) -> FlankModel:
        assert rig is not None  # checked where the scenario is read
        if not isinstance(self.pair, GearPair):
            raise ScenarioError(
                "names a [drive] without gears, in which eccentricities mean nothing; write"
                ' plant_map = "RUN" with the run folder of a fit of this drive.',
                where="pair",
            )
        eccentricities = Eccentricities(
            rig.driving_mm,
            rig.driving_phase_deg,
            rig.driven_mm,
            rig.driven_phase_deg,
            rig.constant_backlash_deg,
        )
        build = exact_model if flanks == "exact" else closed_model
        return build(self.pair, eccentricities)

    def _plant_bounds(self, spec: ScenarioSpec, travel: Travel, draw: int) -> Bounds:
        """Return the flanks of the plant.

        **Raises** `ScenarioError` for a map whose flanks cross: no drive has a gap below zero.
        """
        where = "plant_map" if spec.rig is None else "rig"
        if spec.rig is not None and self.maps.draws is not None:
            one = jax.tree.map(lambda leaf: leaf[0], self.maps.draws)
            span = self._span(one, travel, self.maps.number)
            bounds, gap = self._part(self._drawn, span, nodes_per_turn(one), draw)
        else:
            name = spec.plant_map if spec.rig is None else spec.rig.run
            if name == ECCENTRICITIES:
                source = spec.eccentricities, spec.flanks
                return self._bounds(source, self._checked(source, travel, where), 0)
            bounds, gap, _ = self._part(self._mapped, name, self._checked(name, travel, where))
        _require_gap(gap, "at one angle", where)
        return bounds

    def _believed(self, spec: ScenarioSpec) -> "_Source":
        """Return what the controller takes for the flanks."""
        name = believed_flanks(spec)
        return (_believed(spec), spec.flanks) if name == ECCENTRICITIES else name

    def _checked(self, source: "_Source", travel: Travel, where: str) -> "_Span":
        """Return the span of the table of a named map or of eccentricities.

        **Raises** `ScenarioError` for a map that is not given or is shorter than the motion.
        """
        model = self._flank_model(source, where)
        if not isinstance(model, FlankTable):
            return self._span(model, travel)
        ends = float(model.start) / DEG, float(model.start + model.length) / DEG
        asked = 360 * travel[0], 360 * travel[1]
        if not model.periodic and not (ends[0] < asked[0] + 1e-6 and asked[1] < ends[1] + 1e-6):
            map_ends, motion_ends = (f"{low:z.2f}° … {high:z.2f}°" for low, high in (ends, asked))
            raise ScenarioError(
                f"the map covers {map_ends} of the driving angle, but the motion {motion_ends};"
                " take a longer map (`vttig map --span-rev`) or a shorter motion.",
                where=where,
            )
        return 0, 0, model.periodic

    def _flank_model(self, source: "_Source", where: str) -> FlankModel:
        if not isinstance(source, str):
            return self._part(self._model, *source)
        if source not in self.maps.named:
            raise ScenarioError(
                f"{source!r} is a run folder or a map file, which `vttig simulate` and"
                " `vttig_jax.simulate` read; here give its flank model as `maps`.",
                where=where,
            )
        return self.maps.named[source]

    def _make_bounds(self, source: "_Source", span: "_Span", turns: int) -> Bounds:
        """Return the flanks of a named map or of eccentricities, `turns` driving turns on."""
        model, (first, count, periodic) = self._flank_model(source, ""), span
        if isinstance(model, ClosedModel):
            return first_order_bounds(model, self.closing).turned(turns)
        if not isinstance(model, FlankTable):
            model = _tabulated(model, count, periodic, first + turns, nodes_per_turn(model))
        return replace(model, closing=self.closing).turned(turns)

    def _mapped(self, name: str, span: "_Span") -> tuple[Bounds, float, float]:
        """Return the flanks of a named map, and the smallest and mean gap at its nodes, rad."""
        bounds = self._bounds(name, span, 0)
        if not isinstance(bounds, FlankTable):  # eccentric gears of first order, and nothing else
            return bounds, 0.0, 0.0
        gap = np.asarray(bounds.nodes[:, 2] - bounds.nodes[:, 0])
        return bounds, float(gap.min()), float(gap.mean())

    def _drawn(self, span: "_Span", per_turn: int, draw: int) -> tuple[Bounds, float]:
        """Return the flanks of a draw, and the smallest gap at its nodes, rad."""
        tables, smallest = self._draw_tables(span, per_turn)
        return tables.of_map(draw), float(smallest[draw])

    def _make_draw_tables(
        self, span: "_Span", per_turn: int
    ) -> tuple[FlankTable, Float[np.ndarray, " draws"]]:
        """Return one table of all draws, and the smallest gap of each at the nodes, rad."""
        first, count, periodic = span
        assert self.maps.draws is not None
        if self.maps.number * count * per_turn > _MOST_ROWS:
            raise ScenarioError(
                f"the maps of {self.maps.number} draws over {count} driving turns need"
                f" {self.maps.number * count * per_turn:.2g} nodes, more than {_MOST_ROWS:.2g};"
                " take fewer draws (rig.draws) or a shorter motion.",
                where="rig",
            )
        tables = _tabulated_draws(self.maps.draws, count, periodic, first, per_turn)
        smallest = np.asarray(_smallest(tables.nodes))
        one = jax.tree.map(lambda leaf: np.asarray(leaf[0]), tables)
        return replace(one, nodes=tables.nodes.reshape(-1, 4), closing=self.closing), smallest

    def _span(self, model: FlankModel, travel: Travel, maps: int = 1) -> "_Span":
        """Return first turn and number of turns of a table, and whether it is periodic.

        The table has the hunting period, or at least the travel where the period is too long. The
        number of turns is then a power of two, so that motions share compiled programs.
        """
        hunting, first = self.pair.hunting_turns, math.floor(travel[0]) - 1
        needed = math.ceil(travel[1]) + 1 - first
        count = 1 << (needed - 1).bit_length()
        rows = hunting * nodes_per_turn(model)
        whole = rows <= _WHOLE_ROWS and rows * maps <= _MOST_ROWS
        return (0, hunting, True) if whole or count >= hunting else (first, count, False)

    def _machine(
        self,
        kind: str,
        servo: ServoTable,
        inertia: InertiaTable,
        friction: FrictionTable,
        load: LoadTable,
        mesh: MeshTable,
        actuator: ActuatorTable,
        sampling: SamplingTable,
    ) -> "_Machine":
        """Return the parts whose masses, friction and contact belong together."""
        pair, hertz = self.pair, sampling.controller_hz
        drag = Drag(
            inertia=inertia.driven_kgm2,
            coulomb=friction.coulomb_Nm,
            viscous=friction.viscous_Nms,
            stribeck=friction.stribeck_Nm,
            stribeck_speed=friction.stribeck_rad_s,
            load=load.torque_Nm,
            sticky=friction.stribeck_Nm > 0,
        )
        substeps = round(sampling.plant_hz / hertz) or 1
        if kind == "elastic":
            stiffness = self._stiffness(mesh)
            longest = largest_step(stiffness, mesh.damping_ratio, inertia.driven_kgm2)
            needed = math.ceil(1.0 / (hertz * longest) * (1 - 1e-12))
            substeps = substeps if sampling.plant_hz else needed
            if substeps < needed:
                raise ScenarioError(
                    f"a step of {1 / (hertz * substeps):.3g} s is too long for a mesh of"
                    f" {stiffness:.3g} N m/rad on {inertia.driven_kgm2:g} kg m²; the longest is"
                    f" {longest:.3g} s: take plant_hz = {hertz * needed:g}.",
                    where="sampling.plant_hz",
                )
            plant: Plant = ElasticPlant(drag, stiffness, mesh.damping_ratio)
        else:
            plant = PlayPlant() if kind == "play" else RigidPlant(drag, mesh.restitution)
        light = replace(drag, inertia=0.0) if kind == "play" else drag
        drive: ShaftDrive = Prescribed()
        if servo.motor == "pi":
            fastest, step = servo.speed_gain_Nms / inertia.driving_kgm2, 1 / (hertz * substeps)
            if step * fastest > 1 + 1e-12:
                raise ScenarioError(
                    f"steps of {step:.3g} s are too long for a servo of {servo.speed_gain_Nms:g}"
                    f" N m s/rad on {inertia.driving_kgm2:g} kg m²; take {math.ceil(fastest):g} Hz"
                    " or more, or lower servo.speed_gain_Nms.",
                    where="sampling.plant_hz",
                )
            gains = servo.speed_gain_Nms, servo.integral_gain_Nm, servo.position_gain_1_s
            driving = Drag(inertia.driving_kgm2, friction.driving_Nm)
            drive = ServoDrive(Servo(*gains, servo.torque_limit_Nm), driving, light)
        thrust, sliding = None, mesh.friction_coefficient
        back_drivable = can_back_drive(self.taper, sliding)
        if actuator.force_limit_N > 0 and isinstance(pair, GearPair):
            radius_m, ratio = 1e-3 * float(pair.reference_radii[1]), float(pair.ratio)
            thrust = Thrust(light, self.taper, sliding, radius_m, ratio)
            if servo.motor == "pi":
                wedge = float(self.taper.max()) - sliding
                force = servo.torque_limit_Nm / (ratio * radius_m) * wedge
                back_drivable = back_drivable & (force >= actuator.force_limit_N)
        delay = math.ceil(actuator.delay_s * hertz * (1 - 1e-12))
        carriage = Actuator(
            speed=actuator.speed_mm_s,
            acceleration=actuator.acceleration_mm_s2,
            stroke=actuator.stroke_mm,
            resolution=actuator.resolution_mm,
            delay=delay,
            back_drivable=back_drivable,
            # A power of two, so that most new delays need no new compiled program.
            periods=1 << (max(delay, 1) - 1).bit_length(),
            force_limit=np.asarray(actuator.force_limit_N) if thrust is not None else None,
            thrust=thrust,
        )
        return _Machine(substeps, plant, drive, carriage, (delay + _LOOP_PERIODS) / hertz)

    def _stiffness(self, mesh: MeshTable) -> float:
        """Return the stiffness of the mesh at the driven shaft, N m/rad."""
        if not isinstance(self.pair, GearPair) or np.isnan(self.pair.driven.face_width_mm):
            cure = "add `face_width_mm` to [driven] of the pair file"
            if not isinstance(self.pair, GearPair):
                cure = "a [drive] has none, so choose the rigid plant"
            raise ScenarioError(
                f"the elastic plant needs the face width of the driven gear; {cure}.", where="plant"
            )
        radius = float(self.pair.base_radii[1].mean())
        return mesh_stiffness(mesh.stiffness_N_mm_um, float(self.pair.driven.face_width_mm), radius)

    def _located(
        self,
        spec: ScenarioSpec,
        bounds: Bounds,
        motion: Motion,
        travel: Travel,
        sensors: tuple[Sensor, Sensor],
        lead_s: float,
    ) -> Controller:
        """Return the controller, or a `LostController` if it cannot locate its driving turn.

        If the controller locates a wrong turn of the hunting period, its map is shifted by this
        error.

        **Raises** `ScenarioError` for a controller that shifts gears without taper.
        """
        own = self.controller
        if own.closes if own else spec.controller in _CLOSING:
            self._require_taper(spec.controller if own is None else type(own).__name__)
        source, turns = spec.judgement.turn, None
        if source == "known" or spec.controller == "none":
            turns = 0
        elif source == "located":
            model = self._flank_model(self._believed(spec), "controller_map")
            start = float(motion.at(jnp.zeros(())).angle)
            turns = turn_error(
                self.pair, believed=model, rig=bounds, sensors=sensors, angle=start, seed=spec.seed
            )
        if turns is None:
            return LostController()
        if own is not None or spec.controller == "none":
            return own or NoController()
        source, gap_deg = self._believed(spec), spec.map.constant_backlash_deg
        span = self._checked(source, travel, "controller_map")
        if isinstance(source, str):
            if set(plain_table(spec.map)) - {"constant_backlash_deg"}:
                raise ScenarioError(
                    f"eccentricities of [map] mean nothing in the map {source!r}; give only its"
                    " constant_backlash_deg, or write [eccentricities].",
                    where="map",
                )
            mean = self._part(self._mapped, source, span)[2]
            _require_gap(mean, "on the average", "controller_map")
        believed = source, span, turns, gap_deg if isinstance(source, str) else None
        limits = spec.actuator.speed_mm_s, spec.actuator.acceleration_mm_s2
        return self._part(
            self._controller, spec.controller, spec.judgement, lead_s, limits, *believed
        )

    def _controller(
        self,
        name: str,
        judgement: JudgementTable,
        lead: float,
        limits: tuple[float, float],
        source: "_Source",
        span: "_Span",
        turns: int,
        gap_deg: float | None,
    ) -> Controller:
        bounds = self._bounds(source, span, turns)
        if gap_deg is not None and isinstance(bounds, FlankTable):
            nodes = jnp.asarray(bounds.nodes)
            shift = gap_deg * DEG - jnp.mean(nodes[:, 2] - nodes[:, 0])
            bounds = replace(bounds, nodes=nodes.at[:, 2].add(shift))
        least_speed = judgement.least_rpm * REV / 60.0
        if name == "feedforward":
            return FeedforwardController(bounds, judgement.jump_s)
        if name == "acceleration":
            threshold = judgement.threshold_rad_s2
            return AccelerationController(bounds, threshold, least_speed, judgement.margin_mm)
        retreat = self._retreat(self._flank_model(source, ""), bounds, limits)
        return PredictiveController(
            bounds, judgement.horizon_s, least_speed, judgement.margin_mm, lead, retreat
        )

    def _retreat(
        self, model: FlankModel, bounds: Bounds, limits: tuple[float, float]
    ) -> Retreat | None:
        """Return how the controller looks at the teeth that pass; None without short waves."""
        assert isinstance(self.pair, GearPair)  # a drive without gears has no taper
        teeth = self.pair.driving.teeth
        order = teeth if isinstance(model, FlankTable) else model.highest_order
        points = int(_POINTS * order / teeth)
        if not isinstance(bounds, FlankTable) or points == 0:
            return None
        gap = np.asarray(bounds.nodes[:, 2] - bounds.nodes[:, 0])
        rows = min(math.ceil(REV / teeth / float(bounds.step)) + 1, len(gap))
        passed = np.ptp(np.lib.stride_tricks.sliding_window_view(gap, rows), axis=1).max()
        return Retreat(*limits, REV / teeth, passed / self.closing.sum(), points)

    def _require_taper(self, controller: str) -> None:
        if self.closing.sum() > 0:
            return
        why = "this drive has no gears"
        if isinstance(self.pair, GearPair):
            why = f"the helix angles of both flanks add up to {float(self.taper.sum()):g} in tan β"
        raise ScenarioError(
            f"the controller {controller!r} shifts a gear along its axis to close the gap, but"
            f' {why}; choose "none" or "feedforward", or gears that thin along the axis'
            " (`helix_angle_deg`).",
            where="controller",
        )

    def _sensor(self, table: EncoderTable, driven: bool) -> Sensor:
        per_rev = table.counts_per_rev
        if per_rev is None:
            gears = self.pair if isinstance(self.pair, GearPair) else None
            gear = gears and (gears.driven if driven else gears.driving)
            per_rev = gear.encoder.counts_per_rev if gear else 0
        return Sensor(
            REV / per_rev if per_rev else 0.0,
            table.amplitude_arcsec * ARCSEC,
            table.phase_deg * DEG,
            table.noise_arcsec * ARCSEC,
            eccentric=table.amplitude_arcsec > 0,
        )


def _believed(spec: ScenarioSpec) -> EccentricityTable:
    """Return the eccentricities of the controller's map: those in [map], else the true ones."""
    assert spec.eccentricities is not None  # checked where the scenario is read
    values = {name: value for name, value in plain_table(spec.map).items() if value is not None}
    return structs.replace(spec.eccentricities, **values)


def _require_gap(gap: float, place: str, where: str) -> None:
    """Raise `ScenarioError` for a map whose gap (rad) is below zero at a `place`."""
    if not gap >= 0:
        raise ScenarioError(
            f"flank B lies {-gap / DEG:.5f}° before flank A {place}, where no gap is"
            " left; take a map with a larger backlash (constant_backlash_deg), or with its flanks"
            " in order.",
            where=where,
        )


def _sense(motion: Motion) -> float:
    """Return the direction, 1 or −1, in which the motion runs before the braking."""
    angle = motion.at(jnp.asarray(motion.braking_s)).angle - motion.at(jnp.zeros(())).angle
    return -1.0 if float(angle) < 0 else 1.0


_CLOSING = ("acceleration", "predictive")
"""Controllers that shift gear 2."""

_TIMES = 4097
"""Times of a motion at which its travel is read: a chosen value."""


@eqx.filter_jit
def _ends(motion: Motion) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return the smallest and the largest angle of a motion, rad."""
    angle = motion.at(jnp.linspace(0.0, 1.0, _TIMES) * jnp.asarray(motion.duration_s)).angle
    return angle.min(), angle.max()


@eqx.filter_jit
def _tabulated(model: FlankModel, count: int, periodic: bool, first: int, per: int) -> FlankTable:
    return tabulate_flanks(model, count, periodic=periodic, first_turn=first, per_turn=per)


@eqx.filter_jit
def _tabulated_draws(
    models: FlankModel, count: int, periodic: bool, first: int, per: int
) -> FlankTable:
    return jax.lax.map(lambda model: _tabulated(model, count, periodic, first, per), models)


def _smallest(nodes: Float[Numbers, "*maps rows 4"]) -> Float[Numbers, "*maps"]:
    """Return the smallest gap at the nodes of tables, rad."""
    return jnp.min(jnp.asarray(nodes[..., 2] - nodes[..., 0]), axis=-1)

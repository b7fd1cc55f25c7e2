"""Construction of a case from a scenario: motion, motor, plant, actuator and controller."""

import math
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from msgspec import structs

from ...base.arrays import float64
from ...base.errors import ScenarioError
from ...base.files.toml_io import plain_table
from ...base.units import ARCSEC, DEG, REV
from ...kinematics.exact import exact_model
from ...kinematics.first_order import closed_model
from ...kinematics.flank_model import FlankModel
from ...pair.eccentricities import Eccentricities
from ...pair.gear_pair import GearPair
from ..controllers.acceleration import AccelerationController
from ..controllers.controller import Controller, NoController
from ..controllers.feedforward import FeedforwardController
from ..controllers.predictive import PredictiveController
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
from ..plants.flank_bounds import Bounds, bounds_of
from ..plants.plant import Drag, Plant
from ..plants.play import PlayPlant
from ..plants.rigid import RigidPlant
from ..scenario.spec import ScenarioSpec
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
    ServoTable,
)
from .case import Case

_SHORTEST_QUEUE = 1
"""Least length of the actuator's queue of commands, periods."""


def drag_of(inertia_kgm2: float, friction: FrictionTable, load: LoadTable) -> Drag:
    """Return the inertia, friction and load of the driven shaft."""
    return Drag(
        inertia=inertia_kgm2,
        coulomb=friction.coulomb_Nm,
        viscous=friction.viscous_Nms,
        stribeck=friction.stribeck_Nm,
        stribeck_speed=friction.stribeck_rad_s,
        load=load.torque_Nm,
        sticky=friction.stribeck_Nm > 0,
    )


def drive_of(
    servo: ServoTable,
    plant: str,
    inertia: InertiaTable,
    friction: FrictionTable,
    load: LoadTable,
    plant_hz: float,
) -> ShaftDrive:
    """Return the drive of the driving shaft.

    **Raises** `ScenarioError` for a step of the plant that is too long for the gain of the servo.
    """
    if servo.motor == "prescribed":
        return Prescribed()
    fastest = servo.speed_gain_Nms / inertia.driving_kgm2
    if plant_hz < fastest * (1 - 1e-12):
        raise ScenarioError(
            f"steps of {1 / plant_hz:.3g} s are too long for a servo of"
            f" {servo.speed_gain_Nms:g} N m s/rad on {inertia.driving_kgm2:g} kg m²; take"
            f" {math.ceil(fastest):g} Hz or more, or lower servo.speed_gain_Nms.",
            where="sampling.plant_hz",
        )
    law = Servo(
        servo.speed_gain_Nms,
        servo.integral_gain_Nm,
        servo.position_gain_1_s,
        servo.torque_limit_Nm,
    )
    driven = drag_of(0.0 if plant == "play" else inertia.driven_kgm2, friction, load)
    return ServoDrive(law, Drag(inertia.driving_kgm2, friction.driving_Nm), driven)


def actuator_of(
    pair: GearPair,
    table: ActuatorTable,
    servo: ServoTable,
    plant: str,
    inertia: InertiaTable,
    friction: FrictionTable,
    load: LoadTable,
    mesh: MeshTable,
    controller_hz: float,
) -> Actuator:
    """Return the actuator that slides the driven gear."""
    thrust, back_drivable = None, can_back_drive(pair.taper, mesh.friction_coefficient)
    if table.force_limit_N > 0:
        drag = drag_of(0.0 if plant == "play" else inertia.driven_kgm2, friction, load)
        radius_m = 1e-3 * float(pair.reference_radii[1])
        ratio, sliding = float(pair.ratio), mesh.friction_coefficient
        thrust = Thrust(drag, pair.taper, sliding, radius_m, ratio)
        if servo.motor == "pi":
            force = servo.torque_limit_Nm / (ratio * radius_m) * (float(pair.taper.max()) - sliding)
            back_drivable = back_drivable & (force >= table.force_limit_N)
    delay = delay_of(table, controller_hz)
    # The length of the queue is a power of two, so most new delays need no new compiled program.
    periods = 1 << max(math.ceil(math.log2(max(delay, _SHORTEST_QUEUE))), 0)
    return Actuator(
        speed=table.speed_mm_s,
        acceleration=table.acceleration_mm_s2,
        stroke=table.stroke_mm,
        resolution=table.resolution_mm,
        delay=delay,
        back_drivable=back_drivable,
        periods=periods,
        force_limit=np.asarray(table.force_limit_N) if thrust is not None else None,
        thrust=thrust,
    )


def delay_of(table: ActuatorTable, controller_hz: float) -> int:
    """Return the dead time of the actuator in whole periods of the controller."""
    return math.ceil(table.delay_s * controller_hz * (1 - 1e-12))


_OBSERVERS: dict[str, Callable[[float], Observer]] = {
    "alpha_beta_gamma": AlphaBetaGamma,
    "difference": FilteredDifference,
}
_CACHED_PARTS = 4096
"""Largest number of parts of cases that a builder caches; a chosen value."""
_LOOP_PERIODS = 3.0
"""Delay from an encoder reading to the resulting actuator position, in controller periods."""


def case_of(
    spec: ScenarioSpec,
    pair: GearPair,
    folder: Path = Path(),
    controller: Controller | None = None,
) -> Case:
    """Build the case of a validated scenario; see `Builder`."""
    return Builder(pair, folder, controller).case(spec)


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


class Builder:
    """Builder of the cases of one gear pair; it builds a part that several cases share only once.

    **Arguments**
    - `pair`: gears of the scenarios. - `folder`: folder of recorded motions.
    - `controller`: controller of the user, instead of those of the scenarios.
    """

    def __init__(
        self, pair: GearPair, folder: Path = Path(), controller: Controller | None = None
    ) -> None:
        self.pair = pair
        self.folder = folder
        self.controller = controller
        self._part = lru_cache(_CACHED_PARTS)(lambda make, *arguments: make(*arguments))

    def case(self, spec: ScenarioSpec) -> Case:
        """Build the case of a validated scenario.

        **Raises** `ScenarioError` for helix angles with which no displacement closes the gap, and
        for a step of the plant that is too long for the stiffness of the mesh.
        """
        return Case(**self.parts(spec)._asdict())

    def parts(self, spec: ScenarioSpec) -> CaseParts:
        """Return the parts of a case; see `case`."""
        motion, sense = self._part(self._motion, spec.motion)
        bounds = self._part(self._bounds, spec.eccentricities, spec.flanks)
        hertz = spec.sampling.controller_hz
        substeps = round(spec.sampling.plant_hz / hertz) or 1
        sensors = (spec.driving_encoder, False), (spec.driven_encoder, True)
        tables = spec.inertia, spec.friction, spec.load, spec.mesh
        return CaseParts(
            motion=motion,
            bounds=bounds,
            plant=self._part(self._plant, spec.plant, *tables, hertz, substeps),
            drive=self._part(drive_of, spec.servo, spec.plant, *tables[:3], hertz * substeps),
            actuator=self._part(
                self._actuator, spec.actuator, spec.servo, spec.plant, *tables, hertz
            ),
            observer=self._part(_OBSERVERS[spec.judgement.observer], spec.judgement.bandwidth_hz),
            controller=self._located(spec, bounds, motion),
            driving_sensor=self._part(self._sensor, *sensors[0]),
            driven_sensor=self._part(self._sensor, *sensors[1]),
            period=self._part(float64, 1.0 / hertz),
            sense=self._part(float64, sense),
            seed=self._part(np.asarray, spec.seed),
            substeps=substeps,
            noisy=any(table.noise_arcsec > 0 for table, _ in sensors),
        )

    def _motion(self, table: MotionTable) -> tuple[Motion, float]:
        """Return the motion and the direction, 1 or −1, in which it begins."""
        if table.kind == "recorded":
            motion = read_motion(self.folder / table.file)
            return motion, _sense(motion)
        return motion_of(
            table.kind,
            event=table.event,
            speed_rpm=table.speed_rpm,
            reversal_deg=table.reversal_deg,
            dwell_s=table.dwell_s,
            ramp_s=table.ramp_s,
            slow_share=table.slow_share,
            stop_s=table.stop_s,
        ), 1.0

    def _model(self, rig: EccentricityTable | None, flanks: str) -> FlankModel:
        assert rig is not None  # checked where the scenario is read
        eccentricities = Eccentricities(
            rig.driving_mm,
            rig.driving_phase_deg,
            rig.driven_mm,
            rig.driven_phase_deg,
            rig.constant_backlash_deg,
        )
        build = exact_model if flanks == "exact" else closed_model
        return build(self.pair, eccentricities)

    def _bounds(self, rig: EccentricityTable | None, flanks: str) -> Bounds:
        pair = self.pair
        closing = pair.taper / pair.reference_radii[1]
        if not float(closing.sum()) > 0:
            raise ScenarioError(
                f"the helix angles of flank A and B add up to {float(pair.taper.sum()):g} in tan β,"
                " so that no axial displacement closes the gap; give gears that thin along the axis"
                " (`helix_angle_deg`).",
                where="pair",
            )
        return bounds_of(self._model(rig, flanks), closing)

    def _plant(
        self,
        kind: str,
        inertia: InertiaTable,
        friction: FrictionTable,
        load: LoadTable,
        mesh: MeshTable,
        controller_hz: float,
        substeps: int,
    ) -> Plant:
        drag = drag_of(inertia.driven_kgm2, friction, load)
        if kind == "play":
            return PlayPlant()
        if kind == "rigid":
            return RigidPlant(drag, mesh.restitution)
        stiffness = self._stiffness(mesh)
        step = 1.0 / (controller_hz * substeps)
        longest = largest_step(stiffness, mesh.damping_ratio, inertia.driven_kgm2)
        if step > longest:
            least_hz = controller_hz * math.ceil(1.0 / (controller_hz * longest))
            raise ScenarioError(
                f"a step of {step:.3g} s is too long for a mesh of {stiffness:.3g} N m/rad on"
                f" {inertia.driven_kgm2:g} kg m²; the longest is {longest:.3g} s: take plant_hz ="
                f" {least_hz:g}.",
                where="sampling.plant_hz",
            )
        return ElasticPlant(drag, stiffness, mesh.damping_ratio)

    def _stiffness(self, mesh: MeshTable) -> float:
        """Return the stiffness of the mesh at the driven shaft, N m/rad."""
        width = float(self.pair.driven.face_width_mm)
        if math.isnan(width):
            raise ScenarioError(
                "the elastic plant needs the face width of the driven gear; add `face_width_mm` to"
                " [driven] of the pair file.",
                where="plant",
            )
        radius = float(self.pair.base_radii[1].mean())
        return mesh_stiffness(mesh.stiffness_N_mm_um, width, radius)

    def _actuator(self, *arguments: Any) -> Actuator:
        return actuator_of(self.pair, *arguments)

    def _located(self, spec: ScenarioSpec, bounds: Bounds, motion: Motion) -> Controller:
        """Return the controller, or a `LostController` if it cannot locate its driving turn.

        If the controller locates a wrong turn of the hunting period, its map is shifted by this
        error.
        """
        source, turns = spec.judgement.turn, None
        if source == "known" or spec.controller == "none":
            turns = 0
        elif source == "located":
            sensors = tuple(
                self._part(self._sensor, table, driven)
                for table, driven in ((spec.driving_encoder, False), (spec.driven_encoder, True))
            )
            model = self._part(self._model, _believed(spec), spec.flanks)
            start = float(motion.at(jnp.zeros(())).angle)
            turns = turn_error(
                self.pair, believed=model, rig=bounds, sensors=sensors, angle=start, seed=spec.seed
            )
        if turns is None:
            return LostController()
        hertz = spec.sampling.controller_hz
        lead = (delay_of(spec.actuator, hertz) + _LOOP_PERIODS) / hertz
        believed = _believed(spec), spec.flanks, turns
        return self.controller or self._part(
            self._controller, spec.controller, spec.judgement, lead, *believed
        )

    def _controller(
        self,
        name: str,
        judgement: JudgementTable,
        lead: float,
        rig: EccentricityTable,
        flanks: str,
        turns: int,
    ) -> Controller:
        if name == "none":
            return NoController()
        bounds = self._part(self._bounds, rig, flanks)
        bounds = bounds.turned(turns) if turns else bounds
        if name == "feedforward":
            return FeedforwardController(bounds, judgement.jump_s)
        least_speed = judgement.least_rpm * REV / 60.0
        if name == "acceleration":
            threshold = judgement.threshold_rad_s2
            return AccelerationController(bounds, threshold, least_speed, judgement.margin_mm)
        return PredictiveController(
            bounds, judgement.horizon_s, least_speed, judgement.margin_mm, lead
        )

    def _sensor(self, table: EncoderTable, driven: bool) -> Sensor:
        default = (self.pair.driven if driven else self.pair.driving).encoder.counts_per_rev
        per_rev = default if table.counts_per_rev is None else table.counts_per_rev
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


def _sense(motion: Motion) -> float:
    """Return the direction, 1 or −1, in which the motion runs before the braking."""
    angle = motion.at(jnp.asarray(motion.braking_s)).angle - motion.at(jnp.zeros(())).angle
    return -1.0 if float(angle) < 0 else 1.0

"""From what a scenario file says to a case that runs."""

import math
from collections.abc import Callable
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ..base.errors import ScenarioError
from ..base.units import ARCSEC, DEG, REV
from ..kinematics.closed import closed_model
from ..kinematics.exact import exact_model
from ..pair.eccentricities import Eccentricities
from ..pair.gears import GearPair
from .acceleration_controller import AccelerationController
from .actuator import Actuator, pushed_back
from .bounds import Bounds, bounds_of
from .case import Case
from .controller import Controller, NoController
from .elastic_plant import ElasticPlant, largest_step, mesh_stiffness
from .motion import Motion
from .observer import AlphaBetaGamma, FilteredDifference, Observer
from .pieces import motion_of
from .plant import Drag, Plant
from .play_plant import PlayPlant
from .predictive_controller import PredictiveController
from .recorded_motion import read_motion
from .rigid_plant import RigidPlant
from .sensing import Sensor
from .spec import ScenarioSpec
from .spec_tables import EncoderTable

_OBSERVERS: dict[str, Callable[[float], Observer]] = {
    "alpha_beta_gamma": AlphaBetaGamma,
    "difference": FilteredDifference,
}
_SHORTEST_QUEUE = 1
_PERIODS_BEHIND = 3.0
"""Periods from a reading to the place that the actuator takes by it."""


def case_of(
    spec: ScenarioSpec,
    pair: GearPair,
    folder: Path = Path(),
    controller: Controller | None = None,
) -> Case:
    """Build the case of a validated scenario.

    **Arguments**
    - `pair`: what its `pair` names. - `folder`: where a recorded motion lies.
    - `controller`: one of your own instead of that of the scenario.

    **Raises** `ScenarioError` for what only shows with the pair at hand: helix angles that close
    nothing, a step of the plant too long for the stiffness, a drive without gears.
    """
    motion = _motion(spec, folder)
    bounds = _bounds(spec, pair)
    period = 1.0 / spec.sampling.controller_hz
    substeps = round(spec.sampling.plant_hz / spec.sampling.controller_hz) or 1
    encoders = (spec.driving_encoder, pair.driving), (spec.driven_encoder, pair.driven)
    sensors = [_sensor(table, gear.encoder.counts_per_rev) for table, gear in encoders]
    observer = _OBSERVERS[spec.judgement.observer]
    return Case(
        motion=motion,
        bounds=bounds,
        plant=_plant(spec, pair, period / substeps),
        actuator=_actuator(spec, pair),
        observer=observer(spec.judgement.bandwidth_hz),
        controller=controller or _controller(spec, bounds),
        driving_sensor=sensors[0],
        driven_sensor=sensors[1],
        period=period,
        sense=_sense(motion),
        seed=np.asarray(spec.seed),
        substeps=substeps,
        noisy=any(table.noise_arcsec > 0 for table, _ in encoders),
    )


def _motion(spec: ScenarioSpec, folder: Path) -> Motion:
    table = spec.motion
    if table.kind == "recorded":
        return read_motion(folder / table.file)
    return motion_of(
        table.kind,
        table.event,
        table.speed_rpm,
        table.reversal_deg,
        table.dwell_s,
        table.ramp_s,
        table.slow_share,
        table.stop_s,
    )


def _sense(motion: Motion) -> float:
    """Of the way made before the brakes: the run begins in this sense."""
    way = motion.at(jnp.asarray(motion.braking_s)).angle - motion.at(jnp.zeros(())).angle
    return -1.0 if float(way) < 0 else 1.0


def _bounds(spec: ScenarioSpec, pair: GearPair) -> Bounds:
    rig = spec.eccentricities
    assert rig is not None  # held by the readers of a scenario
    eccentricities = Eccentricities(
        rig.driving_mm,
        rig.driving_phase_deg,
        rig.driven_mm,
        rig.driven_phase_deg,
        rig.constant_backlash_deg,
    )
    closing = pair.taper / pair.reference_radii[1]
    if not float(closing.sum()) > 0:
        raise ScenarioError(
            f"the helix angles of flank A and B add up to {float(pair.taper.sum()):g} in tan β, so"
            " that no axial displacement closes the gap; give gears that thin along the axis"
            " (`helix_angle_deg`).",
            where="pair",
        )
    build = exact_model if spec.flanks == "exact" else closed_model
    return bounds_of(build(pair, eccentricities), closing)


def _plant(spec: ScenarioSpec, pair: GearPair, step: float) -> Plant:
    drag = Drag(
        spec.inertia.driven_kgm2,
        spec.friction.coulomb_Nm,
        spec.friction.viscous_Nms,
        spec.friction.stribeck_Nm,
        spec.friction.stribeck_rad_s,
        spec.load.torque_Nm,
        sticky=spec.friction.stribeck_Nm > 0,
    )
    if spec.plant == "play":
        return PlayPlant()
    if spec.plant == "rigid":
        return RigidPlant(drag, spec.mesh.restitution)
    width = float(pair.driven.face_width_mm)
    if math.isnan(width):
        raise ScenarioError(
            "the elastic plant needs the face width of the driven gear; add `face_width_mm` to"
            " [driven] of the pair file.",
            where="plant",
        )
    radius = float(pair.base_radii[1].mean())
    stiffness = mesh_stiffness(spec.mesh.stiffness_N_mm_um, width, radius)
    ratio, inertia = spec.mesh.damping_ratio, spec.inertia.driven_kgm2
    longest = largest_step(stiffness, ratio, inertia)
    if step > longest:
        raise ScenarioError(
            f"a step of {step:.3g} s is too long for a mesh of {stiffness:.3g} N m/rad on"
            f" {inertia:g} kg m²; the longest is {longest:.3g} s: take plant_hz ="
            f" {_multiple(spec.sampling.controller_hz, longest):g}.",
            where="sampling.plant_hz",
        )
    return ElasticPlant(drag, stiffness, ratio)


def _multiple(controller_hz: float, longest: float) -> float:
    """Lowest multiple of a rate in Hz whose period is at most `longest`."""
    return controller_hz * math.ceil(1.0 / (controller_hz * longest))


def _actuator(spec: ScenarioSpec, pair: GearPair) -> Actuator:
    table = spec.actuator
    delay = _delay(spec)
    # Powers of two, so that most new delays find a compiled program.
    periods = 1 << max(math.ceil(math.log2(max(delay, _SHORTEST_QUEUE))), 0)
    return Actuator(
        table.speed_mm_s,
        table.acceleration_mm_s2,
        table.stroke_mm,
        table.resolution_mm,
        delay,
        pushed_back(pair.taper, spec.mesh.friction_coefficient),
        periods,
    )


def _delay(spec: ScenarioSpec) -> int:
    """Dead time of the actuator in whole periods of the controller."""
    return math.ceil(spec.actuator.delay_s * spec.sampling.controller_hz * (1 - 1e-12))


def _controller(spec: ScenarioSpec, bounds: Bounds) -> Controller:
    if spec.controller == "none":
        return NoController()
    judgement = spec.judgement
    least_speed = judgement.least_rpm * REV / 60.0
    if spec.controller == "acceleration":
        threshold = judgement.threshold_rad_s2
        return AccelerationController(bounds, threshold, least_speed, judgement.margin_mm)
    lead = (_delay(spec) + _PERIODS_BEHIND) / spec.sampling.controller_hz
    return PredictiveController(bounds, judgement.horizon_s, least_speed, judgement.margin_mm, lead)


def _sensor(table: EncoderTable, drawn: int | None) -> Sensor:
    per_rev = drawn if table.counts_per_rev is None else table.counts_per_rev
    return Sensor(
        REV / per_rev if per_rev else 0.0,
        table.amplitude_arcsec * ARCSEC,
        table.phase_deg * DEG,
        table.noise_arcsec * ARCSEC,
        eccentric=table.amplitude_arcsec > 0,
    )

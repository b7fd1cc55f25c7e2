"""The motor and the actuator of a scenario: what moves shafts and gears."""

import math

import numpy as np

from ..base.errors import ScenarioError
from ..pair.gears import GearPair
from .actuator import Actuator, pushed_back
from .drive import Drive, Prescribed
from .plant import Drag
from .servo import Servo
from .servo_drive import ServoDrive
from .spec_tables import (
    ActuatorTable,
    FrictionTable,
    InertiaTable,
    LoadTable,
    MeshTable,
    ServoTable,
)
from .thrust import Thrust

_SHORTEST_QUEUE = 1


def drag_of(inertia_kgm2: float, friction: FrictionTable, load: LoadTable) -> Drag:
    """Of the driven shaft."""
    return Drag(
        inertia_kgm2,
        friction.coulomb_Nm,
        friction.viscous_Nms,
        friction.stribeck_Nm,
        friction.stribeck_rad_s,
        load.torque_Nm,
        sticky=friction.stribeck_Nm > 0,
    )


def drive_of(
    servo: ServoTable,
    plant: str,
    inertia: InertiaTable,
    friction: FrictionTable,
    load: LoadTable,
    plant_hz: float,
) -> Drive:
    """How the driving shaft follows its motion.

    **Raises** `ScenarioError` for a step of the plant too long for the gain of the servo.
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
    """What slides the driven gear."""
    thrust, yields = None, pushed_back(pair.taper, mesh.friction_coefficient)
    if table.force_limit_N > 0:
        drag = drag_of(0.0 if plant == "play" else inertia.driven_kgm2, friction, load)
        radius_m = 1e-3 * float(pair.reference_radii[1])
        ratio, sliding = float(pair.ratio), mesh.friction_coefficient
        thrust = Thrust(drag, pair.taper, sliding, radius_m, ratio)
        if servo.motor == "pi":
            most = servo.torque_limit_Nm / (ratio * radius_m)
            spare = float(pair.taper.max()) - sliding
            yields = yields & (most * spare >= table.force_limit_N)
    delay = delay_of(table, controller_hz)
    # Powers of two, so that most new delays find a compiled program.
    periods = 1 << max(math.ceil(math.log2(max(delay, _SHORTEST_QUEUE))), 0)
    return Actuator(
        table.speed_mm_s,
        table.acceleration_mm_s2,
        table.stroke_mm,
        table.resolution_mm,
        delay,
        yields,
        periods,
        np.asarray(table.force_limit_N) if thrust is not None else None,
        thrust,
    )


def delay_of(table: ActuatorTable, controller_hz: float) -> int:
    """Dead time of the actuator in whole periods of the controller."""
    return math.ceil(table.delay_s * controller_hz * (1 - 1e-12))

"""A motor and both shafts followed step by step: no controller, no actuator, no encoders."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.compiler import fast_to_compile
from tests.control.followed import OPEN
from vttig_jax.control.hardware.servo import Motor, Servo, ServoDrive
from vttig_jax.control.motion.motion import MotionPoint
from vttig_jax.control.plants.plant import FREE, Drag, Plant, Shafts
from vttig_jax.kinematics.flank_table import Bounds, FirstOrderBounds

RATIO = 0.5625
IDLE = Servo(1e-300, 0.0, 0.0, 1.0)
"""No torque."""


def waves(swing: float = 4e-4, gap: float = 8e-4, ratio: float = RATIO) -> FirstOrderBounds:
    """Flanks that go up and down once a turn of each shaft, in different phases."""
    cosine: Any = swing * np.array([[1.0, 0.3], [0.6, -0.5]])
    sine: Any = swing * np.array([[0.2, -0.7], [-0.9, 0.4]])
    return FirstOrderBounds(ratio, np.array([0.0, gap]), cosine, sine, np.ones(2))


TOGETHER = 400
"""Runs are prolonged to a multiple of so many steps, so that they share compiled programs."""


class Start(NamedTuple):
    """Where both shafts begin: rad, rad/s and the flank that carries."""

    angle: Any = 0.0
    speed: Any = 0.0
    offset: Any = 0.0
    drift: Any = 0.0
    side: Any = FREE


class Ways(NamedTuple):
    """Both shafts after every step; `touched` the flank newly met in it."""

    angle: np.ndarray
    speed: np.ndarray
    offset: np.ndarray
    drift: np.ndarray
    side: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    touched: np.ndarray


def drive_of(
    servo: Servo = IDLE, driving: Drag | None = None, driven: Drag | None = None
) -> ServoDrive:
    return ServoDrive(servo, driving or Drag(0.002), driven or Drag(0.01))


def follow(
    drive: ServoDrive,
    plant: Plant,
    bounds: Bounds,
    start: Start,
    told: MotionPoint,
    step: float,
) -> Ways:
    """Both shafts at the end of every step; `told` at the start of the first and after each."""
    begin, steps = jax.tree.map(lambda value: jnp.asarray(value, float), start), len(told.angle) - 1
    asked = jax.tree.map(lambda value: np.pad(value, (0, -steps % TOGETHER), "edge"), told)
    ways = _follow(drive, plant, bounds, begin, asked, jnp.asarray(step, float))
    return Ways(*(np.asarray(way)[:steps] for way in ways))


def told_of(angle: Any, speed: Any) -> MotionPoint:
    """What the motor is told, before the first step and after each: rad and rad/s."""
    angle, speed = jnp.broadcast_arrays(jnp.asarray(angle, float), jnp.asarray(speed, float))
    return MotionPoint(angle, speed, jnp.zeros_like(angle))


def nothing(steps: int) -> MotionPoint:
    """For a servo that asks for no torque."""
    return told_of(0.0, np.zeros(steps + 1))


@eqx.filter_jit(**fast_to_compile())
def _follow(drive, plant, bounds, start, told, step):
    return followed(drive, plant, bounds, start, told, step)


def followed(drive, plant, bounds, start, told, step) -> Any:
    """The same inside a compiled function."""
    places = [value + jnp.zeros(()) for value in start]
    shafts = Shafts(*places, flanks=bounds.at(places[0]))
    first = jax.tree.map(lambda values: values[0], told)
    rest = jax.tree.map(lambda values: values[1:], told)

    def one(state: tuple[Motor, Shafts], point: MotionPoint):
        motor, shafts, touch = drive.step(state[0], plant, state[1], point, OPEN, bounds, step)
        flanks = shafts.flanks
        places = (shafts.angle, shafts.speed, shafts.offset, shafts.drift, shafts.side)
        return (motor, shafts), (*places, flanks.lower, flanks.upper, touch.side)

    found: Any = jax.lax.scan(one, (drive.start(first), shafts), rest)[1]
    return Ways(*found)

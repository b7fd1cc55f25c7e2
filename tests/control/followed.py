"""Both shafts followed step by step: no controller, no actuator, no encoders."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.compiler import fast_to_compile
from tests.control.parts import at
from vttig_jax.control.hardware.servo import Servo, ServoDrive
from vttig_jax.control.motion.motion import Motion, MotionPoint
from vttig_jax.control.plants.plant import FREE, ContactEvent, Drag, Plant, Shafts, Slide
from vttig_jax.kinematics.flank_table import Bounds, FirstOrderBounds

RATIO = 0.5625
OPEN = Slide(*[jnp.zeros(())] * 4)
IDLE = Servo(1e-300, 0.0, 0.0, 1.0)
"""No torque."""
TOGETHER = 250
"""Steps of one call of the compiled program, so that it serves runs of every length."""


class Still(NamedTuple):
    """Walls that do not move: TE of flank A and B, rad."""

    lower: float
    upper: float

    def bounds(self) -> Bounds:
        """As harmonics of size zero, of a pair with ratio 1."""
        zero = np.zeros((2, 2))
        return FirstOrderBounds(1.0, np.array([self.lower, self.upper]), zero, zero, np.ones(2))


def waves(swing: float = 4e-4, gap: float = 8e-4) -> FirstOrderBounds:
    """Flanks that go up and down once a turn of each shaft, in different phases."""
    cosine: Any = swing * np.array([[1.0, 0.3], [0.6, -0.5]])
    sine: Any = swing * np.array([[0.2, -0.7], [-0.9, 0.4]])
    return FirstOrderBounds(RATIO, np.array([0.0, gap]), cosine, sine, np.ones(2))


def shafts_of(
    bounds: Bounds,
    angle: Any = 0.0,
    speed: Any = 0.0,
    offset: Any = 0.0,
    drift: Any = 0.0,
    side: Any = FREE,
) -> Shafts:
    """Both shafts: driving angle and speed, x and its rate, and the flank that carries."""
    values = [jnp.asarray(value, float) for value in (angle, speed, offset, drift, side)]
    return Shafts(*values, flanks=bounds.at(values[0]))


def shafts_at(
    motion: Motion, bounds: Bounds, time: Any, offset: Any, drift: Any, side: float
) -> Shafts:
    """The same with the driving shaft where a motion has it at a time in s."""
    point = motion.at(jnp.asarray(time))
    return shafts_of(bounds, point.angle, point.speed, offset, drift, side)


def drive_of(
    servo: Servo = IDLE, driving: Drag | None = None, driven: Drag | None = None
) -> ServoDrive:
    return ServoDrive(servo, driving or Drag(0.002), driven or Drag(0.01))


def told_of(angle: Any, speed: Any) -> MotionPoint:
    """What the motor is told, before the first step and after each: rad and rad/s."""
    angle, speed = jnp.broadcast_arrays(jnp.asarray(angle, float), jnp.asarray(speed, float))
    return MotionPoint(angle, speed, jnp.zeros_like(angle))


def by_scipy(
    gains: tuple[float, float, float],
    told: MotionPoint,
    step: float,
    start: Any,
    rates: Callable[[Any, float], Any],
    limit: float = np.inf,
    **precision: Any,
) -> np.ndarray:
    """A state after every step by DOP853 between the samples of a servo: shape (steps, states).

    It begins with angle and speed of the driving shaft; `rates` is its derivative under a torque.
    """
    proportional, integral, position = gains
    state, wound, found = np.array(start, float), 0.0, []
    for angle, speed in zip(told.angle[:-1], told.speed[:-1], strict=True):
        error = speed + position * (angle - state[0]) - state[1]
        plain = proportional * error + integral * (wound + step * error)
        torque = np.clip(plain, -limit, limit)
        if torque == plain or error * plain < 0:
            wound += step * error
        law = lambda _, y, torque=torque: rates(y, torque)  # noqa: E731
        state = solve_ivp(law, (0, step), state, "DOP853", **precision).y[:, -1]
        found.append(state)
    return np.array(found)


def at_rest(
    plant: Plant, bounds: Bounds, place: tuple[float, float, float], step: float, steps: int
) -> tuple[Shafts, ContactEvent]:
    """Shafts and touches while the driving shaft stands; `place`: x, its rate and the flank."""
    start = shafts_of(bounds, 0.0, 0.0, *place)
    return turned(None, plant, bounds, start, told_of(np.zeros(steps + 1), 0.0), step)


def follow(
    plant: Plant,
    motion: Motion,
    bounds: Bounds,
    start: Shafts,
    begin: float,
    step: float,
    steps: int,
    every: int = 1,
) -> tuple[Shafts, ContactEvent]:
    """Shafts after every so many steps of a motion, and the touches of all steps."""
    told = at(motion, begin + step * np.arange(steps + 1))
    shafts, touches = turned(None, plant, bounds, start, told, step)
    return jax.tree.map(lambda values: values[every - 1 :: every], shafts), touches


def turned(
    drive: ServoDrive | None,
    plant: Plant,
    bounds: Bounds,
    start: Shafts,
    told: MotionPoint,
    step: float,
) -> tuple[Shafts, ContactEvent]:
    """Both shafts at the end of every step and what they touch; `told` before the first and after.

    Without a drive the driving shaft is where it is told to be.
    """
    steps, parts = len(told.angle) - 1, []
    first = jax.tree.map(lambda values: jnp.asarray(values[0]), told)
    asked = jax.tree.map(lambda values: np.pad(values[1:], (0, -steps % TOGETHER), "edge"), told)
    now: Any = (None if drive is None else drive.start(first), _strong(start))
    for done in range(0, steps, TOGETHER):
        some = jax.tree.map(lambda values, done=done: values[done : done + TOGETHER], asked)
        now, part = _advanced(drive, plant, bounds, now, some, jnp.asarray(step, float))
        parts.append(jax.tree.map(np.asarray, part))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:steps], *parts)


def _strong(tree: Shafts) -> Shafts:
    """The same numbers with types that do not depend on how they were made."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.result_type(leaf)), tree)


def advanced(drive, plant, bounds, now, told, step) -> Any:
    """Motor and shafts after some steps, and shafts and touches after each."""

    def one(state: Any, point: MotionPoint) -> Any:
        motor, shafts = state
        if drive is None:
            ended = plant.step(shafts, point, OPEN, bounds, step)
        else:
            motor, *ended = drive.step(motor, plant, shafts, point, OPEN, bounds, step)
        return (motor, ended[0]), tuple(ended)

    return jax.lax.scan(one, now, told)


_advanced = eqx.filter_jit(advanced, **fast_to_compile())

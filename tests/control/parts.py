"""Parts of a simulation from numbers in one order, and points of a motion, for many tests."""

from typing import Any

import jax
import numpy as np

from vttig_jax.control import Drag, Elastic, Rigid, Sine
from vttig_jax.control.motion.motion import Motion, MotionPoint
from vttig_jax.control.scenario.scenario import EVENTS


def motion_of(
    kind: Any,
    event: Any,
    speed_rpm: Any,
    reversal_deg: Any,
    dwell_s: Any = 2.0,
    ramp_s: Any = 0.5,
    slow_share: Any = 0.3,
    stop_s: Any = 0.05,
) -> Motion:
    """A commanded motion; `kind` and `event` as in a scenario file."""
    if kind == "sine":
        return Sine(speed_rpm, reversal_deg)
    own = {"slow_down": (slow_share,), "aborted": (slow_share,), "emergency_stop": (stop_s,)}
    numbers = (speed_rpm, reversal_deg, dwell_s, ramp_s, *own.get(event, ()))
    return EVENTS[event](*numbers, shape=kind).pieces


def trapezoid(*numbers: Any, event: Any = "reversal", **named: Any) -> Motion:
    return motion_of("trapezoid", event, *numbers, **named)


def s_curve(*numbers: Any, event: Any = "reversal", **named: Any) -> Motion:
    return motion_of("s_curve", event, *numbers, **named)


def rigid(drag: Drag, restitution: Any) -> Rigid:
    return Rigid(restitution, drag)


def elastic(drag: Drag, stiffness: Any, damping_ratio: Any) -> Elastic:
    """Elastic teeth; `stiffness` at the driven shaft, N m/rad."""
    return Elastic(damping_ratio=damping_ratio, drag=drag, stiffness=stiffness)


ROOM = 4096


def at(motion: Any, time: Any) -> MotionPoint:
    """Point of a motion at any times as NumPy arrays.

    JAX always sees the same shape, so that every operation is compiled once for all motions.
    """
    time = np.asarray(time, float)
    flat = time.ravel()
    blocks = [flat[start : start + ROOM] for start in range(0, flat.size, ROOM)]
    points = [motion.at(np.pad(block, (0, ROOM - block.size))) for block in blocks]

    def joined(*parts: Any) -> np.ndarray:
        return np.concatenate(parts)[: flat.size].reshape(time.shape)

    return jax.tree.map(joined, *points)

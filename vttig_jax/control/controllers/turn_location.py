"""What a controller knows of the turn within the hunting period when it starts."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.units import REV
from ...kinematics.flank_model import FlankModel
from ...kinematics.turn_location import locate
from ...pair.gear_pair import GearPair
from ..hardware.encoder import Sensor, shocks
from ..plants.flank_bounds import Bounds
from .controller import Controller, Measurement

CERTAINTY = 0.999
"""Probability from which on a controller takes a turn for found."""

_LEAST_STD = 1e-9
"""rad that even a perfect reading is good to."""


class LostController(Controller):
    """Does not know the turn within the hunting period, and refuses to start."""

    def start(self) -> tuple[()]:
        """No state."""
        return ()

    def step(self, state: Any, seen: Measurement) -> tuple[Any, Float[Array, ""]]:
        """Zero."""
        return state, jnp.zeros(())


def turns_off(
    pair: GearPair,
    believed: FlankModel,
    rig: Bounds,
    sensors: tuple[Sensor, Sensor],
    angle: float,
    seed: int,
) -> int | None:
    """By how many turns a controller errs that locates itself before the run; None: it cannot.

    Both encoders are read once, modulo one turn, while the driven shaft rests on flank A. What
    single readings are worth, √(count²/12 + E²/2 + noise²), the controller knows.

    **Arguments**
    - `believed`: the flanks that the controller knows; `rig`: those there are.
    - `sensors`: of the driving and the driven shaft. - `angle`: driving angle at the start, rad.
    - `seed`: of the noise.
    """
    ratio = float(pair.ratio)
    shock = shocks(jax.random.key(seed), jnp.zeros((), int))
    driven = ratio * angle + float(rig.at(jnp.asarray(angle)).lower)
    readings = [
        float(sensor.read(jnp.asarray(place), one))
        for sensor, place, one in zip(sensors, (angle, driven), shock, strict=True)
    ]
    variances = [_variance(sensor) for sensor in sensors]
    found = locate(
        readings[0] % REV,
        readings[1] % REV,
        pair.ratio,
        believed,
        std_rad=max(np.sqrt(variances[1] + ratio**2 * variances[0]), _LEAST_STD),
    )
    if found.probability < CERTAINTY or not found.fits:
        return None
    return found.turn - int(readings[0] // REV) % found.hunting_turns


def _variance(sensor: Sensor) -> float:
    """Of one reading about the angle, rad²."""
    return float(sensor.count**2 / 12 + sensor.amplitude**2 / 2 + sensor.noise**2)

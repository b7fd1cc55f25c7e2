"""Identification of the driving turn within the hunting period, from encoders that read one turn.

A controller needs the turn at its start, because the backlash map differs from turn to turn.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from ...base.units import REV
from ...kinematics.flank_model import FlankModel
from ...kinematics.turn_location import locate
from ...pair.gear_pair import Drive, GearPair
from ..hardware.encoder import Encoder, noise_draws
from .controller import NoController

CERTAINTY = 0.999
"""Lowest probability at which a controller accepts a located turn; a chosen value."""

_LEAST_STD = 1e-9
"""Lower limit of the assumed standard deviation, rad, for encoders without errors; a chosen value.
"""


class LostController(NoController):
    """Controller for a run in which the turn within the hunting period could not be located.

    It would close the gap, but commands a displacement of zero, so the gap remains open.
    """

    closes: ClassVar[bool] = True


def turn_error(
    pair: GearPair | Drive,
    believed: FlankModel,
    rig: FlankModel,
    sensors: tuple[Encoder, ...],
    angle: float,
    seed: int,
) -> int | None:
    """Locate the turn within the hunting period before the run, and return the error in turns.

    The error is the located turn minus the true turn of the driving shaft. The function returns
    None if the turn cannot be located with the probability `CERTAINTY`.

    Both encoders are read once, modulo one turn, while the driven shaft rests on flank A. The
    location uses the true standard deviation of a reading, √(count²/12 + E²/2 + noise²).

    **Arguments**
    - `believed`: flank model that the controller uses. - `rig`: that of the simulated gears.
    - `sensors`: encoders of the driving and the driven shaft.
    - `angle`: driving angle at the start, rad. - `seed`: seed of the encoder noise.
    """
    ratio = float(pair.ratio)
    draws = noise_draws(jax.random.key(seed), jnp.zeros((), int))
    driven = ratio * angle + float(rig.transmission_error(angle, "A"))
    readings = [
        float(sensor.read(jnp.asarray(true_angle), draw))
        for sensor, true_angle, draw in zip(sensors, (angle, driven), draws, strict=True)
    ]
    variances = [float(sensor.variance) for sensor in sensors]
    location = locate(
        readings[0] % REV,
        readings[1] % REV,
        pair.ratio,
        believed,
        std_rad=max(np.sqrt(variances[1] + ratio**2 * variances[0]), _LEAST_STD),
    )
    if location.probability < CERTAINTY or not location.fits:
        return None
    return location.turn - int(readings[0] // REV) % location.hunting_turns

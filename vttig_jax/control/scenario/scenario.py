"""Scenario of a simulation as objects: gears, motion, plant, controller and the parts around them.

A scenario file builds exactly these objects (`control/simulation/build.py`).
"""

from typing import Literal

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int

from ...base.arrays import Number, Numbers
from ...kinematics.flank_model import FlankModel
from ...pair.gear_pair import Drive, Eccentricities, GearPair
from ..controllers.acceleration import Acceleration
from ..controllers.controller import Controller
from ..fields import Part, Quantity, not_negative, number
from ..hardware.actuator import Actuator
from ..hardware.encoder import Encoder
from ..hardware.observer import AlphaBetaGamma, Observer
from ..hardware.servo import Servo
from ..motion.motion import Motion
from ..motion.profiles import Reversal
from ..plants.plant import Friction, Inertia, Load, Mesh, Plant
from ..plants.rigid import Rigid


class Sampling(Part):
    """Rates of the controller and of the plant."""

    controller_hz: Quantity = number(1000.0, "controller rate", "Hz", gt=0, le=1e7)
    plant_hz: Quantity = not_negative(
        0.0, "plant rate, a whole multiple of controller_hz; 0: equal to it", "Hz"
    )


class Scenario(eqx.Module):
    """One simulated case: a gear drive, its motion, and its controller.

    Every number of every part may be traced by JAX, also those of the gears, the eccentricities and
    the maps. The parts have the names, defaults and units of the tables of a scenario file, which
    `vttig simulate --print-defaults` prints.

    **Arguments**
    - `pair`: the gears, or a drive of which only the ratio is known.
    - `eccentricities`: those of the gears; they need no `plant_map`.
    - `motion`: `Reversal`, `SlowDown`, `AbortedStop`, `EmergencyStop`, `Sine`, `recorded(…)`, or a
      `Motion` of the user. - `plant`: `Play`, `Rigid`, `Elastic`, or a `Plant` of the user.
    - `controller`: `NoController`, `Acceleration`, `Predictive`, `Feedforward`, or a `Controller`
      of the user. - `observer`: what estimates speed and acceleration for it.
    - `servo`: motor of the driving shaft; None for a motion with unlimited torque.
    - `inertia`, `friction`, `load`, `mesh`, `driving_encoder`, `driven_encoder`, `actuator`,
      `sampling`: further parts.
    - `plant_map`: flanks of the gears, instead of those of the eccentricities.
    - `controller_map`: flanks that the controller believes: a flank model, or other eccentricities;
      by default those of `eccentricities`, else `plant_map`.
    - `map_backlash_deg`: mean backlash that the controller believes, instead of that of its map.
    - `flanks`: kinematics of the eccentricities, exact or of first order ("closed").
    - `turn`: how the controller knows its turn within the hunting period, see `[judgement]`.
    - `seed`: seed of the encoder noise.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.control import Predictive, Reversal, Scenario
    >>> from vttig_jax.rig import paper_eccentricities, paper_pair
    >>> vttig_jax.enable_x64()
    >>> motion = Reversal(speed_rpm=60, reversal_deg=720, dwell_s=0.2)
    >>> scenario = Scenario(
    ...     paper_pair(), paper_eccentricities(), motion, controller=Predictive(margin_mm=0.01)
    ... )
    >>> run = vttig_jax.simulate(scenario)
    >>> run.outcome, round(run.metrics["residual_gap_deg"], 5)
    ('ok', 0.00075)

    ```
    """

    pair: GearPair | Drive
    eccentricities: Eccentricities | None = None
    motion: Motion | Reversal = Reversal()
    plant: Plant = Rigid()
    controller: Controller = Acceleration()
    servo: Servo | None = None
    inertia: Inertia = Inertia()
    friction: Friction = Friction()
    load: Load = Load()
    mesh: Mesh = Mesh()
    driving_encoder: Encoder = Encoder()
    driven_encoder: Encoder = Encoder()
    actuator: Actuator = Actuator()
    observer: Observer = AlphaBetaGamma()
    sampling: Sampling = Sampling()
    plant_map: FlankModel | None = None
    controller_map: FlankModel | Eccentricities | None = None
    map_backlash_deg: Float[Number, ""] | None = None
    seed: Int[Numbers, ""] = eqx.field(
        converter=lambda seed: seed if isinstance(seed, jax.Array) else np.asarray(seed), default=0
    )
    flanks: Literal["exact", "closed"] = eqx.field(static=True, default="exact")
    turn: Literal["known", "located", "unknown"] = eqx.field(static=True, default="known")

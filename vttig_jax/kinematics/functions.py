"""Kinematics as pure functions of arrays; all angles are in rad and all lengths in mm.

They can be jitted, batched and differentiated with respect to every number, including the numbers
in `GearPair` and `Eccentricities`. Angles over many turns need 64-bit floats.
"""

from typing import Literal

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Real

from ..base.arrays import compiled
from ..pair.gear_pair import Eccentricities, Flank, GearPair
from .exact import exact_model
from .first_order import PressureAngle, closed_model
from .flank_model import Angles, AnglesLike, FlankModel

Reference = Literal["absolute", "start"]


@compiled
def transmission_error(
    driving_angle: AnglesLike,
    pair: GearPair,
    eccentricities: Eccentricities,
    flank: Flank = "A",
    *,
    reference: Reference = "absolute",
    pressure_angle: PressureAngle = "working",
) -> Angles:
    """Return the first-order transmission error (19), (20).

        TE_A = K [e₁ sin(ψ₁ + α) + e₂ sin(χ₂ − α)] + s tan β_L / R₂
        TE_B = K [e₁ sin(ψ₁ − α) + e₂ sin(χ₂ + α)] − s tan β_R / R₂ + j_c

    **Arguments**
    - `driving_angle`: φ₁ in rad, any shape.
    - `pair`, `eccentricities`: gears and eccentricities of the rig, the latter with s and j_c.
    - `flank`: "A" for increasing φ₁, "B" for decreasing φ₁.
    - `reference`: "absolute", or "start" for the form of the paper, which is zero at φ₁ = 0.
    - `pressure_angle`: "working" for α_w at the nominal centre distance, "reference" for αₜ.

    **Returns** TE in rad of the driven gear, shape of `driving_angle`.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Eccentricities, Gear, GearPair
    >>> vttig_jax.enable_x64()
    >>> pair = GearPair(Gear(45), Gear(80), module_mm=2.0, pressure_angles_deg=20.0)
    >>> rig = Eccentricities(0.0226, 49.5, 0.0273, 79.3, 0.038)
    >>> te = vttig_jax.transmission_error(np.radians([0.0, 90.0]), pair, rig, reference="start")
    >>> np.degrees(te).round(5)
    array([ 0.     , -0.00843])

    ```
    """
    model = closed_model(pair, eccentricities, pressure_angle=pressure_angle)
    return _referenced(model, driving_angle, flank, reference)


@compiled
def exact_transmission_error(
    driving_angle: AnglesLike,
    pair: GearPair,
    eccentricities: Eccentricities,
    flank: Flank = "A",
    *,
    reference: Reference = "absolute",
) -> Angles:
    """Return the exact transmission error of two eccentric involutes; see `ExactModel`.

    Arguments and result are those of `transmission_error`. The relation is implicit in the driven
    angle; it is solved by a fixed point and differentiated by the implicit function theorem.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Eccentricities, Gear, GearPair
    >>> vttig_jax.enable_x64()
    >>> pair = GearPair(Gear(45), Gear(80), module_mm=2.0, pressure_angles_deg=20.0)
    >>> rig = Eccentricities(0.0226, 49.5, 0.0273, 79.3, 0.038)
    >>> te = vttig_jax.exact_transmission_error(np.radians([0.0, 90.0]), pair, rig)
    >>> np.degrees(te).round(5)
    array([0.03403, 0.02559])

    ```
    """
    return _referenced(exact_model(pair, eccentricities), driving_angle, flank, reference)


@compiled
def backlash(
    driving_angle: AnglesLike,
    pair: GearPair,
    eccentricities: Eccentricities,
    *,
    pressure_angle: PressureAngle = "working",
) -> Angles:
    """Return the first-order backlash (21), (22), j = TE_B − TE_A, rad of the driven gear.

        j = j_c + 2 K sin α [e₂ cos χ₂ − e₁ cos ψ₁] − s (tan β_L + tan β_R)/R₂

    The arguments are those of `transmission_error`.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Eccentricities, Gear, GearPair
    >>> vttig_jax.enable_x64()
    >>> pair = GearPair(Gear(45), Gear(80), module_mm=2.0, pressure_angles_deg=20.0)
    >>> rig = Eccentricities(0.0226, 49.5, 0.0273, 79.3, 0.038)
    >>> np.degrees(vttig_jax.backlash(np.radians(7560.0), pair, rig)).round(5).item()
    0.04428

    ```
    """
    model = closed_model(pair, eccentricities, pressure_angle=pressure_angle)
    return model.backlash(driving_angle)


@compiled
def exact_backlash(
    driving_angle: AnglesLike, pair: GearPair, eccentricities: Eccentricities
) -> Angles:
    """Return the exact backlash of two eccentric involutes, rad of the driven gear.

    The arguments are those of `transmission_error`.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax import Eccentricities, Gear, GearPair
    >>> vttig_jax.enable_x64()
    >>> pair = GearPair(Gear(45), Gear(80), module_mm=2.0, pressure_angles_deg=20.0)
    >>> rig = Eccentricities(0.0226, 49.5, 0.0273, 79.3, 0.038)
    >>> np.degrees(vttig_jax.exact_backlash(np.radians(7560.0), pair, rig)).round(5).item()
    0.0443

    ```
    """
    return exact_model(pair, eccentricities).backlash(driving_angle)


@compiled
def axial_displacement(
    backlash_mm: Real[ArrayLike, "*shape"], pair: GearPair
) -> Float[Array, "*shape"]:
    """Return the axial displacement that closes a backlash (16), s = j / (tan β_L + tan β_R), mm.

    `backlash_mm` is measured along the reference circle. The result is infinite without taper.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax import Gear, GearPair
    >>> vttig_jax.enable_x64()
    >>> pair = GearPair(Gear(45, 3, 3), Gear(80, 3, 3), module_mm=2.0, pressure_angles_deg=20.0)
    >>> print(f"{vttig_jax.axial_displacement(0.05, pair):.4f}")
    0.4770

    ```
    """
    return jnp.asarray(backlash_mm, float) / pair.thinning


def _referenced(
    model: FlankModel, driving_angle: AnglesLike, flank: Flank, reference: Reference
) -> Angles:
    if reference not in ("absolute", "start"):
        raise ValueError(
            f'Argument `reference` must be "absolute" or "start", but is {reference!r}.'
        )
    error = model.transmission_error(driving_angle, flank)
    return error if reference == "absolute" else error - model.transmission_error(0.0, flank)

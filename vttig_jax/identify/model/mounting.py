"""Mounting of the driven encoder: flank models in the angles that both encoders read.

The driven gear is at φ₂ = i φ₁ + m + TE. The mounting m is the reading of the driven encoder where
the driving encoder reads zero, minus the TE there. It may be several radians if the encoders are
absolute. If both encoders count from the first sample, it is as small as the TE at the start. The
phase θ₂ of the driven eccentricity e₂ counts from φ₂ = 0 in both cases: the angle of e₂ is
φ₂ + θ₂ = i φ₁ + m + θ₂, apart from the TE.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...kinematics.exact import ExactModel, exact_model
from ...kinematics.first_order import ClosedModel, closed_model
from ...pair.eccentricities import Eccentricities
from ...pair.gear_pair import GearPair
from .column_layout import OFFSET


def offset_name(log: int, logs: int) -> str:
    """Return the parameter name of the offset of log number `log` (from 0) of `logs` logs."""
    return f"{OFFSET}_of_{log + 1}" if logs > 1 else OFFSET


def mounting_of(
    names: Sequence[str],
    values: Float[np.ndarray, " p"],
    flanks: Sequence[str],
    constant_backlash: float,
    log: int = 0,
) -> float:
    """Return the mounting m of a log from the parameters of a fit, rad.

    It is the offset of flank A. If flank B alone was measured, it is the offset of flank B minus
    the `constant_backlash` (rad).
    """
    logs = sum(name.split("_of_")[0] == OFFSET for name in names)
    offset = float(values[list(names).index(offset_name(log, logs))])
    return offset - constant_backlash if tuple(flanks) == ("B",) else offset


def mounted_exact(pair: GearPair, rig: Eccentricities, mounting: float) -> ExactModel:
    """Return the exact model with φ₂ as the driven encoder reads it."""
    model = exact_model(pair, rig)
    return eqx.tree_at(lambda m: m.offset, model, jnp.asarray(model.offset) + mounting)


def mounted_closed(pair: GearPair, rig: Eccentricities, mounting: float) -> ClosedModel:
    """Return the closed form, (19) and (20), with the driven phasor rotated by the mounting."""
    model = closed_model(pair, rig)
    turned = model.driven_phasor * jnp.exp(1j * mounting)
    moved = jnp.asarray(model.offset) + mounting
    return eqx.tree_at(lambda m: (m.driven_phasor, m.offset), model, (turned, moved))

"""Where the driven encoder reads zero: flank models at the angles both encoders show.

The driven gear stands at φ₂ = i φ₁ + m + TE, with the mounting m: what the driven encoder reads
where the driving one reads zero, less the TE there. It is radians where the zero is that of the
reading, and the small TE of the start where both count from the first sample. The phase of the
driven eccentricity counts from φ₂ = 0 in either case, so that e₂ stands at φ₂ + θ₂ = i φ₁ + m + θ₂.
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
    """Name of the parameter that is the offset of a log, counted from 0, among `logs`."""
    return f"{OFFSET}_of_{log + 1}" if logs > 1 else OFFSET


def mounting_of(
    names: Sequence[str],
    values: Float[np.ndarray, " p"],
    flanks: Sequence[str],
    constant_backlash: float,
    log: int = 0,
) -> float:
    """Mounting m of a log of a fit with these parameters, rad.

    The offset is that of flank A; that of flank B alone has the `constant_backlash` (rad) in it.
    """
    logs = sum(name.split("_of_")[0] == OFFSET for name in names)
    offset = float(values[list(names).index(offset_name(log, logs))])
    return offset - constant_backlash if tuple(flanks) == ("B",) else offset


def mounted_exact(pair: GearPair, rig: Eccentricities, mounting: float) -> ExactModel:
    """The exact model with φ₂ as the driven encoder reads it."""
    model = exact_model(pair, rig)
    return eqx.tree_at(lambda m: m.offset, model, jnp.asarray(model.offset) + mounting)


def mounted_closed(pair: GearPair, rig: Eccentricities, mounting: float) -> ClosedModel:
    """The closed form, (19) and (20), with the driven phasor turned by the mounting."""
    model = closed_model(pair, rig)
    turned = model.driven_phasor * jnp.exp(1j * mounting)
    moved = jnp.asarray(model.offset) + mounting
    return eqx.tree_at(lambda m: (m.driven_phasor, m.offset), model, (turned, moved))

"""The paper's mechanical return method on a synthetic rig: gear 1 held, gear 2 rocked."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Real
from numpy.typing import ArrayLike

from ..base.runtime import require_x64
from ..base.units import DEG, REV
from ..kinematics.backlash_map import chunked
from ..kinematics.flank_model import FlankModel
from ..logs.readers.backlash_readings import BacklashReadings
from ..pair.gear_pair import Flank
from .imperfections import EncoderError, quantised
from .synthetic import SyntheticRig

_SETTLE = 12
"""Steps of a fixed point that contracts by the encoder error: 1e-4 a step at 20″."""


def fixed_gear_readings(
    rig: SyntheticRig, driving_deg: ArrayLike, *, std_deg: float = 0.0, seed: int = 0
) -> BacklashReadings:
    """Hold gear 1 at each angle, rock gear 2 to both flanks, and read its encoder there.

        j = reading(φ₂ on flank B) − reading(φ₂ on flank A),  φ₂ = i φ₁ + TE(φ₁)

    with the true contact of the rig. Gear 1 is turned until its encoder shows `driving_deg`, zero
    as in `rig.log()`; the encoder of gear 2 adds its own error and counts.

    **Arguments**
    - `rig`: the rig; its motion, delay and noise of the transmission error play no part here.
    - `driving_deg`: angles shown by the driving encoder, shape (n,).
    - `std_deg`: standard deviation of one backlash reading before counting.
    - `seed`: of that noise.

    **Raises** `ValueError` where the gap is closed at an angle or the noise turns a reading
    negative, for arguments out of range, and without 64-bit floats.

    **Example**
    ```python
    >>> import numpy as np, vttig_jax
    >>> from vttig_jax.rig import fixed_gear_readings
    >>> from vttig_jax.rig import paper_rig
    >>> vttig_jax.enable_x64()
    >>> readings = fixed_gear_readings(paper_rig(), [1080.0, 3600.0, 7560.0])
    >>> np.degrees(readings.backlash).round(3)
    array([0.048, 0.044, 0.048])

    ```
    """
    require_x64("fixed_gear_readings")
    shown = np.asarray(driving_deg, np.float64)
    if shown.ndim != 1 or not shown.size or not np.isfinite(shown).all():
        raise ValueError(
            f"Argument `driving_deg` must be finite angles of shape (n,), but is {driving_deg!r}."
        )
    if not 0 <= std_deg < np.inf:
        raise ValueError(f"Argument `std_deg` must not be negative, but is {std_deg!r}.")
    held = _held_at(shown * DEG, rig.driving_encoder)
    on_a, on_b = _positions(rig, held)
    closed = np.flatnonzero(on_b < on_a)
    if closed.size:
        raise ValueError(
            "Argument `constant_backlash_deg` must keep the gap open, but the backlash is"
            f" {(on_b - on_a)[closed[0]] / DEG:.5f}° at {shown[closed[0]]:.1f}°."
        )
    # Each position carries half the variance of the difference.
    noise = np.random.default_rng(seed).standard_normal((2, len(shown)))
    noise *= std_deg * DEG / np.sqrt(2)
    gap = _difference(rig, on_a + noise[0], on_b + noise[1])
    if np.any(gap < 0):
        worst = int(np.argmin(gap))
        raise ValueError(
            f"Argument `std_deg` must leave the readings positive, but {std_deg:g}° of noise makes"
            f" {gap[worst] / DEG:.5f}° at {shown[worst]:.1f}°."
        )
    source = f"synthetic rig, gear 1 held, seed {seed}"
    return BacklashReadings.from_arrays(shown, gap / DEG, source=source)


def _held_at(shown: Float[np.ndarray, " n"], encoder: EncoderError) -> Float[np.ndarray, " n"]:
    """True angle at which an encoder that shows zero at zero shows `shown`, both in rad."""
    zero = encoder.reading(np.zeros(1))
    angle = shown
    for _ in range(_SETTLE):
        angle = shown - (encoder.reading(angle) - zero - angle)
    return angle


def _positions(
    rig: SyntheticRig, held: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Driven angle on flank A and on flank B while gear 1 is held, rad."""
    model, ratio = rig.flank_model(), float(rig.pair.ratio)
    on_a = chunked(lambda piece: _error(model, piece, "A"), held)
    on_b = chunked(lambda piece: _error(model, piece, "B"), held)
    return ratio * held + on_a, ratio * held + on_b


def _difference(
    rig: SyntheticRig, on_a: Float[np.ndarray, " n"], on_b: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """How far the driven encoder moves from flank A to flank B, rad; whole counts if it counts."""
    low, high = (rig.driven_encoder.reading(position) for position in (on_a, on_b))
    per_rev = rig.pair.driven.encoder.counts_per_rev
    if per_rev is None:
        return high - low
    return (quantised(high, per_rev) - quantised(low, per_rev)) * (REV / per_rev)


@eqx.filter_jit
def _error(
    model: FlankModel, driving_angle: Real[np.ndarray | Array, " n"], flank: Flank
) -> Float[Array, " n"]:
    return model.transmission_error(driving_angle, flank)

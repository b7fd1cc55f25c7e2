"""Backlash readings of a synthetic rig by the paper's mechanical return method."""

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from ..base.runtime import require_x64
from ..base.units import DEG, REV
from ..logs.readers.backlash_readings import BacklashReadings
from .imperfections import EncoderError, quantised
from .synthetic import SyntheticRig

_ITERATIONS = 12
"""Number of fixed-point steps (chosen); an encoder error of 20″ gives a contraction of 1e-4."""


def fixed_gear_readings(
    rig: SyntheticRig, driving_deg: ArrayLike, *, std_deg: float = 0.0, seed: int = 0
) -> BacklashReadings:
    """Simulate backlash readings: gear 1 is held, gear 2 is rocked to both flanks and read there.

        j = reading(φ₂ on flank B) − reading(φ₂ on flank A),  φ₂ = i φ₁ + TE(φ₁)

    TE is the true transmission error of the rig. Gear 1 is turned until its encoder reads
    `driving_deg`, which has the same zero as `rig.log()`. Readings of gear 2 contain the error of
    its encoder and are rounded down to its counts.

    **Arguments**
    - `rig`: the rig; its motion, delay and noise of the transmission error are not used.
    - `driving_deg`: readings of the driving encoder, deg, shape (n,).
    - `std_deg`: standard deviation of one backlash reading before quantisation, deg.
    - `seed`: seed of the noise with `std_deg`.

    **Raises** `ValueError` if the gap is closed at an angle or the noise makes a reading negative,
    for arguments out of range, and without 64-bit floats.

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
    readings = np.asarray(driving_deg, np.float64)
    if readings.ndim != 1 or not readings.size or not np.isfinite(readings).all():
        raise ValueError(
            f"Argument `driving_deg` must be finite angles of shape (n,), but is {driving_deg!r}."
        )
    if not 0 <= std_deg < np.inf:
        raise ValueError(f"Argument `std_deg` must not be negative, but is {std_deg!r}.")
    on_a, on_b = rig.flank_angles(_true_angle(readings * DEG, rig.driving_encoder))
    # The noise of each position has half the variance of the difference.
    noise = np.random.default_rng(seed).standard_normal((2, len(readings)))
    noise *= std_deg * DEG / np.sqrt(2)
    low, high = map(rig.driven_encoder.reading, (on_a + noise[0], on_b + noise[1]))
    gap, per_rev = high - low, rig.pair.driven.encoder.counts_per_rev
    if per_rev is not None:
        gap = (quantised(high, per_rev) - quantised(low, per_rev)) * (REV / per_rev)
    if np.any(gap < 0):
        worst = int(np.argmin(gap))
        raise ValueError(
            f"Argument `std_deg` must leave the readings positive, but {std_deg:g}° of noise makes"
            f" {gap[worst] / DEG:.5f}° at {readings[worst]:.1f}°."
        )
    source = f"synthetic rig, gear 1 held, seed {seed}"
    return BacklashReadings.from_arrays(readings, gap / DEG, source=source)


def _true_angle(reading: Float[np.ndarray, " n"], encoder: EncoderError) -> Float[np.ndarray, " n"]:
    """Return the true angle, rad, at which an encoder has this reading, rad.

    The zero of the encoder is set so that it reads zero at the true angle zero.
    """
    zero = encoder.reading(np.zeros(1))
    angle = reading
    for _ in range(_ITERATIONS):
        angle = reading - (encoder.reading(angle) - zero - angle)
    return angle

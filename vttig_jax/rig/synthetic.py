"""Synthetic rig: exact kinematics, play at every reversal and imperfect encoders.

Its readings are an encoder log, or the gap by the paper's mechanical return method.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from ..base.runtime import require_x64
from ..base.units import DEG, REV
from ..kinematics.exact import exact_model
from ..kinematics.flank_error import errors_at
from ..kinematics.flank_model import FlankModel
from ..kinematics.harmonic import CombinedModel, OrderModel
from ..logs.encoder_log import EncoderLog
from ..logs.readers.backlash_readings import BacklashReadings
from ..pair.gear_pair import Eccentricities, GearPair
from ..pair.schema import FLANKS
from .imperfections import EncoderError, Noise, OrderError, quantised
from .motion import PassMotion


@jax.jit
def play(
    lower: Float[Array, " n"], upper: Float[Array, " n"], start: Float[Array, ""]
) -> Float[Array, " n"]:
    """Apply the play operator x_t = min(max(x_{t−1}, lower_t), upper_t) from x_{−1} = `start`.

    **Arguments**
    - `lower`, `upper`: driven angle on flank A and B, lower ≤ upper, shape (n,).
    - `start`: position before the first sample.
    """

    def follow(position, bounds):
        position = jnp.clip(position, *bounds)
        return position, position

    return jax.lax.scan(follow, start, (lower, upper))[1]


@dataclass(frozen=True)
class SyntheticRig:
    """Gear pair with known errors in a known motion.

    **Arguments**
    - `pair`, `eccentricities`: true values. Both angles are zero at the start, on flank A.
    - `motion`: motion of the driving shaft.
    - `orders`: further harmonics of the transmission error.
    - `driving_encoder`, `driven_encoder`: once-per-turn errors of the encoders. The counts per
      revolution are those of `pair`; if one is missing, both readings are in degrees.
    - `noise`: noise of the transmission error.
    - `delay_s`: delay, s; the driven reading with time stamp t is the angle at t − `delay_s`.
    - `rate_hz`: sampling rate, Hz.
    """

    pair: GearPair
    eccentricities: Eccentricities
    motion: PassMotion = PassMotion()
    orders: tuple[OrderError, ...] = ()
    driving_encoder: EncoderError = EncoderError()
    driven_encoder: EncoderError = EncoderError()
    noise: Noise = Noise()
    delay_s: float = 0.0
    rate_hz: float = 1987.0

    def flank_model(self) -> FlankModel:
        """Return the true flank model: the exact model of the eccentricities plus `orders`.

        One constant is subtracted from both flanks, so that TE_A = 0 at φ₁ = φ₂ = 0.
        """
        exact = exact_model(self.pair, self.eccentricities)
        harmonics = order_model(self.pair, self.orders)
        zero = jnp.asarray(0.0)
        start = exact.at_both_angles(zero, zero, "A") + harmonics.at_both_angles(zero, zero, "A")
        harmonics = eqx.tree_at(lambda m: m.offset, harmonics, harmonics.offset - start)
        return CombinedModel(exact.ratio, exact, harmonics)

    def log(self, seed: int = 0) -> EncoderLog:
        """Run the rig and return the encoder log; equal seeds give equal logs.

        **Raises** `ValueError` if the backlash is negative anywhere in the run; rigid gears cannot
        turn there.
        """
        require_x64("SyntheticRig.log")
        time = np.arange(int(self.motion.duration_s * self.rate_hz) + 1) / self.rate_hz
        generator = np.random.default_rng(seed)
        driving = self.driving_encoder.reading(self.motion.driving_angle(time))
        lower, upper = self.flank_angles(self.motion.driving_angle(time - self.delay_s))
        driven = play(jnp.asarray(lower), jnp.asarray(upper), jnp.asarray(lower[0]))
        driven = self.driven_encoder.reading(np.asarray(driven))
        driven = driven + self.noise.draw(len(time), self.rate_hz, generator)
        counts = [g.encoder.counts_per_rev for g in (self.pair.driving, self.pair.driven)]
        unit = "deg" if None in counts else "counts"
        driving, driven = (
            quantised(angle, per_rev) if per_rev and unit == "counts" else angle / DEG
            for angle, per_rev in zip((driving, driven), counts, strict=True)
        )
        source = f"synthetic rig, seed {seed}"
        return EncoderLog.from_arrays(
            time, driving, driven, pair=self.pair, unit=unit, source=source
        )

    def flank_angles(
        self, driving_angle: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return the driven angles on flank A and on flank B, rad.

        **Raises** `ValueError` if the gap is closed at an angle.
        """
        model, nominal = self.flank_model(), float(self.pair.ratio) * driving_angle
        lower, upper = (nominal + errors_at(model, flank, driving_angle) for flank in FLANKS)
        if np.any(upper < lower):
            worst = int(np.argmin(upper - lower))
            raise ValueError(
                "Argument `constant_backlash_deg` must keep the gap open, but the backlash is"
                f" {(upper - lower)[worst] / DEG:.5f}° at {driving_angle[worst] / DEG:.1f}°."
            )
        return lower, upper


def order_model(pair: GearPair, errors: tuple[OrderError, ...]) -> OrderModel:
    """Return the `OrderModel` of harmonics a sin(kφ + p) = a sin p cos kφ + a cos p sin kφ."""
    first = {"driving": (1, 0), "driven": (0, 1), "mesh": (pair.driving.teeth, 0)}
    orders = [(e.order * first[e.shaft][0], e.order * first[e.shaft][1]) for e in errors]
    terms = tuple(dict.fromkeys(orders))
    waves = np.zeros((2, len(terms)), complex)
    for error, order in zip(errors, orders, strict=True):
        phase = np.exp(1j * error.phase_deg * DEG)
        waves["AB".index(error.flank), terms.index(order)] += error.amplitude_deg * DEG * phase
    return OrderModel(
        ratio=np.asarray(float(pair.ratio)),
        terms=terms,
        offset=jnp.zeros(2),
        cosine=jnp.asarray(np.imag(waves)),
        sine=jnp.asarray(np.real(waves)),
    )


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

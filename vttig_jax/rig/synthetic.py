"""Synthetic rig: exact kinematics, play at every reversal and imperfect encoders."""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.runtime import require_x64
from ..base.units import DEG
from ..kinematics.exact import exact_model
from ..kinematics.flank_error import errors_at
from ..kinematics.flank_model import FlankModel
from ..kinematics.harmonic import CombinedModel, OrderModel
from ..logs.encoder_log import EncoderLog
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

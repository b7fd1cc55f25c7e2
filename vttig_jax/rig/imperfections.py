"""Imperfections of a rig with eccentric gears: further orders, encoder errors and noise."""

from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from ..base.units import ARCSEC, DEG, REV
from ..pair.schema import FLANKS, Flank

Shaft = Literal["driving", "driven", "mesh"]

_SHAFTS: tuple[Shaft, ...] = ("driving", "driven")


@dataclass(frozen=True)
class OrderError:
    """Harmonic a·sin(k φ_shaft + p) in the transmission error of one flank.

    a is `amplitude_deg`, k is `order` in cycles per turn of `shaft`, and p is `phase_deg`. For
    `shaft` "mesh" the order is in cycles per tooth of the driving gear.
    """

    shaft: Shaft
    order: int
    flank: Flank
    amplitude_deg: float
    phase_deg: float


@dataclass(frozen=True)
class EncoderError:
    """Reading φ + E sin(φ + ε) of an eccentric encoder; E is an angle of the encoder's shaft."""

    amplitude_arcsec: float = 0.0
    phase_deg: float = 0.0

    def reading(self, angle: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the reading φ + E sin(φ + ε) at the true angle φ = `angle`, both in rad.

        Only the eccentricity is included; noise and quantisation are not.
        """
        return angle + self.amplitude_arcsec * ARCSEC * np.sin(angle + self.phase_deg * DEG)


@dataclass(frozen=True)
class Noise:
    """Gaussian noise of the transmission error with autocorrelation exp(−|t|/`correlation_s`).

    For `correlation_s` = 0 the noise is white.
    """

    std_deg: float = 0.0
    correlation_s: float = 0.0

    def draw(
        self, count: int, rate_hz: float, generator: np.random.Generator
    ) -> Float[np.ndarray, " n"]:
        """Draw `count` stationary noise samples at the sampling rate, rad."""
        noise = generator.standard_normal(count)
        if self.correlation_s > 0:
            rho = np.exp(-1.0 / (rate_hz * self.correlation_s))
            noise[1:] *= np.sqrt(1 - rho**2)
            noise = np.asarray(lfilter([1.0], [1.0, -rho], noise))
        return self.std_deg * DEG * noise


def quantised(
    angle: Float[np.ndarray, " n"], counts_per_rev: int
) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return the counts of an incremental encoder, rounded down, at an angle in rad."""
    return np.floor(angle * (counts_per_rev / REV)).astype(np.int64)


def random_orders(
    generator: np.random.Generator,
    *,
    pitch_rms_deg: float,
    mesh_amplitude_deg: float,
    highest: int = 8,
) -> tuple[OrderError, ...]:
    """Draw random harmonics of both flanks: orders 2 … `highest` of each shaft and tooth mesh.

    Amplitudes and phases are drawn separately for each flank. On each flank the orders of both
    shafts together have the rms value `pitch_rms_deg`, and the mesh order has the amplitude
    `mesh_amplitude_deg`.
    """
    errors: list[OrderError] = []
    for flank in FLANKS:
        size = 2 * (highest - 1)
        amplitudes = generator.rayleigh(size=size)
        amplitudes *= pitch_rms_deg * np.sqrt(2 / np.sum(amplitudes**2))
        sizes = [*amplitudes.tolist(), mesh_amplitude_deg]
        phases = generator.uniform(0, 360, size + 1).tolist()
        orders: list[tuple[Shaft, int]] = [*product(_SHAFTS, range(2, highest + 1)), ("mesh", 1)]
        for (shaft, order), amplitude, phase in zip(orders, sizes, phases, strict=True):
            errors.append(OrderError(shaft, order, flank, amplitude, phase))
    return tuple(errors)

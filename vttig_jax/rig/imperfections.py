"""What a rig adds to two perfect eccentric gears: other orders, encoder errors, noise."""

from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from ..base.units import ARCSEC, DEG, REV
from ..pair.gear_pair import Flank

Shaft = Literal["driving", "driven", "mesh"]

_SHAFTS: tuple[Shaft, ...] = ("driving", "driven")
_FLANKS: tuple[Flank, ...] = ("A", "B")


@dataclass(frozen=True)
class OrderError:
    """One harmonic a·sin(k φ_shaft + p) in the transmission error of one flank.

    `shaft` "mesh" counts cycles per tooth instead of per revolution of the driving gear.
    """

    shaft: Shaft
    order: int
    flank: Flank
    amplitude_deg: float
    phase_deg: float


@dataclass(frozen=True)
class EncoderError:
    """Reading φ + E sin(φ + ε): an encoder mounted off centre. E is an angle of its own shaft."""

    amplitude_arcsec: float = 0.0
    phase_deg: float = 0.0

    def reading(self, angle: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """What the encoder shows at the true `angle`, both in rad."""
        return angle + self.amplitude_arcsec * ARCSEC * np.sin(angle + self.phase_deg * DEG)


@dataclass(frozen=True)
class Noise:
    """Gaussian noise of the transmission error with correlation exp(−|t|/`correlation_s`)."""

    std_deg: float = 0.0
    correlation_s: float = 0.0

    def draw(
        self, count: int, rate_hz: float, generator: np.random.Generator
    ) -> Float[np.ndarray, " n"]:
        """A stationary path at the sampling rate, rad."""
        shocks = generator.standard_normal(count)
        if self.correlation_s > 0:
            rho = np.exp(-1.0 / (rate_hz * self.correlation_s))
            shocks[1:] *= np.sqrt(1 - rho**2)
            shocks = np.asarray(lfilter([1.0], [1.0, -rho], shocks))
        return self.std_deg * DEG * shocks


def quantised(
    angle: Float[np.ndarray, " n"], counts_per_rev: int
) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Counts of an incremental encoder: whole counts passed at `angle` rad."""
    return np.floor(angle * (counts_per_rev / REV)).astype(np.int64)


def random_orders(
    generator: np.random.Generator,
    *,
    pitch_rms_deg: float,
    mesh_amplitude_deg: float,
    highest: int = 8,
) -> tuple[OrderError, ...]:
    """Orders 2 … `highest` of both shafts and the tooth-mesh order, different on the two flanks.

    Amplitudes and phases are random; on each flank the orders of both shafts together have the rms
    `pitch_rms_deg`, and the mesh order has the amplitude `mesh_amplitude_deg`.
    """
    errors: list[OrderError] = []
    for flank in _FLANKS:
        size = 2 * (highest - 1)
        amplitudes = generator.rayleigh(size=size)
        amplitudes *= pitch_rms_deg * np.sqrt(2 / np.sum(amplitudes**2))
        phases = generator.uniform(0, 360, size + 1)
        places = product(_SHAFTS, range(2, highest + 1))
        errors += [
            OrderError(shaft, order, flank, float(amplitude), float(phase))
            for (shaft, order), amplitude, phase in zip(places, amplitudes, phases, strict=False)
        ]
        errors.append(OrderError("mesh", 1, flank, mesh_amplitude_deg, float(phases[-1])))
    return tuple(errors)

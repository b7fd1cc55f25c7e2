"""Logs of rigs with known truth, by the exact relation or by plain harmonics."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from vttig_jax.base import ARCSEC, DEG, REV
from vttig_jax.kinematics import exact_model
from vttig_jax.logs import EncoderLog
from vttig_jax.logs.motion.flank_assignment import assigned_segments
from vttig_jax.model import shafts_of
from vttig_jax.model.mixed_fit import mixed_fit
from vttig_jax.pair import Drive, Eccentricities, Gear, GearPair, HarmonicOrders

PAIRS = ((45, 80), (60, 35), (19, 61))
RATE_HZ = 250.0
FINE = 20
"""Points of the motion in a sampling interval, so that a delayed angle is exact."""


def gear_pair(driving: int, driven: int) -> GearPair:
    return GearPair(
        Gear(driving, 3.0, 3.0, 20.0),
        Gear(driven, 3.0, 3.0, 20.0),
        module_mm=2.0,
        pressure_angles_deg=20.0,
        centre_distance_mm=float(driving + driven) + 0.12,
        name="pair",
    )


def there_and_back(turns: float, *, back: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Times (s) and driving angles (rad) in fine steps; half of the way at 0.6 of the speed."""
    knots = [0, 0.4, 0.7, 8.3, 8.6, 9.0] + ([9.2, 9.5, 17.1, 17.4, 18.0] if back else [])
    speeds = [0, 0, 1, 1, 0, 0] + ([0, -1, -1, 0, 0] if back else [])
    time = np.arange(0, knots[-1], 1 / RATE_HZ / FINE)
    speed = np.interp(time, knots, speeds) * np.where((time % 9) > 4.5, 0.6, 1.0)
    angle = np.cumsum(np.convolve(speed, np.ones(50 * FINE) / (50 * FINE), "same"))
    return time, angle * turns * REV / np.ptp(angle)


def backwards(time: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Samples on flank B: from the rest before the way back."""
    back = np.flatnonzero(np.gradient(angle) < -1e-9)
    return time >= (time[back[0]] - 0.1 if len(back) else np.inf)


def gears_of(truth: dict) -> Eccentricities:
    return Eccentricities(**{k: v for k, v in truth.items() if "encoder" not in k})


def exact_log(
    pair: GearPair, truth: dict, *, turns: float = 12.0, back: bool = True, noise: float = 2e-6
) -> EncoderLog:
    """Log of eccentric gears and encoders, encoder errors in arcsec; a delay of 0.3 ms."""
    time, angle = there_and_back(turns, back=back)
    model, delay = exact_model(pair, gears_of(truth)), 3e-4 if back else 0.0
    seen, side = np.interp(time - delay, time, angle)[::FINE], backwards(time, angle)[::FINE]
    time, angle = time[::FINE], angle[::FINE]
    error = [np.asarray(model.transmission_error(seen, flank)) for flank in ("A", "B")]
    error = np.where(side, error[1], error[0])
    shown, driven = angle, float(pair.ratio) * seen + error
    waves = [
        truth.get(f"{shaft}_encoder", 0.0)
        * np.sin(reading + np.radians(truth.get(f"{shaft}_encoder_deg", 0.0)))
        for shaft, reading in (("driving", shown), ("driven", driven))
    ]
    noise_rad = noise * np.random.default_rng(0).normal(size=len(time))
    columns = time, shown + waves[0] * ARCSEC, driven + waves[1] * ARCSEC + noise_rad
    return logged(columns, pair)


def drive(ratio: str, orders: HarmonicOrders = HarmonicOrders((1, 2, 3), (1, 2), 0)) -> Drive:
    return Drive(Fraction(ratio), fit=orders, name="drive")


DRIVE = drive("9/16")
WAVES = {("driving", 1): (0.02, 0.7), ("driven", 1): (0.03, 2.0), ("driving", 3): (0.008, -1.0)}
"""(shaft, order) → amplitude (°) and phase (rad)."""

Columns = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Time (s) and both angles (rad)."""


def harmonic_columns(
    waves: dict = WAVES,
    *,
    gap_deg: float = 0.1,
    delay_s: float = 4e-4,
    turns: float = 12.0,
    seed: int = 0,
) -> Columns:
    """Columns of a log of `DRIVE` with a noise of 0.001°."""
    time, angle = there_and_back(turns)
    seen, ratio = np.interp(time - delay_s, time, angle)[::FINE], float(DRIVE.ratio)
    error = gap_deg * DEG * backwards(time, angle)[::FINE]
    time, angle = time[::FINE], angle[::FINE]
    for (shaft, order), (amplitude, phase) in waves.items():
        turned = seen * (ratio if shaft == "driven" else 1.0)
        error = error + amplitude * DEG * np.sin(order * turned + phase)
    error = error + 1e-3 * DEG * np.random.default_rng(seed).normal(size=len(time))
    return time, angle, ratio * seen + error


def logged(columns: Columns, pair: GearPair | Drive = DRIVE, **options) -> EncoderLog:
    time, driving, driven = columns
    options = {"unit": "rad"} | options
    return EncoderLog.from_arrays(time, driving, driven, pair=pair, **options)


def fitted(log: EncoderLog, pair: GearPair | Drive = DRIVE, ramps: bool = True, **options: Any):
    """Fit of the mixed model, also without the ramps that slow down."""
    shafts = shafts_of(log, assigned_segments(log))
    shafts = shafts if ramps else replace(shafts, ramps=())
    return mixed_fit([shafts], pair, pair.fit, **options)

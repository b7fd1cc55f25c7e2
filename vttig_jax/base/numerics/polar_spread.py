"""Amplitude and phase of a vector in the plane whose components have a covariance matrix."""

import math

import numpy as np
from jaxtyping import Float

from ..angles import amplitude_phase
from ..units import DEG


def polar_spread(
    offset: Float[np.ndarray, "2"], spread: Float[np.ndarray, "2 2"]
) -> tuple[float, float, float, float]:
    """Return amplitude, its standard error, phase (deg) and its standard error, to first order."""
    amplitude, phase_deg = (float(part) for part in amplitude_phase(offset[1], offset[0]))
    if amplitude == 0:
        return 0.0, float(np.sqrt(np.max(np.linalg.eigvalsh(spread)))), 0.0, 180.0
    along = offset / amplitude
    across = np.array([-along[1], along[0]])
    phase_std = float(np.sqrt(across @ spread @ across)) / amplitude
    return amplitude, float(np.sqrt(along @ spread @ along)), phase_deg, phase_std / DEG


def upper_limit(amplitude: float, spread: Float[np.ndarray, "2 2"]) -> float:
    """Return the 95 % quantile of the length of a 2-D Gaussian vector with isotropic spread."""
    variance = float(np.trace(spread)) / 2
    from scipy.special import chndtrix  # imported here because it is slow and seldom needed

    return math.sqrt(variance * float(chndtrix(0.95, 2, amplitude**2 / variance)))

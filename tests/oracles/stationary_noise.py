"""Dense covariance of stationary autoregressive noise: an oracle for everything done with lags."""

import numpy as np
from scipy.linalg import toeplitz
from scipy.signal import lfilter

_LONG = 20_000


def covariance(filter_: np.ndarray, count: int) -> np.ndarray:
    """Covariance of `count` successive samples, innovations of variance one.

    From the impulse response of the autoregression, Σ_k h_k h_{k+l}.
    """
    response = np.asarray(lfilter([1.0], filter_, np.eye(1, _LONG + count)[0]))
    return toeplitz([response[:_LONG] @ response[lag : _LONG + lag] for lag in range(count)])


def quadratic(filter_: np.ndarray, runs: list[np.ndarray]) -> np.ndarray:
    """Σ Zᵀ Σ⁻¹ Z over runs of rows that know nothing of each other."""
    return np.sum([r.T @ np.linalg.solve(covariance(filter_, len(r)), r) for r in runs], axis=0)


def path(filter_: np.ndarray, count: int, generator: np.random.Generator) -> np.ndarray:
    """A stationary path with innovations of variance one."""
    shocks = generator.standard_normal(count + 3000)
    return np.asarray(lfilter([1.0], filter_, shocks))[3000:]

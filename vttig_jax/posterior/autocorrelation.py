"""How many steps a walker needs to forget where it was: the integrated autocorrelation time."""

import numpy as np
from jaxtyping import Float
from scipy.fft import next_fast_len

WINDOW = 5.0
"""Sums are cut at the first lag of at least so many autocorrelation times (Sokal)."""


def autocorrelation_time(
    draws: Float[np.ndarray, "steps walkers d"],
) -> Float[np.ndarray, " d"]:
    """Integrated autocorrelation time τ of each coordinate of one ensemble, in steps.

        τ = 1 + 2 Σ ρ(k),  k = 1 … M,  M the first lag ≥ 5 τ(M),

    with ρ the autocorrelation averaged over the walkers (Goodman and Weare; Sokal), taken about the
    mean of the whole ensemble. About the mean of each walker a walker that never moves away would
    look like one that mixes at once; about the common mean its correlation does not decay, and τ
    grows with the chain. A coordinate that does not move at all has τ = `steps`.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.posterior.autocorrelation import autocorrelation_time
    >>> noise = np.random.default_rng(0).standard_normal((4000, 64, 1))
    >>> print(np.round(autocorrelation_time(noise), 1))
    [1.]

    ```
    """
    steps = len(draws)
    covariance = np.stack([_autocovariance(draws[:, :, axis]) for axis in range(draws.shape[2])])
    variance = covariance[:, :1]
    with np.errstate(invalid="ignore", divide="ignore"):
        sums = 2 * np.cumsum(covariance / variance, axis=1) - 1
    long_enough = np.arange(steps) >= WINDOW * sums
    window = np.where(long_enough.any(1), long_enough.argmax(1), steps - 1)
    found = np.take_along_axis(sums, window[:, None], axis=1)[:, 0]
    still = variance[:, 0] <= 0
    return np.where(still | ~np.isfinite(found), float(steps), found)


def _autocovariance(series: Float[np.ndarray, "steps walkers"]) -> Float[np.ndarray, " steps"]:
    """Autocovariance summed over the walkers, by FFT; zeros behind keep the ends apart."""
    steps = len(series)
    length = next_fast_len(2 * steps, real=True)
    # Transposed so that the FFT runs along contiguous memory.
    spectrum = np.fft.rfft(np.ascontiguousarray((series - series.mean()).T), n=length, axis=1)
    power = (spectrum.real**2 + spectrum.imag**2).sum(0)
    return np.fft.irfft(power, n=length)[:steps]

"""The noise a plan takes for granted: what block means of it look like, and rows made white."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import cholesky, solve_toeplitz, solve_triangular, toeplitz
from scipy.signal import lfilter

from ..base.units import DEG

_HIGHEST_ORDER = 512
_SETTLED = 1e-10
"""Relative change of the innovation below which a higher order of the autoregression is no gain."""


@dataclass(frozen=True)
class PlannedNoise:
    """Noise of single samples of the transmission error: correlated, white, and counts on top.

        cov(t) = `std_deg`² exp(−|t|/`correlation_s`) + [t = 0] (`white_std_deg`² + counting)

    The counting error of both encoders, step²/12 each and that of the driving one times i², is
    added from the pair.

    **Arguments**
    - `std_deg`, `correlation_s`: of the correlated part; white too where the time is 0.
    - `white_std_deg`: of a white part that is not from counting.

    **Raises** `ValueError` for values that are negative or not finite.

    **Example**
    ```python
    >>> from vttig_jax.posterior.planned_noise import PlannedNoise
    >>> blocks = PlannedNoise(std_deg=0.002, correlation_s=0.00475).of_blocks(11, 2000.0)
    >>> round(blocks.std / blocks.innovation_std, 2), len(blocks.filter) - 1
    (1.16, 8)

    ```
    """

    std_deg: float = 0.0
    correlation_s: float = 0.0
    white_std_deg: float = 0.0

    def __post_init__(self):
        for name in ("std_deg", "correlation_s", "white_std_deg"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise ValueError(
                    f"Argument `{name}` must be finite and not negative, but is {value!r}."
                )

    def autocovariance(
        self, size: int, rate_hz: float, lags: int, counting_rad: float = 0.0
    ) -> Float[np.ndarray, " lags"]:
        """Autocovariance of means of `size` samples at lags of 0 … `lags` blocks, rad².

        With ρ the correlation of neighbouring samples and m = `size`, in units of σ²/m²:

            γ_0 = m + 2 Σ_{k<m} (m − k) ρ^k,   γ_l = ρ^((l−1)m + 1) ((1 − ρ^m)/(1 − ρ))²

        **Arguments**
        - `counting_rad`: standard deviation of the counting error of one sample.
        """
        step = 1 / (rate_hz * self.correlation_s) if self.correlation_s > 0 else math.inf
        inside = np.arange(1, size)
        first = size + 2 * np.sum((size - inside) * np.exp(-inside * step))
        # (1 − ρ^m)/(1 − ρ) without the cancellation of a long correlation.
        within = math.expm1(-size * step) / math.expm1(-step) if step < math.inf else 1.0
        later = np.exp(-((np.arange(lags) * size) + 1) * step) * within**2
        correlated = (self.std_deg * DEG / size) ** 2 * np.concatenate([[first], later])
        correlated[0] += ((self.white_std_deg * DEG) ** 2 + counting_rad**2) / size
        return correlated

    def of_blocks(
        self,
        size: int,
        rate_hz: float,
        counting_rad: float = 0.0,
        most: int = _HIGHEST_ORDER,
        order: int | None = None,
    ) -> "BlockNoise":
        """Noise of means of `size` samples, as an autoregression.

        **Arguments**
        - `most`: highest order, doubled from 1 until the innovation stands still to 1e-10.
        - `order`: exactly this one instead.
        """
        lags = order if order is not None else min(most, _HIGHEST_ORDER)
        known = self.autocovariance(size, rate_hz, max(lags, 1), counting_rad)
        filter_, variance = _predictor(known, lags if order is not None else 0)
        tried = 1
        while order is None and tried <= lags:
            better, less = _predictor(known, tried)
            if variance - less <= _SETTLED * variance:
                break
            filter_, variance, tried = better, less, 2 * tried
        return BlockNoise(known[: len(filter_)], filter_, math.sqrt(variance), size / rate_hz)


@dataclass(frozen=True)
class BlockNoise:
    """Autoregressive noise of block means that is known beforehand.

    **Arguments**
    - `autocovariance`: at lags 0 … p, rad². `filter`: whitening filter (1, −a₁, …, −a_p).
    - `innovation_std`: rad. `block_s`: duration of a block.
    """

    autocovariance: Float[np.ndarray, " taps"]
    filter: Float[np.ndarray, " taps"]
    innovation_std: float
    block_s: float

    @property
    def std(self) -> float:
        """Standard deviation of a block mean, rad."""
        return math.sqrt(float(self.autocovariance[0]))

    def whitened(self, rows: Float[np.ndarray, "n q"]) -> Float[np.ndarray, "n q"]:
        """Rows of one run in units of the innovation: their noise has unit variance, each its own.

        The first p rows go through the inverse Cholesky factor of their covariance, the others
        through the filter: together the exact likelihood of a stationary autoregression.
        """
        order = min(len(self.filter) - 1, len(rows))
        white = np.asarray(lfilter(self.filter, [1.0], rows, axis=0)) / self.innovation_std
        if order:
            factor = cholesky(toeplitz(self.autocovariance[:order]), lower=True)
            white[:order] = solve_triangular(factor, rows[:order], lower=True)
        return white


def _predictor(
    autocovariance: Float[np.ndarray, " lags"], order: int
) -> tuple[Float[np.ndarray, " taps"], float]:
    """Whitening filter of this order and the variance of what it leaves (Yule–Walker)."""
    if order == 0:
        return np.ones(1), float(autocovariance[0])
    known = autocovariance[: order + 1]
    coefficients = solve_toeplitz(known[:-1], known[1:])
    return np.append(1.0, -coefficients), float(known[0] - coefficients @ known[1:])

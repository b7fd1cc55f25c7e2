"""The noise that a plan assumes: autoregressive noise of block means, and the noise of counting."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from jaxtyping import Float
from scipy.linalg import cholesky, solve_toeplitz, solve_triangular, toeplitz
from scipy.signal import lfilter

from ...base.units import DEG, REV
from ...pair.gear_pair import Drive, GearPair

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
    >>> from vttig_jax.posterior import PlannedNoise
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


_FEW_PHASES = 4
"""Quantisation at so few places between two counts is no noise."""

_SLOW = 10.0
"""Cycles a turn of the counting error that still look like one of the fitted orders …"""

_OFTEN = 50.0
"""… where a turn has so many samples a cycle; with fewer it is quick from sample to sample."""

_FINER = 0.0065
"""Relative step in which another rate is looked for."""


def counting_std(pair: GearPair | Drive) -> float:
    """Standard deviation of the transmission error from counting, rad: √(s₂²/12 + i² s₁²/12)."""
    steps = [0.0 if count is None else REV / count for count in _counts(pair)]
    return math.hypot(float(pair.ratio) * steps[0], steps[1]) / math.sqrt(12)


def frozen_counts(pair: GearPair | Drive, speeds_rpm: Sequence[float], rate_hz: float) -> list[str]:
    """Sentences on shafts that turn by nearly the same fraction of a count every sample.

    60 rpm, 90 000 counts and 2 kHz make 45 counts a sample: every sample then has the same error of
    counting, which wanders with the slow part of the motion instead of averaging out.
    """
    told = []
    for speed_rpm in speeds_rpm:
        for shaft, a_sample in _frozen(pair, speed_rpm, rate_hz):
            told.append(
                f"{speed_rpm:g} rpm at {rate_hz:g} Hz is {a_sample} counts of the {shaft} encoder a"
                " sample: its counting error is frozen, does not average out and biases first"
                f" orders beyond the errors planned; sample at {_better(pair, speeds_rpm, rate_hz)}"
            )
    return told


def _frozen(pair: GearPair | Drive, speed_rpm: float, rate_hz: float) -> list[tuple[str, Fraction]]:
    found = []
    ratios = (1.0, float(pair.ratio))
    for shaft, count, ratio in zip(("driving", "driven"), _counts(pair), ratios, strict=True):
        if count is None:
            continue
        turns_a_second = ratio * speed_rpm / 60
        a_sample = count * turns_a_second / rate_hz
        near = Fraction(a_sample).limit_denominator(_FEW_PHASES)
        samples = rate_hz / turns_a_second
        cycles = abs(a_sample - float(near)) * near.denominator * samples
        # Below one count a sample every count is passed at times of its own.
        if near >= 1 and cycles < min(_SLOW, samples / _OFTEN):
            found.append((shaft, near))
    return found


def _better(pair: GearPair | Drive, speeds_rpm: Sequence[float], rate_hz: float) -> str:
    for step in range(1, 40):
        other = float(f"{rate_hz * (1 - _FINER * step):.4g}")
        if not any(_frozen(pair, speed_rpm, other) for speed_rpm in speeds_rpm):
            return f"{other:g} Hz"
    return "another rate"


def _counts(pair: GearPair | Drive) -> tuple[int | None, int | None]:
    return pair.driving.encoder.counts_per_rev, pair.driven.encoder.counts_per_rev

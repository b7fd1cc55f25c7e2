"""Noise that a plan assumes: autoregressive noise of block means, and quantisation by counting."""

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

_HIGHEST_ORDER = 512  # highest order of an autoregression (chosen)
_SETTLED = 1e-10
"""Relative decrease of the innovation variance below which the order is high enough (chosen)."""


@dataclass(frozen=True)
class PlannedNoise:
    """Noise of single samples of the transmission error: correlated part, white part and counting.

        cov(t) = `std_deg`² exp(−|t|/`correlation_s`) + [t = 0] (`white_std_deg`² + counting)

    The counting error has the variance (s₂² + i² s₁²)/12 with the angular steps s₁, s₂ of driving
    and driven encoder and the ratio i. It follows from the pair and is added later.

    **Arguments**
    - `std_deg`, `correlation_s`: standard deviation and correlation time of the correlated part;
      with 0 s this part is white too.
    - `white_std_deg`: standard deviation of a white part that does not come from counting.

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
        """Return the autocovariance of means of `size` samples at lags of 0 … `lags` blocks, rad².

        Without the white part and in units of σ²/m², where ρ is the correlation of neighbouring
        samples, σ = `std_deg` and m = `size`:

            γ_0 = m + 2 Σ_{k<m} (m − k) ρ^k,   γ_l = ρ^((l−1)m + 1) ((1 − ρ^m)/(1 − ρ))²

        **Arguments**
        - `counting_rad`: standard deviation of the counting error of one sample.
        """
        step = 1 / (rate_hz * self.correlation_s) if self.correlation_s > 0 else math.inf
        inside = np.arange(1, size)
        first = size + 2 * np.sum((size - inside) * np.exp(-inside * step))
        # expm1 avoids the cancellation in (1 − ρ^m)/(1 − ρ) for a long correlation.
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
        """Return the autoregressive noise of block means over `size` samples at the rate `rate_hz`.

        **Arguments**
        - `counting_rad`: standard deviation of the counting error of one sample.
        - `most`: highest order. The order is doubled, from 1 on, until the innovation variance
          changes by less than 1e-10 of its value.
        - `order`: fixed order, which replaces this search.
        """
        lags = order if order is not None else min(most, _HIGHEST_ORDER)
        covariance = self.autocovariance(size, rate_hz, max(lags, 1), counting_rad)
        filter_, variance = _predictor(covariance, lags if order is not None else 0)
        higher = 1
        while order is None and higher <= lags:
            longer, lower = _predictor(covariance, higher)
            if variance - lower <= _SETTLED * variance:
                break
            filter_, variance, higher = longer, lower, 2 * higher
        return BlockNoise(covariance[: len(filter_)], filter_, math.sqrt(variance), size / rate_hz)


@dataclass(frozen=True)
class BlockNoise:
    """Autoregressive noise of order p of block means, with known parameters.

    **Arguments**
    - `autocovariance`: autocovariance at the lags 0 … p blocks, rad².
    - `filter`: whitening filter (1, −a₁, …, −a_p).
    - `innovation_std`: standard deviation of the innovations, rad. - `block_s`: duration of a
      block, s.
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
        """Return the whitened rows of one run, in units of the innovation standard deviation.

        The first p rows are multiplied by the inverse Cholesky factor of their covariance, and the
        remaining rows are filtered. Together this gives the exact likelihood of a stationary
        autoregression.
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
    """Return the whitening filter of this order and its residual variance (Yule–Walker)."""
    if order == 0:
        return np.ones(1), float(autocovariance[0])
    known = autocovariance[: order + 1]
    coefficients = solve_toeplitz(known[:-1], known[1:])
    return np.append(1.0, -coefficients), float(known[0] - coefficients @ known[1:])


_FEW_PHASES = 4
"""If the samples lie at no more than this number of positions within a count, the quantisation is
no noise (chosen)."""

_MOST_SLOW_CYCLES = 10.0
"""A counting error with fewer cycles per turn resembles a fitted order (chosen), …"""

_SAMPLES_PER_CYCLE = 50.0
"""… if each cycle also has more than this number of samples (chosen)."""

_RATE_STEP = 0.0065
"""Relative step of the search for a better sampling rate (chosen)."""


def counting_std(pair: GearPair | Drive) -> float:
    """Return the standard deviation of the counting error, rad: √(s₂²/12 + i² s₁²/12).

    s₁ and s₂ are the angular steps of driving and driven encoder; a step that is not known is 0.
    """
    steps = [0.0 if count is None else REV / count for count in _counts(pair)]
    return math.hypot(float(pair.ratio) * steps[0], steps[1]) / math.sqrt(12)


def frozen_counts(pair: GearPair | Drive, speeds_rpm: Sequence[float], rate_hz: float) -> list[str]:
    """Return sentences on shafts that turn by nearly the same fraction of a count every sample.

    60 rpm, 90 000 counts and 2 kHz give 45 counts per sample: every sample then has the same
    counting error, which follows the slow part of the motion instead of averaging out.
    """
    sentences = []
    for speed_rpm in speeds_rpm:
        for shaft, counts in _frozen(pair, speed_rpm, rate_hz):
            sentences.append(
                f"{speed_rpm:g} rpm at {rate_hz:g} Hz is {counts} counts of the {shaft} encoder per"
                " sample: its counting error is frozen, does not average out and biases first"
                f" orders beyond the plan; sample at {_better_rate(pair, speeds_rpm, rate_hz)}"
            )
    return sentences


def _frozen(pair: GearPair | Drive, speed_rpm: float, rate_hz: float) -> list[tuple[str, Fraction]]:
    frozen = []
    ratios = (1.0, float(pair.ratio))
    for shaft, count, ratio in zip(("driving", "driven"), _counts(pair), ratios, strict=True):
        if count is None:
            continue
        turns_a_second = ratio * speed_rpm / 60
        counts = count * turns_a_second / rate_hz
        fraction = Fraction(counts).limit_denominator(_FEW_PHASES)
        samples = rate_hz / turns_a_second
        cycles = abs(counts - float(fraction)) * fraction.denominator * samples
        # Below one count per sample, the counts are passed at varying times between two samples.
        if fraction >= 1 and cycles < min(_MOST_SLOW_CYCLES, samples / _SAMPLES_PER_CYCLE):
            frozen.append((shaft, fraction))
    return frozen


def _better_rate(pair: GearPair | Drive, speeds_rpm: Sequence[float], rate_hz: float) -> str:
    for step in range(1, 40):
        other = float(f"{rate_hz * (1 - _RATE_STEP * step):.4g}")
        if not any(_frozen(pair, speed_rpm, other) for speed_rpm in speeds_rpm):
            return f"{other:g} Hz"
    return "another rate"


def _counts(pair: GearPair | Drive) -> tuple[int | None, int | None]:
    return pair.driving.encoder.counts_per_rev, pair.driven.encoder.counts_per_rev

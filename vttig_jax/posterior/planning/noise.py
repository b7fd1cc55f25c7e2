"""Noise that a plan assumes: correlated and white noise of samples, and counting."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from jaxtyping import Float

from ...base.units import DEG, REV
from ...pair.gear_pair import Drive, GearPair


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
    >>> noise = PlannedNoise(std_deg=0.002, correlation_s=0.00475)
    >>> covariance = noise.autocovariance(11, 2000.0, 2)
    >>> (covariance / covariance[0]).round(2).tolist()
    [1.0, 0.5, 0.16]

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

        With m = `size` and the time Δt between samples:

            γ_l = Σ_{|k|<m} (m − |k|) cov((l m + k) Δt)/m²

        **Arguments**
        - `counting_rad`: standard deviation of the counting error of one sample.
        """
        apart = np.arange(1 - size, size)
        lag_s = np.abs(np.arange(lags + 1)[:, None] * size + apart) / rate_hz
        covariance = (self.std_deg * DEG) ** 2 * np.exp(-lag_s / max(self.correlation_s, 1e-300))
        covariance[lag_s == 0] += (self.white_std_deg * DEG) ** 2 + counting_rad**2
        return covariance @ (size - np.abs(apart)) / size**2


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

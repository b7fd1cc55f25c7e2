"""Level of the noise in a spectrum, and the probability of a height in noise alone."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.lib.stride_tricks import sliding_window_view

from .spectrum import LEAST_REMAINING, Spectrum

_WINDOW = 40
_KNOT_DISTANCE = 5
"""Width of the window in which the noise level is fitted, and distance of two knots of the fit;
both in resolutions (chosen)."""

_CLIP = 5.0
"""Heights above this multiple of the level are clipped in the fit of the level, because they may be
lines and not noise (chosen)."""

_ITERATIONS, _OF_ROUGH, _SETTLED = 8, 3, 1e-5
"""Largest number of iterations in the fit of the level, and of a rough one; the fit ends earlier if
the logarithm of the level changes by less than `_SETTLED` (chosen)."""

_CACHED_KNOTS = 256  # knots fitted at once; their windows fit the processor cache (chosen)
_EULER = 0.5772156649015329  # minus the mean of the logarithm of an exponential variable

_MANY_KNOTS = 200
_ROUGHLY = 1.5
"""With more knots than `_MANY_KNOTS`, a level from one frequency per resolution and every second
knot is computed first. It is within the factor `_ROUGHLY` of the level; it scatters by a fifth
(chosen)."""


@dataclass(frozen=True)
class Level:
    """Level of the noise: its variance per row at the frequencies `cycles`.

    `logarithm` is ln of the level. `freedom` is the number of independent heights over which each
    value of the level is averaged.
    """

    cycles: Float[np.ndarray, " k"]
    logarithm: Float[np.ndarray, " k"]
    freedom: Float[np.ndarray, " k"]

    def at(
        self, cycles: Float[np.ndarray, " f"]
    ) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, " f"]]:
        """Return level and freedom, interpolated at the given frequencies."""
        level = np.exp(np.interp(cycles, self.cycles, self.logarithm))
        return level, np.interp(cycles, self.cycles, self.freedom)


def noise_level(
    spectrum: Spectrum,
    height: Float[np.ndarray, " f"],
    lines: Float[np.ndarray, " k"],
    *,
    near: Float[np.ndarray, " m"] | None = None,
) -> Level:
    """Return the noise level, fitted as a power of the frequency within 40 cells around each knot.

    A cell is one resolution of the spectrum, 1 / (revolutions of the log). A knot is a frequency at
    which the level is fitted. `height` is the result of `Spectrum.height`. The heights of noise
    have an exponential distribution with the level as mean, so that the fit is a regression of the
    gamma family with logarithmic link. Heights above five times the level count as five times the
    level. Frequencies within one cell of one of `lines` (cycles per revolution) are excluded, and
    so are those that the regressors explain. If frequencies `near` are given, only the knots on
    both sides of each of them are fitted; the level is valid there only.
    """
    knots = _knots(spectrum)
    if near is not None:
        right = np.searchsorted(spectrum.cycles[knots], near)
        knots = knots[np.unique(np.clip([right - 1, right], 0, len(knots) - 1))]
    return _level(spectrum, height, lines, knots)


def may_be_highest(
    spectrum: Spectrum,
    height: Float[np.ndarray, " f"],
    lines: Float[np.ndarray, " k"],
    places: Int[np.ndarray, " p"],
) -> Bool[np.ndarray, " p"]:
    """Return for each of `places` whether its height may be the highest of all `places`.

    Heights are compared relative to the noise level. `places` are indices of frequencies in
    `spectrum.cycles`, and the other arguments are those of `noise_level`. The level is only
    roughly estimated here, from few frequencies. The exact level is then needed only at the places
    for which the result is true.
    """
    knots = _knots(spectrum)
    if len(knots) <= _MANY_KNOTS or not len(places):
        return np.ones(len(places), bool)
    few = np.append(knots[:-1:2], knots[-1])
    level = _level(spectrum, height, lines, few, stride=max(round(spectrum.per_cell), 1))
    usual, freedom = level.at(spectrum.cycles[places])
    relative = height[places] / usual
    least = relative_height(relative / _ROUGHLY, freedom).max()
    return relative_height(relative * _ROUGHLY, freedom) >= least


def _knots(spectrum: Spectrum) -> Int[np.ndarray, " k"]:
    """Return the indices of the frequencies at which the noise level is fitted."""
    count = len(spectrum.cycles)
    apart = max(round(_KNOT_DISTANCE * spectrum.per_cell), 1)
    return np.unique(np.append(np.arange(0, count, apart), count - 1))


def _level(
    spectrum: Spectrum,
    height: Float[np.ndarray, " f"],
    lines: Float[np.ndarray, " k"],
    knots: Int[np.ndarray, " q"],
    stride: int = 1,
) -> Level:
    """Return the level at the knots, fitted to every `stride`-th frequency of their windows.

    `knots` are indices in `spectrum.cycles`. The other arguments are those of `noise_level`.
    """
    cycles, per_cell = spectrum.cycles, spectrum.per_cell
    usable = (spectrum.remaining >= LEAST_REMAINING) & (height > 0)
    for line in lines:
        usable &= np.abs(cycles - line) * spectrum.span >= 1
    size = min(round(_WINDOW * per_cell), len(cycles))
    start = np.clip(knots - size // 2, 0, len(cycles) - size)
    distance, logarithm, weight = (
        sliding_window_view(values, size)[:, ::stride]
        for values in (
            np.log(cycles),
            np.log(np.maximum(height, 1e-300)).astype(np.float32),
            usable.astype(np.float32),
        )
    )
    origin = np.log(cycles[knots])
    parts = [
        _gamma_regression(
            (distance[first] - origin[part, None]).astype(np.float32),
            logarithm[first],
            weight[first],
            _ITERATIONS if stride == 1 else _OF_ROUGH,
        )
        for part in (slice(k, k + _CACHED_KNOTS) for k in range(0, len(knots), _CACHED_KNOTS))
        for first in (start[part],)
    ]
    found = (np.concatenate(part).astype(np.float64) for part in zip(*parts, strict=True))
    intercept, inverse = found
    freedom = np.clip(stride / np.maximum(inverse * per_cell, 1e-12), 0.0, size / per_cell)
    return Level(cycles[knots], intercept, freedom)


def _gamma_regression(
    distance: Float[np.ndarray, "k m"],
    logarithm: Float[np.ndarray, "k m"],
    weight: Float[np.ndarray, "k m"],
    iterations: int,
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Fit ln(level) = a + b · distance in each of k windows of m frequencies.

    Return the intercepts a, which are ln(level) at the knots, and their variances. The variances
    hold for independent heights. There are several frequencies per resolution, so their heights
    are correlated, and the caller must enlarge the variances.

    The heights have an exponential distribution with the level as mean. Heights above `_CLIP` times
    the level count as `_CLIP` times the level, and the mean is corrected for that. Floats of 32
    bits are enough, because the relative standard error of a level is about 0.1.

    **Arguments**
    - `distance`: ln(frequency / frequency of the knot of the window); 0 at the knot.
    - `logarithm`: ln(height) at these frequencies.
    - `weight`: 1 for a height that is used, 0 for one that is excluded.
    """
    total = np.maximum(weight.sum(axis=1), 1e-30)
    centre = np.einsum("km,km->k", weight, distance) / total
    apart = distance - centre[:, None]
    lever = weight * apart
    square = np.maximum(np.einsum("km,km->k", lever, apart), 1e-30)
    response, mean = logarithm + np.float32(_EULER), np.float32(-np.expm1(-_CLIP))
    slope, level, log_level = np.zeros_like(centre), np.zeros_like(centre), np.empty_like(apart)
    for number in range(iterations + 1):
        if number:
            np.multiply(apart, slope[:, None], out=log_level)
            log_level += level[:, None]
            np.subtract(logarithm, log_level, out=response)
            np.minimum(response, np.float32(np.log(_CLIP)), out=response)
            np.exp(response, out=response)
            response /= mean
            response += log_level
            response -= 1
        before, level = level, np.einsum("km,km->k", weight, response) / total
        slope = np.einsum("km,km->k", lever, response) / square
        if np.abs(level - before).max() < _SETTLED:
            break
    return level - slope * centre, 1 / total + centre**2 / square


def false_alarm_probability(
    height: float, turns: Float[np.ndarray, " n"], bandwidth: float
) -> float:
    """Return the probability that noise alone reaches `height` anywhere in a spectrum.

    Baluev, MNRAS 385, 1279 (2008), for a known noise level (z there): 1 − (1 − e⁻ᶻ) e⁻ᵗ with
    τ = W e⁻ᶻ √z and W = bandwidth √(4π var turns). It is an upper bound that is sharp for small
    probabilities.

    **Arguments**
    - `height`: z; for noise alone it has an exponential distribution at every frequency.
    - `turns`: revolutions of the rows. `bandwidth`: range of the spectrum in cycles per revolution.
    """
    width = bandwidth * np.sqrt(4 * np.pi * np.var(turns))
    tau = width * np.exp(-height) * np.sqrt(height)
    single = np.exp(-height)
    return float(np.clip(single - (1 - single) * np.expm1(-tau), 0.0, 1.0))


def relative_height(
    relative: Float[np.ndarray, " f"], freedom: Float[np.ndarray, " f"]
) -> Float[np.ndarray, " f"]:
    """Return z = −ln P, where P is the probability of a height of `relative` times the noise level.

    The level is itself a mean of `freedom` heights, so that `relative` has an F distribution with 2
    and 2 `freedom` degrees of freedom: P = (1 + relative / freedom)^−freedom = exp(−z).
    """
    return freedom * np.log1p(relative / np.maximum(freedom, 1e-300))

"""Spectrum of averaged rows, and the level of its noise at a frequency.

Spectrum of the rows over the driving angle by FFT.

Level of the noise in a spectrum, and the probability of a height in noise alone.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial import Chebyshev

from ...base.numerics.counting import next_smooth
from ...base.units import REV
from .rows import Regressors, Rows, transposed

LEAST_CYCLES = 1.5
"""Least number of cycles of a line over the whole log, to separate it from drift (chosen)."""

LEAST_REMAINING = 0.25
"""A frequency is usable if at least this fraction of the power of a line there is orthogonal to the
regressors (chosen)."""

_OVERSAMPLING = 4  # frequencies per resolution; resolution = 1 / (revolutions of the log) (chosen)
_BINS_PER_CYCLE = 4  # angle bins per cycle of the highest frequency (chosen)
_MOST_BINS = 2**24
"""Largest length of a transform; it limits the memory to 0.5 GB (chosen)."""

_SPREAD, _NODES = 7, 24  # bins over which a row is spread, quadrature nodes; error 1e-6
_DEGREE = 24  # degree of the polynomial for the transform of the spreading; error 1e-15

_STEPS, _TABLE = 16, 4096  # quantiles of row distances, frequencies in a filter table (chosen)


@dataclass(frozen=True)
class Spectrum:
    """Equidistant frequencies, and the data from which the heights at them are computed by FFT.

    **Arguments**
    - `cycles`: frequencies in cycles per revolution, shape (f,).
    - `remaining`: fraction of the power of a line orthogonal to the regressors, shape (f,).
    - `spread`: angle bins over which every row is spread, and their weights, shape (n, w).
    - `sharpening`: correction of the power for the spreading, shape (f,).
    - `length`: number of angle bins in the Fourier transform.
    - `first`: index of the first of `cycles` in the transform.
    - `span`: revolutions between the lowest and the highest angle.
    - `steps`: quantiles of the revolutions from row to row, shape (s,).
    """

    cycles: Float[np.ndarray, " f"]
    remaining: Float[np.ndarray, " f"]
    spread: tuple[Int[np.ndarray, "n w"], Float[np.ndarray, "n w"]]
    sharpening: Float[np.ndarray, " f"]
    length: int
    first: int
    span: float
    steps: Float[np.ndarray, " s"]

    @classmethod
    def of(cls, rows: Rows, regressors: Regressors, highest: float) -> "Spectrum":
        """Return a spectrum whose frequencies extend from 1.5 cycles over the log to `highest`.

        **Raises** `ValueError` if the log is too long for a transform.
        """
        width = 1 / (_BINS_PER_CYCLE * highest)
        count = _OVERSAMPLING * rows.span / width
        if count > _MOST_BINS:
            most = highest * _MOST_BINS / count
            raise ValueError(
                f"Argument `highest` must be at most {most:.4g} cycles per revolution over"
                f" {rows.span:.4g} revolutions, but is {highest:.4g}: search fewer runs at once."
            )
        place = (rows.turns - rows.turns.min()) / width
        bins = np.ceil(place - _SPREAD / 2).astype(np.int64)[:, None] + np.arange(_SPREAD)
        weights = _kernel(bins - place[:, None])
        length = next_smooth(max(int(np.ceil(count)), 4 * _SPREAD))
        step = 1 / (length * width)
        first = int(np.ceil(LEAST_CYCLES / (rows.span * step)))
        cycles = step * np.arange(first, int(highest / step) + 1)
        moved = np.concatenate([np.abs(np.diff(rows.turns[run])) for run in rows.runs])
        steps = np.quantile(moved, (np.arange(_STEPS) + 0.5) / _STEPS)
        empty = cls(
            cycles=cycles,
            remaining=np.ones_like(cycles),
            spread=(bins - bins.min(), weights),
            sharpening=_smoothing(cycles * width) ** -2,
            length=length,
            first=first,
            span=rows.span,
            steps=steps,
        )
        regressed = np.zeros_like(cycles)
        for where, basis in regressors.blocks:
            for column in basis.T:
                regressed += empty._power(column, where)
        return replace(empty, remaining=np.clip(1 - regressed / len(rows.value), 0.0, 1.0))

    def height(
        self, innovations: Float[np.ndarray, " n"], taps: Float[np.ndarray, " taps"]
    ) -> Float[np.ndarray, " f"]:
        """Return half the decrease of the sum of squares by a line at every frequency.

        `innovations` is the residual whitened by the filter `taps`. For white innovations of
        variance 1 the result has an exponential distribution with mean 1. As an approximation,
        cosine and sine are taken as orthogonal and of equal norm.
        """
        usable = self.remaining >= LEAST_REMAINING
        power = self._power(transposed(innovations, taps), slice(None))
        length = len(self.spread[0]) * self.remaining * self._gain(taps)
        return np.where(usable, power / np.where(usable, length, 1.0), 0.0)

    @property
    def per_cell(self) -> float:
        """Number of frequencies per resolution."""
        return 1 / (self.span * self.step)

    @property
    def step(self) -> float:
        """Distance of two frequencies, cycles per revolution."""
        return float(self.cycles[1] - self.cycles[0])

    def _gain(self, taps: Float[np.ndarray, " taps"]) -> Float[np.ndarray, " f"]:
        """Return the mean power gain |A|² of the filter at every frequency.

        The gain depends on the angle from row to row; it is averaged over the quantiles `steps`.
        """
        if len(taps) == 1:
            return np.ones_like(self.cycles)
        table = np.abs(np.fft.rfft(taps, 2 * _TABLE)) ** 2
        total = np.zeros_like(self.cycles)
        for step in self.steps:
            phase = self.cycles * step
            phase -= np.rint(phase)  # cycles per row, folded
            total += np.interp(np.abs(phase) * 2 * _TABLE, np.arange(_TABLE + 1), table)
        return total / len(self.steps)

    def _power(self, values: Float[np.ndarray, " m"], where: slice) -> Float[np.ndarray, " f"]:
        """Return |Σ v exp(2πi f turns)|² at all frequencies f, for values v at the rows `where`."""
        bins, weights = self.spread
        parts = values[:, None] * weights[where]
        sums = np.bincount(bins[where].ravel(), parts.ravel(), self.length + _SPREAD)
        stop = self.first + len(self.cycles)
        # The transform is periodic: bins beyond its length are added to the first bins.
        sums[:_SPREAD] += sums[self.length :]
        transform = np.fft.rfft(sums[: self.length])[self.first : stop]
        return np.abs(transform) ** 2 * self.sharpening


def _kernel(distance: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Return the kernel exp(β (√(1 − (2 x / w)²) − 1)) at a distance of x bins; w is its width.

    A. Barnett, J. Magland, L. af Klinteberg, SIAM J. Sci. Comput. 41, C479 (2019); β = 2.3 w.
    """
    inside = np.maximum(1 - (2 * distance / _SPREAD) ** 2, 0.0)
    return np.exp(2.3 * _SPREAD * (np.sqrt(inside) - 1))


def _smoothing(cycles: Float[np.ndarray, " f"]) -> Float[np.ndarray, " f"]:
    """Return the Fourier transform of the kernel at frequencies in cycles per bin.

    The transform is smooth, so that a polynomial through few frequencies has all digits.
    """
    nodes, share = np.polynomial.legendre.leggauss(_NODES)
    weights = share * _kernel(nodes * _SPREAD / 2) * _SPREAD / 2

    def transform(at: Float[np.ndarray, " _"]) -> Float[np.ndarray, " _"]:
        return np.cos(REV * np.outer(at, nodes * _SPREAD / 2)) @ weights

    domain = [0.0, max(float(cycles[-1]), 1e-12)] if len(cycles) else [0.0, 1.0]
    return np.asarray(Chebyshev.interpolate(transform, _DEGREE, domain=domain)(cycles))


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

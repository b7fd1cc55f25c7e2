"""Spectrum of the rows over the driving angle by FFT, and the level of its noise."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.fft import next_fast_len, rfft

from ...base.units import REV
from .noise import transposed
from .regression import Regressors
from .rows import Rows

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

_WINDOW = 40
_KNOT_DISTANCE = 5
"""Width of the window in which the noise level is fitted, and distance of two knots of the fit;
both in resolutions (chosen)."""

_CLIP = 5.0
"""Heights above this multiple of the level are clipped in the fit of the level, because they may be
lines and not noise (chosen)."""

_ITERATIONS, _SETTLED = 8, 1e-5
"""Largest number of iterations in the fit of the level; the fit ends earlier if the logarithm of
the level changes by less than `_SETTLED` (chosen)."""

_CACHED_KNOTS = 256  # knots fitted at once; their windows fit the processor cache (chosen)
_STEPS, _TABLE = 16, 4096  # quantiles of row distances, frequencies in a filter table (chosen)
_EULER = 0.5772156649015329  # minus the mean of the logarithm of an exponential variable


@dataclass(frozen=True)
class Spectrum:
    """Equidistant frequencies, and the data from which the heights at them are computed by FFT.

    **Arguments**
    - `cycles`: frequencies in cycles per revolution, shape (f,).
    - `remaining`: fraction of the power of a line orthogonal to the regressors, shape (f,).
    - `spread`: first angle bin of every row, shape (n,), and the weights with which the row is
      spread over this and the next bins, shape (n, w).
    - `sharpening`: correction of the power for the spreading, shape (f,).
    - `length`: number of angle bins in the Fourier transform.
    - `first`: index of the first of `cycles` in the transform.
    - `span`: revolutions between the lowest and the highest angle.
    - `steps`: quantiles of the revolutions from row to row, shape (s,).
    """

    cycles: Float[np.ndarray, " f"]
    remaining: Float[np.ndarray, " f"]
    spread: tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n w"]]
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
        bins = np.ceil(place - _SPREAD / 2).astype(np.int64)
        weights = _kernel(bins[:, None] + np.arange(_SPREAD) - place[:, None])
        length = int(next_fast_len(max(int(np.ceil(count)), 4 * _SPREAD), real=True) or 0)
        step = 1 / (length * width)
        first = int(np.ceil(LEAST_CYCLES / (rows.span * step)))
        cycles = step * np.arange(first, int(highest / step) + 1)
        nodes, share = np.polynomial.legendre.leggauss(_NODES)
        wave = np.cos(REV * np.outer(cycles * width, nodes * _SPREAD / 2))
        smoothing = wave @ (share * _kernel(nodes * _SPREAD / 2)) * _SPREAD / 2
        moved = np.concatenate([np.abs(np.diff(rows.turns[run])) for run in rows.runs])
        steps = np.quantile(moved, (np.arange(_STEPS) + 0.5) / _STEPS)
        empty = cls(
            cycles=cycles,
            remaining=np.ones_like(cycles),
            spread=(bins - bins.min(), weights),
            sharpening=smoothing**-2,
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

    @cached_property
    def windows(
        self,
    ) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, "k m"], Float[np.ndarray, "k m"]]:
        """Indices of the knots, the window of indices around each, and ln(frequency / knot) there.

        A knot is a frequency at which the noise level is fitted.
        """
        cycles = self.cycles
        per_cell = 1 / (self.span * (cycles[1] - cycles[0]))
        size = min(round(_WINDOW * per_cell), len(cycles))
        apart = max(round(_KNOT_DISTANCE * per_cell), 1)
        knots = np.unique(np.append(np.arange(0, len(cycles), apart), len(cycles) - 1))
        start = np.clip(knots - size // 2, 0, len(cycles) - size)
        window = start[:, None] + np.arange(size)
        distance = np.log(cycles)
        return knots, window, (distance[window] - distance[knots, None]).astype(np.float32)

    def _gain(self, taps: Float[np.ndarray, " taps"]) -> Float[np.ndarray, " f"]:
        """Return the mean power gain |A|² of the filter at every frequency.

        The gain depends on the angle from row to row; it is averaged over the quantiles `steps`.
        """
        if len(taps) == 1:
            return np.ones_like(self.cycles)
        table = np.abs(np.asarray(rfft(taps, 2 * _TABLE))) ** 2
        total = np.zeros_like(self.cycles)
        for step in self.steps:
            phase = np.abs((self.cycles * step + 0.5) % 1.0 - 0.5)  # cycles per row, folded
            total += np.interp(phase * 2 * _TABLE, np.arange(_TABLE + 1), table)
        return total / len(self.steps)

    def _power(self, values: Float[np.ndarray, " m"], where: slice) -> Float[np.ndarray, " f"]:
        """Return |Σ v exp(2πi f turns)|² at all frequencies f, for values v at the rows `where`."""
        bins, weights = self.spread
        sums = np.zeros(self.length + _SPREAD)
        for k in range(_SPREAD):
            sums += np.bincount(bins[where] + k, values * weights[where, k], len(sums))
        stop = self.first + len(self.cycles)
        # The transform is periodic: bins beyond its length are added to the first bins.
        sums[:_SPREAD] += sums[self.length :]
        transform = np.asarray(rfft(sums[: self.length]))[self.first : stop]
        return np.abs(transform) ** 2 * self.sharpening


def _kernel(distance: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Return the kernel exp(β (√(1 − (2 x / w)²) − 1)) at a distance of x bins; w is its width.

    A. Barnett, J. Magland, L. af Klinteberg, SIAM J. Sci. Comput. 41, C479 (2019); β = 2.3 w.
    """
    inside = np.maximum(1 - (2 * distance / _SPREAD) ** 2, 0.0)
    return np.exp(2.3 * _SPREAD * (np.sqrt(inside) - 1))


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
    spectrum: Spectrum, height: Float[np.ndarray, " f"], lines: Float[np.ndarray, " k"]
) -> Level:
    """Return the noise level, fitted as a power of the frequency within 40 cells around each knot.

    A cell is one resolution. The heights of noise have an exponential distribution with the level
    as mean, so that the fit is a regression of the gamma family with logarithmic link. Heights
    above five times the level count as five times the level. Frequencies within one cell of one of
    `lines` are excluded, and so are those that the regressors explain.
    """
    cycles = spectrum.cycles
    per_cell = 1 / (spectrum.span * (cycles[1] - cycles[0]))
    near = [np.abs(cycles - line) * spectrum.span < 1 for line in lines]
    usable = (spectrum.remaining >= LEAST_REMAINING) & (height > 0)
    usable &= ~np.any(near, axis=0) if near else True
    knots, window, distance = spectrum.windows
    logarithm = np.log(np.maximum(height, 1e-300)).astype(np.float32)
    weight = usable.astype(np.float32)
    parts = [
        _gamma_regression(distance[part], logarithm[window[part]], weight[window[part]])
        for part in (slice(k, k + _CACHED_KNOTS) for k in range(0, len(knots), _CACHED_KNOTS))
    ]
    found = (np.concatenate(part).astype(np.float64) for part in zip(*parts, strict=True))
    intercept, inverse = found
    most = window.shape[1] / per_cell
    freedom = np.clip(1 / np.maximum(inverse * per_cell, 1e-12), 0.0, most)
    return Level(cycles[knots], intercept, freedom)


def _gamma_regression(
    distance: Float[np.ndarray, "k m"],
    logarithm: Float[np.ndarray, "k m"],
    weight: Float[np.ndarray, "k m"],
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Fit ln level = a + b · distance in every window; return the a and their variances.

    `logarithm` is ln height; the heights have an exponential distribution with the level as mean.
    Heights with `weight` 0 are excluded. Floats of 32 bits are enough, because the relative
    standard error of a level is about 0.1.
    """
    total = np.maximum(weight.sum(axis=1), 1e-30)
    centre = np.einsum("km,km->k", weight, distance) / total
    apart = distance - centre[:, None]
    lever = weight * apart
    square = np.maximum(np.einsum("km,km->k", lever, apart), 1e-30)
    response, mean = logarithm + np.float32(_EULER), np.float32(-np.expm1(-_CLIP))
    slope, level, log_level = np.zeros_like(centre), np.zeros_like(centre), np.empty_like(apart)
    for number in range(_ITERATIONS + 1):
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

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
"""Least part of a line that the regressors leave, as a fraction of its power (chosen)."""

_OVERSAMPLING = 4  # frequencies per resolution, 1 / (revolutions of the log) (chosen)
_BINS_PER_CYCLE = 4  # angle bins per cycle of the highest frequency (chosen)
_MOST_BINS = 2**24
"""Largest length of a transform; it limits the memory to 0.5 GB (chosen)."""

_SPREAD, _NODES = 7, 24  # bins of the spreading of a row, nodes of its transform; error 1e-6

_WINDOW = 40
_KNOT_DISTANCE = 5
"""Resolutions over which the level is smooth, and between two places where it is fitted (chosen)"""

_CLIP = 5.0
"""Largest height in the fit of the level, relative to the level: lines are no noise (chosen)."""

_ITERATIONS, _SETTLED = 8, 1e-5
"""Most steps of the fit of the level, and the change of its logarithm that ends it (chosen)."""

_CACHED_KNOTS = 256  # knots fitted at once, so that their windows stay in the cache (chosen)
_STEPS, _TABLE = 16, 4096  # quantiles of the steps, frequencies in the table of a filter (chosen)
_EULER = 0.5772156649015329  # minus the mean of the logarithm of an exponential variable


@dataclass(frozen=True)
class Spectrum:
    """Equidistant frequencies, and the part of a line at each that the regressors leave.

    **Arguments**
    - `cycles`: frequencies in cycles per revolution, shape (f,).
    - `remaining`: fraction of the power of a line outside the regressors, shape (f,).
    - `spread`: first angle bin that every row is spread over, shape (n,), and its weights there.
    - `sharpening`: correction of the power for the spreading, shape (f,).
    - `length`: length of the transform.
    - `first`: index of the first frequency in the transform.
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
        """Return the frequencies from 1.5 cycles over the log to `highest`.

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

        For white innovations of variance 1 it has an exponential distribution with mean 1. Cosine
        and sine are taken as orthogonal and equally long.
        """
        usable = self.remaining >= LEAST_REMAINING
        power = self._power(transposed(innovations, taps), slice(None))
        length = len(self.spread[0]) * self.remaining * self._gain(taps)
        return np.where(usable, power / np.where(usable, length, 1.0), 0.0)

    @cached_property
    def windows(
        self,
    ) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, "k m"], Float[np.ndarray, "k m"]]:
        """Knots of the level, the frequencies around each, and ln of their ratio to the knot."""
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
        """Return the mean of |A|² of the filter over the rows, each with its step of the angle."""
        if len(taps) == 1:
            return np.ones_like(self.cycles)
        table = np.abs(np.asarray(rfft(taps, 2 * _TABLE))) ** 2
        total = np.zeros_like(self.cycles)
        for step in self.steps:
            phase = np.abs((self.cycles * step + 0.5) % 1.0 - 0.5)  # cycles per row, folded
            total += np.interp(phase * 2 * _TABLE, np.arange(_TABLE + 1), table)
        return total / len(self.steps)

    def _power(self, values: Float[np.ndarray, " m"], where: slice) -> Float[np.ndarray, " f"]:
        """Return |Σ v exp(2πi f turns)|²."""
        bins, weights = self.spread
        sums = np.zeros(self.length + _SPREAD)
        for k in range(_SPREAD):
            sums += np.bincount(bins[where] + k, values * weights[where, k], len(sums))
        stop = self.first + len(self.cycles)
        # Bins beyond the length belong to the start: the transform is periodic.
        sums[:_SPREAD] += sums[self.length :]
        transform = np.asarray(rfft(sums[: self.length]))[self.first : stop]
        return np.abs(transform) ** 2 * self.sharpening


def _kernel(distance: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Return exp(β (√(1 − (2 x / w)²) − 1)) at a distance of x bins, w the width of the kernel.

    A. Barnett, J. Magland, L. af Klinteberg, SIAM J. Sci. Comput. 41, C479 (2019); β = 2.3 w.
    """
    inside = np.maximum(1 - (2 * distance / _SPREAD) ** 2, 0.0)
    return np.exp(2.3 * _SPREAD * (np.sqrt(inside) - 1))


@dataclass(frozen=True)
class Level:
    """Level of the noise: its variance per row at the frequencies `cycles`.

    `freedom` is the number of independent heights that a value of the level is the mean of.
    """

    cycles: Float[np.ndarray, " k"]
    logarithm: Float[np.ndarray, " k"]
    freedom: Float[np.ndarray, " k"]

    def at(
        self, cycles: Float[np.ndarray, " f"]
    ) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, " f"]]:
        """Return level and freedom at other frequencies."""
        level = np.exp(np.interp(cycles, self.cycles, self.logarithm))
        return level, np.interp(cycles, self.cycles, self.freedom)


def noise_level(
    spectrum: Spectrum, height: Float[np.ndarray, " f"], lines: Float[np.ndarray, " k"]
) -> Level:
    """Fit the level of the noise around every frequency: a power of the frequency over 40 cells.

    A cell is one resolution. The heights of noise have an exponential distribution with the level
    as mean, so that the fit is a regression of the gamma family with logarithmic link. Heights
    above five times the level count as five times the level, and frequencies within one cell of a
    line of `lines` or inside the regressors do not count.
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
    """Return the intercepts of ln height = a + b distance, and their variance for exponentials.

    `logarithm` is ln height. Floats of 32 bits are enough, because a level scatters by a tenth.
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
    """Return the probability that noise alone reaches a height anywhere in a spectrum.

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

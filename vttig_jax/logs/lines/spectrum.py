"""Spectrum of the rows over the driving angle by FFT."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from numpy.polynomial import Chebyshev

from ...base.numerics.counting import next_smooth
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

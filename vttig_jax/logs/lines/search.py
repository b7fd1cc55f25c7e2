"""Periodic lines of unknown frequency in the transmission error, after a fit or before one.

Lines of a belt, a bearing ring or an inner gear stage appear without a known tooth count or order.
They are searched in the spectrum of averaged rows over the driving angle (FFT), where the level of
the noise gives the probability of a height in noise alone. More lines at multiples of one frequency
than a coincidence can explain are those of a hidden shaft.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial import Chebyshev
from scipy.fft import next_fast_len

from ...base.angles import amplitude_phase, wrap_deg
from ...base.numerics.counting import whole_below
from ...base.threads import one_blas_thread
from ...base.units import ARCSEC, REV
from ..encoder_log import EncoderLog
from ..motion.segments import Segment
from .rows import (
    APART,
    LineFit,
    LineRegression,
    Rows,
    Stretch,
    filter_of_order,
    highest_resolved,
    noise_filter,
    scaled,
    stack,
    transposed,
)

_LEAST_ROWS = 24
_LEAST_FREEDOM = 4.0
"""Least number of rows beyond one per regressor, and least number of independent heights that
define the local noise level. With fewer heights, only the autoregression defines the noise."""

_LEAST_AMPLITUDE = 3.0  # least amplitude of a line in standard errors (chosen)

_SPARE = 3
"""Number of candidates beyond the requested number of lines, so that further lines do not count as
noise (chosen)."""

_ROUNDING = 1e-26
"""A residual is rounding error if its sum of squares is at most this fraction of that of the values
(chosen)."""


@dataclass(frozen=True)
class Line:
    """Periodic component a sin(c φ + p) of the transmission error, with φ the driving angle.

    **Arguments**
    - `cycles_per_rev`: c in cycles per driving revolution, with standard error `cycles_std`.
    - `amplitude_arcsec`: a > 0 in arcsec, with standard error `amplitude_std_arcsec`.
    - `phase_deg`: p in degrees at driving angle 0, in [0, 360).
    - `false_alarm`: probability that noise alone has a line of this height anywhere in the scan.
    """

    cycles_per_rev: float
    cycles_std: float
    amplitude_arcsec: float
    amplitude_std_arcsec: float
    phase_deg: float
    false_alarm: float

    def __str__(self) -> str:
        return (
            f"{self.amplitude_arcsec:.3g} ± {self.amplitude_std_arcsec:.1g}″ at"
            f" {self.cycles_per_rev:.6g} ± {self.cycles_std:.1g} cycles per revolution"
            f" (probability {self.false_alarm:.1g} by chance)"
        )


@one_blas_thread
def find_lines(
    runs: Sequence[Stretch], *, highest: float, false_alarm: float = 1e-3, most: int = 5
) -> tuple[Line, ...]:
    """Return periodic lines in coloured noise, the most significant first.

    The trial frequencies extend from 1.5 cycles over the whole log to `highest`, in steps of a
    quarter of the resolution. Each trial adds a cosine and a sine of the driving angle to the
    regressors. All columns are whitened by the autoregression of the residual, and the height of a
    trial is compared with the local noise level of the spectrum. The best line is added with a
    refined frequency, and the noise is estimated again. A line is accepted if the probability that
    noise alone reaches its height anywhere in the scan is below `false_alarm`. Rows denser than six
    per cycle of `highest` are averaged in blocks.

    **Arguments**
    - `runs`: uninterrupted stretches with rows in time order; see `Stretch`.
    - `highest`: highest frequency in cycles per revolution; at most half the rows per revolution.
    - `false_alarm`: largest false-alarm probability of a line, between 0 and 1.
    - `most`: largest number of lines.

    **Raises** `ValueError` for a `highest` above the limit of aliasing, or with more than about 4
    million trial frequencies.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs import Stretch, find_lines
    >>> angle = 2 * np.pi * np.linspace(0.0, 20.0, 2000)
    >>> noise = np.random.default_rng(0).normal(0.0, 1e-5, 2000)
    >>> run = Stretch(angle, 2e-5 * np.sin(3.09 * angle) + noise, np.ones((2000, 1)))
    >>> [line] = find_lines([run], highest=20.0)
    >>> round(line.cycles_per_rev, 2), round(line.amplitude_arcsec, 1)
    (3.09, 4.1)

    ```
    """
    if not 0 < false_alarm < 1:
        raise ValueError(f"Argument `false_alarm` must lie between 0 and 1, but is {false_alarm}.")
    if most < 0:
        raise ValueError(f"Argument `most` must be at least 0, but is {most}.")
    rows = stack(runs, highest)
    count = sum(columns.shape[1] for _, columns in rows.nuisance)
    enough = len(rows.value) >= _LEAST_ROWS + count
    if not enough or rows.span == 0 or highest * rows.span <= LEAST_CYCLES:
        return ()
    spectrum = Spectrum.of(rows, highest)
    if len(spectrum.cycles) < 2:
        return ()
    plain = LineRegression(rows, rows.without_regressors(rows.value), np.ones(1))
    search = _Search(rows, plain, spectrum, false_alarm)
    return search.surviving(search.candidates(most + _SPARE))[:most]


@dataclass(frozen=True, eq=False)
class _Search:
    """Search for candidate lines above the noise level, and test of their significance.

    `plain` is the regression without whitening, from which all whitened ones are made.
    """

    rows: Rows
    plain: LineRegression
    spectrum: "Spectrum"
    false_alarm: float

    def candidates(self, most: int) -> Float[np.ndarray, " k"]:
        """Return the frequencies of up to `most` candidate lines.

        Each step adds the line that stands highest above the noise level and refines all
        frequencies. The autoregression can follow a strong line and hide it in the whitened
        spectrum; therefore the spectrum without whitening is searched too, with its noise level.
        """
        frequencies = np.zeros(0)
        while len(frequencies) < most:
            without = self.plain.fit(frequencies)
            if without.misfit <= _ROUNDING * float(self.rows.value @ self.rows.value):
                break
            taps = noise_filter(self.rows, without.rest)
            parts = dict.fromkeys([self.plain, self.plain.whitened(taps)])  # one for white noise
            found = [(*self._highest(part, frequencies), part) for part in parts]
            score, cycles, regression = max(found, key=itemgetter(0))
            if score <= 0 or self._alarm(score) > self.false_alarm:
                break
            tried = np.append(frequencies, cycles)
            frequencies = regression.refine(tried, self._lowest).frequencies
        return frequencies

    def surviving(self, frequencies: Float[np.ndarray, " k"]) -> tuple[Line, ...]:
        """Remove the least certain line until the false-alarm probability of all is small enough.

        Return the remaining lines, the most certain first.
        """
        while len(frequencies):
            taps = noise_filter(self.rows, self.plain.fit(frequencies).rest)
            regression = self.plain.whitened(taps)
            found = regression.refine(frequencies, self._lowest)
            frequencies = found.frequencies
            height = self.spectrum.height(found.rest, taps)
            usual, freedom = noise_level(self.spectrum, height, frequencies, frequencies)
            level = np.where(freedom >= _LEAST_FREEDOM, usual, 0.0)
            scores = self._scores(found, taps, usual, freedom)
            worst = int(np.argmin(scores))
            if self._alarm(float(scores[worst])) <= self.false_alarm:
                return self._lines(regression, found, scores, level)
            frequencies = np.delete(frequencies, worst)
        return ()

    def _highest(
        self, regression: LineRegression, frequencies: Float[np.ndarray, " k"]
    ) -> tuple[float, float]:
        """Return score (−ln P) and frequency of the peak highest above the noise level.

        The lines `frequencies` are fitted first, and peaks near them are excluded.
        """
        height = self.spectrum.height(regression.fit(frequencies).rest, regression.taps)
        free = np.flatnonzero(self.spectrum.is_apart(frequencies))
        places = free[may_be_highest(self.spectrum, height, frequencies, free)]
        if not len(places):
            return -1.0, 0.0
        cycles = self.spectrum.cycles[places]
        usual, freedom = noise_level(self.spectrum, height, frequencies, cycles)
        score = relative_height(height[places] / usual, freedom)
        best = int(np.argmax(score))
        return float(score[best]), float(cycles[best])

    def _scores(
        self,
        found: LineFit,
        taps: Float[np.ndarray, " taps"],
        usual: Float[np.ndarray, " k"],
        freedom: Float[np.ndarray, " k"],
    ) -> Float[np.ndarray, " k"]:
        """Return z = −ln P of every line, where P is the probability of its height in noise alone.

        All other lines are fitted too. z is the smaller of two values. The first is the likelihood
        ratio against an autoregression of the same order that is fitted without the line, because
        a narrow resonance of the noise looks like a line. The second is the height above the local
        level `usual` of the whitened spectrum, which includes noise that the autoregression misses.
        """
        frequencies = found.frequencies
        if found.misfit <= 0:
            return np.full(len(frequencies), np.inf)
        without = []
        for others in (np.delete(frequencies, k) for k in range(len(frequencies))):
            again = filter_of_order(self.rows, self.plain.fit(others).rest, len(taps) - 1)
            without.append(self.plain.whitened(again).fit(others).misfit)
        gain = np.log(np.maximum(np.array(without) / found.misfit, 1.0))
        ratio = 0.5 * self._freedom(found, taps) * gain
        nearby = relative_height(0.5 * found.drops / usual, freedom)
        return np.where(freedom >= _LEAST_FREEDOM, np.minimum(ratio, nearby), ratio)

    def _freedom(self, found: LineFit, taps: Float[np.ndarray, " taps"]) -> int:
        """Return the number of rows beyond those that the regressors, lines and filter use up."""
        used = self.rows.rank + 3 * len(found.frequencies) + len(taps)
        return max(len(self.rows.value) - used, 1)

    @property
    def _lowest(self) -> float:
        return LEAST_CYCLES / self.rows.span

    def _alarm(self, score: float) -> float:
        cycles = self.spectrum.cycles
        return false_alarm_probability(score, self.rows.turns, float(np.ptp(cycles)))

    def _lines(
        self,
        regression: LineRegression,
        found: LineFit,
        scores: Float[np.ndarray, " k"],
        level: Float[np.ndarray, " k"],
    ) -> tuple[Line, ...]:
        """Return the lines, the most certain first.

        Their standard errors use the larger noise level: the mean or the local one, `level`.
        """
        coefficients, covariance = regression.with_corrections(found)
        count, lines = len(scores), []
        variance = np.maximum(level, found.misfit / self._freedom(found, regression.taps))
        for number in np.argsort(-scores, kind="stable"):
            cycles = float(found.frequencies[number])
            wave = slice(2 * number, 2 * number + 2)
            pair = coefficients[wave]
            amplitude, phase_deg = amplitude_phase(*pair)
            slope = pair / amplitude if amplitude > 0 else np.array([1.0, 0.0])
            std = float(np.sqrt(variance[number] * (slope @ covariance[wave, wave] @ slope)))
            if amplitude < _LEAST_AMPLITUDE * std:
                continue  # the amplitude is not separable from that of a close neighbour
            of_cycles = covariance[2 * count + number, 2 * count + number]
            lines.append(
                Line(
                    cycles_per_rev=cycles,
                    cycles_std=float(np.sqrt(variance[number] * of_cycles)),
                    amplitude_arcsec=float(amplitude) / ARCSEC,
                    amplitude_std_arcsec=std / ARCSEC,
                    phase_deg=float(wrap_deg(phase_deg - 360.0 * (cycles * self.rows.origin))),
                    false_alarm=self._alarm(float(scores[number])),
                )
            )
        return tuple(lines)


HIGHEST = 12.0
"""Highest frequency of the search in cycles per driving revolution (chosen)."""

_FASTEST = 0.9
"""Quantile of the driving angle per sample; the highest frequency is limited so that a cycle has at
least `_ALIAS` steps of this size (chosen)."""

_ALIAS, _ROWS_PER_CYCLE = 3.0, 5.0  # least samples, and averaged rows, per cycle of `highest`
_FEWEST_ROWS, _MOST = 20, 5  # least averaged rows of a stretch, largest number of lines (chosen)


def blind_lines(log: EncoderLog, segments: Sequence[Segment]) -> tuple[Line, ...]:
    """Return significant lines of the transmission error in the segments, most significant first.

    The regressors of each flank are an offset, time, its square, speed and torque. Therefore drift
    or a delay between the channels is not detected as a line.
    """
    if max((s.stop - s.start for s in segments), default=0) < 2:
        return ()
    angle = log.driving.steady_angle(log.time)
    usable = ~log.spikes
    speed = log.smooth_speed(angle)
    steps = np.concatenate([np.abs(np.diff(angle[s.start : s.stop])) for s in segments])
    per_turn = REV / max(float(np.quantile(steps, _FASTEST)), 1e-12)
    highest = min(HIGHEST, per_turn / _ALIAS)
    size = max(1, whole_below(per_turn / (_ROWS_PER_CYCLE * highest)))
    time = (log.time - log.time.mean()) / max(float(np.ptp(log.time)), 1e-300)
    columns = [np.ones(len(log)), time, time**2, scaled(speed.value)]
    if log.torque is not None:
        columns.append(scaled(log.torque))
    channels = [angle, log.transmission_error, *columns]
    runs = []
    for segment in segments:
        rows = segment.start + np.flatnonzero(usable[segment.start : segment.stop])
        rows = rows[: len(rows) // size * size]
        if len(rows) < _FEWEST_ROWS * size:
            continue
        means = [channel[rows].reshape(-1, size).mean(axis=1) for channel in channels]
        runs.append(Stretch(means[0], means[1], np.stack(means[2:], axis=1), segment.flank))
    highest = min(highest, highest_resolved(runs)) if runs else 0.0
    return find_lines(runs, highest=highest, most=_MOST) if highest >= 1 else ()


HIGHEST_ORDER = 6
"""Highest order of a hidden shaft; lines of a shaft have low orders (chosen)."""

_CLEARER = 0.1
"""A shaft with orders up to 2 × `HIGHEST_ORDER` counts only if its coincidence is smaller than that
of the shaft with low orders by this factor; chosen value."""

COINCIDENCE = 1e-3  # largest likelihood ratio of a coincidence to a shaft; chosen value


@dataclass(frozen=True)
class Multiples:
    """Hidden shaft: lines at multiples of one frequency.

    **Arguments**
    - `turns`: the frequency, turns of the shaft per driving turn. - `std`: its standard error.
    - `orders`: order of every line of the shaft, ascending.
    - `coincidence`: ratio of the likelihood of lines at random frequencies to that of the shaft, or
      an upper bound of the probability that random lines imitate the shaft.
    """

    turns: float
    std: float
    orders: tuple[int, ...]
    coincidence: float


def hidden_shaft(cycles: Sequence[float], stds: Sequence[float]) -> Multiples | None:
    """Return the shaft whose orders explain several of the lines, or None.

    Of several possible shafts, the one that is least probable as a coincidence is returned.
    If a line c₀ ± s₀ has order k₀, its shaft turns f = c₀/k₀ times. If another line c ± s has order
    m of this shaft, the density of c is normal about m f with the variance s² + (m s₀/k₀)². If not,
    c lies anywhere between two multiples with the density 1/f. The product of the ratios of these
    densities over all lines of the shaft, divided by the number of ways to choose k₀ and the lines,
    is the likelihood ratio of a shaft to a coincidence. It must exceed 1000.

    **Arguments**
    - `cycles`, `stds`: frequencies of lines with standard errors, cycles per driving revolution.

    **Example**
    ```python
    >>> from vttig_jax.logs.lines.search import hidden_shaft
    >>> shaft = hidden_shaft([3.0874, 1.5441, 4.6307], [0.0004, 0.003, 0.003])
    >>> round(shaft.turns, 4), shaft.orders
    (1.5437, (1, 2, 3))

    ```
    """
    lines = sorted(zip(stds, cycles, strict=True))
    best = _best(lines, HIGHEST_ORDER)
    if best is None or best.coincidence >= COINCIDENCE:
        return None
    slower = _best(lines, 2 * HIGHEST_ORDER)  # its even orders alone are a shaft of twice the speed
    return slower if slower and slower.coincidence < _CLEARER * best.coincidence else best


def _best(lines: Sequence[tuple[float, float]], highest: int) -> Multiples | None:
    """Return the shaft with orders up to `highest` that is least probable as a coincidence."""
    found = [
        one
        for start in range(len(lines) - 1)
        for order in range(1, highest + 1)
        if (one := _of_order(lines[start:], order, len(lines), highest)) is not None
    ]
    return min(found, key=lambda one: one.coincidence, default=None)


def _of_order(
    lines: Sequence[tuple[float, float]], first: int, total: int, highest: int
) -> Multiples | None:
    """Return the shaft for which the first of `lines` has the order `first`, or None.

    `lines` are pairs (standard error, frequency) in cycles per revolution, the most precise first.
    `total` is the number of all lines, and `highest` is the highest order.
    """
    base_std, base = (part / first for part in lines[0])
    members, chance = {first: lines[0]}, 1.0
    for std, cycles in lines[1:]:
        order = round(cycles / base)
        spread = math.hypot(std, order * base_std)
        off = (cycles - order * base) / spread
        coincidence = math.sqrt(2 * math.pi) * spread * math.exp(min(off**2, 100) / 2) / base
        if 1 <= order <= highest and order not in members and coincidence < 1:
            members[order] = (std, cycles)
            chance *= coincidence
    if len(members) < 2 or math.gcd(*members) > 1:
        return None
    weights = {order: order / std for order, (std, _) in members.items()}
    std = 1 / math.hypot(*weights.values())
    turns = std**2 * sum(weights[order] * c / s for order, (s, c) in members.items())
    chance *= highest * math.comb(total, len(members))
    return Multiples(turns, std, tuple(sorted(members)), min(chance, 1.0))


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
    def of(cls, rows: Rows, highest: float) -> "Spectrum":
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
        length: int = next_fast_len(max(int(np.ceil(count)), 4 * _SPREAD), real=True)  # pyright: ignore
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
        for where, basis in rows.bases:
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

    def is_apart(self, lines: Float[np.ndarray, " k"]) -> Bool[np.ndarray, " f"]:
        """Return which frequencies lie at least one resolution from each of `lines`."""
        free = np.ones(len(self.cycles), bool)
        for line in lines:
            free &= np.abs(self.cycles - line) * self.span >= APART
        return free

    @property
    def per_cell(self) -> float:
        """Number of frequencies per resolution."""
        return 1 / (self.span * float(self.cycles[1] - self.cycles[0]))

    @property
    def knots(self) -> Int[np.ndarray, " k"]:
        """Indices of the frequencies at which the noise level is fitted."""
        count = len(self.cycles)
        apart = max(round(_KNOT_DISTANCE * self.per_cell), 1)
        return np.unique(np.append(np.arange(0, count, apart), count - 1))

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


def noise_level(
    spectrum: Spectrum,
    height: Float[np.ndarray, " f"],
    lines: Float[np.ndarray, " k"],
    at: Float[np.ndarray, " m"],
    *,
    roughly: bool = False,
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Return the level of the noise, its variance per row, and its freedom at frequencies `at`.

    The level is fitted as a power of the frequency within 40 cells around each knot. A cell is one
    resolution of the spectrum, 1 / (revolutions of the log). A knot is a frequency at which the
    level is fitted. `height` is the result of `Spectrum.height`. The heights of noise have an
    exponential distribution with the level as mean, so that the fit is a regression of the gamma
    family with logarithmic link. Heights above five times the level count as five times the level.
    Frequencies within one cell of one of `lines` (cycles per revolution) are excluded, and so are
    those that the regressors explain. Only the knots on both sides of each of `at` are fitted;
    `roughly` takes every second knot, and one frequency per cell. The freedom is the number of
    independent heights over which the level is averaged.
    """
    cycles, per_cell, knots, stride = spectrum.cycles, spectrum.per_cell, spectrum.knots, 1
    if roughly:
        knots, stride = np.append(knots[:-1:2], knots[-1]), max(round(per_cell), 1)
    else:
        right = np.searchsorted(cycles[knots], at)
        knots = knots[np.unique(np.clip([right - 1, right], 0, len(knots) - 1))]
    usable = (spectrum.remaining >= LEAST_REMAINING) & (height > 0) & spectrum.is_apart(lines)
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
    logarithm, inverse = found
    freedom = np.clip(stride / np.maximum(inverse * per_cell, 1e-12), 0.0, size / per_cell)
    level = np.exp(np.interp(at, cycles[knots], logarithm))
    return level, np.interp(at, cycles[knots], freedom)


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
    if len(spectrum.knots) <= _MANY_KNOTS or not len(places):
        return np.ones(len(places), bool)
    at = spectrum.cycles[places]
    usual, freedom = noise_level(spectrum, height, lines, at, roughly=True)
    relative = height[places] / usual
    least = relative_height(relative / _ROUGHLY, freedom).max()
    return relative_height(relative * _ROUGHLY, freedom) >= least


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
    slope, level = np.zeros_like(centre), np.zeros_like(centre)
    for number in range(iterations + 1):
        if number:
            log_level = apart * slope[:, None] + level[:, None]
            relative = np.exp(np.minimum(logarithm - log_level, np.float32(np.log(_CLIP))))
            response = relative / mean + log_level - 1
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

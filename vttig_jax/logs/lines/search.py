"""Spectral lines of the residual: their search, the blind search, and lines of a hidden shaft.

Search for periodic lines in the transmission error at unknown frequencies.

Lines of a belt, a bearing ring or an inner gear stage appear without a known tooth count or order.

Search for periodic lines of unknown period in a log before a fit.

Hidden shafts: more lines at multiples of one frequency than a coincidence can explain.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter

import numpy as np
from jaxtyping import Bool, Float

from ...base.angles import amplitude_phase, wrap_deg
from ...base.numerics.counting import whole_below
from ...base.threads import one_blas_thread
from ...base.units import ARCSEC, REV
from ..encoder_log import EncoderLog
from ..motion.segments import Segment
from .rows import (
    APART,
    LineRegression,
    Regressors,
    Rows,
    Stretch,
    filter_of_order,
    highest_resolved,
    noise_filter,
    stack,
)
from .spectrum import (
    LEAST_CYCLES,
    Spectrum,
    false_alarm_probability,
    may_be_highest,
    noise_level,
    relative_height,
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


_Level = tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]
"""Noise level at every line, and the number of independent heights over which it is averaged."""


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
    regressors = Regressors.of(rows)
    spectrum = Spectrum.of(rows, regressors, highest)
    if len(spectrum.cycles) < 2:
        return ()
    search = _Search(rows, regressors, spectrum, false_alarm)
    return search.surviving(search.candidates(most + _SPARE))[:most]


@dataclass(frozen=True, eq=False)
class _Search:
    """Search for candidate lines above the noise level, and test of their significance."""

    rows: Rows
    regressors: Regressors
    spectrum: Spectrum
    false_alarm: float

    @cached_property
    def plain(self) -> LineRegression:
        """Regression without whitening, from which all whitened ones are made."""
        return LineRegression.of(self.rows, self.regressors)

    def candidates(self, most: int) -> Float[np.ndarray, " k"]:
        """Return the frequencies of up to `most` candidate lines.

        Each step adds the line that stands highest above the noise level and refines all
        frequencies. The autoregression can follow a strong line and hide it in the whitened
        spectrum; therefore the spectrum without whitening is searched too, with its noise level.
        """
        frequencies = np.zeros(0)
        while len(frequencies) < most:
            residual = self.plain.after(frequencies)
            if self._is_rounding(residual):
                break
            taps = noise_filter(self.rows, residual)
            parts = [self.plain]
            if len(taps) > 1:
                parts.append(self.plain.whitened(taps))
            found = [(*self._highest(part, frequencies), part) for part in parts]
            score, cycles, regression = max(found, key=itemgetter(0))
            if score <= 0 or self._alarm(score) > self.false_alarm:
                break
            frequencies = regression.refine(np.append(frequencies, cycles), self._lowest)
        return frequencies

    def surviving(self, frequencies: Float[np.ndarray, " k"]) -> tuple[Line, ...]:
        """Remove the least certain line until the false-alarm probability of all is small enough.

        Return the remaining lines, the most certain first.
        """
        while len(frequencies):
            taps = noise_filter(self.rows, self.plain.after(frequencies))
            regression = self.plain.whitened(taps)
            frequencies = regression.refine(frequencies, self._lowest)
            level = self._level(regression, frequencies)
            scores = self._scores(regression, frequencies, level)
            worst = int(np.argmin(scores))
            if self._alarm(float(scores[worst])) <= self.false_alarm:
                return self._lines(regression, frequencies, scores, level)
            frequencies = np.delete(frequencies, worst)
        return ()

    def _highest(
        self, regression: LineRegression, frequencies: Float[np.ndarray, " k"]
    ) -> tuple[float, float]:
        """Return score (−ln P) and frequency of the peak highest above the noise level.

        The lines `frequencies` are fitted first, and peaks near them are excluded.
        """
        height = self.spectrum.height(regression.after(frequencies), regression.taps)
        open_ = np.flatnonzero(self._free(frequencies))
        places = open_[may_be_highest(self.spectrum, height, frequencies, open_)]
        if not len(places):
            return -1.0, 0.0
        cycles = self.spectrum.cycles[places]
        usual, freedom = noise_level(self.spectrum, height, frequencies, near=cycles).at(cycles)
        score = relative_height(height[places] / usual, freedom)
        best = int(np.argmax(score))
        return float(score[best]), float(cycles[best])

    def _scores(
        self, regression: LineRegression, frequencies: Float[np.ndarray, " k"], level: _Level
    ) -> Float[np.ndarray, " k"]:
        """Return z = −ln P of every line, where P is the probability of its height in noise alone.

        All other lines are fitted too. z is the smaller of two values. The first is the likelihood
        ratio against an autoregression of the same order that is fitted without the line, because
        a narrow resonance of the noise looks like a line. The second is the height above the local
        level of the whitened spectrum, which includes noise that the autoregression misses.
        """
        drops, misfit = regression.drops(frequencies)
        if misfit <= 0:
            return np.full(len(frequencies), np.inf)
        used = self.regressors.rank + 3 * len(frequencies) + len(regression.taps)
        rows = len(self.rows.value)
        without = [self._misfit_without(regression, frequencies, k) for k in range(len(drops))]
        gain = np.log(np.maximum(np.array(without) / misfit, 1.0))
        ratio = 0.5 * max(rows - used, 1) * gain
        usual, freedom = level
        nearby = relative_height(0.5 * drops / usual, freedom)
        return np.where(freedom >= _LEAST_FREEDOM, np.minimum(ratio, nearby), ratio)

    def _misfit_without(
        self, regression: LineRegression, frequencies: Float[np.ndarray, " k"], line: int
    ) -> float:
        """Return the sum of squares without the line of index `line`.

        The whitening filter is fitted again without this line and has the same order.
        """
        others = np.delete(frequencies, line)
        residual = self.plain.after(others)
        taps = filter_of_order(self.rows, residual, len(regression.taps) - 1)
        return self.plain.whitened(taps).misfit(others)

    def _level(self, regression: LineRegression, frequencies: Float[np.ndarray, " k"]) -> _Level:
        height = self.spectrum.height(regression.after(frequencies), regression.taps)
        return noise_level(self.spectrum, height, frequencies, near=frequencies).at(frequencies)

    @property
    def _lowest(self) -> float:
        return LEAST_CYCLES / self.rows.span

    def _free(self, frequencies: Float[np.ndarray, " k"]) -> Bool[np.ndarray, " f"]:
        cycles = self.spectrum.cycles
        free = np.ones(len(cycles), bool)
        for frequency in frequencies:
            free &= np.abs(cycles - frequency) * self.spectrum.span >= APART
        return free

    def _alarm(self, score: float) -> float:
        cycles = self.spectrum.cycles
        return false_alarm_probability(score, self.rows.turns, float(np.ptp(cycles)))

    def _is_rounding(self, residual: Float[np.ndarray, " n"]) -> bool:
        value = self.rows.value
        return float(residual @ residual) <= _ROUNDING * float(value @ value)

    def _lines(
        self,
        regression: LineRegression,
        frequencies: Float[np.ndarray, " k"],
        scores: Float[np.ndarray, " k"],
        level: _Level,
    ) -> tuple[Line, ...]:
        """Return the lines, the most certain first.

        Their standard errors use the larger noise level: the mean or the local one.
        """
        coefficients, covariance = regression.solve(frequencies)
        misfit = regression.misfit(frequencies)
        used = self.regressors.rank + 3 * len(frequencies) + len(regression.taps)
        usual = misfit / max(len(self.rows.value) - used, 1)
        nearby, freedom = level
        variance = np.where(freedom >= _LEAST_FREEDOM, np.maximum(nearby, usual), usual)
        lines = []
        for number in np.argsort(-scores, kind="stable"):
            cycles = float(frequencies[number])
            wave = slice(2 * number, 2 * number + 2)
            pair = coefficients[wave]
            amplitude, phase_deg = amplitude_phase(*pair)
            slope = pair / amplitude if amplitude > 0 else np.array([1.0, 0.0])
            correction = 2 * len(frequencies) + number
            std = float(np.sqrt(variance[number] * (slope @ covariance[wave, wave] @ slope)))
            if amplitude < _LEAST_AMPLITUDE * std:
                continue  # the amplitude is not separable from that of a close neighbour
            lines.append(
                Line(
                    cycles_per_rev=cycles,
                    cycles_std=float(
                        np.sqrt(variance[number] * covariance[correction, correction])
                    ),
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
    if not segments:
        return ()
    angle = log.driving.steady_angle(log.time)
    usable = ~log.spikes
    speed = log.smooth_speed(angle)
    steps = np.concatenate([np.abs(np.diff(angle[s.start : s.stop])) for s in segments])
    per_turn = REV / max(float(np.quantile(steps, _FASTEST)), 1e-12)
    highest = min(HIGHEST, per_turn / _ALIAS)
    size = max(1, whole_below(per_turn / (_ROWS_PER_CYCLE * highest)))
    time = (log.time - log.time.mean()) / max(float(np.ptp(log.time)), 1e-300)
    columns = [np.ones(len(log)), time, time**2, _scaled(speed.value)]
    if log.torque is not None:
        columns.append(_scaled(log.torque))
    channels = [angle, log.transmission_error, *columns]
    runs = []
    for segment in segments:
        rows = np.arange(segment.start, segment.stop)
        rows = rows[usable[rows]]
        rows = rows[: len(rows) // size * size]
        if len(rows) < _FEWEST_ROWS * size:
            continue
        means = [channel[rows].reshape(-1, size).mean(axis=1) for channel in channels]
        runs.append(Stretch(means[0], means[1], np.stack(means[2:], axis=1), segment.flank))
    highest = min(highest, highest_resolved(runs)) if runs else 0.0
    return find_lines(runs, highest=highest, most=_MOST) if highest >= 1 else ()


def _scaled(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    size = float(np.abs(values).max())
    return values / size if size > 0 else values


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

"""Search for periodic lines in the transmission error at unknown frequencies.

Lines of a belt, a bearing ring or an inner gear stage appear without a known tooth count or order.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

from ...base.angles import amplitude_phase, wrap_deg
from ...base.threads import one_blas_thread
from ...base.units import ARCSEC
from .noise import Whitening, estimate_noise, mean_square, no_whitening, noise_of_order
from .periodogram import (
    APART,
    LEAST_CYCLES,
    LineRegression,
    Scan,
    degrees_of_freedom,
    design_matrix,
    false_alarm_probability,
    refine,
    scan,
)
from .rows import Rows, Stretch, stack

_OVERSAMPLING = 4  # trial frequencies per resolution (chosen)
_MOST_TRIALS = 200_000
_LEAST_ROWS = 24
_NEIGHBOURS = 20.0
_EXCLUDED = 1.0
"""The noise floor is taken within ±20 and beyond ±1 resolutions of a line (chosen)."""

_MOST_JOINT = 3
"""Largest number of lines that are tested together (chosen)."""

_ROUNDS = 5
_ROUNDING = 1e-26
"""Largest ratio of the sum of squares to that of the values which is a rounding error (chosen)."""


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
            f" (false alarm {self.false_alarm:.1g})"
        )


@dataclass(frozen=True)
class _State:
    """Frequencies of the accepted lines, noise of their residual and its sum of squares."""

    frequencies: Float[np.ndarray, " k"]
    noise: Whitening
    misfit: float


@one_blas_thread
def find_lines(
    runs: Sequence[Stretch], *, highest: float, false_alarm: float = 1e-3, most: int = 5
) -> tuple[Line, ...]:
    """Find periodic lines in coloured noise beside the regressors, the most significant first.

    The trial frequencies extend from 1.5 cycles over the whole log to `highest`, in steps of a
    quarter of the resolution. Each trial adds a cosine and a sine of the driving angle to the
    regressors. All columns are whitened by the autoregression of the residual and weighted by its
    local size. The best line is added with a refined frequency, and the noise is estimated again.
    It is accepted if the probability that noise alone reaches its height anywhere in the scan is
    below `false_alarm`. The search continues up to `most` lines. More than 10 000 rows are averaged
    in blocks.

    **Arguments**
    - `runs`: uninterrupted stretches with rows in time order; see `Stretch`.
    - `highest`: highest frequency in cycles per revolution; at most half the rows per revolution.
    - `false_alarm`: largest false-alarm probability of a line, between 0 and 1.

    **Raises** `ValueError` for a `highest` above the limit of aliasing, or with more than 200 000
    trial frequencies.

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
    cycles = _grid(rows, highest)
    if len(cycles) < 2 or len(rows.value) < _LEAST_ROWS + rows.nuisance.shape[1]:
        return ()
    return _search(rows, cycles, false_alarm, most)


def _grid(rows: Rows, highest: float) -> Float[np.ndarray, " f"]:
    if rows.span == 0:
        return np.zeros(0)
    step = 1 / (_OVERSAMPLING * rows.span)
    count = int((highest - LEAST_CYCLES / rows.span) / step) + 1
    if count > _MOST_TRIALS:
        raise ValueError(
            f"Argument `highest` must be at most {_MOST_TRIALS * step:.4g} cycles per revolution"
            f" over {rows.span:.4g} revolutions, but is {highest:.4g}: search fewer runs at once."
        )
    return LEAST_CYCLES / rows.span + step * np.arange(max(count, 0))


def _search(
    rows: Rows, cycles: Float[np.ndarray, " f"], threshold: float, most: int
) -> tuple[Line, ...]:
    noise, misfit = estimate_noise(rows, rows.nuisance, no_whitening(rows))
    state = _State(np.zeros(0), noise, misfit)
    spectrum = scan(rows, rows.nuisance, noise, cycles)
    alarms: list[float] = []
    while len(alarms) < most:
        trial, trial_spectrum = state, spectrum
        for count in range(1, min(_MOST_JOINT, most - len(alarms)) + 1):
            extended = _with_best_line(rows, trial, trial_spectrum)
            if extended is None:
                return _lines(rows, state, spectrum, alarms)
            trial = extended
            design = design_matrix(rows, trial.frequencies)
            trial_spectrum = scan(rows, design, trial.noise, cycles)
            alarm = _alarm(rows, state, trial, trial_spectrum)
            if alarm <= threshold:
                state, spectrum = trial, trial_spectrum
                alarms += [alarm] * count
                break
        else:
            break
    return _lines(rows, state, spectrum, alarms)


def _with_best_line(rows: Rows, state: _State, spectrum: Scan) -> _State | None:
    """Add the candidate with the largest gain; return None if the residual is a rounding error."""
    if state.misfit <= _ROUNDING * float(rows.value @ rows.value):
        return None
    candidates = _candidates(rows, state, spectrum)
    trials = [_with_line(rows, state, *candidate) for candidate in candidates.items()]
    return max(trials, key=lambda trial: _gain(rows, state, trial), default=None)


def _alarm(rows: Rows, state: _State, extended: _State, spectrum: Scan) -> float:
    """Return the probability that noise alone gives each added line its part of the gain.

    Two neighbouring lines hide each other, because the noise model of one alone follows the other.
    They are tested together, also against the noise order without them, which may follow both.
    """
    count = len(extended.frequencies) - len(state.frequencies)
    gain = _gain(rows, state, extended) / count
    if count > 1:
        gain = min(gain, _gain(rows, state, extended, len(state.noise.filter) - 1) / count)
    floor = max(_floor(spectrum, line, rows.span) for line in extended.frequencies[-count:])
    freedom = _freedom(rows, extended, 2)
    return false_alarm_probability(gain / floor, rows, freedom, float(np.ptp(spectrum.cycles)))


def _freedom(rows: Rows, state: _State, per_line: int) -> int:
    columns = rows.nuisance.shape[1] + per_line * len(state.frequencies)
    return degrees_of_freedom(state.noise, columns)


def _candidates(rows: Rows, state: _State, spectrum: Scan) -> dict[float, Whitening]:
    """Return candidate frequencies of the next line, each with the noise of its scan.

    The autoregression can follow a strong line and hide it in the whitened scan. In the scan
    without whitening, division of the power by its running median removes the colour of the noise.
    """
    cycles, design = spectrum.cycles, design_matrix(rows, state.frequencies)
    unfiltered = scan(rows, design, no_whitening(rows), cycles).height
    power = np.expm1(2 * unfiltered / len(rows.value))
    usable = power > 0  # elsewhere the regressors contain the trial
    filled = np.where(usable, power, np.median(power[usable]) if usable.any() else 0.0)
    usual = median_filter(filled, 2 * round(_NEIGHBOURS * _OVERSAMPLING) + 1, mode="nearest")
    above = power / np.maximum(usual, 1e-15 * power.max(initial=1e-300))
    free = np.all(np.abs(cycles[:, None] - state.frequencies) * rows.span >= APART, axis=1)
    scans = ((spectrum.height, state.noise), (above, no_whitening(rows)))
    places = [(np.argmax(np.where(free, height, -1.0)), noise) for height, noise in scans]
    return {float(cycles[place]): noise for place, noise in places if free[place]}


def _with_line(rows: Rows, state: _State, candidate: float, noise: Whitening) -> _State:
    """Add a line, refine all frequencies together and estimate the noise of the residual."""
    frequencies = refine(rows, np.append(state.frequencies, candidate), noise)
    noise = no_whitening(rows)
    for _ in range(_ROUNDS):
        design = design_matrix(rows, frequencies)
        # The noise must not follow the residual of a small frequency error.
        near = np.concatenate([design, rows.turns[:, None] * design[:, -2:]], axis=1)
        noise, _ = estimate_noise(rows, near, noise)
        before, frequencies = frequencies, refine(rows, frequencies, noise)
        if np.array_equal(before, frequencies):
            break
    return _State(frequencies, *estimate_noise(rows, design_matrix(rows, frequencies), noise))


def _gain(rows: Rows, state: _State, extended: _State, order: int | None = None) -> float:
    """Return the log-likelihood ratio of the added lines; infinite for a residual of zero.

    The reference without them is the best autoregression of the same order, or of another `order`
    with the correction of BIC.
    """
    if extended.misfit <= 0:
        return np.inf
    extended_order = len(extended.noise.filter) - 1
    order = extended_order if order is None else order
    design = design_matrix(rows, state.frequencies)
    noise = noise_of_order(rows, design, extended.noise, order)
    ratio = mean_square(rows, design, noise) * extended.noise.rows / extended.misfit
    freedom = _freedom(rows, extended, 2)
    penalty = 0.5 * (order - extended_order) * np.log(freedom)
    return max(0.5 * freedom * np.log(ratio) + penalty, 0.0)


def _floor(spectrum: Scan, line: float, span: float) -> float:
    """Return the noise height around a line relative to white noise, at least 1.

    Colour that the autoregression misses and groups of weak lines increase it; single lines do not
    change the median.
    """
    distance = np.abs(spectrum.cycles - line) * span
    near = spectrum.height[(distance > _EXCLUDED) & (distance < _NEIGHBOURS)]
    return max(float(np.median(near)) / np.log(2.0), 1.0) if len(near) else 1.0


def _lines(rows: Rows, state: _State, spectrum: Scan, alarms: list[float]) -> tuple[Line, ...]:
    frequencies = state.frequencies
    if len(frequencies) == 0:
        return ()
    coefficients, covariance = LineRegression.from_rows(rows, state.noise).solve(frequencies)
    variance = state.misfit / _freedom(rows, state, 3)
    lines = []
    for number, (cycles, alarm) in enumerate(zip(frequencies, alarms, strict=True)):
        wave = slice(2 * number, 2 * number + 2)
        pair = coefficients[wave]
        amplitude, phase_deg = amplitude_phase(*pair)
        slope = pair / amplitude if amplitude > 0 else np.array([1.0, 0.0])
        scale = variance * _floor(spectrum, cycles, rows.span)
        correction = 2 * len(frequencies) + number
        lines.append(
            Line(
                float(cycles),
                float(np.sqrt(scale * covariance[correction, correction])),
                float(amplitude) / ARCSEC,
                float(np.sqrt(scale * (slope @ covariance[wave, wave] @ slope))) / ARCSEC,
                float(wrap_deg(phase_deg - 360.0 * (cycles * rows.origin))),
                alarm,
            )
        )
    return tuple(lines)

"""Blind search for periodic lines in the transmission error, at any cycles per revolution.

A tooth count or an order need not be known: a belt, a bearing ring or a stage inside a gearbox
shows at a period of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

from ...base.angles import amplitude_phase, wrap_deg
from ...base.threads import one_blas_thread
from ...base.units import ARCSEC
from .noise import Whitening, estimate, mean_square, of_order, plain
from .periodogram import (
    APART,
    LEAST_CYCLES,
    Regressed,
    Scan,
    chance,
    columns,
    degrees_of_freedom,
    refined,
    scan,
)
from .rows import Rows, Stretch, stack

_OVERSAMPLING = 4
_MOST_TRIALS = 200_000
_LEAST_ROWS = 24
_NEIGHBOURS = 20.0
_OWN = 1.0
"""The floor of the scan is read within ±20 and beyond ±1 resolutions of a line."""

_AHEAD = 3
"""Lines that may have to be seen together before any of them counts."""

_ROUNDS = 5
_ROUNDING = 1e-26
"""Share of the squared values below which what is left of them is rounding."""


@dataclass(frozen=True)
class Line:
    """A periodic part of the transmission error, a sin(c φ + p) with φ the driving angle.

    **Arguments**
    - `cycles_per_rev`: c, cycles per driving revolution, with its standard error `cycles_std`.
    - `amplitude_arcsec`: a > 0, with `amplitude_std_arcsec`.
    - `phase_deg`: p, at driving angle 0, in [0, 360).
    - `false_alarm`: probability that noise alone shows a line of this height anywhere in the scan.
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
    """Frequencies found so far, the noise beside them and its sum of squares."""

    found: Float[np.ndarray, " k"]
    noise: Whitening
    rest: float


@one_blas_thread
def find_lines(
    runs: Sequence[Stretch], *, highest: float, false_alarm: float = 1e-3, most: int = 5
) -> tuple[Line, ...]:
    """Lines that stand out from coloured noise and from the regressors, the clearest first.

    Every trial frequency from 1.5 cycles over the whole log to `highest`, a quarter of the
    resolution apart, offers a cosine and a sine of the driving angle beside the regressors.
    Everything is whitened by the autoregression of what is left and weighed by its local size. The
    best trial joins the regressors with its frequency refined and the noise is estimated anew; it
    counts when noise alone would reach its height anywhere in the scan with a probability below
    `false_alarm`. Then the search goes on, up to `most` lines.

    More than 10 000 rows are thinned to block means.

    **Arguments**
    - `runs`: uninterrupted stretches, rows in time order; see `Stretch`.
    - `highest`: cycles per revolution up to which to look; at most half the rows per revolution.
    - `false_alarm`: between 0 and 1.

    **Raises** `ValueError` for a `highest` that the rows cannot tell from its alias, or that needs
    more than 200 000 trial frequencies.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs import Run, find_lines
    >>> angle = 2 * np.pi * np.linspace(0.0, 20.0, 2000)
    >>> noise = np.random.default_rng(0).normal(0.0, 1e-5, 2000)
    >>> run = Run(angle, 2e-5 * np.sin(3.09 * angle) + noise, np.ones((2000, 1)))
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
    noise, rest = estimate(rows, rows.nuisance, plain(rows))
    state = _State(np.zeros(0), noise, rest)
    seen = scan(rows, rows.nuisance, noise, cycles)
    chances: list[float] = []
    while len(chances) < most:
        ahead, beyond = state, seen
        for count in range(1, min(_AHEAD, most - len(chances)) + 1):
            further = _next(rows, ahead, beyond)
            if further is None:
                return _lines(rows, state, seen, chances)
            ahead = further
            beyond = scan(rows, columns(rows, ahead.found), ahead.noise, cycles)
            alarm = _alarm(rows, state, ahead, beyond)
            if alarm <= threshold:
                state, seen = ahead, beyond
                chances += [alarm] * count
                break
        else:
            break
    return _lines(rows, state, seen, chances)


def _next(rows: Rows, state: _State, seen: Scan) -> _State | None:
    """One more line, the candidate that explains most; none where rounding is all that is left."""
    if state.rest <= _ROUNDING * float(rows.value @ rows.value):
        return None
    trials = [_joined(rows, state, *best) for best in _candidates(rows, state, seen).items()]
    return max(trials, key=lambda trial: _gain(rows, state, trial), default=None)


def _alarm(rows: Rows, state: _State, more: _State, seen: Scan) -> float:
    """Probability that noise alone gives each of the lines that were added its share of the gain.

    Two lines side by side hide one another: beside either alone an autoregression follows the
    other. They are judged together, and then against noise that may follow both.
    """
    count = len(more.found) - len(state.found)
    gain = _gain(rows, state, more) / count
    if count > 1:
        gain = min(gain, _gain(rows, state, more, len(state.noise.filter) - 1) / count)
    floor = max(_floor(seen, line, rows.span) for line in more.found[-count:])
    freedom = degrees_of_freedom(more.noise, rows.nuisance.shape[1] + 2 * len(more.found))
    return chance(gain / floor, rows, freedom, float(np.ptp(seen.cycles)))


def _candidates(rows: Rows, state: _State, seen: Scan) -> dict[float, Whitening]:
    """Trial frequencies that may hold the next line, with the noise they were found in.

    An autoregression follows a strong line and hides it from the whitened scan. The plain scan
    over the running median of its power knows no colour either, and lets single lines stand.
    """
    unfiltered = scan(rows, columns(rows, state.found), plain(rows), seen.cycles).height
    power = np.expm1(2 * unfiltered / len(rows.value))
    offered = power > 0  # elsewhere the regressors are the trial
    filled = np.where(offered, power, np.median(power[offered]) if offered.any() else 0.0)
    usual = median_filter(filled, 2 * round(_NEIGHBOURS * _OVERSAMPLING) + 1, mode="nearest")
    above = power / np.maximum(usual, 1e-15 * power.max(initial=1e-300))
    free = np.all(np.abs(seen.cycles[:, None] - state.found) * rows.span >= APART, axis=1)
    scans = ((seen.height, state.noise), (above, plain(rows)))
    places = [(np.argmax(np.where(free, height, -1.0)), noise) for height, noise in scans]
    return {float(seen.cycles[place]): noise for place, noise in places if free[place]}


def _joined(rows: Rows, state: _State, candidate: float, noise: Whitening) -> _State:
    """The lines with one more, all frequencies refined together, and the noise beside them."""
    found = refined(rows, np.append(state.found, candidate), noise)
    noise = plain(rows)
    for _ in range(_ROUNDS):
        design = columns(rows, found)
        # What a frequency a little off leaves is taken off too, or the noise would follow it.
        near = np.concatenate([design, rows.turns[:, None] * design[:, -2:]], axis=1)
        noise, _ = estimate(rows, near, noise)
        before, found = found, refined(rows, found, noise)
        if np.array_equal(before, found):
            break
    return _State(found, *estimate(rows, columns(rows, found), noise))


def _gain(rows: Rows, state: _State, more: _State, order: int | None = None) -> float:
    """Logarithm of the likelihood ratio of more lines; infinite where nothing is left.

    Without them, an autoregression of the same order explains the rows as well as it can; one of
    another `order` pays, or is paid, for the difference as in BIC.
    """
    if more.rest <= 0:
        return np.inf
    own = len(more.noise.filter) - 1
    order = own if order is None else order
    design = columns(rows, state.found)
    noise = of_order(rows, design, more.noise, order)
    before = mean_square(rows, design, noise) * more.noise.rows / more.rest
    freedom = degrees_of_freedom(more.noise, rows.nuisance.shape[1] + 2 * len(more.found))
    return max(0.5 * freedom * np.log(before) + 0.5 * (order - own) * np.log(freedom), 0.0)


def _floor(seen: Scan, line: float, span: float) -> float:
    """Height of the noise around a line over what whitened rows would show there, at least 1.

    Colour that the autoregression did not follow, or a bundle of lines too weak to count, raises
    it. The median passes over single lines.
    """
    away = np.abs(seen.cycles - line) * span
    near = seen.height[(away > _OWN) & (away < _NEIGHBOURS)]
    return max(float(np.median(near)) / np.log(2.0), 1.0) if len(near) else 1.0


def _lines(
    rows: Rows,
    state: _State,
    seen: Scan,
    chances: list[float],
) -> tuple[Line, ...]:
    found, noise = state.found, state.noise
    if len(found) == 0:
        return ()
    coefficients, covariance = Regressed.of(rows, noise).solved(found)
    variance = state.rest / degrees_of_freedom(noise, rows.nuisance.shape[1] + 3 * len(found))
    lines = []
    for number, (cycles, alarm) in enumerate(zip(found, chances, strict=True)):
        own = slice(2 * number, 2 * number + 2)
        pair = coefficients[own]
        amplitude, phase_deg = amplitude_phase(*pair)
        slope = pair / amplitude if amplitude > 0 else np.array([1.0, 0.0])
        scale = variance * _floor(seen, cycles, rows.span)
        change = 2 * len(found) + number
        lines.append(
            Line(
                float(cycles),
                float(np.sqrt(scale * covariance[change, change])),
                float(amplitude) / ARCSEC,
                float(np.sqrt(scale * (slope @ covariance[own, own] @ slope))) / ARCSEC,
                float(wrap_deg(phase_deg - 360.0 * (cycles * rows.origin))),
                alarm,
            )
        )
    return tuple(lines)

"""Numbers behind pictures: thinned lines, turns folded onto one, and the spectrum of a residual."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ..base.units import ARCSEC, DEG, REV
from ..identify.orders import is_fractional
from ..identify.records import Noise
from ..identify.result import Fit
from ..kinematics.flank_error import errors_at
from ..kinematics.harmonic import OrderModel
from ..pair.gear_pair import Flank, GearPair

FALSE_ALARM = 1e-3
"""Probability that noise alone rises anywhere above the level that a spectrum shows (chosen)."""

_MOST_BINS = 720  # of a folded turn; a chosen value

Runs = Sequence[tuple[Float[np.ndarray, " _"], Float[np.ndarray, " _"]]]
"""Places (rising or falling, in turns) and values of each run."""

Made = Callable[[Flank, Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]
"""Flank and driving angles → transmission error, all in rad."""

MOST_POINTS = 20_000
"""Largest number of points of a line (chosen), about ten times the pixels across a page."""


def thinned(
    x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], most: int = MOST_POINTS
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Return fewer points of a line, which look the same in a picture.

    The line is divided into pieces of equally many points. The points of minimum and maximum y of
    each piece and the two end points are kept, in their order.

    **Arguments**
    - `x`, `y`: the line; NaN in y is ignored if its piece also has numbers.
    - `most`: largest number of points, at least 4; shorter lines are returned unchanged.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.plotting.curves import thinned
    >>> x, y = thinned(np.arange(100.0), np.sin(np.arange(100.0)), 10)
    >>> len(x) <= 10, bool(y.max() == np.sin(np.arange(100.0)).max())
    (True, True)

    ```
    """
    if most < 4:
        raise ValueError(f"Argument `most` must be at least 4, but is {most}.")
    if len(y) <= most:
        return x, y
    width = -(-len(y) // ((most - 2) // 2))
    pieces = np.pad(y, (0, -len(y) % width), constant_values=np.nan).reshape(-1, width)
    missing = np.isnan(pieces)
    starts = np.arange(len(pieces)) * width
    lowest = starts + np.where(missing, np.inf, pieces).argmin(axis=1)
    highest = starts + np.where(missing, -np.inf, pieces).argmax(axis=1)
    kept = np.unique(np.concatenate([lowest, highest, [0, len(y) - 1]]))
    return x[kept], y[kept]


def mean_spectrum(runs: Runs) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Return frequencies and amplitudes of the mean spectrum of runs, up to half of their rows.

    Each run, less its mean, is interpolated to equal steps and windowed (Hann). The amplitudes are
    those of sines, the root of the mean power of the runs.

    **Arguments**
    - `runs`: places and values of each run.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.plotting.curves import mean_spectrum
    >>> turns = np.linspace(0.0, 20.0, 2001)
    >>> cycles, size = mean_spectrum([(turns, 3.0 * np.sin(2 * np.pi * 5.0 * turns))])
    >>> round(float(cycles[size.argmax()]), 6), round(float(size.max()), 1)
    (5.0, 3.0)

    ```
    """
    longest = max((place for place, _ in runs), key=len)
    cycles, power = np.arange(len(longest) // 2) / np.ptp(longest), 0.0
    for place, values in runs:
        order, even = np.argsort(place), np.linspace(place.min(), place.max(), len(place))
        window, values = np.hanning(len(place)), values - values.mean()
        spectrum = np.fft.rfft(np.interp(even, place[order], values[order]) * window)
        own = np.arange(len(spectrum)) / np.ptp(place)
        size = np.abs(spectrum) * 2 / window.sum()
        power += np.interp(cycles, own, size**2, right=0.0) / len(runs)
    return cycles, np.sqrt(power)


def noise_level(
    noise: Noise, runs: Runs, cycles: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " m"]:
    """Return the amplitudes, arcsec, above which noise alone rises anywhere in 1 of 1000 logs.

    The power of `mean_spectrum` is R times less than a gamma variable of shape R, for R runs, times
    its expectation, that of the autoregression: σ²/|1 − Σ c_j e^{−2πijν}|² at ν cycles in a row.
    """
    from scipy.special import gammainccinv

    mean, lags = np.zeros(len(cycles)), np.arange(1, len(noise.coefficients) + 1)
    for place, _ in runs:
        window, per_row = np.hanning(len(place)), cycles * np.ptp(place) / len(place)
        response = 1 - np.exp(-2j * np.pi * np.outer(per_row, lags)) @ np.array(noise.coefficients)
        mean += (per_row <= 0.5) * np.sum(window**2) / np.sum(window) ** 2 / np.abs(response) ** 2
    reach = gammainccinv(len(runs), FALSE_ALARM / max(len(cycles), 1)) / len(runs) ** 2
    return 2 * noise.innovation_std_deg * DEG / ARCSEC * np.sqrt(mean * reach)


@dataclass(frozen=True)
class ResidualSpectrum:
    """Spectrum of what a fit leaves: `cycles` per driving turn, amplitude `size`, noise `level`, ″.

    It ends above the highest order and line of the fit.
    """

    cycles: Float[np.ndarray, " m"]
    size: Float[np.ndarray, " m"]
    level: Float[np.ndarray, " m"]

    @property
    def words(self) -> str:
        """Whether a line rises above the noise."""
        peak = int(np.argmax(self.size * (self.size > self.level)))
        if self.size[peak] <= self.level[peak]:
            return "no line of the rest rises above what noise alone would reach"
        at = f"{self.size[peak]:.3g}″ at {self.cycles[peak]:.4g} cycles per driving turn"
        return f"a line of the rest, {at}, rises above what noise alone would reach"


def residual_spectrum(fit: Fit) -> ResidualSpectrum | None:
    """Return the spectrum of what a fit leaves in runs of half a turn; None where there is none."""
    pairs = zip(fit.curves, fit.residuals, strict=True)
    runs = [(curve.driving_angle / REV, left / ARCSEC) for curve, left in pairs]
    runs = [run for run in runs if len(run[0]) >= 16 and np.ptp(run[0]) > 0.5]
    if not runs:
        return None
    cycles, size = mean_spectrum(runs)
    lines = [one.cycles_per_rev for one in fit.checks.lines]
    shown = slice(1, np.searchsorted(cycles, 1.2 * max(20.0, fit.model.highest_order, *lines)))
    level = noise_level(fit.noise, runs, cycles)
    return ResidualSpectrum(cycles[shown], size[shown], level[shown])


def driving_turns(fit: Fit) -> float:
    """Return the largest number of turns that the driving shaft made in one direction."""
    return max((float(np.ptp(curve.driving_angle)) for curve in fit.curves), default=0.0) / REV


@dataclass(frozen=True)
class Folded:
    """Transmission error over one turn of a shaft, the mean over all its turns.

    **Arguments**
    - `shaft`: its name. - `turns`: how many were folded.
    - `middle`, `fine`: angles of the shaft, deg, of `measured` and of `fitted`.
    - `measured`: flank → error less all that the fit does not attribute to this shaft, arcsec; NaN
      where there is no row. - `fitted`: flank → what the orders of this shaft make, arcsec.
    """

    shaft: str
    turns: float
    middle: Float[np.ndarray, " n"]
    fine: Float[np.ndarray, " m"]
    measured: dict[str, Float[np.ndarray, " n"]]
    fitted: dict[str, Float[np.ndarray, " m"]]

    @property
    def words(self) -> str:
        """What each turn repeats."""
        sizes = " and ".join(f"{np.ptp(one):.4g}″" for one in self.fitted.values())
        return f"each turn of the {self.shaft} shaft repeats {sizes}, peak to peak, with its noise"


def folded_turns(fit: Fit) -> Iterator[Folded]:
    """Yield the error over a turn of each shaft that made one, also of one that only lines show."""
    turned, model = driving_turns(fit), fit.model
    if not isinstance(model, OrderModel):
        return
    terms = np.asarray(model.terms, float).reshape(-1, 2)
    teeth = fit.pair.driving.teeth if isinstance(fit.pair, GearPair) else np.inf
    mesh = (terms[:, 1] == 0) & (np.abs(terms[:, 0]) >= teeth)
    for place, (shaft, speed) in enumerate((("driving", 1.0), ("driven", abs(float(model.ratio))))):
        own = (terms[:, 1 - place] == 0) | mesh
        if turned * speed >= 1 and own.any():
            part = replace(model, offset=0 * model.offset)
            part = replace(part, cosine=model.cosine * own[None], sine=model.sine * own[None])
            highest = np.abs(terms[own] @ [1.0, float(model.ratio)]).max() / speed
            yield _folded(fit, shaft, speed, highest, lambda f, x, p=part: errors_at(p, f, x))
    for one in fit.findings if any(map(is_fractional, fit.orders)) else ():
        if one.slug == "hidden-shaft" and turned * (speed := one.numbers["turns_per_rev"]) >= 1:
            yield _folded(fit, "hidden", speed, 3.0, lambda f, x, v=speed: _lines(fit, f, x, v))


def _lines(
    fit: Fit, flank: Flank, driving: Float[np.ndarray, " n"], speed: float
) -> Float[np.ndarray, " n"]:
    """Return what the lines of a hidden shaft make, with their phases of the middle of the log."""
    middle, error = np.mean([np.mean(curve.driving_angle) for curve in fit.curves]), 0.0 * driving
    for one in fit.orders:
        whole = round(one.order / speed) * speed
        if one.flank == flank and is_fractional(one) and abs(one.order - whole) < 0.02 * speed:
            phase = whole * driving + (one.order - whole) * middle + one.phase_deg * DEG
            error = error + one.amplitude_arcsec * ARCSEC * np.sin(phase)
    return error


def _folded(fit: Fit, shaft: str, speed: float, highest: float, made: Made) -> Folded:
    """Return the error over a turn of a shaft that makes `speed` turns in a driving turn.

    The turn has at least eight parts for each cycle of the `highest` order; `made` is what the
    shaft makes of a flank at driving angles, rad.
    """
    bins = int(np.clip(8 * highest, 90, _MOST_BINS))
    middle, fine = (np.arange(n) * 360.0 / n + 180.0 / n for n in (bins, 4 * bins))
    measured, fitted = {}, {}
    flanks: tuple[Flank, ...] = tuple(dict.fromkeys(curve.flank for curve in fit.curves))
    for flank in flanks:
        runs = [k for k, curve in enumerate(fit.curves) if curve.flank == flank]
        angle = np.concatenate([fit.curves[k].driving_angle for k in runs])
        left = np.concatenate([fit.residuals[k] for k in runs])
        error = made(flank, np.append(angle, fine * DEG / speed)) / ARCSEC
        place = (angle / REV * speed % 1.0 * bins).astype(int) % bins
        count = np.bincount(place, minlength=bins)
        total = np.bincount(place, error[: len(angle)] + left / ARCSEC, bins)
        measured[flank] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
        fitted[flank] = error[len(angle) :]
    return Folded(shaft, driving_turns(fit) * speed, middle, fine, measured, fitted)

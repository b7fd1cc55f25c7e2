"""Search for hidden shafts: more power than noise has at multiples of one frequency (a comb).

The frequencies of weak lines are too uncertain to decide whether they are multiples, and the
search may miss weak lines. Therefore the height of the spectrum at the multiples is tested. The
height at a frequency is half the decrease of the sum of squares by a line there. A resolution is
1 / (revolutions of the log), in cycles per revolution.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import CubicSpline
from scipy.special import gammaincc

from ...base.threads import one_blas_thread
from .comparison import Comparison
from .hidden_shaft import COINCIDENCE, HIGHEST_ORDER, Multiples
from .noise import noise_filter
from .noise_level import noise_level, relative_height
from .regression import LineRegression, Regressors
from .rows import Rows, Stretch, highest_resolved, stack
from .spectrum import LEAST_CYCLES, Spectrum

_MOST_BASES = 3  # a shaft must contain one of this number of most certain lines (chosen)
_PRESENT = math.log(1e3)
"""A multiple is present if −ln P of its height is at least this value, where P is the probability
of such a height in noise alone at a given frequency (chosen)."""

_APART = 3.0
"""Heights within this many resolutions of a line are not counted for the share p, because the line
and its own modulation cause them (chosen)."""

_LEAST_APART = 4.0  # least distance of two multiples in resolutions; chosen value
_NYQUIST = 0.49  # largest frequency of a multiple in cycles per row; chosen value
_FINER = 8  # steps of the fine grid per frequency step of the spectrum; chosen value
_NEARBY = 30
"""Frequencies on each side of one from which its height is interpolated; those farther away change
it by less than 1e-15 of their own heights."""

_STEP = 0.05  # step for the curvature, relative to half the range of the refinement; chosen value


@one_blas_thread
def shaft_of_multiples(
    sides: Sequence[Sequence[Stretch]],
    lines: Sequence[float],
    *,
    highest: float,
    is_order: Callable[[float], bool],
) -> Multiples | None:
    """Return the hidden shaft whose orders explain lines of the spectrum, or None.

    If a known line c has order k, its shaft turns f = c/k times per driving revolution. All
    multiples m f are then fitted, the strongest first, with separate amplitudes on every side. For
    every multiple, p is the share of the spectrum that stands at least as high above the local
    noise level as the multiple. If lines lie at random frequencies, p is uniform, whatever the
    heights of the lines and the colour of the noise. The product of the r smallest of M shares is
    at most x with a probability below (M over r) Q(r, −ln x), where Q is the upper incomplete gamma
    function. This bound times the number of the tried c, k and r must be below 0.001.

    **Arguments**
    - `sides`: stretches of every side (a flank), from which the known lines are not removed.
    - `lines`: frequencies of certain lines in cycles per revolution, the most certain first.
    - `highest`: highest frequency of a multiple in cycles per revolution.
    - `is_order`: whether a frequency is a whole order of a shaft with an encoder; such a multiple
      is not counted.

    **Example**
    ```python
    >>> import numpy as np
    >>> from vttig_jax.logs import Stretch
    >>> from vttig_jax.logs.lines.comb import shaft_of_multiples
    >>> angle = 2 * np.pi * np.linspace(0.0, 40.0, 4000)
    >>> noise = np.random.default_rng(0).normal(0.0, 1e-5, 4000)
    >>> value = noise + 5e-5 * np.sin(3.0874 * angle)
    >>> value += sum(2e-5 * np.sin(m * 1.5437 * angle) for m in (1, 3, 4))
    >>> run = Stretch(angle, value, np.ones((4000, 1)))
    >>> shaft = shaft_of_multiples([[run]], [3.0874], highest=12.0, is_order=lambda f: False)
    >>> round(shaft.turns, 3), shaft.orders
    (1.544, (1, 2, 3, 4))

    ```
    """
    resolved = [highest_resolved(side, 1 / _NYQUIST) for side in sides if side]
    highest = min([highest, *resolved])
    bases = [line for line in lines if line < highest][:_MOST_BASES]
    spectra = [_Side.of(side, highest) for side in sides if bases]
    if not spectra or any(one is None for one in spectra):
        return None
    grid = _finer(max((one.spectrum for one in spectra if one), key=lambda s: s.span))
    trials = len(bases) * HIGHEST_ORDER
    found = [
        one
        for base in bases
        for one in _of_base(base, [side for side in spectra if side], grid, is_order)
    ]
    best = min(found, key=lambda one: one.coincidence, default=None)
    if best is None or trials * best.coincidence >= COINCIDENCE:
        return None
    turns, std = _refined(sides, best, highest)
    return Multiples(turns, std, best.orders, trials * best.coincidence)


@dataclass(frozen=True, eq=False)
class _Side:
    """Rows of one side (flank), their spectrum, and the unwhitened line regression `plain`."""

    rows: Rows
    spectrum: Spectrum
    plain: LineRegression

    @classmethod
    def of(cls, runs: Sequence[Stretch], highest: float) -> "_Side | None":
        rows = stack(runs, highest)
        if highest * rows.span <= LEAST_CYCLES:
            return None
        regressors = Regressors.of(rows)
        spectrum = Spectrum.of(rows, regressors, highest)
        if len(spectrum.cycles) < 2:
            return None
        return cls(rows, spectrum, LineRegression.of(rows, regressors))

    def after(self, fixed: Sequence[float], grid: Float[np.ndarray, " f"]) -> "_Heights":
        """Return −ln P at the frequencies `grid`, after a fit of lines at the frequencies `fixed`.

        P is the probability that noise of the local level alone has the height of the spectrum at
        the frequency. The autoregression may follow a strong line and hide it; therefore the larger
        of the values with and without whitening is used.
        """
        left = self.plain.after(fixed)
        white = self.plain.whitened(noise_filter(self.rows, left))
        spectra = [self.spectrum.height(left, self.plain.taps)]
        if white is not self.plain:
            spectra.append(self.spectrum.height(white.after(fixed), white.taps))
        return _Heights(self.spectrum, np.array(fixed), tuple(spectra), grid)


@dataclass(frozen=True, eq=False)
class _Heights:
    """Heights −ln P above the local noise level after a fit of the lines `fixed`.

    They are computed at the frequencies of the spectrum and interpolated at those of `grid`.
    """

    spectrum: Spectrum
    fixed: Float[np.ndarray, " k"]
    spectra: tuple[Float[np.ndarray, " _"], ...]
    grid: Float[np.ndarray, " f"]

    @cached_property
    def everywhere(self) -> Float[np.ndarray, " f"]:
        """Heights at all frequencies of the grid."""
        places = np.arange(len(self.spectrum.cycles))
        return self._interpolated(self._scores(places), places, self.grid)

    def at(self, cycles: Sequence[float]) -> Float[np.ndarray, " m"]:
        """Return the heights at some frequencies; only heights near them are computed."""
        count = len(self.spectrum.cycles)
        if count <= len(cycles) * 2 * _NEARBY:
            return np.interp(cycles, self.grid, self.everywhere)
        middles = np.searchsorted(self.spectrum.cycles, cycles)
        starts = np.clip(middles - _NEARBY, 0, count - 2 * _NEARBY)
        near = starts[:, None] + np.arange(2 * _NEARBY)
        scores = self._scores(near.ravel()).reshape(near.shape)
        right = np.clip(np.searchsorted(self.grid, cycles), 1, len(self.grid) - 1)
        ends = np.stack([self.grid[right - 1], self.grid[right]])
        low, high = _splines(scores, (ends - self.spectrum.cycles[starts]) / self.spectrum.step)
        share = (np.asarray(cycles) - ends[0]) / (ends[1] - ends[0])
        return low + np.clip(share, 0.0, 1.0) * (high - low)

    def _scores(self, places: Int[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        """Return the heights at the frequencies of the spectrum with the indices `places`."""
        cycles = self.spectrum.cycles[places]
        scores = []
        for height in self.spectra:
            level = noise_level(self.spectrum, height, self.fixed, near=cycles).at(cycles)
            scores.append(relative_height(height[places] / level[0], level[1]))
        return np.max(scores, axis=0)

    def _interpolated(
        self,
        scores: Float[np.ndarray, " p"],
        places: Int[np.ndarray, " p"],
        at: Float[np.ndarray, " m"],
    ) -> Float[np.ndarray, " m"]:
        inside = np.clip(at, self.spectrum.cycles[0], self.spectrum.cycles[-1])
        return np.asarray(CubicSpline(self.spectrum.cycles[places], scores)(inside))


def _splines(
    values: Float[np.ndarray, "k p"], places: Float[np.ndarray, "m k"]
) -> Float[np.ndarray, "m k"]:
    """Return cubic splines through each row of equidistant values, at m places of every row.

    A place counts from the first value of the row, in steps from value to value.
    """
    count = values.shape[1]
    inside = np.clip(places, 0.0, count - 1.0)
    piece = np.clip(inside.astype(np.int64), 0, count - 2)
    coefficients = CubicSpline(np.arange(count), values, axis=1).c
    found = np.zeros_like(inside)
    for order in coefficients:  # of the powers, the highest first
        found = found * (inside - piece) + order[piece, np.arange(len(values))]
    return found


def _finer(spectrum: Spectrum) -> Float[np.ndarray, " f"]:
    cycles = spectrum.cycles
    return np.linspace(cycles[0], cycles[-1], _FINER * (len(cycles) - 1) + 1)


def _of_base(
    base: float,
    sides: Sequence[_Side],
    grid: Float[np.ndarray, " f"],
    is_order: Callable[[float], bool],
) -> list[Multiples]:
    """Return a possible shaft for every order that the line at the frequency `base` may have.

    `grid` holds the frequencies of the spectrum. The coincidence of each shaft does not include the
    factor for the number of trials.
    """
    resolution = 1 / max(side.spectrum.span for side in sides)
    first = [side.after([base], grid) for side in sides]
    tried: dict[int, dict[int, float]] = {}
    for order in range(1, HIGHEST_ORDER + 1):
        turns = base / order
        multiples = {
            m: m * turns
            for m in range(1, HIGHEST_ORDER + 1)
            if m != order and grid[0] <= m * turns <= grid[-1] and not is_order(m * turns)
        }
        if multiples and turns >= _LEAST_APART * resolution:
            tried[order] = multiples
    every = sorted({cycles for multiples in tried.values() for cycles in multiples.values()})
    at = dict(zip(every, _sum_at(first, every), strict=True))
    found = []
    for order, multiples in tried.items():
        if max(at[cycles] for cycles in multiples.values()) < _PRESENT:
            continue
        shares = _shares(base, dict(multiples), sides, grid, first)
        orders = tuple(sorted([order, *shares]))
        if shares and math.gcd(*orders) == 1:
            chance = _chance([*shares.values()], len(multiples))
            found.append(Multiples(base / order, 0.0, orders, chance))
    return found


def _sum_at(sides: Sequence[_Heights], cycles: Sequence[float]) -> Float[np.ndarray, " m"]:
    """Return the sum of the heights of all sides at the given frequencies."""
    return np.sum([one.at(cycles) for one in sides], axis=0) if len(cycles) else np.zeros(0)


def _shares(
    base: float,
    open_: dict[int, float],
    sides: Sequence[_Side],
    grid: Float[np.ndarray, " f"],
    first: Sequence[_Heights],
) -> dict[int, float]:
    """Return the share p (see `shaft_of_multiples`) of every multiple that stands above the noise.

    `open_` maps the order of each tried multiple to its frequency; the strongest is fitted first.
    `first` are the heights of every side after a fit of `base`.
    """
    span = max(side.spectrum.span for side in sides)
    fixed, shares, found = [base], {}, first
    while open_:
        at = dict(zip(open_, _sum_at(found, [*open_.values()]), strict=True))
        best = max(at, key=lambda m: at[m])
        if at[best] < _PRESENT:
            break
        counted = np.all(np.abs(grid[:, None] - np.array(fixed)) * span > _APART, axis=1)
        heights = np.sum([one.everywhere for one in found], axis=0)
        as_high = int(np.count_nonzero(heights[counted] >= at[best]))
        shares[best] = (1 + as_high) / (1 + int(np.count_nonzero(counted)))
        fixed.append(open_.pop(best))
        if open_:
            found = [side.after(fixed, grid) for side in sides]
    return shares


def _chance(shares: Sequence[float], tried: int) -> float:
    """Return the upper bound of the probability of the shares p by chance, the least over all r.

    See `shaft_of_multiples`. `tried` is the number M of tried multiples; the bound includes the
    factor for the number of r.
    """
    products = np.cumsum(-np.log(np.sort(shares)))
    bounds = [
        math.comb(tried, r) * float(gammaincc(r, product))
        for r, product in enumerate(products, start=1)
    ]
    return min(1.0, len(bounds) * min(bounds))


def _refined(
    sides: Sequence[Sequence[Stretch]], shaft: Multiples, highest: float
) -> tuple[float, float]:
    """Return the shaft frequency at which all multiples together fit best, and its standard error.

    Both are in turns per driving revolution.
    """
    from scipy.optimize import minimize_scalar  # slow to import, and `inspect` compares nothing

    runs = [run for side in sides for run in side]
    names = [str(number) for number, side in enumerate(sides) for _ in side]
    lines = [order * shaft.turns for order in shaft.orders]
    comparison = Comparison.of(runs, names, frequencies=lines, highest=highest)
    near = 0.5 * comparison.resolution / max(shaft.orders)

    def height(turns: float) -> float:
        return comparison.height([order * turns for order in shaft.orders])

    bounds = (shaft.turns - near, shaft.turns + near)
    options = {"xatol": 1e-3 * near}
    found: Any = minimize_scalar(height, bounds=bounds, method="bounded", options=options)
    turns, step = float(found.x), _STEP * near
    low, middle, high = (height(turns + sign * step) for sign in (-1.0, 0.0, 1.0))
    return turns, step * float(np.sqrt(2 / max(low + high - 2 * middle, 1e-300)))

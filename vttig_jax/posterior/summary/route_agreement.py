"""Comparison of three intervals of a coordinate: curvature of the fit, profile likelihood, sampler.

The three routes share only the likelihood. If they agree, it is unlikely that one has failed; a
disagreement is reported. Differences of the centres are in standard deviations of the draws, and
half widths are divided by those of the draws. The tolerances include the Monte-Carlo error of the
draws.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...base.files.text_tables import decimals, text_table
from ...base.numerics.quantiles import NORMAL_95
from ...base.results import TextResult
from ...base.threads import one_blas_thread
from ...identify.fit_result import Fit
from ..density.density import fit_target
from ..density.prior import Prior
from ..density.profile_likelihood import Profiler
from .draws import shown_unit
from .posterior import Posterior

CENTRES = 0.3
"""Largest accepted distance between two centres, in standard deviations (chosen)."""
WIDTHS = 0.15
"""Largest accepted relative difference of two half widths (chosen)."""
MONTE_CARLO = 3.0
"""Monte-Carlo standard errors that are added to both tolerances (chosen)."""

ONE_SIGMA = 0.6826894921370859
"""Probability within one standard deviation of a normal density."""
PROBABILITIES = (ONE_SIGMA, 0.95)
ROUTES = ("fit", "profile", "sampled")


@dataclass(frozen=True)
class Route:
    """Centre and half widths of the 68 and 95 % intervals of one coordinate by one route."""

    centre: float
    half68: float
    half95: float

    def after(self, offset: float) -> "Route":
        """Return the same intervals around a centre that is larger by `offset`."""
        return replace(self, centre=self.centre + offset)

    @property
    def half_widths(self) -> tuple[float, float]:
        """Half widths of the 68 and 95 % intervals."""
        return self.half68, self.half95


@dataclass(frozen=True)
class RouteComparison:
    """Intervals of one coordinate by three routes, in internal units.

    **Arguments**
    - `fit`, `profile`, `sampled`: routes; `profile` is infinitely wide if it is unbounded.
    - `effective`: effective number of draws of the sampled route.
    """

    name: str
    unit: str
    fit: Route
    profile: Route
    sampled: Route
    effective: float

    @property
    def monte_carlo_margin(self) -> float:
        """Monte-Carlo error of the draws times `MONTE_CARLO`, as a fraction of the std.

        For n effective draws of a normal density, the standard error of the mean is σ/√n. The
        relative standard error of a half width is 0.96/√n for the 16 and 84 % quantiles and 0.95/√n
        for the 2.5 and 97.5 % quantiles.
        """
        return MONTE_CARLO / np.sqrt(max(self.effective, 1.0))

    def shift(self, route: str) -> float:
        """Return the centre of a route minus the sampled one, in sampled standard deviations."""
        return (getattr(self, route).centre - self.sampled.centre) / self.sampled.half68

    def widths(self, route: str) -> tuple[float, float]:
        """Return the 68 and 95 % half widths of a route divided by the sampled ones."""
        widths, sampled = getattr(self, route).half_widths, self.sampled.half_widths
        return widths[0] / sampled[0], widths[1] / sampled[1]

    def centre_differs(self, route: str) -> bool:
        """Return whether the centre of a route is outside the tolerance."""
        return not abs(self.shift(route)) <= CENTRES + self.monte_carlo_margin

    def width_differs(self, route: str) -> bool:
        """Return whether a half width of a route is outside the tolerance."""
        allowed = np.log1p(WIDTHS + self.monte_carlo_margin)
        return not all(abs(np.log(ratio)) <= allowed for ratio in self.widths(route))


@dataclass(frozen=True)
class Agreement(TextResult):
    """Result of the comparison of three routes.

    **Arguments**
    - `compared`: comparison of every coordinate.
    - `widening`: largest factor by which the standard errors of the fit, and with them the density,
      are wider than the noise model alone says; 1 without widening.
    - `takes_delay_as_zero`: whether the compared constant backlash is that of a delay of zero,
      although the intervals of the fit and of the posterior contain other delays.
    """

    compared: tuple[RouteComparison, ...]
    widening: float = 1.0
    takes_delay_as_zero: bool = False

    @property
    def agreed(self) -> bool:
        """Whether no centre and no width of any coordinate is outside its tolerance."""
        return not self.sentences

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences on disagreements; each names the worst coordinate and counts the others."""
        sentences = []
        for route in ("fit", "profile"):
            resized = [c for c in self.compared if c.width_differs(route)]
            if resized:
                sentences.append(self._width_words(route, resized))
            shifted = [c for c in self.compared if c.centre_differs(route)]
            if shifted:
                sentences.append(self._centre_words(route, shifted))
        return tuple(sentences)

    def _width_words(self, route: str, resized: Sequence[RouteComparison]) -> str:
        worst = max(resized, key=lambda c: max(abs(np.log(r)) for r in c.widths(route)))
        if np.isinf(worst.profile.half95) and route == "profile":
            return f"the profile interval of {_label(worst)} is unbounded{_others(resized)}."
        ratio = max(worst.widths(route), key=lambda r: abs(np.log(r)))
        subject = {"fit": "the fit's standard error", "profile": "the profile interval"}[route]
        size = f"{ratio:.2g} times the sampled one"
        return f"{subject} of {_label(worst)} is {size}{_others(resized)}."

    def _centre_words(self, route: str, shifted: Sequence[RouteComparison]) -> str:
        worst = max(shifted, key=lambda c: abs(c.shift(route)))
        name = {"fit": "the fit's value", "profile": "the maximum of the density"}[route]
        return (
            f"{name} of {_label(worst)} is {abs(worst.shift(route)):.2g} standard deviations from"
            f" the mean of the draws{_others(shifted)}."
        )

    def to_json(self) -> dict:
        """Return the coordinates with their routes in display units, and the sentences."""
        return {
            "agreed": self.agreed,
            "sentences": list(self.sentences),
            "widening": self.widening,
            "coordinates": [_record(coordinate) for coordinate in self.compared],
        }

    def __str__(self) -> str:
        rows = []
        for coordinate in self.compared:
            unit, scale = shown_unit(coordinate.name, coordinate.unit)
            routes = [getattr(coordinate, route) for route in ROUTES]
            cells = [_in_digits(r.centre / scale, r.half95 / scale) for r in routes]
            rows.append([coordinate.name, *cells, unit])
        table = text_table(rows, ["95 %", *ROUTES, "unit"], align="lrrrl")
        words = "\n".join(self.sentences) or "the three routes agree."
        if self.takes_delay_as_zero:
            words += " The constant backlash of this table is that of a delay of zero."
        return f"{table}\n\n{words}"


def _in_digits(centre: float, half: float) -> str:
    """Return a number with three digits of its half-width."""
    places = decimals(half, centre) + 1
    return f"{centre:z.{places}f} ± {half:.{places}f}"


@one_blas_thread
def agreement(posterior: Posterior, prior: Prior = Prior()) -> Agreement:
    """Compare the fit, the profile likelihood and the draws, coordinate by coordinate.

    Centres may differ by 0.3 standard deviations and half widths by 15 %, plus three Monte-Carlo
    standard errors of the draws.

    **Arguments**
    - `posterior`: draws of `sample` or `sample_nuts`.
    - `prior`: prior of the draws.

    **Raises** `ValueError` if the draws have another prior, and the errors of `profile`.
    """
    fit = posterior.fit
    target = fit_target(fit, prior)
    if target.prior.sentences != posterior.prior:
        raise ValueError(
            f"Argument `prior` must be that of the draws, {'; '.join(posterior.prior)}, but is"
            f" {'; '.join(target.prior.sentences)}."
        )
    profiler = Profiler(target)
    effective = dict(
        zip(posterior.diagnosis.names, posterior.diagnosis.effective.tolist(), strict=True)
    )
    compared = []
    for name in posterior.physical:
        routes = _of_fit(fit, name), _of_profile(profiler, name), _of_draws(posterior, name)
        if name == "delay":  # all three count from the delay that the fit removed before
            routes = tuple(route.after(posterior.delay_offset_s) for route in routes)
        unit = posterior.units[posterior.names.index(name)]
        compared.append(RouteComparison(name, unit, *routes, effective=effective[name]))
    return Agreement(tuple(compared), posterior.widening, posterior.gap_of_delay is not None)


def _of_fit(fit: Fit, name: str) -> Route:
    place = fit.covariance_names.index(name)
    std = float(np.sqrt(fit.covariance[place, place]))
    return Route(float(fit.values[place]), std, NORMAL_95 * std)


def _of_profile(profiler: Profiler, name: str) -> Route:
    intervals = [profiler.interval(name, probability) for probability in PROBABILITIES]
    return Route(intervals[0].best, *(interval.half_width for interval in intervals))


def _of_draws(posterior: Posterior, name: str) -> Route:
    draws = posterior.values(name)
    tails = [0.5 * (1 - probability) for probability in PROBABILITIES]
    low, lower, higher, high = np.quantile(draws, [tails[1], tails[0], 1 - tails[0], 1 - tails[1]])
    return Route(float(draws.mean()), float(higher - lower) / 2, float(high - low) / 2)


def _label(coordinate: RouteComparison) -> str:
    return coordinate.name.replace("_", " ")


def _others(coordinates: Sequence[RouteComparison]) -> str:
    count = len(coordinates) - 1
    return f" ({count} other coordinate{'s' if count > 1 else ''} likewise)" if count else ""


def _record(coordinate: RouteComparison) -> dict:
    unit, scale = shown_unit(coordinate.name, coordinate.unit)
    record: dict = {"name": coordinate.name, "unit": unit, "effective_draws": coordinate.effective}
    for route in ROUTES:
        interval = getattr(coordinate, route)
        numbers = [number / scale for number in (interval.centre, *interval.half_widths)]
        kept = [number if np.isfinite(number) else None for number in numbers]
        record[route] = dict(zip(("centre", "half68", "half95"), kept, strict=True))
    return record

"""Three routes to the same interval: the fit's curvature, profile likelihood and the sampler.

They share the likelihood and nothing else, so that where they agree none of them went astray, and
where they do not the reader has to know. Widths and centres are compared in the sampled standard
deviation, with what the finite number of draws leaves open added to the tolerance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...base.files.text_tables import text_table
from ...identify.fit_result import Fit
from ...identify.report.parameters import NORMAL_95
from ..density.density import fit_target
from ..density.prior import Prior
from ..density.profile_likelihood import Profiler
from .draws import border
from .posterior import Posterior

CENTRES = 0.3
"""Standard deviations that two centres may be apart."""
WIDTHS = 0.15
"""Share by which two half widths may differ."""
MONTE_CARLO = 3.0
"""Standard errors of the draws that come on top."""

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

    @property
    def halves(self) -> tuple[float, float]:
        """Both half widths."""
        return self.half68, self.half95


@dataclass(frozen=True)
class Compared:
    """One coordinate by three routes, in internal units.

    **Arguments**
    - `fit`, `profile`, `sampled`: the routes; `profile` is infinitely wide where it is unbounded.
    - `effective`: effective draws behind the sampled one.
    """

    name: str
    unit: str
    fit: Route
    profile: Route
    sampled: Route
    effective: float

    @property
    def open(self) -> float:
        """What the draws leave open, as a share of the standard deviation.

        The standard error of a mean is σ/√n; that of half the distance between the 16 and 84 %
        quantiles, or of 2.5 and 97.5 %, is 0.96 and 0.95 of its value, over √n.
        """
        return MONTE_CARLO / np.sqrt(max(self.effective, 1.0))

    def shift(self, route: str) -> float:
        """Centre of a route less the sampled one, in sampled standard deviations."""
        return (getattr(self, route).centre - self.sampled.centre) / self.sampled.half68

    def widths(self, route: str) -> tuple[float, float]:
        """68 and 95 % half widths of a route over the sampled ones."""
        found, sampled = getattr(self, route).halves, self.sampled.halves
        return found[0] / sampled[0], found[1] / sampled[1]

    def shifted(self, route: str) -> bool:
        """Is the centre of a route too far off?"""
        return not abs(self.shift(route)) <= CENTRES + self.open

    def resized(self, route: str) -> bool:
        """Is a half width of a route too different?"""
        allowed = np.log1p(WIDTHS + self.open)
        return not all(abs(np.log(ratio)) <= allowed for ratio in self.widths(route))


@dataclass(frozen=True)
class Agreement:
    """Whether three routes lead to the same intervals.

    **Arguments**
    - `compared`: coordinate by coordinate.
    - `widening`: how many times wider the fit made its standard errors because its residual is not
      white; 1 where it did not.
    """

    compared: tuple[Compared, ...]
    widening: float = 1.0

    @property
    def agreed(self) -> bool:
        """True where no centre and no width of any coordinate is off."""
        return not self.sentences

    @property
    def sentences(self) -> tuple[str, ...]:
        """What disagrees, the worst coordinate of each kind first."""
        found = []
        for route in ("fit", "profile"):
            resized = [one for one in self.compared if one.resized(route)]
            if resized:
                found.append(self._width_words(route, resized))
            shifted = [one for one in self.compared if one.shifted(route)]
            if shifted:
                found.append(self._centre_words(route, shifted))
        return tuple(found)

    def _width_words(self, route: str, resized: Sequence[Compared]) -> str:
        worst = max(resized, key=lambda one: max(abs(np.log(r)) for r in one.widths(route)))
        if np.isinf(worst.profile.half95) and route == "profile":
            return f"the profile interval of {_label(worst)} is unbounded{_others(resized)}."
        ratio = max(worst.widths(route), key=lambda r: abs(np.log(r)))
        what = {"fit": "the fit's standard error", "profile": "the profile interval"}[route]
        why = ""
        if route == "fit" and self.widening > 1:
            why = (
                ": its residual is not what its noise model says, so it takes standard errors from"
                " blocks of the log, which the sampler does not"
            )
        size = f"{ratio:.2g} times the sampled one"
        return f"{what} of {_label(worst)} is {size}{_others(resized)}{why}."

    def _centre_words(self, route: str, shifted: Sequence[Compared]) -> str:
        worst = max(shifted, key=lambda one: abs(one.shift(route)))
        what = {"fit": "the fit's value", "profile": "the maximum of the density"}[route]
        return (
            f"{what} of {_label(worst)} is {abs(worst.shift(route)):.2g} standard deviations from"
            f" the mean of the draws{_others(shifted)}."
        )

    def to_json(self) -> dict:
        """Coordinates with their routes in the units people read, and the sentences."""
        return {
            "agreed": self.agreed,
            "sentences": list(self.sentences),
            "widening": self.widening,
            "coordinates": [_record(one) for one in self.compared],
        }

    def __str__(self) -> str:
        rows = []
        for one in self.compared:
            unit, scale = border(one.name, one.unit)
            routes = [getattr(one, route) for route in ROUTES]
            cells = [f"{r.centre / scale:.6g} ± {r.half95 / scale:.3g}" for r in routes]
            rows.append([one.name, *cells, unit])
        table = text_table(rows, ["95 %", *ROUTES, "unit"], align="lrrrl")
        words = "\n".join(self.sentences) or "the three routes agree."
        return f"{table}\n\n{words}"


def agreement(posterior: Posterior, prior: Prior = Prior()) -> Agreement:
    """Compare the fit, profile likelihood and the draws, coordinate by coordinate.

    Centres may be 0.3 standard deviations apart and half widths 15 %, plus three Monte-Carlo
    standard errors of the draws.

    **Arguments**
    - `posterior`: draws of `sample` or `sample_nuts`.
    - `prior`: that of the draws.

    **Raises** `ValueError` where the draws have another prior, and as `profile` does.
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
    compared = tuple(
        Compared(
            name,
            posterior.units[posterior.names.index(name)],
            _of_fit(fit, name),
            _of_profile(profiler, name),
            _of_draws(posterior, name),
            effective[name],
        )
        for name in posterior.physical
    )
    white = fit.checks.get("whiteness") or {}
    return Agreement(compared, float(white.get("widening", 1.0)))


def _of_fit(fit: Fit, name: str) -> Route:
    place = fit.covariance_names.index(name)
    std = float(np.sqrt(fit.covariance[place, place]))
    return Route(float(fit.values[place]), std, NORMAL_95 * std)


def _of_profile(profiler: Profiler, name: str) -> Route:
    intervals = [profiler.interval(name, probability) for probability in PROBABILITIES]
    return Route(intervals[0].best, *(one.half_width for one in intervals))


def _of_draws(posterior: Posterior, name: str) -> Route:
    draws = posterior.values(name)
    tails = [0.5 * (1 - probability) for probability in PROBABILITIES]
    low, lower, higher, high = np.quantile(draws, [tails[1], tails[0], 1 - tails[0], 1 - tails[1]])
    return Route(float(draws.mean()), float(higher - lower) / 2, float(high - low) / 2)


def _label(one: Compared) -> str:
    return one.name.replace("_", " ")


def _others(ones: Sequence[Compared]) -> str:
    count = len(ones) - 1
    return f" ({count} other coordinate{'s' if count > 1 else ''} likewise)" if count else ""


def _record(one: Compared) -> dict:
    unit, scale = border(one.name, one.unit)
    record: dict = {"name": one.name, "unit": unit, "effective_draws": one.effective}
    for route in ROUTES:
        found = getattr(one, route)
        numbers = [number / scale for number in (found.centre, *found.halves)]
        kept = [number if np.isfinite(number) else None for number in numbers]
        record[route] = dict(zip(("centre", "half68", "half95"), kept, strict=True))
    return record

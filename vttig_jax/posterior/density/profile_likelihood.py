"""Profile intervals: one coordinate is held while the density is maximised over all others.

With ℓ(x) the log-density and ℓ̂ its maximum, the interval of coordinate k holds every value c with

    2 (ℓ̂ − max {ℓ(x): x_k = c}) ≤ q,    q the quantile of χ² with one degree of freedom.

The maximum is over all other coordinates, including those of the noise, and the density includes
the prior. No draws and no normal approximation are needed: S. A. Murphy, A. W. van der Vaart, J.
Am. Stat. Assoc. 95 (2000) 449.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq, minimize
from scipy.stats import chi2

from ...base.errors import NoAnswerError
from ...base.runtime import require_x64
from ...base.threads import one_blas_thread
from ...identify.fit_result import Fit
from ...identify.noise.restricted_likelihood import LARGEST
from .density import NOISE_STD, FitTarget, fit_target

_UNBOUNDED_FROM = 64.0
"""Distance in standard errors beyond which a side counts as unbounded (chosen)."""

_TOLERANCE = 1e-4
"""Gradient, per standard error, at which a search for a maximum ends (chosen). The log-density at
its end is then too low by about 1e-8."""

_WALL = 1e6
"""Value in place of minus the log-density outside the prior (chosen). It grows with the squared
distance from the start."""

_STEP_TOLERANCE = 1e-5  # error of an end, in standard errors (chosen)
_DIFFERENCE_STEP = 1e-3  # step of gradient differences, in standard errors (chosen)
_LEAST_CURVATURE = 1e-3  # lower bound of the scaled curvatures (chosen)
_UNBOUNDED = "the density does not fall off"
_AT_BOUND = "ends at the bound of the prior"

Point = Float[np.ndarray, " d"]


@dataclass(frozen=True)
class ProfileInterval:
    """Profile interval of one coordinate, internal units.

    **Arguments**
    - `best`: value at the maximum of the density.
    - `low`, `high`: ends of the interval; None for an unbounded side.
    - `reason`: sentence if an end is missing or is the bound of the prior, else None.
    """

    name: str
    unit: str
    probability: float
    best: float
    low: float | None
    high: float | None
    reason: str | None = None

    @property
    def half_width(self) -> float:
        """Half the distance between the ends; infinite if one is missing."""
        if self.low is None or self.high is None:
            return float("inf")
        return 0.5 * (self.high - self.low)

    def to_json(self) -> dict:
        """Return the fields by name."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    def __str__(self) -> str:
        low, high = ("unbounded" if x is None else f"{x:.6g}" for x in (self.low, self.high))
        why = "" if self.reason is None else f" ({self.reason})"
        percent = f"{100 * self.probability:.6g} %"
        return f"{self.name} = {self.best:.6g}, {percent} {low} … {high} {self.unit}{why}"


@one_blas_thread
def profile(of: Fit | FitTarget, name: str, probability: float = 0.95) -> ProfileInterval:
    """Return the profile interval of one coordinate of the posterior of a fit.

    The density that is maximised includes the prior, so an end can be the bound of the prior.

    **Arguments**
    - `of`: fit (with the default prior), or target of a fit with another prior.
    - `name`: name of a coordinate in `FitTarget.names`, but not of a partial autocorrelation.
    - `probability`: probability of the interval, between 0 and 1.

    **Raises** `ValueError` for a wrong name or probability, `NoAnswerError` if the density has no
    maximum.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.posterior import profile
    >>> from vttig_jax.rig import paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig()
    >>> result = profile(vttig_jax.fit(rig.log(), rig.pair), "driving_x")
    >>> result.low < result.best < result.high
    True

    ```
    """
    return Profiler(_target(of)).interval(name, probability)


@one_blas_thread
def profiles(
    of: Fit | FitTarget, names: Sequence[str] | None = None, probability: float = 0.95
) -> dict[str, ProfileInterval]:
    """Return name → profile interval, by default for all coordinates except those of the noise.

    The arguments are those of `profile`; `names` are the names of several coordinates.
    """
    profiler = Profiler(_target(of))
    wanted = profiler.physical if names is None else names
    return {name: profiler.interval(name, probability) for name in wanted}


def _target(of: Fit | FitTarget) -> FitTarget:
    require_x64("profile")
    return of if isinstance(of, FitTarget) else fit_target(of)


class Profiler:
    """Search for the maximum of a posterior density, with all coordinates free or with one held.

    The density is that of `target` and includes the prior.

    The search uses the coordinates u, which are those of the target, except that arctanh(π/bound)
    takes the place of a partial autocorrelation π; the bound is `LARGEST`.
    """

    def __init__(self, target: FitTarget):
        self.target = target
        self._noise = target.names.index(NOISE_STD) + 1

    @property
    def physical(self) -> tuple[str, ...]:
        """Names of the coordinates that are not noise."""
        return self.target.names[: self._noise - 1]

    def interval(self, name: str, probability: float = 0.95) -> ProfileInterval:
        """Return the profile interval of one coordinate of the posterior density, prior included.

        `name` is a physical coordinate or `log_innovation_std`, not a partial autocorrelation.
        `probability` is that of the interval. The end of an unbounded side is None.

        **Raises** `ValueError` for a wrong name or probability, `NoAnswerError` if the density has
        no maximum.
        """
        if name not in self.target.names[: self._noise]:
            raise ValueError(
                f"Argument `name` must be one of {', '.join(self.target.names[: self._noise])},"
                f" but is {name!r}."
            )
        if not 0.0 < probability < 1.0:
            raise ValueError(
                f"Argument `probability` must be between 0 and 1, but is {probability:g}."
            )
        index = self.target.names.index(name)
        path = _ProfilePath(self, index)
        quantile = float(chi2.ppf(probability, 1))
        (low, below), (high, above) = (path.end(side, quantile) for side in (-1.0, 1.0))
        reasons = [f"{where}: {why}" for where, why in (("below", below), ("above", above)) if why]
        return ProfileInterval(
            name=name,
            unit=self.target.units[index],
            probability=probability,
            best=float(self.best[index]),
            low=low,
            high=high,
            reason="; ".join(reasons) or None,
        )

    @property
    def best(self) -> Point:
        """Point with the largest density, in internal units."""
        return np.append(self._maximum[0][: self._noise], self._partial(self._maximum[0]))

    def value_and_gradient(self, u: Point) -> tuple[float, Point]:
        """Return minus the log-density and its gradient in u.

        Outside the prior, return a high value that grows with the distance from the start.
        """
        point = np.append(u[: self._noise], self._partial(u))
        value, gradient = self.target.value_and_gradient(point)
        if np.isfinite(value):
            gradient = np.array(gradient)
            gradient[self._noise :] *= LARGEST * (1.0 - np.tanh(u[self._noise :]) ** 2)
            return -value, -gradient
        away = (u - self._start) / self._spread
        return _WALL * (1.0 + float(away @ away)), 2.0 * _WALL * away / self._spread

    def _partial(self, u: Point) -> Float[np.ndarray, " order"]:
        return LARGEST * np.tanh(u[self._noise :])

    @cached_property
    def _start(self) -> Point:
        centre = self.target.centre
        inner = np.clip(centre[self._noise :] / LARGEST, -0.999, 0.999)
        return np.append(centre[: self._noise], np.arctanh(inner))

    @cached_property
    def _gain(self) -> Point:
        """Derivatives du/dx with respect to the coordinates x of the target, at the start."""
        inner = np.tanh(self._start[self._noise :])
        return np.append(np.ones(self._noise), 1.0 / (LARGEST * (1.0 - inner**2)))

    @cached_property
    def _spread(self) -> Point:
        return self._gain * np.sqrt(np.diag(self.target.covariance))

    @cached_property
    def _maximum(self) -> tuple[Point, float]:
        """Point u with the largest density, and minus the log-density at this point."""
        factor = np.linalg.cholesky(self.target.covariance * np.outer(self._gain, self._gain))
        maximum = self.maximise(self._start, factor)
        if maximum[1] >= _WALL:
            raise NoAnswerError("the density has no maximum inside the prior.")
        return maximum

    @cached_property
    def covariance(self) -> Float[np.ndarray, "d d"]:
        """Inverse Hessian of minus the log-density in u at the maximum, by gradient differences."""
        top, size = self._maximum[0], self._spread
        slopes = np.empty((len(top), len(top)))
        for k in range(len(top)):
            step = np.zeros(len(top))
            step[k] = _DIFFERENCE_STEP * size[k]
            ahead, back = (self.value_and_gradient(top + s * step)[1] for s in (1.0, -1.0))
            slopes[k] = (ahead - back) * size / (2 * _DIFFERENCE_STEP)
        values, vectors = np.linalg.eigh(0.5 * (slopes + slopes.T))
        return (vectors / np.maximum(values, _LEAST_CURVATURE)) @ vectors.T * np.outer(size, size)

    def maximise(self, start: Point, directions: Float[np.ndarray, "d m"]) -> tuple[Point, float]:
        """Return the point `start` + `directions` z with the largest density, in u.

        Also return minus its log-density. With the lengths of `directions`, z is of order one.
        """

        def scaled(z):
            value, slope = self.value_and_gradient(start + directions @ z)
            return value, directions.T @ slope

        zero = np.zeros(directions.shape[1])
        result = minimize(scaled, zero, jac=True, method="BFGS", options={"gtol": _TOLERANCE})
        return start + directions @ result.x, float(result.fun)


class _ProfilePath:
    """Maxima of the density with one coordinate held some standard errors from its best value.

    The covariance is factored with this coordinate first. The first column of the Cholesky factor,
    `along`, is the path of these maxima if the density is normal. The other columns, `across`, are
    the directions of deviations from this path.
    """

    def __init__(self, profiler: Profiler, place: int):
        self.profiler = profiler
        top, self.least_value = profiler._maximum
        order = [place, *(k for k in range(len(top)) if k != place)]
        factor = np.linalg.cholesky(profiler.covariance[np.ix_(order, order)])
        back = np.argsort(order)
        self.along, self.across = factor[back, 0], factor[back, 1:]
        self.place, self.top = place, top
        self.offsets = {0.0: np.zeros(len(top))}

    def end(self, side: float, quantile: float) -> tuple[float | None, str | None]:
        """Return one end of the interval, and a remark or None.

        At the end, twice the log-density is `quantile` below its maximum. `side` is −1 for the
        lower and +1 for the upper end. An unbounded side has None as its end.
        """
        # The root of the drop is searched, because it is the number of steps if the density is
        # normal. Each distance is searched once: a second search from a nearer start may end
        # slightly lower.
        wanted = float(np.sqrt(quantile))
        excess = {0.0: -wanted}

        def excess_at(steps: float) -> float:
            if steps not in excess:
                drop = max(self.log_density_drop(side * steps), 0.0)
                excess[steps] = min(float(np.sqrt(drop)), 2 * wanted) - wanted
            return excess[steps]

        outer = wanted
        while excess_at(outer) < 0:
            outer *= 2.0
            if outer > _UNBOUNDED_FROM:
                return None, _UNBOUNDED
        root = brentq(excess_at, 0.0, outer, xtol=_STEP_TOLERANCE)
        assert isinstance(root, float)
        inside = max(root * (1 - 1e-4) - 2 * _STEP_TOLERANCE, 0.0)
        at_bound = self.log_density_drop(side * inside) < 0.9 * quantile
        value = float(self.top[self.place] + side * root * self.along[self.place])
        return value, _AT_BOUND if at_bound else None

    def log_density_drop(self, steps: float) -> float:
        """Return 2 (ℓ̂ − ℓ) with the coordinate `steps` standard errors from its best value."""
        nearest = min(self.offsets, key=lambda known: abs(known - steps))
        ratio = steps / nearest if nearest else 0.0
        start = self.top + steps * self.along + ratio * self.offsets[nearest]
        point, value = self.profiler.maximise(start, self.across)
        if value < _WALL:
            self.offsets[steps] = point - self.top - steps * self.along
        return 2.0 * (value - self.least_value)

"""Profile intervals: how far a coordinate can go while all others, noise too, do their best.

With ℓ(x) the log-density and ℓ̂ its maximum, the interval of coordinate k holds every value c with

    2 (ℓ̂ − max {ℓ(x): x_k = c}) ≤ q,    q the quantile of χ² with one degree of freedom.

No draws, no normal approximation: S. A. Murphy, A. W. van der Vaart, J. Am. Stat. Assoc. 95 (2000)
449. The prior takes part as in the sampled density.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import brentq, minimize
from scipy.stats import chi2

from ...base.arrays import Numbers
from ...base.errors import NoAnswerError
from ...base.runtime import require_x64
from ...base.threads import one_blas_thread
from ...identify.fit_result import Fit
from ...identify.noise.reml import LARGEST
from .density import NOISE_STD, Density, FitTarget, fit_target

_FARTHEST = 64.0
"""Standard errors at which a side counts as unbounded."""

_SETTLED = 1e-4
"""Gradient in units of the standard error: leaves 1e-8 of the log-density."""

_OUTSIDE = 1e6
"""Height of the wall around the prior, growing outwards."""

_STEP = 1e-3
_FLATTEST = 1e-3
_UNBOUNDED = "the density does not fall off"
_AT_BOUND = "ends at the bound of the prior"

Point = Float[np.ndarray, " d"]


@dataclass(frozen=True)
class ProfileInterval:
    """Profile interval of one coordinate, internal units.

    **Arguments**
    - `best`: value at the maximum of the density.
    - `low`, `high`: ends; None where that side has none.
    - `reason`: why an end is missing, or is not one of the data.
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
        """Half the distance between the ends; infinite where one is missing."""
        if self.low is None or self.high is None:
            return float("inf")
        return 0.5 * (self.high - self.low)

    def to_json(self) -> dict:
        """The fields by name."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    def __str__(self) -> str:
        low, high = ("unbounded" if x is None else f"{x:.6g}" for x in (self.low, self.high))
        why = "" if self.reason is None else f" ({self.reason})"
        percent = f"{100 * self.probability:.6g} %"
        return f"{self.name} = {self.best:.6g}, {percent} {low} … {high} {self.unit}{why}"


@one_blas_thread
def profile(of: Fit | FitTarget, name: str, probability: float = 0.95) -> ProfileInterval:
    """Profile interval of one coordinate of the posterior of a fit.

    **Arguments**
    - `of`: a fit (default prior), or the target of one with a prior of its own.
    - `name`: a coordinate, as in `FitTarget.names`.
    - `probability`: between 0 and 1.

    **Raises** `ValueError` for a name or probability that cannot be, `NoAnswerError` where the
    density has no maximum.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.posterior import profile
    >>> from vttig_jax.rig import paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig()
    >>> found = profile(vttig_jax.fit(rig.log(), rig.pair), "driving_x")
    >>> found.low < found.best < found.high
    True

    ```
    """
    return Profiler(_target(of)).interval(name, probability)


@one_blas_thread
def profiles(
    of: Fit | FitTarget, names: Sequence[str] | None = None, probability: float = 0.95
) -> dict[str, ProfileInterval]:
    """Profile intervals by name, of all coordinates that are no noise unless told otherwise."""
    profiler = Profiler(_target(of))
    wanted = profiler.physical if names is None else names
    return {name: profiler.interval(name, probability) for name in wanted}


def _target(of: Fit | FitTarget) -> FitTarget:
    require_x64("profile")
    return of if isinstance(of, FitTarget) else fit_target(of)


class Profiler:
    """Maxima of the density of one target, free and with a coordinate held.

    Works on u: the coordinates, but arctanh(π/bound) for a partial autocorrelation, which is free.
    """

    def __init__(self, target: FitTarget):
        self.target = target
        self._noise = target.names.index(NOISE_STD) + 1

    @property
    def physical(self) -> tuple[str, ...]:
        """Names of the coordinates that are no noise."""
        return self.target.names[: self._noise - 1]

    def interval(self, name: str, probability: float = 0.95) -> ProfileInterval:
        """Profile interval of a coordinate; see `profile`."""
        if name not in self.target.names[: self._noise]:
            raise ValueError(
                f"Argument `name` must be one of {', '.join(self.target.names[: self._noise])},"
                f" but is {name!r}."
            )
        if not 0.0 < probability < 1.0:
            raise ValueError(
                f"Argument `probability` must be between 0 and 1, but is {probability:g}."
            )
        place = self.target.names.index(name)
        path = _Path(self, place)
        quantile = float(chi2.ppf(probability, 1))
        (low, below), (high, above) = (path.end(side, quantile) for side in (-1.0, 1.0))
        reasons = [f"{where}: {why}" for where, why in (("below", below), ("above", above)) if why]
        return ProfileInterval(
            name,
            self.target.units[place],
            probability,
            float(self.best[place]),
            low,
            high,
            "; ".join(reasons) or None,
        )

    @property
    def best(self) -> Point:
        """The maximum of the density, internal units."""
        return np.append(self._top[0][: self._noise], self._partial(self._top[0]))

    def value_and_slope(self, u: Point) -> tuple[float, Point]:
        """Minus log-density and its gradient in u; a wall outside the prior."""
        value, slope = _falling(self.target.density, u, self._noise)
        if np.isfinite(value):
            return float(value), np.asarray(slope)
        away = (u - self._start) / self._spread
        return _OUTSIDE * (1.0 + float(away @ away)), 2.0 * _OUTSIDE * away / self._spread

    def _partial(self, u: Point) -> Float[np.ndarray, " order"]:
        return LARGEST * np.tanh(u[self._noise :])

    @cached_property
    def _start(self) -> Point:
        centre = self.target.centre
        inner = np.clip(centre[self._noise :] / LARGEST, -0.999, 0.999)
        return np.append(centre[: self._noise], np.arctanh(inner))

    @cached_property
    def _gain(self) -> Point:
        """du/dx at the start."""
        inner = np.tanh(self._start[self._noise :])
        return np.append(np.ones(self._noise), 1.0 / (LARGEST * (1.0 - inner**2)))

    @cached_property
    def _spread(self) -> Point:
        return self._gain * np.sqrt(np.diag(self.target.covariance))

    @cached_property
    def _top(self) -> tuple[Point, float]:
        """Maximum of the density in u, and minus its log-density there."""
        factor = np.linalg.cholesky(self.target.covariance * np.outer(self._gain, self._gain))
        found = self.lowest(self._start, factor)
        if found[1] >= _OUTSIDE:
            raise NoAnswerError("the density has no maximum inside the prior.")
        return found

    @cached_property
    def covariance(self) -> Float[np.ndarray, "d d"]:
        """Inverse curvature of the density in u at its maximum, by differences of gradients."""
        top, size = self._top[0], self._spread
        slopes = np.empty((len(top), len(top)))
        for k in range(len(top)):
            step = np.zeros(len(top))
            step[k] = _STEP * size[k]
            ahead, back = (self.value_and_slope(top + s * step)[1] for s in (1.0, -1.0))
            slopes[k] = (ahead - back) * size / (2 * _STEP)
        values, vectors = np.linalg.eigh(0.5 * (slopes + slopes.T))
        return (vectors / np.maximum(values, _FLATTEST)) @ vectors.T * np.outer(size, size)

    def lowest(self, start: Point, directions: Float[np.ndarray, "d m"]) -> tuple[Point, float]:
        """Maximum of the density over `start` + `directions` z, which scale z to order one."""

        def scaled(z):
            value, slope = self.value_and_slope(start + directions @ z)
            return value, directions.T @ slope

        zero = np.zeros(directions.shape[1])
        found = minimize(scaled, zero, jac=True, method="BFGS", options={"gtol": _SETTLED})
        return start + directions @ found.x, float(found.fun)


class _Path:
    """The maxima with one coordinate held at its best value and a number of standard errors.

    The columns of the Cholesky factor with that coordinate in front are where the others follow to
    along a normal density, and the directions in which they may leave it.
    """

    def __init__(self, profiler: Profiler, place: int):
        self.profiler = profiler
        top, self.lowest = profiler._top
        order = [place, *(k for k in range(len(top)) if k != place)]
        factor = np.linalg.cholesky(profiler.covariance[np.ix_(order, order)])
        back = np.argsort(order)
        self.along, self.across = factor[back, 0], factor[back, 1:]
        self.place, self.top = place, top
        self.warm = {0.0: np.zeros(len(top))}

    def end(self, side: float, quantile: float) -> tuple[float | None, str | None]:
        """Where twice the log-density has fallen by `quantile`, and what is special about it."""
        # Each place once: from a nearer start the others may do a little better the second time.
        seen = {0.0: -quantile}

        def above(steps: float) -> float:
            if steps not in seen:
                seen[steps] = min(self.fall(side * steps), 4 * quantile) - quantile
            return seen[steps]

        far = float(np.sqrt(quantile))
        while above(far) < 0:
            far *= 2.0
            if far > _FARTHEST:
                return None, _UNBOUNDED
        found = brentq(above, 0.0, far, xtol=1e-5)
        assert isinstance(found, float)
        at_bound = self.fall(side * found * (1 - 1e-4)) < 0.9 * quantile
        value = float(self.top[self.place] + side * found * self.along[self.place])
        return value, _AT_BOUND if at_bound else None

    def fall(self, steps: float) -> float:
        """2 (ℓ̂ − ℓ) with the coordinate `steps` standard errors from its best value."""
        nearest = min(self.warm, key=lambda known: abs(known - steps))
        ratio = steps / nearest if nearest else 0.0
        start = self.top + steps * self.along + ratio * self.warm[nearest]
        reached, value = self.profiler.lowest(start, self.across)
        if value < _OUTSIDE:
            self.warm[steps] = reached - self.top - steps * self.along
        return 2.0 * (value - self.lowest)


@eqx.filter_jit
def _falling(
    density: Density, u: Float[Numbers, " d"], noise: int
) -> tuple[Float[Array, ""], Float[Array, " d"]]:
    def minus(u):
        return -density(jnp.concatenate([u[:noise], LARGEST * jnp.tanh(u[noise:])]))

    return jax.value_and_grad(minus)(jnp.asarray(u))

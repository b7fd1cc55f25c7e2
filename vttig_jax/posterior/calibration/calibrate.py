"""Calibration of a fit: how often its intervals hold the truth of rigs like this one.

These rigs have the motion and the noise of the fit, with truths and rows drawn from its posterior.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy import stats
from scipy.signal import lfilter

from ...base.errors import NoAnswerError
from ...base.files.text_tables import key_values, text_table
from ...base.results import TextResult
from ...base.runtime import require_x64
from ...base.threads import one_blas_thread
from ...identify.fit_settings import FitSettings
from ...identify.identification import told_by
from ...identify.result import Fit
from ...model.columns import GROUPS
from ...model.density import LAGS, whitening
from ...model.functionals import Posterior
from ...model.gears import Gears, Relation, fitted_gears
from ...model.mixed_fit import MixedFit, largest, residuals
from ...model.parameter import Parameter
from ...model.rows import Rows
from ...pair.gear_pair import Drive, GearPair

OF_A_LOG = ("drift", "delay_parts")
"""Groups of coefficients that belong to a recording and not to the rig: drawn anew from their prior
at the fitted width. All others are drawn from their posterior."""

_FORGOTTEN = 2000
"""Rows after which noise has forgotten how it began (chosen)."""


@dataclass(frozen=True, eq=False)
class LikeRigs:
    """Rigs like that of a fit, with its columns, noise and coefficients.

    A rig has coefficients β ~ N(β̂, M⁻¹); those of drift and of the parts of the delay are new,
    β ~ N(0, τ²). Of gears first eccentricities and encoder errors are drawn, and the first orders
    follow through the exact relation. Its rows are y = X β + n with noise n of the fitted θ.
    """

    fit: MixedFit
    pair: GearPair | Drive
    kinds: tuple[str, ...]

    @cached_property
    def _tied(self) -> tuple[Gears, Float[np.ndarray, "p p"]] | None:
        """The fitted gears with the factor of their covariance; None without gears."""
        if not isinstance(self.pair, GearPair):
            return None
        gears = fitted_gears(self.pair, self.fit, self.kinds)
        if gears is None:
            return None
        covariance = self.fit.posterior.told(gears.rows, moved=True)[1]
        return gears, _root(covariance)

    @cached_property
    def _spread(self) -> Float[np.ndarray, "columns columns"]:
        """Factor of M⁻¹."""
        size = len(self.fit.posterior.problem.columns)
        return _root(np.asarray(self.fit.posterior.at.spread)[:size, :size])

    def drawn(self, generator: np.random.Generator) -> Float[np.ndarray, " columns"]:
        """Return the scaled coefficients β of a rig."""
        posterior, problem = self.fit.posterior, self.fit.posterior.problem
        size = len(problem.columns)
        beta = np.asarray(posterior.at.beta)[:size]
        beta = beta + self._spread @ generator.standard_normal(size)
        member = np.asarray(problem.compressed.member)[:size]
        for place, group in enumerate(GROUPS):
            own = member[:, place] > 0
            if group in OF_A_LOG and own.any():
                width = np.exp(posterior.theta[LAGS + 1 + place]) / np.sqrt(member[own, place])
                beta[own] = width * generator.standard_normal(own.sum())
        if self._tied is not None:
            gears, root = self._tied
            values = gears.values + root @ generator.standard_normal(len(root))
            places = gears.relation.tied_columns(problem.index)
            tied = np.asarray(_coefficients(gears.relation, jnp.asarray(values)))[: len(places)]
            scale = np.diag(problem.natural)[places]
            beta[places] = (tied / scale - problem.start[places]) / problem.unit
        return beta

    def truth(self, beta: Float[np.ndarray, " columns"]) -> MixedFit:
        """Return the fit as if its coefficients were those of a rig, exactly."""
        posterior = self.fit.posterior
        whole = jnp.asarray(posterior.at.beta).at[: len(beta)].set(jnp.asarray(beta))
        at = eqx.tree_at(lambda solved: solved.beta, posterior.at, whole)
        return replace(self.fit, posterior=replace(posterior, at=at))

    def refitted(
        self, beta: Float[np.ndarray, " columns"], generator: np.random.Generator
    ) -> MixedFit:
        """Return the fit of new rows of a rig in the same motion."""
        posterior, problem = self.fit.posterior, self.fit.posterior.problem
        taps, std = np.asarray(whitening(posterior.partial)), posterior.innovation_std
        expected = problem.natural @ (problem.unit * beta + problem.start)
        rows: list[Rows] = []
        left = residuals(problem.columns, self.fit.rows, expected)
        for one, off in zip(self.fit.rows, left, strict=True):
            table = one.table.copy()
            table[:, -1] -= off
            for first, last in zip(one.first, one.last, strict=True):  # a noise of its own each
                white = std * generator.standard_normal(last - first + 1 + _FORGOTTEN)
                table[first : last + 1, -1] += np.asarray(lfilter([1.0], taps, white))[_FORGOTTEN:]
            rows.append(replace(one, table=table))
        new = problem.of(problem.columns, rows, None, self.fit.delay_s)
        found = largest(new.compressed)
        posterior = Posterior(new, np.asarray(found.value), found.aux)
        return replace(self.fit, rows=tuple(rows), posterior=posterior, weights=None)


_coefficients = eqx.filter_jit(Relation.coefficients)


def _root(covariance: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """Return a matrix whose product with its transpose is a covariance."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, axes = np.linalg.eigh(covariance / scale / scale[:, None])
    return scale[:, None] * axes * np.sqrt(np.maximum(values, 0.0))


TOLERATED = 0.925
"""Smallest true coverage of 95 % intervals that counts as calibrated (chosen)."""

FAMILY_WISE = 0.01
"""Probability of a false alarm in the whole table (chosen)."""


@dataclass(frozen=True)
class Coverage:
    """Number `hits` of 95 % intervals that hold the truth, out of `rigs`.

    `low` and `high` are the 95 % Clopper–Pearson bounds of the true share.
    """

    hits: int
    rigs: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """Share of the intervals that hold the truth."""
        return self.hits / self.rigs

    @property
    def probability(self) -> float:
        """Probability of so few hits, or fewer, if the true share is the smallest tolerated one."""
        return float(stats.binom.cdf(self.hits, self.rigs, TOLERATED))


def coverage(hits: int, rigs: int) -> Coverage:
    """Return a coverage with its binomial bounds.

    **Example**
    ```python
    >>> from vttig_jax.posterior import coverage
    >>> result = coverage(950, 1000)
    >>> round(result.share, 3), round(result.low, 3), round(result.high, 3)
    (0.95, 0.935, 0.963)

    ```
    """
    interval = stats.binomtest(hits, rigs).proportion_ci(0.95, "exact")
    return Coverage(hits, rigs, float(interval.low), float(interval.high))


@dataclass(frozen=True)
class Judged:
    """Intervals of one parameter over all rigs.

    **Arguments**
    - `coverage`: of the rigs that told the parameter. - `told`: share of these rigs.
    - `rms`: rms of (value − truth)/std; 1 if the standard errors are right.
    - `std`: mean standard error in `unit`. - `holds`: False if the intervals are too narrow.
    """

    name: str
    unit: str
    coverage: Coverage
    told: float
    rms: float
    std: float
    holds: bool

    def to_json(self) -> dict:
        """Return the JSON object of the parameter."""
        return {
            "unit": self.unit,
            "rigs": self.coverage.rigs,
            "share": self.coverage.share,
            "low95": self.coverage.low,
            "high95": self.coverage.high,
            "told": self.told,
            "rms_of_errors": self.rms,
            "mean_std": self.std,
            "holds": self.holds,
        }


@dataclass(frozen=True)
class Calibration(TextResult):
    """Coverage of the intervals of a fit on rigs like its own.

    **Arguments**
    - `source`: logs of the fit. - `parameters`: name → intervals of this parameter.
    - `rigs`, `seed`: number of rigs, and seed of the draws. - `seconds`: time of the computation.
    """

    source: str
    parameters: Mapping[str, Judged]
    rigs: int
    seed: int
    seconds: float

    @property
    def failed(self) -> tuple[str, ...]:
        """Parameters whose intervals are too narrow."""
        return tuple(name for name, one in self.parameters.items() if not one.holds)

    @property
    def is_calibrated(self) -> bool:
        """Whether all intervals hold as often as they claim."""
        return not self.failed

    def to_json(self) -> dict:
        """Return the object of schema `vttig.calibrate/2`."""
        return {
            "schema": "vttig.calibrate/2",
            "source": self.source,
            "calibrated": self.is_calibrated,
            "rigs": self.rigs,
            "seed": self.seed,
            "seconds": self.seconds,
            "failed": list(self.failed),
            "parameters": {name: one.to_json() for name, one in self.parameters.items()},
        }

    def __str__(self) -> str:
        asked = [("rigs like this one", self.rigs), ("seed", self.seed)]
        head = key_values(asked, title=self.source)
        rows = []
        for name, one in self.parameters.items():
            hits, verdict = one.coverage, "holds" if one.holds else "TOO NARROW"
            shares = f"{100 * hits.share:.1f}", f"{100 * hits.low:.1f}–{100 * hits.high:.1f}"
            sizes = f"{100 * one.told:.0f}", f"{one.rms:.2f}", f"{one.std:.2g}"
            rows.append((name, *shares, *sizes, one.unit, verdict))
        titles = ["parameter", "95 % interval holds [%]", "binomial [%]", "told [%]"]
        titles += ["rms error/std", "mean std", "unit", ""]
        verdict = "yes" if self.is_calibrated else f"NO; too narrow: {', '.join(self.failed)}"
        table = text_table(rows, titles, align="lrrrrrll")
        return "\n\n".join([head, table, f"calibrated: {verdict}"])


@one_blas_thread
def calibrate(
    fit: Fit,
    *,
    rigs: int = 400,
    seed: int = 0,
    progress: Callable[[int], None] = lambda rigs: None,
) -> Calibration:
    """Return how often the intervals of a fit hold the truth on rigs like this one.

    Every rig has the motion, the noise and the columns of the fit, and its coefficients are drawn
    from the posterior of the fit; its new rows are fitted by the same model. Outliers, the search
    for lines and the assignment of flanks are not repeated.

    **Arguments**
    - `fit`: a fit of logs; one from `read_fit` has no rows and is refused.
    - `rigs`: number of rigs. - `seed`: seed of the draws.
    - `progress`: called with the number of further rigs that are done.

    **Raises** `NoAnswerError` for a fit without a determined parameter, `ValueError` for wrong
    arguments and without 64-bit floats.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.posterior import calibrate
    >>> from vttig_jax.rig import PassMotion, paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig(motion=PassMotion(speed_rpm=240.0, reversal_deg=3600.0))
    >>> result = calibrate(vttig_jax.fit(rig.log(), rig.pair), rigs=40)
    >>> result.is_calibrated, result.parameters["driving_eccentricity_mm"].coverage.rigs
    (True, 40)

    ```
    """
    require_x64("calibrate")
    if rigs < 1:
        raise ValueError(f"Argument `rigs` must be at least 1, but is {rigs!r}.")
    if not fit.core.rows:
        raise ValueError(
            "Argument `fit` must be a fit of logs, but is one from a folder, which keeps no rows;"
            " fit the logs again, or use `vttig calibrate RUN`."
        )
    start = time.perf_counter()
    settings = FitSettings() if fit.request is None else fit.request.settings

    def read(core) -> dict[str, Parameter]:
        return told_by(core, fit.pair, settings, fit.source)[1]

    like = LikeRigs(fit.core, fit.pair, settings.kinds)
    seen: dict[str, list[Judgement]] = {}
    units: dict[str, str] = {}
    for number in range(rigs):
        generator = np.random.default_rng([seed, number])
        beta = like.drawn(generator)
        truths, found = read(like.truth(beta)), read(like.refitted(beta, generator))
        for name, one in found.items():
            true = truths[name].value if name in truths else None
            if true is not None and (judged := _judged(one, true)) is not None:
                seen.setdefault(name, []).append(judged)
                units[name] = one.unit
        progress(1)
    if not seen:
        raise NoAnswerError("the fit tells no parameter whose intervals could be judged.")
    return Calibration(
        fit.source, _table(seen, units, rigs), rigs, seed, time.perf_counter() - start
    )


Judgement = tuple[float, bool, float]
"""Interval of a parameter of one rig: its error in standard errors, whether it holds the truth, and
its standard error."""


def _judged(found: Parameter, true: float) -> Judgement | None:
    """Return whether the interval of a parameter holds the truth.

    None for a parameter that the rig does not tell. An amplitude that is not significant has an
    upper limit, which is no equal-tailed interval and is left out, as is its phase.
    """
    if found.value is None or found.upper95 is not None:
        return None
    value, std, low, high = found.value, found.std, found.low95, found.high95
    assert std is not None and low is not None and high is not None  # all are given with a value
    if found.name.endswith("_phase_deg"):
        true = value + (true - value + 180.0) % 360.0 - 180.0
    return (value - true) / std, low <= true <= high, std


def _table(
    seen: Mapping[str, list[Judgement]], units: Mapping[str, str], rigs: int
) -> dict[str, Judged]:
    """Return the table; Holm's method judges all parameters together."""
    coverages = {
        name: coverage(sum(holds for _, holds, _ in own), len(own)) for name, own in seen.items()
    }
    narrow = set()
    ordered = sorted(coverages, key=lambda name: coverages[name].probability)
    for remaining, name in zip(range(len(ordered), 0, -1), ordered, strict=True):
        if coverages[name].probability > FAMILY_WISE / remaining:
            break
        narrow.add(name)
    table = {}
    for name, own in seen.items():
        errors, _, stds = (np.array(part) for part in zip(*own, strict=True))
        rms, std, told = float(np.sqrt(np.mean(errors**2))), float(np.mean(stds)), len(own) / rigs
        holds = name not in narrow
        table[name] = Judged(name, units[name], coverages[name], told, rms, std, holds)
    return table

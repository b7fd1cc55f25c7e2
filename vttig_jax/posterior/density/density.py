"""Posterior density of a fit: likelihood times prior, evaluated at many points at once."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from ...base.errors import NoAnswerError, UsageError
from ...identify.evidence import Evidence
from ...identify.fit_result import Fit
from ...identify.noise.restricted_likelihood import LARGEST
from ...pair.gear_pair import Drive
from .evaluation import (
    BATCHES,
    Density,
    Evaluation,
    evaluation,
    exact_value_and_gradient,
    in_batches,
    is_near,
    near_value_and_gradient,
)
from .likelihood import Likelihood, likelihood_of
from .local_likelihood import LocalLikelihood, local_likelihood, probes, tolerance
from .prior import OPTIONS, Prior, StatedPrior, state_prior

NOISE_STD = "log_innovation_std"
_SHAFTS, _AXES = ("driving", "driven"), ("_x", "_y", "_x_difference", "_y_difference")


@dataclass(frozen=True, eq=False)
class FitTarget:
    """Density of a fit as a sampler needs it: names, units, log-density and starting points.

    **Arguments**
    - `names`, `units`: names and units (mm, rad, s) of the coordinates, noise parameters last.
    - `density`, `prior`: density to sample, and the prior in words.
    - `centre`, `covariance`: mean and covariance of the Laplace approximation.
    - `identity`: data, options and prior; those of a checkpoint must be equal to continue it.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    density: Density
    prior: StatedPrior
    centre: Float[np.ndarray, " d"]
    covariance: Float[np.ndarray, "d d"]
    identity: dict[str, Any]

    def log_density(self, points: Float[np.ndarray, "walkers d"]) -> Float[np.ndarray, " walkers"]:
        """Return the log-density of every point; near the fit it comes from polynomials."""
        points = np.asarray(points, np.float64)
        local = self._local
        if local is None:
            return self.exact_log_density(points)
        values = in_batches(self._near, points)
        far = np.flatnonzero(~is_near(self.density, local, points))
        if far.size:
            # These points are few, so that the program of the smallest batch suffices.
            values[far] = in_batches(self._exact, points[far], BATCHES[-1:])
        return values

    def exact_log_density(
        self, points: Float[np.ndarray, "walkers d"]
    ) -> Float[np.ndarray, " walkers"]:
        """Return the log-density of every point from the exact likelihood, without polynomials."""
        return in_batches(self._exact, points)

    def value_and_gradient(
        self, point: Float[np.ndarray, " d"]
    ) -> tuple[float, Float[np.ndarray, " d"]]:
        """Return the log-density of one point and its gradient; near the fit without compiling."""
        local, density = self._local, self.density
        if local is None or not is_near(density, local, point[None])[0]:
            return exact_value_and_gradient(density, point)
        return near_value_and_gradient(density, local, point)

    @property
    def partial(self) -> Float[np.ndarray, " order"]:
        """Partial autocorrelations of the noise at the centre."""
        return self.centre[self.names.index(NOISE_STD) + 1 :]

    @cached_property
    def _local(self) -> LocalLikelihood | None:
        """Polynomial likelihood near the fit; None if it differs from the exact one at a probe.

        Differences up to `tolerance` are allowed.
        """
        widening = np.asarray(self.density.widening)
        narrow = self.covariance / np.outer(widening, widening)
        local = local_likelihood(self.density.likelihood, self.centre, narrow)
        if local is None:
            return None
        near = probes(self.centre, narrow, np.asarray(local.half_width))
        points = self.centre + (near - self.centre) * widening
        wanted = self.exact_log_density(points)
        # The probes are repeated to the number of points that the sampler evaluates at once, so
        # that the probes and the sampler use the same compiled program.
        many = np.resize(points, (BATCHES[0], points.shape[1]))
        found = in_batches(evaluation(self.density, local), many)[: len(points)]
        same = np.isfinite(wanted) & np.isfinite(found)
        wrong = np.abs(np.subtract(found, wanted, where=same, out=np.zeros(len(points))))
        agreed = np.array_equal(np.isfinite(wanted), np.isfinite(found))
        return local if agreed and wrong.max() <= tolerance(self.density.likelihood) else None

    @cached_property
    def _exact(self) -> Evaluation:
        return evaluation(self.density, None)

    @cached_property
    def _near(self) -> Evaluation:
        return evaluation(self.density, self._local)

    def starts(self, count: int, generator: np.random.Generator) -> Float[np.ndarray, "count d"]:
        """Draw `count` starting points from the Laplace approximation."""
        return generator.multivariate_normal(self.centre, self.covariance, count, method="cholesky")


def is_physical(name: str) -> bool:
    """Return whether a forward-model parameter of this name is physical, so that it can be sampled.

    Physical parameters are constant backlash, delay, and the components of eccentricities, first
    orders and encoder errors.
    """
    if name in ("constant_backlash", "delay"):
        return True
    return name.startswith(_SHAFTS) and name.endswith(_AXES)


def sampled_names(fit: Fit) -> list[str]:
    """Return the names of the physical parameters that the logs determine, in fit order.

    These parameters are sampled.
    """
    determined = () if fit.evidence is None else fit.evidence.determined
    return [name for name in fit.covariance_names if is_physical(name) and name in determined]


def fit_target(fit: Fit, prior: Prior = Prior()) -> FitTarget:
    """Return the posterior of a fit, ready to be sampled.

    The sampled parameters are the noise and, if the log determines them, eccentricities, encoder
    errors, constant backlash and delay. Offsets, drift, wind-up and free orders are integrated out.

    **Raises** `NoAnswerError` if no parameter is determined or there is no noise, `UsageError` if
    the prior excludes the fit or the fit cannot be sampled.
    """
    target = target_of(fit, prior)
    _require_inside(target, fit)
    return target


def target_of(fit: Fit, prior: Prior) -> FitTarget:
    """Return the posterior of a fit as `fit_target` does, but without evaluating the density.

    **Raises** the errors of `fit_target`, but no error for a prior that excludes the fit.
    """
    evidence = _evidence_of(fit)
    _require_one_noise(fit)
    names = list(fit.covariance_names)
    sampled = sampled_names(fit)
    if not sampled:
        raise NoAnswerError("the log determines no parameter; see `vttig fit`.", where=fit.source)
    relation, order = evidence.relation(fit.pair), len(evidence.partial)
    likelihood = likelihood_of(
        evidence.summary,
        relation=relation,
        jacobian=evidence.jacobian,
        values=fit.values,
        sampled=sampled,
        order=order,
        variance_factor=evidence.variance_factor,
    )
    rows = float(likelihood.rows) - likelihood.coefficients
    if not fit.noise.innovation_std > 0 or _is_rounding(fit):
        raise NoAnswerError(
            "the residual is only rounding error: without noise there is no posterior, and the fit"
            " itself is exact.",
            where=fit.source,
        )
    indices = [names.index(name) for name in sampled]
    partials = tuple(f"partial_{k}" for k in range(1, order + 1))
    centre = np.concatenate(
        [fit.values[indices], [np.log(fit.noise.innovation_std)], evidence.partial]
    )
    noise = np.append(0.5, 1 - evidence.partial**2) / rows
    covariance = np.zeros((len(centre), len(centre)))
    covariance[: len(sampled), : len(sampled)] = fit.covariance[np.ix_(indices, indices)]
    covariance[len(sampled) :, len(sampled) :] = np.diag(noise)
    all_names = (*sampled, NOISE_STD, *partials)
    known_prior = state_prior(prior, fit.pair, sampled, evidence.delay_s)
    widening = np.ones(len(centre))
    widening[: len(sampled)] = evidence.widening[indices]
    return FitTarget(
        names=all_names,
        units=(*(_unit(fit, name) for name in sampled), *("1",) * (1 + order)),
        density=_density(likelihood, known_prior, all_names, centre=centre, widening=widening),
        prior=known_prior,
        centre=centre,
        covariance=covariance,
        identity=_identity(fit, prior),
    )


def _evidence_of(fit: Fit) -> Evidence:
    """Return the compressed logs of a fit.

    **Raises** `UsageError` for a fit of a given flank model and for one without compressed logs.
    """
    if fit.given is not None:
        raise UsageError(
            f"this fit is of the flank model {fit.given.name}, but the density of the sampler knows"
            " the exact relation only; take the Gaussian of `covariance` and `values`, or fit"
            " without `model`.",
            where=fit.source,
        )
    if fit.evidence is None:
        raise UsageError(
            "this fit holds no lag products, which sampling needs; repeat it with `vttig fit`"
            " --overwrite.",
            where=fit.source,
        )
    return fit.evidence


def _require_one_noise(fit: Fit) -> None:
    """Raise `UsageError` if the fit has a separate noise model for each speed plateau."""
    if fit.noise.plateaus:
        raise UsageError(
            "the sampler needs one noise model for the whole rig, but this fit has one per speed;"
            " fit it again without --noise-of plateau, or sample the logs of one speed.",
            where=fit.source,
        )


def _density(
    likelihood: Likelihood,
    prior: StatedPrior,
    names: Sequence[str],
    *,
    centre: Float[np.ndarray, " d"],
    widening: Float[np.ndarray, " d"],
) -> Density:
    bound = np.full(len(names), np.inf)
    for name, size in prior.bounds.items():
        bound[names.index(name)] = size
    bound[[name.startswith("partial_") for name in names]] = LARGEST
    return Density(
        likelihood=likelihood,
        bound=bound,
        planes=tuple(
            (names.index(disc.coordinates[0]), names.index(disc.coordinates[1]))
            for disc in prior.discs
        ),
        plane_bound=np.array([disc.bound for disc in prior.discs]),
        plane_std=np.array([disc.std for disc in prior.discs]),
        flat_in_amplitude=tuple(disc.flat_in_amplitude for disc in prior.discs),
        centre=centre,
        widening=widening,
    )


def _unit(fit: Fit, name: str) -> str:
    if name == "delay":
        return "s"
    return "rad" if "encoder" in name or "backlash" in name or isinstance(fit.pair, Drive) else "mm"


def _is_rounding(fit: Fit) -> bool:
    """Return whether the noise is so small that it is only rounding of the transmission error."""
    largest = max((np.abs(c.transmission_error).max(initial=0.0) for c in fit.curves), default=0.0)
    return fit.noise.innovation_std <= 1e-10 * float(largest)


def _identity(fit: Fit, prior: Prior) -> dict[str, Any]:
    """Return JSON values of data, model and prior; those of a checkpoint must be equal."""
    assert fit.evidence is not None
    summary = fit.evidence.summary
    largest = float(fit.evidence.widening.max(initial=1.0))
    return {
        **({"widening": round(largest, 3)} if largest > 1 else {}),
        "data_sha256": fit.sha256,
        "pair": fit.pair.name,
        "flanks": "".join(flank.flank for flank in summary.flanks),
        "rows": [flank.rows for flank in summary.flanks],
        "orders": [harmonic.name for harmonic in summary.terms.free + summary.terms.tied],
        "columns": [f"{name} of log {log + 1}" for name, log in summary.columns.names],
        "encoder_terms": fit.evidence.encoder_terms,
        "gear_terms": fit.evidence.gear_terms,
        "delay_s": round(fit.evidence.delay_s, 9),
        "variance_factor": round(fit.evidence.variance_factor, 6),
        "noise": f"{fit.noise.name}, stationary in {fit.noise.choice.stationary_in}",
        "noise_order": len(fit.evidence.partial),
        "prior": asdict(prior),
    }


def _require_inside(target: FitTarget, fit: Fit) -> None:
    """Raise an error if the density is zero at the fit.

    If a bound of the prior is the cause, it is a `UsageError` that names the option to widen it.
    Otherwise it is a `NoAnswerError`.
    """
    if np.isfinite(target.exact_log_density(target.centre[None])[0]):
        return
    centre, density = target.centre, target.density
    for (x, y), disc in zip(density.planes, target.prior.discs, strict=True):
        if np.hypot(centre[x], centre[y]) > disc.bound:
            raise UsageError(_excluded(disc.words, disc.field), where=fit.source)
    outside = [target.names[k] for k in np.flatnonzero(np.abs(centre) > np.asarray(density.bound))]
    if "constant_backlash" in outside:
        words = next(s for s in target.prior.sentences if s.startswith("constant backlash"))
        raise UsageError(_excluded(words, "backlash_deg"), where=fit.source)
    names = ", ".join(outside).replace("_", " ") or "the fitted point"
    raise NoAnswerError(
        f"the log density of the fit is zero ({names}), so no walker can start there; see `vttig"
        " fit`.",
        where=fit.source,
    )


def _excluded(words: str, field: str) -> str:
    return (
        f"the prior excludes the fit ({words}); widen it with {OPTIONS[field]} (in Python"
        f" Prior({field}=…))."
    )

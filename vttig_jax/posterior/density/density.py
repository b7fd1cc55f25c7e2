"""The posterior density of a fit: likelihood times prior, over points in a table."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.arrays import Numbers, float64
from ...base.errors import NoAnswerError, UsageError
from ...identify.fit_result import Fit
from ...identify.noise.reml import LARGEST
from ...pair.gear_pair import Drive
from .likelihood import Likelihood, likelihood_of
from .prior import Disc, Prior, StatedPrior, stated

NOISE_STD = "log_innovation_std"
_SHAFTS, _AXES = ("driving", "driven"), ("_x", "_y", "_x_difference", "_y_difference")


class Density(eqx.Module):
    """Log-density of (asked parameters, log std of the innovations, partial autocorrelations).

    `centre` and `width` of the planes and bounds are in internal units: mm, rad, s.
    """

    likelihood: Likelihood
    bound: Float[Numbers, " d"] = eqx.field(converter=float64)
    planes: tuple[tuple[int, int], ...] = eqx.field(static=True)
    plane_bound: Float[Numbers, " planes"] = eqx.field(converter=float64)
    plane_std: Float[Numbers, " planes"] = eqx.field(converter=float64)
    flat_in_amplitude: tuple[bool, ...] = eqx.field(static=True)

    def __call__(self, point: Float[Array, " d"]) -> Float[Array, ""]:
        """Log-density at one point, −∞ outside the prior."""
        asked = len(self.likelihood.asked)
        inside = jnp.all(jnp.abs(point) <= jnp.asarray(self.bound))
        prior = jnp.zeros(())
        for place, (x, y) in enumerate(self.planes):
            square = point[x] ** 2 + point[y] ** 2
            inside &= square <= jnp.asarray(self.plane_bound)[place] ** 2
            prior -= 0.5 * square / jnp.asarray(self.plane_std)[place] ** 2
            if self.flat_in_amplitude[place]:
                prior -= 0.5 * jnp.log(square)
        partial = jnp.clip(point[asked + 1 :], -LARGEST, LARGEST)
        value = self.likelihood(point[:asked], partial, point[asked]) + prior
        return jnp.where(inside & jnp.isfinite(value), value, -jnp.inf)


@dataclass(frozen=True, eq=False)
class FitTarget:
    """What a sampler needs of a fit: names, units, log-density and starting points.

    **Arguments**
    - `names`, `units`: of the coordinates; mm, rad and s, noise parameters last.
    - `density`, `prior`: what is sampled, and the prior in words.
    - `centre`, `covariance`: of the Laplace approximation, from which walkers start.
    - `identity`: data, options and prior, that a checkpoint has to agree with.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    density: Density
    prior: StatedPrior
    centre: Float[np.ndarray, " d"]
    covariance: Float[np.ndarray, "d d"]
    identity: dict[str, Any]

    def log_density(self, points: Float[np.ndarray, "walkers d"]) -> Float[np.ndarray, " walkers"]:
        """Log-density of every point, NumPy float64."""
        return np.asarray(_over_points(self.density, points))

    def starts(self, count: int, generator: np.random.Generator) -> Float[np.ndarray, "count d"]:
        """Points drawn from the Laplace approximation."""
        return generator.multivariate_normal(self.centre, self.covariance, count, method="cholesky")


@eqx.filter_jit
def _over_points(density: Density, points: Float[Numbers, "walkers d"]) -> Float[Array, " walkers"]:
    return jax.vmap(density)(jnp.asarray(points))


def is_physical(name: str) -> bool:
    """Is this parameter of a relation one that the sampler asks for?"""
    if name in ("constant_backlash", "delay"):
        return True
    return name.startswith(_SHAFTS) and name.endswith(_AXES)


def fit_target(fit: Fit, prior: Prior = Prior()) -> FitTarget:
    """The posterior of a fit, ready to be sampled.

    Asked for are eccentricities, encoder errors, constant backlash and delay as far as the log
    determines them, and the noise; offsets, drift, wind-up and free orders are integrated out.

    **Raises** `NoAnswerError` where nothing is determined or there is no noise to speak of,
    `UsageError` where the prior leaves the fit out.
    """
    evidence = fit.evidence
    if evidence is None:
        raise UsageError(
            "this fit holds no lag products to sample from; make it again with `vttig fit`"
            " --overwrite.",
            where=fit.source,
        )
    _require_one_noise(fit)
    names = list(fit.covariance_names)
    asked = [name for name in names if is_physical(name) and name in evidence.determined]
    if not asked:
        raise NoAnswerError("the log determines no parameter; see `vttig fit`.", where=fit.source)
    relation, order = evidence.relation(fit.pair), len(evidence.partial)
    likelihood = likelihood_of(
        evidence.summary,
        relation,
        evidence.jacobian,
        fit.values,
        asked,
        order,
        evidence.variance_factor,
    )
    rows = float(likelihood.rows) - likelihood.coefficients
    if not fit.noise.innovation_std > 0 or _is_rounding(fit):
        raise NoAnswerError(
            "the residual is nothing but rounding: without noise there is no posterior; the fit"
            " itself is exact.",
            where=fit.source,
        )
    places = [names.index(name) for name in asked]
    partials = tuple(f"partial_{k}" for k in range(1, order + 1))
    centre = np.concatenate(
        [fit.values[places], [np.log(fit.noise.innovation_std)], evidence.partial]
    )
    noise = np.append(0.5, 1 - evidence.partial**2) / rows
    covariance = np.zeros((len(centre), len(centre)))
    covariance[: len(asked), : len(asked)] = fit.covariance[np.ix_(places, places)]
    covariance[len(asked) :, len(asked) :] = np.diag(noise)
    all_names = (*asked, NOISE_STD, *partials)
    known = stated(prior, fit.pair, asked, evidence.delay_s)
    target = FitTarget(
        names=all_names,
        units=(*(_unit(fit, name) for name in asked), *("1",) * (1 + order)),
        density=_density(likelihood, known, all_names),
        prior=known,
        centre=centre,
        covariance=covariance,
        identity=_identity(fit, prior),
    )
    _require_inside(target, fit)
    return target


def _require_one_noise(fit: Fit) -> None:
    """Refuse noise that differs from speed to speed."""
    if fit.noise.plateaus:
        raise UsageError(
            "the sampler knows one noise for the whole rig, but every speed of this fit has its"
            " own; fit it again without --noise-of plateau, or sample the logs of one speed.",
            where=fit.source,
        )


def _density(likelihood: Likelihood, prior: StatedPrior, names: Sequence[str]) -> Density:
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
    )


def _unit(fit: Fit, name: str) -> str:
    if name == "delay":
        return "s"
    return "rad" if "encoder" in name or "backlash" in name or isinstance(fit.pair, Drive) else "mm"


def _is_rounding(fit: Fit) -> bool:
    """True where the noise is what rounding leaves of the transmission error."""
    largest = max((np.abs(c.transmission_error).max(initial=0.0) for c in fit.curves), default=0.0)
    return fit.noise.innovation_std <= 1e-10 * float(largest)


def _identity(fit: Fit, prior: Prior) -> dict[str, Any]:
    """What a checkpoint must agree with: data, model and prior."""
    assert fit.evidence is not None
    summary = fit.evidence.summary
    return {
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
    if np.isfinite(target.log_density(target.centre[None])[0]):
        return
    centre, density = target.centre, target.density
    for (x, y), disc in zip(density.planes, target.prior.discs, strict=True):
        if np.hypot(centre[x], centre[y]) > disc.bound:
            words = next(
                words
                for words in target.prior.sentences
                if words.startswith(
                    (f"{_label(disc)} ecc", f"{_label(disc)} first", f"{_label(disc)}:")
                )
            )
            raise UsageError(f"the prior excludes the fit ({words}); widen it.", where=fit.source)
    outside = np.flatnonzero(np.abs(centre) > np.asarray(density.bound))
    names = ", ".join(target.names[k].replace("_", " ") for k in outside) or "the fitted point"
    raise UsageError(f"the prior excludes the fit ({names}); widen it.", where=fit.source)


def _label(disc: Disc) -> str:
    return disc.name.replace("_", " ")

"""A second sampler on the same density: Hamiltonian trajectories of blackjax instead of walkers."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from ..base.arrays import Numbers, float64
from ..base.errors import NoAnswerError, UsageError
from ..base.runtime import require_x64
from ..identify.fit_result import Fit
from ..identify.noise.reml import LARGEST
from .density.density import NOISE_STD, Density, FitTarget, fit_target
from .density.prior import Prior
from .sampler import posterior_of
from .sampling.convergence import Diagnosis, autocorrelation_time, r_hat
from .sampling.ensembles import FEWEST_ENSEMBLES, Chains, Progress
from .sampling.stop_rule import Until
from .summary.posterior import Posterior

_CHUNK = 100
"""Draws between two looks at the interrupts."""

_TRIES = 50


@dataclass(frozen=True)
class NutsDiagnosis(Diagnosis):
    """Convergence of chains of which each is its own ensemble of one walker.

    `divergences` counts trajectories whose energy ran away: there the density is too sharply bent
    for the step, and what lies behind is missing.
    """

    divergences: int = 0

    @property
    def converged(self) -> bool:
        """Long chains that agree, and no trajectory that diverged."""
        return super().converged and not self.divergences

    def __str__(self) -> str:
        text = super().__str__()
        if self.divergences:
            text += f"; {self.divergences} trajectories diverged"
        return text

    def _cure(self) -> str:
        if self.long_enough and self.agreed:
            return "take a shorter step: raise `acceptance`"
        return f"draw more: about {max(2 * self.steps, self.needed)} a chain"

    def to_json(self) -> dict[str, Any]:
        """As of ensembles, with `divergences` and the name of the sampler."""
        return super().to_json() | {"divergences": self.divergences, "sampler": "nuts"}


class Whitened(eqx.Module):
    """Log-density of y, x = `centre` + `factor` y with partial autocorrelations π = bound · tanh x.

    Near the Laplace approximation y is standard normal. The Jacobian is that of the tanh.
    """

    density: Density
    centre: Float[Numbers, " d"] = eqx.field(converter=float64)
    factor: Float[Numbers, "d d"] = eqx.field(converter=float64)
    noise: int = eqx.field(static=True)

    def point(self, y: Float[Array, " d"]) -> Float[Array, " d"]:
        """The coordinates of the density."""
        x = jnp.asarray(self.centre) + jnp.asarray(self.factor) @ y
        return jnp.concatenate([x[: self.noise], LARGEST * jnp.tanh(x[self.noise :])])

    def __call__(self, y: Float[Array, " d"]) -> Float[Array, ""]:
        """Log-density of y up to a constant."""
        point = self.point(y)
        partial = point[self.noise :] / LARGEST
        return self.density(point) + jnp.sum(jnp.log1p(-(partial**2)))


def sample_nuts(
    fit: Fit,
    *,
    prior: Prior = Prior(),
    seed: int = 0,
    chains: int = FEWEST_ENSEMBLES,
    draws: int = 1000,
    warmup: int = 500,
    acceptance: float = 0.8,
    progress: Callable[[Progress], None] | None = None,
) -> Posterior:
    """Sample the posterior of a fit by NUTS (M. D. Hoffman, A. Gelman, JMLR 15 (2014) 1593).

    The density is that of `sample`; what differs is the way through it, so that agreement of both
    says that neither has missed a part. Step and masses adapt during the warm-up, chain by chain.

    **Arguments**
    - `fit`, `prior`, `seed`: as of `sample`.
    - `chains`: 4 or more, started apart, advanced together.
    - `draws`, `warmup`: of every chain, after and before it is recorded.
    - `acceptance`: aimed at; nearer to 1 makes shorter steps.
    - `progress`: called after every 100 draws.

    **Returns** a `Posterior`: an ensemble a chain, one walker each.

    **Raises** `UsageError` where blackjax is not installed, and as `sample` does.
    """
    require_x64("sample_nuts")
    blackjax = _blackjax()
    for name, value, least in (
        ("chains", chains, FEWEST_ENSEMBLES),
        ("draws", draws, 8),
        ("warmup", warmup, 50),
    ):
        if value < least:
            raise ValueError(f"Argument `{name}` must be at least {least}, but is {value!r}.")
    if not 0.0 < acceptance < 1.0:
        raise ValueError(f"Argument `acceptance` must be between 0 and 1, but is {acceptance:g}.")
    target = fit_target(fit, prior)
    whitened = whitened_of(target)
    begin, warm, move = jax.random.split(jax.random.key(seed), 3)
    starts = _starts(whitened, begin, chains)
    states, tuned = _warm_up(blackjax, whitened, starts, warm, warmup, acceptance)
    found = []
    for first in range(0, draws, _CHUNK):
        count = min(_CHUNK, draws - first)
        keys = jax.random.split(jax.random.fold_in(move, first), (count, chains))
        states, part = _advance(blackjax, whitened, states, tuned, keys)
        found.append([np.asarray(array) for array in part])
        if progress is not None:
            progress(Progress(first + count, draws, 0.0, None, ""))
    points, rate, diverged = (np.concatenate(part) for part in zip(*found, strict=True))
    made = _chains(target, np.moveaxis(points, 0, 1), rate, int(diverged.sum()), seed)
    return posterior_of(fit, target, made)


def whitened_of(target: FitTarget) -> Whitened:
    """The density of a target in coordinates whose Laplace approximation is standard normal."""
    noise = target.names.index(NOISE_STD) + 1
    inner = np.clip(target.centre[noise:] / LARGEST, -0.99, 0.99)
    gain = np.append(np.ones(noise), 1.0 / (LARGEST * (1.0 - inner**2)))
    return Whitened(
        target.density,
        np.append(target.centre[:noise], np.arctanh(inner)),
        np.linalg.cholesky(target.covariance * np.outer(gain, gain)),
        noise,
    )


def _blackjax() -> Any:
    try:
        return importlib.import_module("blackjax")
    except ImportError:
        raise UsageError(
            "sampling by NUTS needs the package blackjax: pip install `vttig-jax[nuts]`."
        ) from None


def _starts(whitened: Whitened, key: PRNGKeyArray, chains: int) -> Float[Array, "chains d"]:
    """Draws from the Laplace approximation inside the prior."""
    shape = (chains, len(whitened.centre))
    starts = jax.random.normal(key, shape)
    for again in range(1, _TRIES):
        inside = jnp.isfinite(jax.vmap(whitened)(starts))
        if inside.all():
            return starts
        others = jax.random.normal(jax.random.fold_in(key, again), shape)
        starts = jnp.where(inside[:, None], starts, others)
    raise NoAnswerError("the prior excludes the starts of the chains; widen its bounds.")


@eqx.filter_jit
def _warm_up(blackjax, whitened, starts, key, steps, acceptance):
    adaptation = blackjax.window_adaptation(
        blackjax.nuts, whitened, target_acceptance_rate=acceptance
    )

    def one(key, start):
        found, _ = adaptation.run(key, start, steps)
        return found.state, found.parameters

    return jax.vmap(one)(jax.random.split(key, len(starts)), starts)


@eqx.filter_jit
def _advance(blackjax, whitened, states, tuned, keys):
    kernel = blackjax.nuts.build_kernel()

    def one(key, state, tuned):
        return kernel(key, state, whitened, **tuned)

    def step(states, keys):
        states, info = jax.vmap(one)(keys, states, tuned)
        points = jax.vmap(whitened.point)(states.position)
        return states, (points, info.acceptance_rate, info.is_divergent)

    return jax.lax.scan(step, states, keys)


def _chains(
    target: FitTarget,
    points: Float[np.ndarray, "chains draws d"],
    acceptance: Float[np.ndarray, "draws chains"],
    divergences: int,
    seed: int,
) -> Chains:
    """The draws as those of ensembles of one walker; the warm-up is gone already."""
    count, steps, _ = points.shape
    draws = points[:, :, None]
    tau = np.maximum(np.mean([autocorrelation_time(chain) for chain in draws], axis=0), 1.0)
    rates = acceptance.mean(axis=0)
    diagnosis = NutsDiagnosis(
        names=target.names,
        tau=tau,
        shortest=float(steps / tau.max()),
        r_hat=r_hat(draws),
        acceptance=float(rates.mean()),
        effective=count * steps / tau,
        steps=steps,
        until=Until(),
        divergences=divergences,
    )
    values = [target.log_density(chain) for chain in points]
    return Chains(
        names=target.names,
        units=target.units,
        draws=draws,
        log_density=np.stack(values)[:, :, None],
        acceptance=rates,
        steps=steps,
        thin=1,
        discarded=0,
        seed=seed,
        identity=target.identity,
        diagnosis=diagnosis,
    )

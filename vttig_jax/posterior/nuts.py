"""NUTS of blackjax on the same density: a second sampler to check the ensembles of emcee."""

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
from ..identify.noise.restricted_likelihood import LARGEST
from .density.density import NOISE_STD, FitTarget, fit_target
from .density.evaluation import Density
from .density.prior import Prior
from .sampler import posterior_of
from .sampling.convergence import Diagnosis, autocorrelation_time, r_hat
from .sampling.ensembles import FEWEST_ENSEMBLES, Chains
from .sampling.progress import Progress
from .sampling.stop_rule import Until
from .summary.posterior import Posterior

_CHUNK = 100
"""Draws of every chain per compiled call (chosen). An interrupt takes effect between two calls."""

_MOST_REDRAWS = 50
"""Largest number of attempts to draw starts inside the prior (chosen)."""


@dataclass(frozen=True)
class NutsDiagnosis(Diagnosis):
    """Convergence of NUTS chains, each treated as an ensemble of one walker.

    `divergences` counts trajectories whose energy error diverged. At such a place the curvature of
    the density is too large for the step size, and the draws miss the region beyond it.
    """

    divergences: int = 0

    @property
    def converged(self) -> bool:
        """Whether the chains are long, agree with each other, and have no divergent trajectory."""
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
        """Return the fields of `Diagnosis`, with `divergences` and the name of the sampler."""
        return super().to_json() | {"divergences": self.divergences, "sampler": "nuts"}


class Whitened(eqx.Module):
    """Log-density of the whitened coordinates y, in which the Laplace approximation is N(0, 1).

    With x = `centre` + `factor` y, the first `noise` elements of x are coordinates of `density`.
    The others give the partial autocorrelations π = `LARGEST` · tanh x. The log-density includes
    the Jacobian of tanh.
    """

    density: Density
    centre: Float[Numbers, " d"] = eqx.field(converter=float64)
    factor: Float[Numbers, "d d"] = eqx.field(converter=float64)
    noise: int = eqx.field(static=True)

    def point(self, y: Float[Array, " d"]) -> Float[Array, " d"]:
        """Return the coordinates of `density` that belong to the whitened coordinates y."""
        x = jnp.asarray(self.centre) + jnp.asarray(self.factor) @ y
        return jnp.concatenate([x[: self.noise], LARGEST * jnp.tanh(x[self.noise :])])

    def __call__(self, y: Float[Array, " d"]) -> Float[Array, ""]:
        """Return the log-density of y up to a constant."""
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

    The density is that of `sample`; only the sampling method differs. If both samplers agree, it is
    unlikely that one has missed a part of the posterior. Step size and mass matrix of every chain
    adapt during its warm-up.

    **Arguments**
    - `fit`, `prior`, `seed`: as in `sample`.
    - `chains`: number of chains, 4 or more, with different starts, advanced together.
    - `draws`, `warmup`: recorded draws and warm-up steps of every chain.
    - `acceptance`: target acceptance rate; a rate nearer to 1 gives shorter steps.
    - `progress`: function called after every 100 draws.

    **Returns** a `Posterior` in which each chain is an ensemble of one walker.

    **Raises** `UsageError` if blackjax is not installed, and the errors of `sample`.
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
    start_key, warmup_key, draw_key = jax.random.split(jax.random.key(seed), 3)
    starts = _starts(whitened, start_key, chains)
    states, tuned = _warm_up(
        blackjax,
        whitened=whitened,
        starts=starts,
        key=warmup_key,
        steps=warmup,
        acceptance=acceptance,
    )
    parts = []
    for first in range(0, draws, _CHUNK):
        count = min(_CHUNK, draws - first)
        keys = jax.random.split(jax.random.fold_in(draw_key, first), (count, chains))
        states, part = _advance(blackjax, whitened, states, tuned, keys)
        parts.append([np.asarray(array) for array in part])
        if progress is not None:
            progress(Progress(first + count, draws, 0.0, None, ""))
    points, rate, diverged = (np.concatenate(part) for part in zip(*parts, strict=True))
    nuts_chains = _chains(target, np.moveaxis(points, 0, 1), rate, int(diverged.sum()), seed)
    return posterior_of(fit, target, nuts_chains)


def whitened_of(target: FitTarget) -> Whitened:
    """Return the density of `target` in coordinates whose Laplace approximation is N(0, 1)."""
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
    """Return whitened starts of the chains: draws of the Laplace approximation inside the prior."""
    shape = (chains, len(whitened.centre))
    starts = jax.random.normal(key, shape)
    for attempt in range(1, _MOST_REDRAWS):
        inside = jnp.isfinite(jax.vmap(whitened)(starts))
        if inside.all():
            return starts
        redrawn = jax.random.normal(jax.random.fold_in(key, attempt), shape)
        starts = jnp.where(inside[:, None], starts, redrawn)
    raise NoAnswerError("the prior excludes the starts of the chains; widen its bounds.")


@eqx.filter_jit
def _warm_up(blackjax, whitened, starts, key, steps, acceptance):
    adaptation = blackjax.window_adaptation(
        blackjax.nuts, whitened, target_acceptance_rate=acceptance
    )

    def adapted(key, start):
        result, _ = adaptation.run(key, start, steps)
        return result.state, result.parameters

    return jax.vmap(adapted)(jax.random.split(key, len(starts)), starts)


@eqx.filter_jit
def _advance(blackjax, whitened, states, tuned, keys):
    kernel = blackjax.nuts.build_kernel()

    def moved(key, state, tuned):
        return kernel(key, state, whitened, **tuned)

    def step(states, keys):
        states, info = jax.vmap(moved)(keys, states, tuned)
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
    """Return the draws as `Chains`, in which every NUTS chain is an ensemble of one walker.

    `points` are the draws without the warm-up, and `acceptance` is the acceptance rate of every
    draw of every chain.
    """
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

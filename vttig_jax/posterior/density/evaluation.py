"""Log-density of a fit: its value at many points, and its slope at one."""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Inexact

from ...base.arrays import Numbers, float64, namespace
from ...identify.noise.restricted_likelihood import LARGEST
from .likelihood import Likelihood
from .local_likelihood import LocalLikelihood

BATCHES = (128, 32)
"""Numbers of points that are evaluated together; more shapes would be compiled (chosen)."""

_IMAGINARY = 1e-30  # step whose square vanishes beside every number; chosen value


class Density(eqx.Module):
    """Log-density of (sampled parameters, log std of the innovations, partial autocorrelations).

    The log-likelihood of a fit whose standard errors are wider than those of its noise model, w
    times, has this width too: it is taken at `centre` + (point − `centre`)/w, as in M. Ribatet,
    D. Cooley and A. C. Davison, Statistica Sinica 22 (2012) 813 for composite ones.

    `centre`, `bound`, `plane_bound` and `plane_std` are in internal units: mm, rad, s.
    """

    likelihood: Likelihood
    bound: Float[Numbers, " d"] = eqx.field(converter=float64)
    planes: tuple[tuple[int, int], ...] = eqx.field(static=True)
    plane_bound: Float[Numbers, " planes"] = eqx.field(converter=float64)
    plane_std: Float[Numbers, " planes"] = eqx.field(converter=float64)
    flat_in_amplitude: tuple[bool, ...] = eqx.field(static=True)
    centre: Float[Numbers, " d"] = eqx.field(converter=float64)
    widening: Float[Numbers, " d"] = eqx.field(converter=float64)

    def narrowed(self, point: Float[Numbers, "*n d"]) -> Float[Numbers, "*n d"]:
        """Return the point at which the likelihood of the noise model is taken."""
        xp = namespace(point)
        centre = xp.asarray(self.centre)
        return centre + (point - centre) / xp.asarray(self.widening)

    def __call__(self, point: Float[Array, " d"]) -> Float[Array, ""]:
        """Return the log-density at one point, −∞ outside the prior."""
        value = self.likelihood_at(point) + self.log_prior(point)
        return jnp.where(jnp.isfinite(value), value, -jnp.inf)

    def likelihood_at(self, point: Float[Array, " d"]) -> Float[Array, ""]:
        """Return the log-likelihood at one point."""
        count = len(self.likelihood.sampled_indices)
        partial = jnp.clip(point[count + 1 :], -LARGEST, LARGEST)
        return self.likelihood(jnp.asarray(self.narrowed(point))[:count], partial, point[count])

    def log_prior(self, point: Inexact[Numbers, "*point"]) -> Inexact[Numbers, "*n"]:
        """Return the log-density of the prior up to a constant, −∞ outside its bounds.

        A NumPy array may be complex and hold one point a column, shape (d, n).
        """
        xp = namespace(point)
        inside = xp.all(xp.abs(point.T) <= xp.asarray(self.bound), axis=-1)
        prior = xp.zeros(inside.shape)
        for k, (x, y) in enumerate(self.planes):
            square = point[x] ** 2 + point[y] ** 2
            inside &= xp.real(square) <= xp.asarray(self.plane_bound)[k] ** 2
            prior = prior - 0.5 * square / xp.asarray(self.plane_std)[k] ** 2
            if self.flat_in_amplitude[k]:
                prior = prior - 0.5 * xp.log(square)
        return xp.where(inside, prior, -xp.inf)


Evaluation = Callable[[Float[np.ndarray, "walkers d"]], Float[Array, " walkers"]]


def evaluation(density: Density, local: LocalLikelihood | None) -> Evaluation:
    """Return the compiled density of many points, exact if `local` is None.

    Its arrays are on the device once for all evaluations.
    """
    used = density if local is None else eqx.tree_at(lambda d: d.likelihood, density, None)
    arrays, structure = jax.tree.flatten((used, local))
    held = tuple(jax.device_put(arrays))  # `jnp.asarray` compiles a program for every shape
    return partial(_program_of(structure), held)


@lru_cache(maxsize=16)
def _program_of(structure: Any) -> Callable[..., Float[Array, " walkers"]]:
    """Return the program of densities of one structure; a call then compares no structures."""

    @jax.jit
    def at_points(
        arrays: tuple[Array, ...], points: Float[Array, "walkers d"]
    ) -> Float[Array, " walkers"]:
        density, local = jax.tree.unflatten(structure, arrays)
        if local is None:
            return jax.vmap(density)(points)
        values = local(jax.vmap(density.narrowed)(points)) + jax.vmap(density.log_prior)(points)
        return jnp.where(jnp.isfinite(values), values, -jnp.inf)

    return at_points


def in_batches(
    evaluate: Evaluation, points: Float[np.ndarray, "walkers d"]
) -> Float[np.ndarray, " walkers"]:
    """Return the values of all points, evaluated in batches of few sizes, which compile once."""
    size = next((n for n in BATCHES if n <= len(points)), BATCHES[-1])
    if len(points) == size:
        return np.array(evaluate(points))
    filled = np.repeat(points[:1], -len(points) % size, axis=0)
    parts = np.split(np.concatenate([points, filled]), -(-len(points) // size))
    return np.concatenate([evaluate(part) for part in parts])[: len(points)]


def near_value_and_gradient(
    density: Density, local: LocalLikelihood, point: Float[np.ndarray, " d"]
) -> tuple[float, Float[np.ndarray, " d"]]:
    """Return the log-density of a point near the fit and its gradient; nothing is compiled."""
    value, slope = local.value_and_gradient(np.asarray(density.narrowed(point)))
    steps = point[:, None] + 1j * _IMAGINARY * np.eye(len(point))
    prior: Any = density.log_prior(steps)
    value += float(prior[0].real)
    gradient = slope / np.asarray(density.widening) + prior.imag / _IMAGINARY
    return (value if np.isfinite(value) else -np.inf), gradient


def exact_value_and_gradient(
    density: Density, point: Float[np.ndarray, " d"]
) -> tuple[float, Float[np.ndarray, " d"]]:
    """Return the log-density of a point and its gradient without polynomials."""
    value, gradient = _value_and_gradient(density, point)
    return float(value), np.asarray(gradient)


@eqx.filter_jit
def _value_and_gradient(
    density: Density, point: Float[Numbers, " d"]
) -> tuple[Float[Array, ""], Float[Array, " d"]]:
    return jax.value_and_grad(density)(jnp.asarray(point))

"""Log-density of a fit: its value at many points, and its gradient at one point."""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Inexact

from ...base.arrays import Numbers, float64, namespace
from ...identify.noise.restricted_likelihood import LARGEST
from .likelihood import Likelihood
from .local_likelihood import LocalLikelihood

BATCHES = (128, 32)
"""Numbers of points per call of the compiled density (chosen). Each number compiles a program."""

_IMAGINARY = 1e-30  # imaginary step of derivatives; its square is negligible; chosen value


class Density(eqx.Module):
    """Log-density of (sampled parameters, log std of the innovations, partial autocorrelations).

    If the standard errors of the fit are w times those of its noise model, the likelihood is made
    wider by the same factors w (`widening`). It is evaluated at `centre` + (point − `centre`)/w, as
    M. Ribatet, D. Cooley and A. C. Davison, Statistica Sinica 22 (2012) 813, do for composite
    likelihoods.

    `planes` are index pairs of coordinates (x, y), each with the prior of one `Disc`. `centre`,
    `bound`, `plane_bound` and `plane_std` are in internal units: mm, rad, s.
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
        """Return `centre` + (point − `centre`)/`widening`, where the likelihood is evaluated."""
        xp = namespace(point)
        centre = xp.asarray(self.centre)
        return centre + (point - centre) / xp.asarray(self.widening)

    def __call__(self, point: Float[Array, " d"]) -> Float[Array, ""]:
        """Return the log-density at one point, −∞ outside the prior."""
        value = self.likelihood_at(point) + self.log_prior(point)
        return jnp.where(jnp.isfinite(value), value, -jnp.inf)

    def likelihood_at(self, point: Float[Array, " d"]) -> Float[Array, ""]:
        """Return the log-likelihood, widened by `widening`, at one point."""
        count = len(self.likelihood.sampled_indices)
        partial = jnp.clip(point[count + 1 :], -LARGEST, LARGEST)
        return self.likelihood(jnp.asarray(self.narrowed(point))[:count], partial, point[count])

    def log_prior(self, point: Inexact[Numbers, "*point"]) -> Inexact[Numbers, "*n"]:
        """Return the log-density of the prior up to a constant, −∞ outside its bounds.

        `point` is one point, shape (d,), or a NumPy array with n points as columns, shape (d, n).
        Such an array may be complex, for derivatives by an imaginary step.
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
    """Return a compiled function that gives the log-density of many points.

    It uses the polynomial likelihood `local`, or the exact likelihood if `local` is None. The
    arrays of the density are copied to the device only once.
    """
    used = density if local is None else eqx.tree_at(lambda d: d.likelihood, density, None)
    arrays, structure = jax.tree.flatten((used, local))
    held = tuple(jax.device_put(arrays))  # `jnp.asarray` compiles a program for every shape
    return partial(_program_of(structure), held)


@lru_cache(maxsize=16)
def _program_of(structure: Any) -> Callable[..., Float[Array, " walkers"]]:
    """Return the compiled program of all densities with the same tree structure.

    Its arguments are arrays only, so that JAX does not compare tree structures in every call.
    """

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
    evaluate: Evaluation,
    points: Float[np.ndarray, "walkers d"],
    sizes: tuple[int, ...] = BATCHES,
) -> Float[np.ndarray, " walkers"]:
    """Return the values of all points, evaluated in batches of equal size.

    The size is one of `sizes`, so that few programs are compiled. The last batch is filled up.
    """
    size = next((n for n in sizes if n <= len(points)), sizes[-1])
    if len(points) == size:
        return np.array(evaluate(points))
    filled = np.repeat(points[:1], -len(points) % size, axis=0)
    parts = np.split(np.concatenate([points, filled]), -(-len(points) // size))
    return np.concatenate([evaluate(part) for part in parts])[: len(points)]


def is_near(
    density: Density, local: LocalLikelihood, points: Float[np.ndarray, "n d"]
) -> Bool[np.ndarray, " n"]:
    """Return at which points the polynomial likelihood is valid.

    Functions of the class are called, because Equinox makes a new pytree of every bound method.
    That takes as long as the evaluation of 64 points.
    """
    return LocalLikelihood.holds(local, np.asarray(Density.narrowed(density, points)))


def near_value_and_gradient(
    density: Density, local: LocalLikelihood, point: Float[np.ndarray, " d"]
) -> tuple[float, Float[np.ndarray, " d"]]:
    """Return the log-density of a point near the fit and its gradient, without compiling."""
    at = np.asarray(Density.narrowed(density, point))
    value, slope = LocalLikelihood.value_and_gradient(local, at)
    steps = point[:, None] + 1j * _IMAGINARY * np.eye(len(point))
    prior: Any = Density.log_prior(density, steps)
    value += float(prior[0].real)
    gradient = slope / np.asarray(density.widening) + prior.imag / _IMAGINARY
    return (value if np.isfinite(value) else -np.inf), gradient


def exact_value_and_gradient(
    density: Density, point: Float[np.ndarray, " d"]
) -> tuple[float, Float[np.ndarray, " d"]]:
    """Return the log-density of a point and its gradient from the exact likelihood."""
    value, gradient = _value_and_gradient(density, point)
    return float(value), np.asarray(gradient)


@eqx.filter_jit
def _value_and_gradient(
    density: Density, point: Float[Numbers, " d"]
) -> tuple[Float[Array, ""], Float[Array, " d"]]:
    return jax.value_and_grad(density)(jnp.asarray(point))

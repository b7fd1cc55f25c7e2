"""Reduced rows as polynomials of the noise parameters, for samplers.

The elimination of the free harmonics costs a Cholesky factorisation of every flank for each value
of the partial autocorrelations π, and a sampler asks for a million values. The posterior of π is
narrow, and the result is a smooth function of π. Within a box around the fit, products of Chebyshev
polynomials replace it. Their error is measured at random points of the box; it is far below what a
sampler can see.
"""

from itertools import product
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.arrays import Numbers, float64, namespace
from ...identify.noise.reml import LARGEST
from .likelihood import Likelihood, ReducedRows

_WIDTHS = 6.0  # half-width of the box in standard deviations of the noise parameters; chosen value
_DEGREES = (3, 5, 7, 9)  # total degrees that are tried; chosen values
_MOST_TERMS = 220  # polynomials beyond which the elimination itself costs less; measured
_MOST_NODES = 3000  # eliminations for the coefficients; chosen value
_BATCH = 64  # eliminations of one call; chosen value
_TOLERANCE = 1e-6  # largest error of the log-density within the box; chosen value


class InterpolatedRows(eqx.Module):
    """Reduced rows as a polynomial of the partial autocorrelations.

    **Arguments**
    - `centre`, `half_width`: box in which the polynomial holds.
    - `degrees`: degree of every term in every partial autocorrelation.
    - `coefficients`: of every term, for the log-determinant and the factors.
    - `shape`: shape of the factors.
    """

    centre: Float[Numbers, " order"] = eqx.field(converter=float64)
    half_width: Float[Numbers, " order"] = eqx.field(converter=float64)
    coefficients: Float[Numbers, "terms values"] = eqx.field(converter=float64)
    degrees: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    shape: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, partial: Float[Array, " order"]) -> ReducedRows:
        """Return the reduced rows at a point of the box."""
        scaled = (partial - jnp.asarray(self.centre)) / jnp.asarray(self.half_width)
        terms = _terms(scaled, np.array(self.degrees))
        values = terms @ jnp.asarray(self.coefficients)
        return ReducedRows(values[0], values[1:].reshape(self.shape))

    def holds(self, partial: Float[np.ndarray, "walkers order"]) -> bool:
        """Return whether all points are inside the box."""
        return bool(np.all(np.abs(partial - self.centre) <= self.half_width))


def interpolated_rows(
    likelihood: Likelihood, centre: Float[np.ndarray, " order"], std: Float[np.ndarray, " order"]
) -> InterpolatedRows | None:
    """Return the interpolation of the reduced rows around `centre`.

    The result is None if no degree reaches the tolerance with few enough terms.
    """
    half_width = np.minimum(_WIDTHS * std, 0.5 * (LARGEST - np.abs(centre)))
    if np.any(half_width <= 0):
        return None
    generator = np.random.default_rng(0)
    probes = generator.uniform(-1.0, 1.0, (_BATCH, len(centre)))
    wanted = _reduced(likelihood, centre + half_width * probes)
    for degree in _DEGREES if len(centre) else (0,):
        every = list(product(range(degree + 1), repeat=len(centre)))
        degrees = np.array([term for term in every if sum(term) <= degree])
        if len(every) > _MOST_NODES or len(degrees) > _MOST_TERMS:
            return None
        roots = np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
        nodes = roots[np.array(every, int).reshape(len(every), len(centre))]
        values = _reduced(likelihood, centre + half_width * nodes)
        coefficients = np.linalg.lstsq(_terms(nodes, degrees), values, rcond=None)[0]
        found = _terms(probes, degrees) @ coefficients
        size = likelihood.triangles.shape[-1] - likelihood.free
        shape = (len(likelihood.triangles), size, size)
        if _error(found, wanted, shape, float(likelihood.rows)) <= _TOLERANCE:
            terms = tuple(tuple(int(d) for d in term) for term in degrees)
            return InterpolatedRows(centre, half_width, coefficients, terms, shape)
    return None


def _terms(scaled: Any, degrees: np.ndarray) -> Any:
    """Return the products of Chebyshev polynomials at points of ±1, shape (…, terms)."""
    xp = namespace(scaled)
    polynomials = [xp.ones_like(scaled), scaled]
    for _ in range(2, int(degrees.max(initial=0)) + 1):
        polynomials.append(2 * scaled * polynomials[-1] - polynomials[-2])
    table = xp.stack(polynomials, axis=-1)
    terms = xp.ones((*scaled.shape[:-1], len(degrees)))
    for coordinate, own in enumerate(degrees.T):
        terms = terms * table[..., coordinate, own]
    return terms


def _reduced(
    likelihood: Likelihood, partial: Float[np.ndarray, "n order"]
) -> Float[np.ndarray, "n values"]:
    """Return log-determinant and factors at every point, in batches of one size."""
    found = []
    for first in range(0, len(partial), _BATCH):
        own = partial[first : first + _BATCH]
        padded = np.concatenate([own, np.repeat(own[:1], _BATCH - len(own), axis=0)])
        rows = _of_batch(likelihood, padded)
        factor = np.asarray(rows.factor).reshape(_BATCH, -1)
        found.append(np.column_stack([np.asarray(rows.determinant), factor])[: len(own)])
    return np.concatenate(found)


@eqx.filter_jit
def _of_batch(likelihood: Likelihood, partial: Float[Numbers, "n order"]) -> ReducedRows:
    return jax.vmap(likelihood.reduced)(jnp.asarray(partial))


def _error(
    found: Float[np.ndarray, "n values"],
    wanted: Float[np.ndarray, "n values"],
    shape: tuple[int, ...],
    rows: float,
) -> float:
    """Return the largest error of the log-density at the best coefficients of every flank."""
    factor, other = (values[:, 1:].reshape(-1, *shape) for values in (wanted, found))
    best = [np.linalg.lstsq(own[:, :-1], own[:, -1], rcond=None)[0] for own in factor[0]]
    residual = np.append(-np.stack(best), np.ones((shape[0], 1)), axis=1)[None, :, :, None]
    misfit, its = (np.sum((own @ residual) ** 2, axis=(1, 2, 3)) for own in (factor, other))
    change = np.abs(its - misfit) / np.where(misfit > 0, misfit, 1.0)
    return float(np.max(np.abs(found[:, 0] - wanted[:, 0]) + 0.5 * rows * change))

"""Likelihood of a fit near its optimum, quick enough for a sampler.

A sampler asks for the likelihood at hundreds of thousands of points near the fit. The columns that
are integrated out (free harmonics, nuisance parameters) are orthogonalised once, with the noise of
the fit: there their Gram matrix G is the identity. At other partial autocorrelations π of the noise
its diagonal moves by some tenths, and its other elements hardly at all. So

    log|G| = Σ log G_ii + small,    misfit = [δ, 1] (H + small) [δ, 1]ᵀ,

where δ = β − β₀ are the tied coefficients minus those of the fit. H is the Gram matrix of the
columns that are kept: the tied columns and, as the last one, the residual of the fit. G_ii and H
are exact sums of the lag products with weights that depend on π. The small parts are approximated
by polynomials of π, and δ by polynomials of the parameters, within a box around the fit. The errors
are measured at separate points of the box. If no polynomial reaches the tolerance, a fit has no
local likelihood. For points outside the box, the exact likelihood is used.
"""

from itertools import product
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Inexact

from ...base.arrays import Number, Numbers, float64, namespace
from ...identify.compress.flank_summary import FlankSummary
from ...identify.noise.restricted_likelihood import LARGEST
from .likelihood import Likelihood
from .orthogonal_columns import OrthogonalColumns, orthogonal_columns

_WIDTHS = 7.0  # half-width of the box in standard deviations; chosen value
_DEGREES = tuple(range(2, 13))  # total degrees in π that are tried; chosen values
_CURVED_DEGREES = (2, 3, 4)  # total degrees in the eccentricities that are tried; chosen values
_MOST_TERMS = 500  # most terms in π; with more, the exact likelihood costs less; chosen value
_PROBES = 64  # points at which the error is measured; chosen value
_REACHES = (1.0, 2.0, 3.0)  # spreads of these points in standard deviations; chosen values
_TOLERANCE = 1e-8  # largest error of the log-likelihood, apart from rounding; chosen value
_ROUNDING = 1e-13  # rounding error of the log-likelihood per row; chosen value
_IMAGINARY = 1e-30  # imaginary step of derivatives; its square is negligible; chosen value
_DIFFERENCE = 1e-5  # step of π for central differences; chosen value
_GROUP = 8  # diagonal elements whose product has one common logarithm; chosen value

Columns = Float[np.ndarray, "_ n"]
"""One column per point."""


class LocalLikelihood(eqx.Module):
    """Log-likelihood of many points (sampled parameters, log std, partial autocorrelations).

    **Arguments**
    - `centre`, `half_width`: box in which it is valid; its width is infinite for the log std.
    - `tied`: matrix that is multiplied with the basis functions of `_tied_terms` to give [δ, 1].
    - `square`: matrix that is multiplied with the weights of the lag products and the polynomial
      terms of π to give the upper triangle of H + small.
    - `diagonal`: matrix that is multiplied with the weights to give the diagonal elements G_ii.
    - `determinant`: coefficients of the polynomial in π for the remaining part of log|G|.
    - `initial`: numbers from which `kind.determinant_of` computes the log-determinant of the noise.
    - `freedom`: number of rows minus number of coefficients.
    - `sampled`: number of sampled parameters.
    - `curved`: indices of the parameters in which δ is not linear; `degrees`: total degrees of the
      polynomials in these parameters and in π.
    """

    centre: Float[Numbers, " d"] = eqx.field(converter=float64)
    half_width: Float[Numbers, " d"] = eqx.field(converter=float64)
    tied: Float[Numbers, "kept terms"] = eqx.field(converter=float64)
    square: Float[Numbers, "pairs features"] = eqx.field(converter=float64)
    diagonal: Float[Numbers, "eliminated products"] = eqx.field(converter=float64)
    determinant: Float[Numbers, " terms"] = eqx.field(converter=float64)
    initial: Float[Numbers, "*terms"] = eqx.field(converter=float64)
    freedom: Float[Numbers, ""] = eqx.field(converter=float64)
    kind: type[FlankSummary] = eqx.field(static=True)
    sampled: int = eqx.field(static=True)
    curved: tuple[int, ...] = eqx.field(static=True)
    degrees: tuple[int, int] = eqx.field(static=True)

    def __call__(self, points: Float[Numbers, "n d"]) -> Float[Numbers, " n"]:
        """Return the log-likelihood of every point; the values are valid only inside the box."""
        partial = points[:, self.sampled + 1 :]
        weights, initial = jax.vmap(self._of_noise, out_axes=(1, 0))(partial)
        return self._at(points, weights, jnp.asarray(initial))

    def value_and_gradient(
        self, point: Float[np.ndarray, " d"]
    ) -> tuple[float, Float[np.ndarray, " d"]]:
        """Return the log-likelihood of one point in the box and its gradient, without compiling.

        The gradient comes from an imaginary step and is exact to rounding (W. Squire, G. Trapp,
        SIAM Review 40 (1998) 110). Only the weights of the lag products and the log-determinant of
        the noise do not accept complex π; their derivatives are central differences.
        """
        partial, first = point[self.sampled + 1 :], self.sampled + 1
        of_noise = self._of_noise  # each access to a method costs more than its call
        numbers = np.tile(np.append(*of_noise(partial))[:, None], len(point)).astype(complex)
        for k in range(len(partial)):
            step = _DIFFERENCE * np.eye(len(partial))[k]
            ahead, back = (np.append(*of_noise(partial + s * step)) for s in (1.0, -1.0))
            numbers[:, first + k] += 1j * _IMAGINARY * (ahead - back) / (2 * _DIFFERENCE)
        points = point + 1j * _IMAGINARY * np.eye(len(point))
        values: Any = self._at(points, numbers[:-1], numbers[-1])
        return float(values[0].real), values.imag / _IMAGINARY

    def _of_noise(
        self, partial: Float[Numbers, " order"]
    ) -> tuple[Float[Numbers, " products"], Number]:
        """Return the weights of the lag products, and the log-determinant of the noise, at π."""
        initial = namespace(partial).asarray(self.initial)
        return self.kind.product_weights(partial), self.kind.determinant_of(initial, partial)

    def _at(
        self,
        points: Inexact[Numbers, "n d"],
        weights: Inexact[Numbers, "products n"],
        initial: Inexact[Numbers, " n"],
    ) -> Inexact[Numbers, " n"]:
        xp, count = namespace(points), self.sampled
        scaled = ((points - xp.asarray(self.centre)[None]) / xp.asarray(self.half_width)[None]).T
        vector = xp.asarray(self.tied) @ _tied_terms(scaled[:count], self.curved, self.degrees[0])
        log_std, terms = points[:, count], _terms(scaled[count + 1 :], self.degrees[1])
        square = xp.asarray(self.square) @ xp.concatenate([weights, terms])
        first, second = np.triu_indices(len(self.tied))
        misfit = xp.sum(square * vector[first] * vector[second], axis=0)
        determinant = _log_product(xp.asarray(self.diagonal) @ weights) + initial
        determinant += xp.asarray(self.determinant) @ terms
        return -(
            xp.asarray(self.freedom) * log_std
            + 0.5 * determinant
            + 0.5 * misfit * xp.exp(-2 * log_std)
        )

    def holds(self, points: Float[np.ndarray, "n d"]) -> Bool[np.ndarray, " n"]:
        """Return which points are inside the box."""
        return np.all(np.abs(points - self.centre) <= self.half_width, axis=1)


def local_likelihood(
    likelihood: Likelihood,
    centre: Float[np.ndarray, " d"],
    covariance: Float[np.ndarray, "d d"],
) -> LocalLikelihood | None:
    """Return the likelihood near `centre`, or None if no polynomial reaches the tolerance.

    `centre` and `covariance` are mean and covariance of the Laplace approximation, for the
    coordinates (sampled parameters, log std, partial autocorrelations).
    """
    count = len(likelihood.sampled_indices)
    half_width = _half_width(centre, covariance, count)
    points = probes(centre, covariance, half_width)
    scaled = ((points - centre) / half_width).T
    try:
        columns = orthogonal_columns(
            likelihood, centre[count + 1 :], _tied_at(likelihood, centre[None, :count])[0]
        )
        tied = _tied_polynomial(likelihood, columns, centre, half_width, points)
        if tied is None:
            return None
        curved, degree, matrix = tied
        vectors = matrix @ _tied_terms(scaled[:count], curved, degree) * np.exp(-points[:, count])
        box = centre[count + 1 :], half_width[count + 1 :]
        small = _small_polynomial(columns, box, scaled[count + 1 :], vectors, likelihood)
    except np.linalg.LinAlgError:
        return None
    if small is None:
        return None
    noise_degree, coefficients = small
    coefficients[0, 0] += columns.determinant
    return LocalLikelihood(
        centre=centre,
        half_width=half_width,
        tied=matrix,
        square=np.concatenate([columns.squares, coefficients[1:]], axis=1),
        diagonal=columns.diagonal,
        determinant=coefficients[0],
        initial=likelihood.determinants,
        freedom=float(likelihood.rows) - likelihood.coefficients,
        kind=likelihood.kind,
        sampled=count,
        curved=curved,
        degrees=(degree, noise_degree),
    )


def probes(
    centre: Float[np.ndarray, " d"],
    covariance: Float[np.ndarray, "d d"],
    half_width: Float[np.ndarray, " d"],
) -> Float[np.ndarray, "probes d"]:
    """Return random points of the box at which the error is measured.

    They are normal draws with one, two and three times the standard deviations of `covariance`.
    """
    generator = np.random.default_rng(0)
    draws = generator.multivariate_normal(0 * centre, covariance, _PROBES, method="cholesky")
    draws *= np.resize(_REACHES, _PROBES)[:, None]
    return centre + np.clip(draws, -half_width, half_width)


def tolerance(likelihood: Likelihood) -> float:
    """Return the largest accepted error of the local log-likelihood; it grows with the rows."""
    return _TOLERANCE + _ROUNDING * float(likelihood.rows)


def _half_width(
    centre: Float[np.ndarray, " d"], covariance: Float[np.ndarray, "d d"], sampled: int
) -> Float[np.ndarray, " d"]:
    """Return the half-widths of the box, infinite for the log std.

    For a partial autocorrelation it is at most half of the distance from the centre to ± `LARGEST`,
    so that the noise is stationary in the whole box.
    """
    half_width = _WIDTHS * np.sqrt(np.diag(covariance))
    half_width[sampled] = np.inf
    inner = 0.5 * (LARGEST - np.abs(centre[sampled + 1 :]))
    half_width[sampled + 1 :] = np.clip(half_width[sampled + 1 :], 1e-12, np.maximum(inner, 1e-12))
    return half_width


def _tied_at(
    likelihood: Likelihood, sampled: Float[np.ndarray, "n s"]
) -> Float[np.ndarray, "n flanks tied"]:
    """Return the tied coefficients for each row of `sampled`, values of the sampled parameters."""
    parameters = np.repeat(np.asarray(likelihood.fixed)[None], len(sampled), axis=0)
    parameters[:, list(likelihood.sampled_indices)] = sampled
    return np.stack([likelihood.relation.linearised(own)[0] for own in parameters])


def _tied_polynomial(
    likelihood: Likelihood,
    columns: OrthogonalColumns,
    centre: Float[np.ndarray, " d"],
    half_width: Float[np.ndarray, " d"],
    points: Float[np.ndarray, "probes d"],
) -> tuple[tuple[int, ...], int, Float[np.ndarray, "kept terms"]] | None:
    """Return the polynomial for δ, or None if no degree reaches the tolerance at `points`.

    The polynomial consists of the indices of the curved parameters, the total degree in them, and
    the matrix `LocalLikelihood.tied`, which gives [δ, 1].
    """
    count = len(likelihood.sampled_indices)
    middle, width = centre[:count], half_width[:count]
    linear = likelihood.relation.linear.shape[0]
    curved = tuple(k for k, index in enumerate(likelihood.sampled_indices) if index >= linear)
    origin = _tied_at(likelihood, middle[None]).reshape(-1)
    wanted = _tied_at(likelihood, points[:, :count]).reshape(len(points), -1).T - origin[:, None]
    gram = columns.at_fit[:-1, :-1]
    generator = np.random.default_rng(1)
    for degree in _CURVED_DEGREES if curved else (0,):
        terms = len(_degrees(len(curved), degree)) + count - len(curved)
        nodes = np.cos(np.pi * generator.random((2 * terms + 10, count)))
        values = _tied_at(likelihood, middle + width * nodes).reshape(len(nodes), -1) - origin
        matrix = np.linalg.lstsq(_tied_terms(nodes.T, curved, degree).T, values, rcond=None)[0].T
        found = matrix @ _tied_terms(((points[:, :count] - middle) / width).T, curved, degree)
        wrong = np.abs(np.sum((found - wanted) * (gram @ (found + wanted)), axis=0))
        if np.max(0.5 * wrong * np.exp(-2 * points[:, count])) <= 0.1 * tolerance(likelihood):
            one = np.arange(matrix.shape[1]) == count - len(curved)
            return curved, degree, np.concatenate([matrix, one[None]])
    return None


def _small_polynomial(
    columns: OrthogonalColumns,
    box: tuple[Float[np.ndarray, " order"], Float[np.ndarray, " order"]],
    probed: Columns,
    vectors: Columns,
    likelihood: Likelihood,
) -> tuple[int, Float[np.ndarray, "values terms"]] | None:
    """Return the total degree and the coefficients of the polynomials of π for the small parts.

    Return None if no degree reaches the tolerance. `box` is centre and half-width of π. `probed`
    holds π of the probes, scaled to the box, and `vectors` holds [δ, 1] of the probes divided by
    the std of the innovations.
    """
    centre, width = box
    weights_of = likelihood.kind.product_weights

    def small_parts(scaled: Columns) -> Columns:
        weights = [np.asarray(weights_of(centre + width * one)) for one in scaled.T]
        return columns.small_parts(np.stack(weights))

    first, second = np.triu_indices(len(vectors))
    pairs = vectors[first] * vectors[second]
    wanted = small_parts(probed)
    generator = np.random.default_rng(2)
    nodes, values = np.empty((len(centre), 0)), np.empty((len(wanted), 0))
    for degree in _DEGREES if len(centre) else (0,):
        terms = len(_degrees(len(centre), degree))
        if terms > _MOST_TERMS:
            return None
        more = np.cos(np.pi * generator.random((len(centre), 2 * terms + 10 - nodes.shape[1])))
        nodes, values = np.hstack([nodes, more]), np.hstack([values, small_parts(more)])
        coefficients = np.linalg.lstsq(_terms(nodes, degree).T, values.T, rcond=None)[0].T
        wrong = coefficients @ _terms(probed, degree) - wanted
        error = 0.5 * np.abs(wrong[0] + np.sum(wrong[1:] * pairs, axis=0))
        if np.max(error) <= 0.1 * tolerance(likelihood):
            return degree, coefficients
    return None


def _degrees(coordinates: int, degree: int) -> tuple[tuple[int, ...], ...]:
    """Return, for each product of polynomials up to a total `degree`, its degree per coordinate."""
    every = product(range(degree + 1), repeat=coordinates) if coordinates < 5 else None
    if every is not None:
        return tuple(one for one in every if sum(one) <= degree)
    shorter = [_degrees(coordinates - 1, degree - own) for own in range(degree + 1)]
    return tuple((own, *rest) for own, part in enumerate(shorter) for rest in part)


def _terms(scaled: Inexact[Numbers, "p n"], degree: int) -> Inexact[Numbers, "terms n"]:
    """Return all products of Chebyshev polynomials up to a total `degree`, at n points.

    `scaled` has one column per point, with coordinates from −1 to 1.
    """
    xp = namespace(scaled)
    degrees = np.array(_degrees(len(scaled), degree), int)
    terms = xp.ones((len(degrees), scaled.shape[1]))
    for coordinate, own in zip(scaled, degrees.T, strict=True):
        polynomials = [xp.ones_like(coordinate), coordinate]
        for _ in range(2, degree + 1):
            polynomials.append(2 * coordinate * polynomials[-1] - polynomials[-2])
        terms = terms * xp.stack(polynomials)[own]
    return terms


def _tied_terms(
    scaled: Inexact[Numbers, "s n"], curved: tuple[int, ...], degree: int
) -> Inexact[Numbers, "terms n"]:
    """Return the basis functions of the polynomial for the tied coefficients, at n points.

    `scaled` are the sampled parameters at these points, scaled to −1 … 1 in the box. The tied
    coefficients depend linearly on most of them; `curved` are the indices of the others. The first
    rows of the result are the linear parameters themselves. The following rows are the products of
    Chebyshev polynomials of the curved parameters up to the total `degree`; the first of them is
    the constant 1.
    """
    linear = np.array([k for k in range(len(scaled)) if k not in curved], int)
    others = _terms(scaled[np.array(curved, int)], degree)
    return namespace(scaled).concatenate([scaled[linear], others])


def _log_product(values: Inexact[Numbers, "k n"]) -> Inexact[Numbers, " n"]:
    """Return the sum of the logarithms of each column.

    The values are near 1, so they can be multiplied in groups first to save logarithms.
    """
    xp, missing = namespace(values), -len(values) % _GROUP
    padded = xp.concatenate([values, xp.ones((missing, values.shape[1]))])
    return xp.sum(xp.log(xp.prod(padded.reshape(-1, _GROUP, values.shape[1]), axis=1)), axis=0)

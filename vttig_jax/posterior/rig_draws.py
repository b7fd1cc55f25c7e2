"""Draws of a rig: coefficients given θ, eccentricities, and the flank model of every draw."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..identify.given import given_column
from ..identify.orders import flank_rows
from ..identify.result import Fit
from ..model.columns import GAP
from ..model.density import Compressed, normal
from ..model.gears import GEARS, KINDS, Relation
from ..model.parameters import Quantities, quantities_of
from ..pair.gear_pair import Drive, GearPair
from .target import FitTarget, Tie, batched

_STEPS = 3
"""Steps of least squares, each of which leaves about a thousandth of the error."""


def quantities(fit: Fit) -> Quantities:
    """Return the quantities of a fit under its assumptions on encoders and gears.

    The parameters of a flank model of the user have columns of their own.
    """
    posterior, perfect = fit.core.posterior, ("perfect_gears", "perfect_encoders")
    told = quantities_of(
        fit.core,
        fit.pair if fit.given is None else Drive(fit.pair.ratio),
        [kind for kind, name in zip(KINDS, perfect, strict=True) if name not in fit.conditional_on],
    )
    index = posterior.problem.index
    if not (names := tuple(n for n in fit.covariance_names if given_column(n) in index)):
        return told
    rows = np.stack([posterior.row(given_column(name)) for name in names])
    values = fit.values[[fit.covariance_names.index(name) for name in names]]
    return told.joined(names, rows, values - rows @ posterior.moved)


def unit_of(fit: Fit, name: str) -> str:
    """Return the unit of a quantity."""
    if name in GEARS and isinstance(fit.pair, GearPair) and fit.given is None:
        return "mm"
    if name.startswith("model"):
        return fit.parameters[name].unit
    return {"delay": "s", "ratio": "1", "torque": "rad/unit of torque"}.get(name, "rad")


def target_of(fit: Fit) -> FitTarget:
    """Return the density of a fit; perfect encoders or gears tie its coefficients."""
    told = quantities(fit)
    tied = told.gears is not None and len(told.gears.relation.names) <= len(GEARS)
    data = " ".join(one.sha256 for one in fit.logs)
    return FitTarget(fit.core.posterior, told, data, tie_of(fit, told) if tied else None)


def tie_of(fit: Fit, told: Quantities) -> Tie | None:
    """Return how the first orders follow from eccentricities and encoder errors; None for drives.

    The log tells the parameters best in the order of `told`, which has them first.
    """
    if told.gears is None:
        return None
    relation, problem = told.gears.relation, fit.core.posterior.problem
    places, scale = relation.tied_columns(problem.index), np.diag(problem.natural)
    own = told.at(*relation.names)
    rows, start = (np.diag(scale) * problem.unit)[places], (scale * problem.start)[places]
    of_fit = told.gears.values, told.covariance[np.ix_(own, own)]
    rows, start, values, spread = map(jnp.asarray, (rows, start, *of_fit))
    units = tuple(unit_of(fit, name) for name in relation.names)
    return Tie(relation, rows, start, values, spread, units)


def rig_draws(
    fit: Fit,
    target: FitTarget,
    points: Float[np.ndarray, "m d"],
    random: np.random.RandomState,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return one draw of the rig for every draw of θ.

    It has the values of `target.told`, mm, rad, s, shape (m, p), and offset, cosine and sine of the
    terms of the fitted `OrderModel`, rad, as `flanks_of` returns them.

    The coefficients are drawn from their exact normal given θ. Eccentricities and encoder errors
    follow from each draw of them by the least squares of the fit, unless they are sampled: then the
    coefficients are drawn given those that the relation ties.
    """
    told, problem = target.told, fit.core.posterior.problem
    tie = target.tie or tie_of(fit, told)
    normals = random.standard_normal((len(points), len(problem.columns)))
    sampled = [] if target.tie is None else [points[:, len(target.free) :]]
    drawn = partial(_drawn, target.logs, tie)
    scaled, parameters = batched(drawn, target.thetas(points), normals, *sampled)
    coefficients = np.diag(problem.natural) * (problem.unit * scaled + problem.start)
    values = coefficients @ told.rows.T + told.shift
    if tie is not None and told.gears is not None:
        values[:, told.at(*tie.relation.names)] = parameters
        if "constant_backlash" in told.names:
            added = batched(partial(_constant, tie.relation), parameters)
            values[:, told.at("constant_backlash")[0]] -= added - told.gears.constants[-1]
    return values, *flanks_of(fit, coefficients)


def flanks_of(
    fit: Fit, coefficients: Float[np.ndarray, "m columns"], *, bends: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return offsets, cosines and sines of the terms of `fit.model` on both flanks, of all draws.

    Their shapes are (m, 2), (m, 2, terms) and (m, 2, terms).

    As in the model of the fit, an unmeasured flank has the orders of the other one, and orders that
    both flanks have in common are left out if their shaft made less than a turn: the log tells only
    their prior, and with `bends` their sum where it covers. The common level is that of the fit: no
    map depends on it.
    """
    core = fit.core
    series = np.einsum("mc,fwpc->mfwp", coefficients, flank_rows(core, bends=bends))
    offset = np.repeat(np.asarray(fit.model.offset)[None], len(coefficients), axis=0)
    if (place := core.posterior.problem.index.get(GAP)) is not None:
        off = coefficients[:, place] - core.posterior.moved[place]
        offset = offset + np.multiply.outer(off, [-0.5, 0.5])
    return offset, series[..., 1], series[..., 0]


@eqx.filter_jit
def _drawn(logs, tie, thetas, normals, sampled=None):
    return jax.vmap(partial(_one, logs, tie))(thetas, normals, sampled)


def _one(
    logs: Compressed,
    tie: Tie | None,
    theta: Float[Array, " theta"],
    normals: Float[Array, " columns"],
    parameters: Float[Array, " p"] | None,
) -> tuple[Float[Array, " columns"], Float[Array, " p"]]:
    one = normal(theta, logs)
    beta = one.solved(one.half + normals)
    if tie is None:
        return beta, jnp.zeros(0)
    _, half = tie.given(one)
    covariance, tied = half.T @ half, tie.start + tie.rows @ beta
    if parameters is None:
        return beta, _nearest(tie, tied, covariance)
    scale = jnp.sqrt(jnp.diag(covariance))
    off = (tie.tied(parameters) - tied) / scale
    gain = jnp.linalg.solve(covariance / scale[None] / scale[:, None], off) / scale
    return beta + one.solved(half @ gain), parameters


def _nearest(
    tie: Tie, tied: Float[Array, " t"], covariance: Float[Array, "t t"]
) -> Float[Array, " p"]:
    """Return the p of least squares, (h(p) − c_T)ᵀ V⁻¹ (h(p) − c_T).

    The steps of Gauss and Newton have the slope at the fit: h bends by 10⁻³ of itself.
    """
    slope, scale = jax.jacfwd(tie.tied)(tie.values), jnp.sqrt(jnp.diag(covariance))
    factor = jnp.linalg.cholesky(covariance / scale[None] / scale[:, None])
    whitened = partial(jax.scipy.linalg.solve_triangular, factor, lower=True)
    gain = jnp.linalg.pinv(whitened(slope / scale[:, None]), rtol=1e-12)
    step = lambda p, _: (p - gain @ whitened((tie.tied(p) - tied) / scale), None)  # noqa: E731
    return jax.lax.scan(step, tie.values, length=_STEPS)[0]


@eqx.filter_jit
def _constant(relation: Relation, parameters: Float[Array, "m p"]) -> Float[Array, " m"]:
    """Return the gap that the gears add to the constant one, of every draw, rad."""
    return jax.vmap(lambda p: relation.coefficients(p)[-1])(parameters)

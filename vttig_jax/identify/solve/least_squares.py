"""Levenberg–Marquardt solution from the summary, with its covariance and rank."""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.typing import ArrayLike
from jaxtyping import Float

from ..model.forward_model import ForwardModel
from ..noise.noise_model import WhitenedFlank

_MOST_STEPS = 100  # steps of the solver; chosen value
_RANK_TOLERANCE = 1e-6
"""Smallest singular value of a determined direction of the column-scaled Jacobian, relative to the
largest. A direction without data has 1e-10, the weight of a pseudo-observation (`orthogonal`)."""

_NOT_ABOVE, _ROUNDING = 0.01, 1e-6
"""The misfit of a minimum exceeds that of the linear solution by at most 1 % of the latter or of
one standard deviation, whichever is larger, plus 1e-6 of the length of R_ty; chosen values."""

_SETTLED = 0.01
"""Largest misfit, in standard deviations, that another Gauss–Newton step removes at a minimum. The
number of solver steps depends on rounding and is no criterion."""

_NAMED = 0.2
"""Share of a direction above which a parameter is named; chosen value."""


@dataclass(frozen=True)
class Solution:
    """Estimated parameters with their covariance.

    **Arguments**
    - `names`, `values`, `covariance`: Cartesian parameters in mm and rad.
    - `determined`: False for a parameter that is part of a direction without data.
    - `tied`, `jacobian`: tied coefficients of every flank, and their Jacobian.
    - `converged`: whether the solver reached a minimum. - `steps`: number of its steps.
    - `weakest`: determined direction with the largest standard error.
    - `misfit`, `linear_misfit`: distance of the forward model from the harmonics of the logs, in
      standard deviations, at this solution and at the linear solution.
    """

    names: tuple[str, ...]
    values: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    determined: np.ndarray
    tied: Float[np.ndarray, "flanks tied"]
    jacobian: Float[np.ndarray, "flanks tied p"]
    converged: bool
    steps: int
    weakest: "Direction | None" = None
    misfit: float = 0.0
    linear_misfit: float = 0.0


@dataclass(frozen=True)
class Direction:
    """Direction in parameter space with a large standard error.

    **Arguments**
    - `parameters`: name → signed share of the largest parameters of the direction, if every
      parameter is scaled to the same effect on the data.
    - `inflation`: its standard error relative to that of a single parameter fitted alone.
    """

    parameters: dict[str, float]
    inflation: float

    def to_json(self) -> dict:
        """Return the fields under `weakest_direction`."""
        return dict(vars(self))


def solve(relation: ForwardModel, flanks: tuple[WhitenedFlank, ...]) -> Solution:
    """Minimise Σ_f |R_tt h_f(p) − R_ty|² over the parameters p.

    The residuals are in standard deviations. The parameters are scaled to O(1) by the Jacobian at
    zero eccentricity, where the forward model is linear within 1e-3. A damped step from there may
    turn a large offset or drift into eccentricities of metres, where the model has other minima. If
    the misfit is above that of the linear solution, the solver starts again from that solution.
    """
    matrices, targets = (np.stack([flank.tied[part] for flank in flanks]) for part in (0, 1))
    start = np.zeros(len(relation.names))
    slopes = _whitened(matrices, _linearised(relation, start)[1])
    size = np.linalg.norm(slopes, axis=0)
    scale = 1 / np.where(size > 0, size, 1.0)
    linear = np.linalg.lstsq(slopes * scale, targets.ravel(), rcond=_RANK_TOLERANCE)[0]

    def misfit(values: Float[ArrayLike, " p"]) -> float:
        tied = np.asarray(_linearised(relation, np.asarray(values))[0])
        return float(np.linalg.norm(np.einsum("fij,fj->fi", matrices, tied) - targets))

    linear_misfit = misfit(scale * linear)
    if not np.isfinite(linear_misfit):  # the linear solution is outside the valid geometry
        linear_misfit = float(np.linalg.norm(targets))
    bound = linear_misfit + _NOT_ABOVE * max(linear_misfit, 1.0)
    bound += _ROUNDING * float(np.linalg.norm(targets))
    values, converged, steps = _minimise(relation, matrices, targets, scale, start)
    if not misfit(values) <= bound:
        values, converged, more = _minimise(relation, matrices, targets, scale, linear)
        steps = steps + more
    reached = misfit(values)
    if not np.isfinite(reached):
        values, reached = start, np.inf
    tied, jacobian = (np.asarray(part) for part in _linearised(relation, np.asarray(values)))
    slopes = _whitened(matrices, jacobian)
    covariance, determined, weakest = _covariance(slopes, relation.names)
    left = np.einsum("fij,fj->fi", matrices, tied) - targets
    settled = bool(converged) or _gain(slopes * scale, left.ravel()) <= _SETTLED
    return Solution(
        names=relation.names,
        values=np.asarray(values),
        covariance=covariance,
        determined=determined,
        tied=tied,
        jacobian=jacobian,
        converged=settled and reached <= bound,
        steps=int(steps),
        weakest=weakest,
        misfit=reached,
        linear_misfit=linear_misfit,
    )


def _gain(slopes: Float[np.ndarray, "r p"], left: Float[np.ndarray, " r"]) -> float:
    """Return the length, in standard deviations, that a Gauss–Newton step removes from `left`."""
    step = np.linalg.lstsq(slopes, left, rcond=_RANK_TOLERANCE)[0]
    return float(np.linalg.norm(slopes @ step))


def _whitened(
    matrices: Float[np.ndarray, "flanks tied tied"], jacobian: Float[ArrayLike, "flanks tied p"]
) -> Float[np.ndarray, "r p"]:
    """Return the Jacobian of the whitened residuals of all flanks."""
    jacobian = np.asarray(jacobian)
    return np.einsum("fij,fjp->fip", matrices, jacobian).reshape(-1, jacobian.shape[-1])


@eqx.filter_jit
def _linearised(relation: ForwardModel, parameters: Float[ArrayLike, " p"]):
    """Return the tied coefficients and their Jacobian, compiled apart from the solver for reuse."""
    parameters = jnp.asarray(parameters)
    jacobian = jax.jacfwd(lambda p: relation.coefficients(p))(parameters)
    return relation.coefficients(parameters), jacobian


@eqx.filter_jit
def _minimise(
    relation: ForwardModel,
    matrices: Float[ArrayLike, "flanks tied tied"],
    targets: Float[ArrayLike, "flanks tied"],
    scale: Float[ArrayLike, " p"],
    start: Float[ArrayLike, " p"],
):
    def misfit(scaled, _):
        predicted = relation.coefficients(jnp.asarray(scale) * scaled)
        return (jnp.einsum("fij,fj->fi", matrices, predicted) - targets).ravel()

    solution = optx.least_squares(
        misfit,
        optx.LevenbergMarquardt(rtol=1e-9, atol=1e-9),
        jnp.asarray(start),
        max_steps=_MOST_STEPS,
        throw=False,
        # The solution is never differentiated, and the implicit adjoint doubles the tracing time.
        adjoint=optx.RecursiveCheckpointAdjoint(),
    )
    converged = solution.result == optx.RESULTS.successful
    return scale * solution.value, converged, solution.stats["num_steps"]


def _covariance(
    jacobian: Float[np.ndarray, "r p"], names: tuple[str, ...]
) -> tuple[Float[np.ndarray, "p p"], np.ndarray, Direction | None]:
    """Return (JᵀJ)⁻¹ on the determined directions, the determined parameters, and the weakest."""
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0] = 1.0
    _, singular, directions = np.linalg.svd(jacobian / size, full_matrices=True)
    singular = np.append(singular, np.zeros(len(directions) - len(singular)))
    fixed = singular > _RANK_TOLERANCE * singular[0]
    open_part = np.abs(directions[~fixed]).max(axis=0, initial=0.0)
    inverse = directions[fixed].T / singular[fixed] ** 2 @ directions[fixed]
    weakest = _weakest(singular[fixed], directions[fixed], names) if fixed.any() else None
    return inverse / np.outer(size, size), open_part < 1e-3, weakest


def _weakest(
    singular: Float[np.ndarray, " d"], directions: Float[np.ndarray, "d p"], names: tuple[str, ...]
) -> Direction:
    """Return the direction of the smallest singular value with its largest parameters."""
    direction = directions[np.argmin(singular)]
    order = [k for k in np.argsort(-np.abs(direction)) if abs(direction[k]) > _NAMED][:4]
    sign = np.sign(direction[order[0]])
    shares = {names[k]: float(sign * direction[k]) for k in order}
    return Direction(shares, float(1 / singular.min()))

"""Levenberg–Marquardt on the summary, and the covariance and rank of what it finds."""

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

_MOST_STEPS = 100
_RANK_TOLERANCE = 1e-6
"""Smallest singular value of the column-scaled Jacobian, relative to the largest, that counts.

A direction without data keeps 1e-10, the weight of the pseudo-observations (`orthogonal`).
"""

_NOT_ABOVE, _ROUNDING = 0.01, 1e-6
"""A minimum lies above the linear solution by no more than a hundredth of that or of a standard
deviation, or a millionth of the whole."""

_SETTLED = 0.01
"""Standard deviations by which another Gauss–Newton step would lower the misfit, at a minimum. How
many steps the solver took before it stopped hangs on rounding and decides nothing."""

_NAMED = 0.2
"""Share of a direction from which a parameter is named."""


@dataclass(frozen=True)
class Solution:
    """Parameters with their covariance.

    **Arguments**
    - `names`, `values`, `covariance`: Cartesian parameters in mm and rad.
    - `determined`: False where the data leave a direction open that moves this parameter.
    - `tied`: tied coefficients of every flank, and their `jacobian`, shape (flanks, tied, p).
    - `converged`, `steps`: of the solver; what is no minimum has not converged.
    - `weakest`: the direction among the determined ones that the data fix worst.
    - `misfit`, `linear_misfit`: standard deviations by which the relation misses the harmonics of
      the logs, at the solution and at that of the linear relation.
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
    """A direction in parameter space that the data hardly fix.

    **Arguments**
    - `names`, `shares`: parameters that take part, with signed shares of the direction when every
      parameter is scaled to the same effect on the data.
    - `inflation`: how many times larger its standard error is than that of a parameter on its own.
    """

    names: tuple[str, ...]
    shares: tuple[float, ...]
    inflation: float

    def to_json(self) -> dict:
        """Fields under `checks.weakest_direction`."""
        return {
            "parameters": dict(zip(self.names, self.shares, strict=True)),
            "inflation": self.inflation,
        }


def solve(relation: ForwardModel, flanks: tuple[WhitenedFlank, ...]) -> Solution:
    """Minimise Σ_f |R_tt h_f(p) − R_ty|² over the parameters.

    The residuals are in standard deviations; the parameters are scaled to O(1) by the Jacobian at
    zero eccentricity, where the relation is already within 1e-3 of linear. A damped step from there
    may spread a large offset or drift over eccentricities of metres, where the relation has minima
    of its own: what ends above the linear solution starts again from that.
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
    if not np.isfinite(linear_misfit):  # outside the geometry: nothing to compare with
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
        relation.names,
        np.asarray(values),
        covariance,
        determined,
        tied,
        jacobian,
        settled and reached <= bound,
        int(steps),
        weakest,
        reached,
        linear_misfit,
    )


def _gain(slopes: Float[np.ndarray, "r p"], left: Float[np.ndarray, " r"]) -> float:
    """Length of what a Gauss–Newton step would take off the residuals, in standard deviations."""
    step = np.linalg.lstsq(slopes, left, rcond=_RANK_TOLERANCE)[0]
    return float(np.linalg.norm(slopes @ step))


def _whitened(
    matrices: Float[np.ndarray, "flanks tied tied"], jacobian: Float[ArrayLike, "flanks tied p"]
) -> Float[np.ndarray, "r p"]:
    """Jacobian of the residuals of all flanks."""
    jacobian = np.asarray(jacobian)
    return np.einsum("fij,fjp->fip", matrices, jacobian).reshape(-1, jacobian.shape[-1])


@eqx.filter_jit
def _linearised(relation: ForwardModel, parameters: Float[ArrayLike, " p"]):
    """Tied coefficients and their Jacobian, compiled apart from the solver: it is used twice."""
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
        # Nobody differentiates through the solution, and the implicit adjoint doubles the tracing.
        adjoint=optx.RecursiveCheckpointAdjoint(),
    )
    converged = solution.result == optx.RESULTS.successful
    return scale * solution.value, converged, solution.stats["num_steps"]


def _covariance(
    jacobian: Float[np.ndarray, "r p"], names: tuple[str, ...]
) -> tuple[Float[np.ndarray, "p p"], np.ndarray, Direction | None]:
    """(JᵀJ)⁻¹ on the directions the data fix, which parameters lie wholly in those, the weakest."""
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
    """The direction of the smallest singular value, by its largest parameters."""
    direction = directions[np.argmin(singular)]
    order = [k for k in np.argsort(-np.abs(direction)) if abs(direction[k]) > _NAMED][:4]
    sign = np.sign(direction[order[0]])
    return Direction(
        tuple(names[k] for k in order),
        tuple(float(sign * direction[k]) for k in order),
        float(1 / singular.min()),
    )

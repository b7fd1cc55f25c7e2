"""Least-squares solution from the summary, with its covariance and rank."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..model.forward_model import ForwardModel, PairRelation
from ..noise.noise_model import WhitenedFlank
from .eccentricity_search import RANK_TOLERANCE, EccentricitySearch

_NOT_ABOVE, _ROUNDING = 0.01, 1e-6
"""The misfit of a minimum exceeds that of the linear solution by at most 1 % of the latter or of
one standard deviation, whichever is larger, plus 1e-6 of the length of R_ty; chosen values."""

_SETTLED = 0.01
"""Largest misfit, in standard deviations, that another Gauss–Newton step removes at a minimum. The
number of solver steps depends on rounding and is no criterion."""

_NAMED = 0.2
"""A parameter is listed for a direction if its share in it is larger than this; chosen value."""


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
    """Minimise Σ_f |R_tt h_f(p) − R_ty|² over the parameters p; f runs over the flanks.

    h_f are the tied coefficients of the forward model. The residuals are in standard deviations.
    The parameters are scaled to O(1) by the Jacobian at zero eccentricity, where the forward model
    is linear within 1e-3. The solver starts from the linear solution. The model can have other
    minima. If the solver ends above the misfit of the linear solution, it starts again from zero
    eccentricity.
    """
    matrices, targets = (np.stack([flank.tied[part] for flank in flanks]) for part in (0, 1))
    slopes = _whitened(matrices, relation.linearised(np.zeros(len(relation.names)))[1])
    size = np.linalg.norm(slopes, axis=0)
    scale = 1 / np.where(size > 0, size, 1.0)
    linear = scale * np.linalg.lstsq(slopes * scale, targets.ravel(), rcond=RANK_TOLERANCE)[0]

    def misfit(values: Float[np.ndarray, " p"]) -> float:
        tied = relation.linearised(values)[0]
        return float(np.linalg.norm(np.einsum("fij,fj->fi", matrices, tied) - targets))

    reached = linear_misfit = misfit(linear)
    if not np.isfinite(linear_misfit):  # the linear solution is outside the valid geometry
        linear_misfit = float(np.linalg.norm(targets))
    bound = linear_misfit + _NOT_ABOVE * max(linear_misfit, 1.0)
    bound += _ROUNDING * float(np.linalg.norm(targets))
    values, converged, steps = linear, True, 1
    if isinstance(relation, PairRelation):
        search = EccentricitySearch.of(relation, matrices, targets, scale)
        steps = 0
        for start in (linear, 0 * linear):
            values, converged, more = search.minimise(start)
            reached, steps = misfit(values), steps + more
            if reached <= bound:
                break
    if not np.isfinite(reached):
        values, reached = 0 * linear, np.inf
    tied, jacobian = relation.linearised(values)
    slopes = _whitened(matrices, jacobian)
    covariance, determined, weakest = _covariance(slopes, relation.names)
    left = np.einsum("fij,fj->fi", matrices, tied) - targets
    settled = converged or _gain(slopes * scale, left.ravel()) <= _SETTLED
    return Solution(
        names=relation.names,
        values=values,
        covariance=covariance,
        determined=determined,
        tied=tied,
        jacobian=jacobian,
        converged=settled and reached <= bound,
        steps=steps,
        weakest=weakest,
        misfit=reached,
        linear_misfit=linear_misfit,
    )


def _gain(slopes: Float[np.ndarray, "r p"], left: Float[np.ndarray, " r"]) -> float:
    """Return the length of the part of `left` that one more Gauss–Newton step would remove.

    `left` is the whitened residual, and `slopes` its Jacobian; both are in standard deviations.
    """
    step = np.linalg.lstsq(slopes, left, rcond=RANK_TOLERANCE)[0]
    return float(np.linalg.norm(slopes @ step))


def _whitened(
    matrices: Float[np.ndarray, "flanks tied tied"], jacobian: Float[np.ndarray, "flanks tied p"]
) -> Float[np.ndarray, "r p"]:
    """Return the Jacobian of the whitened residuals of all flanks."""
    return np.einsum("fij,fjp->fip", matrices, jacobian).reshape(-1, jacobian.shape[-1])


def _covariance(
    jacobian: Float[np.ndarray, "r p"], names: tuple[str, ...]
) -> tuple[Float[np.ndarray, "p p"], np.ndarray, Direction | None]:
    """Return the covariance (JᵀJ)⁻¹ of the determined directions, with two further results.

    They are a mask that is True for determined parameters, and the weakest determined direction.
    """
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0] = 1.0
    _, singular, directions = np.linalg.svd(jacobian / size, full_matrices=True)
    singular = np.append(singular, np.zeros(len(directions) - len(singular)))
    fixed = singular > RANK_TOLERANCE * singular[0]
    open_part = np.abs(directions[~fixed]).max(axis=0, initial=0.0)
    inverse = directions[fixed].T / singular[fixed] ** 2 @ directions[fixed]
    weakest = _weakest(singular[fixed], directions[fixed], names) if fixed.any() else None
    return inverse / np.outer(size, size), open_part < 1e-3, weakest


def _weakest(
    singular: Float[np.ndarray, " d"], directions: Float[np.ndarray, "d p"], names: tuple[str, ...]
) -> Direction:
    """Return the direction with the smallest singular value, and up to 4 of its main parameters."""
    direction = directions[np.argmin(singular)]
    order = [k for k in np.argsort(-np.abs(direction)) if abs(direction[k]) > _NAMED][:4]
    sign = np.sign(direction[order[0]])
    shares = {names[k]: float(sign * direction[k]) for k in order}
    return Direction(shares, float(1 / singular.min()))

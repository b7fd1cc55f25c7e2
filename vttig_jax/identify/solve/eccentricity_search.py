"""Levenberg–Marquardt search of the eccentricities, with all linear parameters eliminated.

The misfit is |M (B g(e) + L q) − t|, where g are the transmission errors on the torus for the
eccentricities e, and q are the parameters that only scale a column. For every e the best q is
linear (variable projection: Golub and Pereyra 1973). The projection on what L cannot explain leaves
|W g(e) − w|, and a QR factorisation brings (W, w) to one shape for all models. One compiled program
therefore solves every log of every gear pair.
"""

from dataclasses import dataclass

import jax
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ..model.forward_model import PairRelation
from ..model.torus import GEARS, POINTS, Torus, errors_and_slopes

_MOST_STEPS = 100  # steps of the solver; chosen value

_TOLERANCE = 1e-9
"""Change of an eccentricity, in standard errors of it alone, at which the search ends."""

RANK_TOLERANCE = 1e-6
"""Smallest singular value of a determined direction of the column-scaled Jacobian, relative to the
largest. A direction without data has 1e-10, the weight of a pseudo-observation (`orthogonal`)."""

_VALUES = 2 * POINTS**2
"""Transmission errors of both flanks on the grid."""


@dataclass(frozen=True)
class EccentricitySearch:
    """Misfit of the eccentricities alone, and the linear parameters that belong to them.

    **Arguments**
    - `relation`: forward model. - `scale`: standard error of each parameter alone.
    - `triangle`: (W, w), triangular, in standard deviations.
    - `spread`: M B, from the errors of both flanks on the grid to whitened rows.
    - `target`: t. - `inverse`: pseudo-inverse of the whitened columns M L, for parameters that are
      divided by `scale`.
    """

    relation: PairRelation
    scale: Float[np.ndarray, " p"]
    triangle: Float[np.ndarray, "values_1 values_1"]
    spread: Float[np.ndarray, "rows values"]
    target: Float[np.ndarray, " rows"]
    inverse: Float[np.ndarray, "linear rows"]

    @classmethod
    def of(
        cls,
        relation: PairRelation,
        matrices: Float[np.ndarray, "flanks tied tied"],
        targets: Float[np.ndarray, "flanks tied"],
        scale: Float[np.ndarray, " p"],
    ) -> "EccentricitySearch":
        """Eliminate the linear parameters from the whitened rows `matrices`, `targets`."""
        flanks, width = targets.shape
        whitened = matrices @ np.asarray(relation.basis)
        spread = np.zeros((flanks, width, 2, POINTS**2))
        for row, side in enumerate(relation.sides):
            spread[row, :, side] = whitened[row]
        spread = spread.reshape(flanks * width, _VALUES)
        linear = np.asarray(relation.linear) * scale[: len(relation.linear), None, None]
        columns = np.einsum("fij,pfj->fip", matrices, linear).reshape(flanks * width, -1)
        left, singular, right = np.linalg.svd(columns, full_matrices=False)
        kept = singular > RANK_TOLERANCE * singular[0]
        explained = left[:, kept]
        target = targets.ravel()
        rows = np.column_stack([spread, target])
        rows -= explained @ (explained.T @ rows)
        triangle = np.zeros((_VALUES + 1, _VALUES + 1))
        found = np.linalg.qr(rows, mode="r")
        triangle[: len(found)] = found
        inverse = right[kept].T / singular[kept] @ explained.T
        return cls(
            relation=relation,
            scale=scale,
            triangle=triangle,
            spread=spread,
            target=target,
            inverse=inverse,
        )

    def minimise(self, start: Float[np.ndarray, " p"]) -> tuple[Float[np.ndarray, " p"], bool, int]:
        """Return the parameters of least misfit, whether the search settled, and its steps."""
        relation, first = self.relation, len(self.relation.linear)
        scale, gears = np.zeros(len(GEARS)), np.zeros(len(GEARS))
        scale[relation.places] = self.scale[first:]
        gears[relation.places] = start[first:] / self.scale[first:]
        found, settled, steps = _minimise(relation.torus, self.triangle, scale, gears)
        gears = np.asarray(found)
        errors = np.asarray(errors_and_slopes(relation.torus, gears)[0])
        linear = self.inverse @ (self.target - self.spread @ errors.ravel())
        values = np.concatenate([self.scale[:first] * linear, gears[relation.places]])
        return values, bool(settled), int(steps)


@jax.jit
def _minimise(
    torus: Torus,
    triangle: Float[Array, "values_1 values_1"],
    scale: Float[Array, "4"],
    start: Float[Array, "4"],
) -> tuple[Float[Array, "4"], Bool[Array, ""], Int[Array, ""]]:
    def misfit(scaled: Float[Array, "4"], _: None) -> Float[Array, " values_1"]:
        return triangle[:, :-1] @ torus.errors(scale * scaled).ravel() - triangle[:, -1]

    solution = optx.least_squares(
        misfit,
        optx.LevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE),
        start,
        max_steps=_MOST_STEPS,
        throw=False,
        # The solution is never differentiated, and the implicit adjoint doubles the tracing time.
        adjoint=optx.RecursiveCheckpointAdjoint(),
    )
    settled = solution.result == optx.RESULTS.successful
    return scale * solution.value, settled, solution.stats["num_steps"]

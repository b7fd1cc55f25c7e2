"""Search of the eccentricities by a trust region, with all linear parameters eliminated.

The misfit is |M (B g(e) + L q) − t|. Here g are the transmission errors on the torus for the
eccentricities e, B projects them on the tied columns, q are the parameters that only scale a column
(L), M contains the whitened columns of all flanks, and t the whitened y. For every e the best q
follows by linear least squares (variable projection: Golub and Pereyra 1973). A projection
orthogonal to M L and a QR factorisation leave |W g(e) − w| with a triangular matrix (W, w). Only g
and its derivatives are compiled, in one program for every log of every gear pair; the few steps of
SciPy take less time than the tracing of a compiled solver.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from ..model.forward_model import PairRelation
from ..model.torus import GEARS, POINTS, errors_and_slopes

_MOST_STEPS = 100  # trial points of the solver; chosen value

_TOLERANCE = 1e-6
"""The search ends if the gradient of half the squared misfit is smaller than this. Eccentricities
are measured in their standard errors, so the next step would change them by about this many
standard errors (chosen). Rounding hides smaller changes of the squared misfit. One Gauss–Newton
step, which needs no comparison of misfits, follows."""

_LEAST_STEP = 1e-12  # relative step at which the search ends if rounding hides the slope (chosen)

RANK_TOLERANCE = 1e-6
"""Smallest singular value of a determined direction of the column-scaled Jacobian, relative to the
largest singular value. A direction without data has about 1e-10, the weight of a pseudo-observation
(`orthogonal`)."""

_VALUES = 2 * POINTS**2
"""Number of transmission errors of both flanks on the grid."""


@dataclass(frozen=True)
class EccentricitySearch:
    """Misfit as a function of the eccentricities alone, and the best linear parameters for them.

    **Arguments**
    - `relation`: forward model.
    - `scale`: standard error that each parameter would have if it were fitted alone.
    - `triangle`: (W, w), triangular, in standard deviations of the noise.
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
        """Return the parameters of least misfit, and whether the search settled.

        The third result is the number of trial points. A start outside the valid geometry, where
        the base circles overlap, is returned unchanged.
        """
        relation, first = self.relation, len(self.relation.linear)
        scale, places = self.scale[first:], relation.places

        def evaluated(scaled: Float[np.ndarray, " q"]) -> list[Float[np.ndarray, "..."]]:
            gears = np.zeros(len(GEARS))
            gears[places] = scale * scaled
            errors, slopes = map(np.asarray, errors_and_slopes(relation.torus, gears))
            return [errors.ravel(), slopes.reshape(_VALUES, -1)[:, places] * scale]

        def misfit(scaled: Float[np.ndarray, " q"]) -> Float[np.ndarray, " values_1"]:
            return self.triangle[:, :-1] @ evaluated(scaled)[0] - self.triangle[:, -1]

        if not np.isfinite(misfit(start[first:] / scale)).all():
            return start, False, 1
        slopes: Any = lambda scaled: self.triangle[:, :-1] @ evaluated(scaled)[1]  # noqa: E731
        never: Any = None
        found = least_squares(
            misfit,
            start[first:] / scale,
            jac=slopes,
            gtol=_TOLERANCE,
            xtol=_LEAST_STEP,
            ftol=never,
            max_nfev=_MOST_STEPS,
        )
        best = found.x - np.linalg.lstsq(found.jac, found.fun, rcond=RANK_TOLERANCE)[0]
        linear = self.inverse @ (self.target - self.spread @ evaluated(best)[0])
        values = np.concatenate([self.scale[:first] * linear, scale * best])
        return values, found.status > 0, int(found.nfev)

"""Search of the eccentricities by a trust region, with all linear parameters eliminated.

The misfit is |M (B g(e) + L q) − t|, where g are the transmission errors on the torus for the
eccentricities e, and q are the parameters that only scale a column. For every e the best q is
linear (variable projection: Golub and Pereyra 1973). The projection on what L cannot explain leaves
|W g(e) − w| with a triangular (W, w). Only g and its derivatives are compiled, in one program for
every log of every gear pair; the few steps of SciPy take less time than a compiled solver takes to
be traced.
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
"""Slope of half the squared misfit, per standard error of an eccentricity alone, at which the
search ends: the next step changes it by about as many standard errors (chosen). Rounding hides
smaller changes of the squared misfit, and one last step needs no comparison of it."""

_LEAST_STEP = 1e-12  # last step beside the eccentricities if rounding hides the slope (chosen)

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
        """Return the parameters of least misfit, whether the search settled, and its steps.

        A start outside the valid geometry, where the base circles overlap, is returned as it is.
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

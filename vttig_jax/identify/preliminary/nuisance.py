"""Linear regression of drift, delay and regressors after the elimination of the harmonics.

In this model all harmonics, free and tied, have independent coefficients on each flank. Offset,
drift, delay and each regressor of a log have one coefficient for both flanks. The gap between the
flanks is one coefficient for all logs. The model needs no forward model and no iteration. It is
used to select regressors and to compute the next step of the delay.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ..compress.harmonic_summary import ROUNDING, HarmonicSummary
from ..compress.orthogonal import EMPTY, triangle_of
from ..model.column_layout import OFFSET, own_parameters


@dataclass(frozen=True)
class NuisanceRegression:
    """Least squares of the coefficients of drift, delay and regressors on whitened rows.

    **Arguments**
    - `names`: names of the coefficients.
    - `triangle`: factor of the columns of these coefficients and of y, which is the last column,
      after the elimination of harmonics, offsets and gap. It is upper triangular, except after
      `merged`.
    - `rows`: number of block rows minus the number of eliminated coefficients.
    - `total`, `raw`: sums of squares of y and of each column before the elimination.
    """

    names: tuple[str, ...]
    triangle: Float[np.ndarray, "r q"]
    rows: float
    total: float
    raw: Float[np.ndarray, " p"]

    @property
    def is_exact(self) -> bool:
        """Whether the residual of the model with all coefficients is only rounding error."""
        return self.misfit(self.names) <= ROUNDING * self.total

    def left(self, name: str) -> float:
        """Return the share of the sum of squares of a column that the eliminated ones leave.

        It is 0 … 1; near 0, harmonics, offsets and gap explain the column, and its coefficient is
        not identifiable.
        """
        place = self.names.index(name)
        square = float(self.triangle[:, place] @ self.triangle[:, place])
        return square / float(self.raw[place]) if self.raw[place] > EMPTY else 0.0

    def merged(self, groups: Mapping[str, Sequence[str]]) -> "NuisanceRegression":
        """Return the regression with a further column for each group: the sum of its columns.

        The columns of a group are zero in the rows in which another column of it is not.
        """
        places = [[self.names.index(name) for name in group] for group in groups.values()]
        sums = [self.triangle[:, own].sum(axis=1, keepdims=True) for own in places]
        return replace(
            self,
            names=(*self.names, *groups),
            triangle=np.concatenate([self.triangle[:, :-1], *sums, self.triangle[:, -1:]], axis=1),
            raw=np.concatenate([self.raw, [self.raw[own].sum() for own in places]]),
        )

    def misfit(self, names: Sequence[str]) -> float:
        """Return the residual sum of squares of the fit with these coefficients only.

        It is never smaller than the rounding error.
        """
        return max(float(self._among(names)[-1, -1] ** 2), ROUNDING * self.total)

    def estimate(self, name: str, among: Sequence[str]) -> tuple[float, float]:
        """Return the coefficient `name` and its standard error in a fit of the names `among`."""
        value, covariance, _ = self.estimates([name], among)
        return float(value[0]), float(np.sqrt(covariance[0, 0]))

    def estimates(
        self, names: Sequence[str], among: Sequence[str]
    ) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"], Float[np.ndarray, " k"]]:
        """Return the coefficients `names` and their covariance matrix in a fit of `among`.

        The third result is the share of the sum of squares of each column that all other columns
        leave.
        """
        triangle = self._among(among)
        inverse = np.linalg.inv(triangle[:-1, :-1])[[list(among).index(name) for name in names]]
        variance = self.misfit(among) / max(self.rows - len(among), 1.0)
        square = inverse @ inverse.T
        raw = self.raw[[self.names.index(name) for name in names]]
        left = 1 / np.maximum(np.diag(square) * raw, 1.0)
        return inverse @ triangle[:-1, -1], square * variance, np.where(raw > EMPTY, left, 0.0)

    def bic(self, names: Sequence[str]) -> float:
        """Return the Bayesian information criterion of a model with only these coefficients."""
        left = max(self.misfit(names), 1e-300)
        return self.rows * np.log(left) + len(names) * np.log(max(self.rows, 2.0))

    def _among(self, names: Sequence[str]) -> Float[np.ndarray, "r r"]:
        """Return the upper triangular factor of the columns `names` and y."""
        return triangle_of(self.triangle[:, [*(self.names.index(n) for n in names), -1]])


def own_terms(summary: HarmonicSummary, filter_: Float[np.ndarray, " taps"]) -> NuisanceRegression:
    """Whiten the rows, and eliminate the harmonics of every flank, the offsets and the gap.

    The result is the regression of the remaining columns: drift, delay and regressors.
    """
    columns = summary.columns
    names, places = own_parameters(columns)
    own = np.arange(columns.own_slice.start, columns.own_slice.stop)
    harmonics = np.delete(np.arange(columns.width - 1), own)
    order = np.array([*harmonics, *own, columns.width - 1], np.int64)
    offsets = np.eye(len(own))[:, [name == OFFSET for name, _ in columns.names]]
    first = summary.flanks[0].flank if summary.flanks else "A"
    gap = len(summary.flanks) == 2
    fixed = offsets.shape[1] + gap
    spread = np.zeros((len(own), fixed + len(names)))
    spread[:, : offsets.shape[1]] = offsets
    spread[:, fixed:][[name != OFFSET for name, _ in columns.names]] = places
    kept, raw = [], np.zeros(spread.shape[1] + 1)
    for flank in summary.flanks:
        if gap:
            spread[:, fixed - 1] = offsets.sum(axis=1) * (flank.flank != first)
        widened = np.block([[spread, np.zeros((len(own), 1))], [np.zeros(spread.shape[1]), 1.0]])
        triangle = triangle_of(flank.factor(filter_)[:, order])
        kept.append(triangle[len(harmonics) :, len(harmonics) :] @ widened)
        raw += np.sum((triangle[:, len(harmonics) :] @ widened) ** 2, axis=0)
    left = triangle_of(np.concatenate(kept))[fixed:, fixed:]
    rows = summary.rows - len(harmonics) * len(summary.flanks) - fixed
    return NuisanceRegression(names, left, float(max(rows, 1)), float(raw[-1]), raw[fixed:-1])

"""Coefficients of the own columns of the logs in the linear model: what is in a log, and how sure.

The harmonics, free and tied alike, count as free on each flank; offsets, drift, delay and the other
regressors have one coefficient for both flanks, the gap between the flanks one for all logs. That
needs no relation and no iteration, so it serves to choose among them and to step towards the delay.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .channels import is_shared
from .columns import OFFSET, Columns
from .normal_equations import cholesky
from .summary import HarmonicSummary

_ROUNDING = 1e-12
"""Share of y² below which a misfit is rounding, and the ridge of the normal equations."""


@dataclass(frozen=True)
class OwnTerms:
    """Normal equations of the own coefficients, in the units of the innovations' sum of squares.

    **Arguments**
    - `names`: of the coefficients.
    - `gram`, `right`: of the normal equations; `square`: y² that the harmonics leave.
    - `rows`: block rows with a full history, less the coefficients of harmonics and offsets.
    - `total`: y² itself; `raw`: squares of the own columns themselves.
    """

    names: tuple[str, ...]
    gram: Float[np.ndarray, "p p"]
    right: Float[np.ndarray, " p"]
    square: float
    rows: float
    total: float
    raw: Float[np.ndarray, " p"]

    @property
    def is_exact(self) -> bool:
        """True where rounding is all that the model leaves."""
        return self.misfit(self.names) <= _ROUNDING * self.total

    def left(self, name: str) -> float:
        """Share of a regressor, squared, that the harmonics and offsets do not explain."""
        place = self.names.index(name)
        return float(self.gram[place, place] / self.raw[place]) if self.raw[place] > 0 else 0.0

    def misfit(self, names: Sequence[str]) -> float:
        """Sum of squared innovations with only these coefficients."""
        keep = [self.names.index(name) for name in names]
        if not keep:
            return self.square
        gram, right = self.gram[np.ix_(keep, keep)], self.right[keep]
        return self.square - float(right @ _solve(gram, right))

    def estimate(self, name: str, among: Sequence[str]) -> tuple[float, float]:
        """A coefficient and its standard error when `among` are fitted together."""
        keep = [self.names.index(other) for other in among]
        gram, right = self.gram[np.ix_(keep, keep)], self.right[keep]
        place = list(among).index(name)
        inverse = _solve(gram, np.eye(len(keep)))
        variance = self.misfit(among) / max(self.rows - len(keep), 1.0)
        return float((inverse @ right)[place]), float(np.sqrt(inverse[place, place] * variance))

    def bic(self, names: Sequence[str]) -> float:
        """Bayesian information criterion of a model with only these coefficients."""
        left = max(self.misfit(names), 1e-300)
        return self.rows * np.log(left) + len(names) * np.log(max(self.rows, 2.0))


def own_terms(summary: HarmonicSummary, filter_: Float[np.ndarray, " taps"]) -> OwnTerms:
    """Eliminate the harmonics of every flank, the offsets and the gap under a whitening filter."""
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
    gram, raw = np.zeros((spread.shape[1] + 1,) * 2), np.zeros(spread.shape[1] + 1)
    for flank in summary.flanks:
        products = flank.whitened(filter_)[np.ix_(order, order)]
        if gap:
            spread[:, fixed - 1] = offsets.sum(axis=1) * (flank.flank != first)
        widened = np.block([[spread, np.zeros((len(own), 1))], [np.zeros(spread.shape[1]), 1.0]])
        kept = cholesky(products)[len(harmonics) :, len(harmonics) :] @ widened
        gram += kept.T @ kept
        raw += np.diag(widened.T @ products[len(harmonics) :, len(harmonics) :] @ widened)
    left = cholesky(gram)[fixed:, fixed:]
    left = left.T @ left
    rows = summary.rows - len(harmonics) * len(summary.flanks) - fixed
    return OwnTerms(
        names,
        left[:-1, :-1],
        left[:-1, -1],
        float(left[-1, -1]),
        float(max(rows, 1)),
        float(raw[-1]),
        raw[fixed:-1],
    )


def own_parameters(
    columns: Columns,
) -> tuple[tuple[str, ...], Float[np.ndarray, "own p"]]:
    """Coefficients of the own columns other than offsets, and which column has which.

    A coefficient that all logs share has the name of its columns, another one the number of its log
    behind it where there are several.
    """
    several = len(columns.own) > 1
    entries = [entry for entry in columns.names if entry[0] != OFFSET]
    labels = [
        f"{name}_of_{log + 1}" if several and not is_shared(name) else name for name, log in entries
    ]
    names = tuple(dict.fromkeys(labels))
    matrix = np.zeros((len(entries), len(names)))
    for row, label in enumerate(labels):
        matrix[row, names.index(label)] = 1.0
    return names, matrix


def _solve(gram: Float[np.ndarray, "p p"], right: np.ndarray) -> np.ndarray:
    """Solve after scaling to one; a direction without data costs a ridge of 1e-12."""
    size = np.sqrt(np.maximum(np.diag(gram), 0.0))
    size[size == 0] = 1.0
    scaled = gram / np.outer(size, size) + 1e-12 * np.eye(len(gram))
    spread = size[:, None] if right.ndim == 2 else size
    return np.linalg.solve(scaled, right / spread) / spread

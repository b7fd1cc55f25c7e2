"""Averaged rows of the transmission error, their noise, and regressions on them.

Stretches of one or several logs are averaged in blocks and stacked. A run is an uninterrupted
stretch of rows, along which the noise is an autoregression that whitens it. Lines (cosine and sine
of unknown frequency) are fitted by least squares together with regressors.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import get_blas_funcs, qr

from ...base.numerics.autoregression import whitening_filter
from ...base.numerics.counting import whole_below
from ...base.units import REV
from ..channel.speed import usual_step

_ROWS_PER_CYCLE = 6.0
"""Rows per cycle of the highest frequency; denser rows are averaged in blocks (chosen)."""

_LEAST_ROWS = 1000
"""Least number of rows that averaging leaves (chosen)."""


@dataclass(frozen=True)
class Stretch:
    """Uninterrupted stretch of a log, also called a run, with its rows in time order.

    **Arguments**
    - `angle`: driving angle in rad, shape (n,), with the same zero for all runs. It may be another
      variable: 2π t/s gives lines in cycles per second.
    - `value`: transmission error or residual in rad, shape (n,).
    - `nuisance`: regressors that are fitted with every line, shape (n, p); at least a constant.
    - `group`: name of a group (a flank, a log); its runs share the coefficients of the regressors.
    """

    angle: Float[np.ndarray, " n"]
    value: Float[np.ndarray, " n"]
    nuisance: Float[np.ndarray, "n p"]
    group: str = ""

    def __post_init__(self):
        rows = {len(self.angle), len(self.value), len(self.nuisance)}
        if len(rows) != 1 or self.nuisance.ndim != 2 or self.nuisance.shape[1] == 0:
            raise ValueError(
                "Argument `nuisance` must have a row for every angle and value and at least one"
                f" column, but the shapes are {self.angle.shape}, {self.value.shape} and"
                f" {self.nuisance.shape}."
            )
        for name in ("angle", "value", "nuisance"):
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(
                    f"Argument `{name}` must be finite in every row, but it is not; remove these"
                    " rows and split the run there."
                )


_KNOWN = 12  # largest number of lines whose columns are cached (chosen)

Wave = Float[np.ndarray, "n 2"]
"""Columns of one line: cosine and sine at every row; each column is contiguous in memory."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of all runs, one run after the other.

    **Arguments**
    - `turns`: driving revolutions minus their mean `origin`, shape (n,).
    - `width`: revolutions over which each row is averaged, shape (n,).
    - `value`: transmission error or residual in rad, shape (n,).
    - `nuisance`: for every group the slice of its rows, and its regressors, shape (rows, q).
    - `starts`: index of the first row of every run, and n at the end.
    """

    turns: Float[np.ndarray, " n"]
    origin: float
    width: Float[np.ndarray, " n"]
    value: Float[np.ndarray, " n"]
    nuisance: tuple[tuple[slice, Float[np.ndarray, "_ _"]], ...]
    starts: tuple[int, ...]

    @property
    def runs(self) -> list[slice]:
        """Slice of the rows of every run that has rows; a run shorter than one block has none."""
        return [slice(first, stop) for first, stop in pairwise(self.starts) if stop > first]

    @property
    def span(self) -> float:
        """Revolutions between the lowest and the highest angle."""
        return float(np.ptp(self.turns))

    @cached_property
    def bases(self) -> list[tuple[slice, Float[np.ndarray, "_ _"]]]:
        """Rows of every group, and an orthonormal basis of its regressors."""
        return [(where, orthonormal(columns)[0]) for where, columns in self.nuisance]

    @property
    def rank(self) -> int:
        """Number of independent regressors of all groups."""
        return sum(basis.shape[1] for _, basis in self.bases)

    def without_regressors(self, columns: Float[np.ndarray, " n *k"]) -> Float[np.ndarray, " n *k"]:
        """Return the part of `columns` orthogonal to the regressors, column-major in memory."""
        left = np.array(columns.T, order="C")
        for where, basis in self.bases:
            part = left[..., where]
            part -= (part @ basis) @ basis.T
        return left.T

    @cached_property
    def wave(self) -> Callable[[float], Wave]:
        """Function from the frequency of a line to its columns, which keeps the last ones.

        Both columns are averaged over the angle `width` over which the row itself was averaged.
        """
        turns, width, averaged = self.turns, self.width, self.width.any()

        def wave(cycles: float) -> Wave:
            turned = cycles * turns
            angle = REV * (turned - np.rint(turned))  # NumPy is faster for small angles
            table = np.stack([np.cos(angle), np.sin(angle)])
            if averaged:
                table *= np.sinc(cycles * width)
            return table.T

        return lru_cache(_KNOWN)(wave)

    def slope(self, cycles: float) -> Wave:
        """Return the derivatives of the columns of a line with respect to its frequency."""
        cosine, sine = self.wave(cycles).T
        turns = REV * self.turns
        return np.stack([-turns * sine, turns * cosine]).T


def stack(runs: Sequence[Stretch], highest: float) -> Rows:
    """Stack the rows of all runs; rows denser than six per cycle of `highest` are averaged.

    **Raises** `ValueError` if runs of one group differ in their columns, or if a cycle of `highest`
    has fewer than two rows, because its alias would look the same.
    """
    if not runs:
        raise ValueError("Argument `runs` must hold at least one run, but is empty.")
    step = typical_step(runs)
    if highest > (most := highest_resolved(runs)):
        raise ValueError(
            f"Argument `highest` must be at most {most:.4g} cycles per revolution, but is"
            f" {highest:.4g}: the rows are {step:.3g} revolutions apart."
        )
    block = sum(len(run.value) for run in runs) // _LEAST_ROWS
    if step > 0:
        block = min(block, whole_below(1 / (_ROWS_PER_CYCLE * highest * step)))
    groups: dict[str, list[Stretch]] = {}
    for run in runs:
        groups.setdefault(run.group, []).append(run)
    for name, members in groups.items():
        if len({run.nuisance.shape[1] for run in members}) != 1:
            raise ValueError(
                "Argument `nuisance` must have the same columns in all runs of a group, but group"
                f" {name!r} has {sorted({run.nuisance.shape[1] for run in members})}."
            )
    ordered = [_averaged(run, max(block, 1)) for members in groups.values() for run in members]
    turns = np.concatenate([run.angle for run, _ in ordered]) / REV
    origin = float(turns.mean()) if len(turns) else 0.0
    starts = (0, *np.cumsum([len(run.value) for run, _ in ordered]).tolist())
    nuisance, first = [], 0
    for members in groups.values():  # runs of a group are neighbours
        parts = [run.nuisance for run, _ in ordered[first : first + len(members)]]
        rows = slice(starts[first], starts[first + len(parts)])
        nuisance.append((rows, np.concatenate(parts)))
        first += len(parts)
    return Rows(
        turns=turns - origin,
        origin=origin,
        width=np.concatenate([width for _, width in ordered]),
        value=np.concatenate([run.value for run, _ in ordered]),
        nuisance=tuple(nuisance),
        starts=starts,
    )


def highest_resolved(runs: Sequence[Stretch], rows_per_cycle: float = 2.0) -> float:
    """Return the frequency with this number of rows per cycle, in cycles per revolution.

    The rows are `typical_step` apart. The result is infinite if no angle of the runs changes.
    """
    step = typical_step(runs)
    return 1 / (rows_per_cycle * step) if step > 0 else np.inf


def typical_step(runs: Sequence[Stretch]) -> float:
    """Return the travel-weighted median of the distance between successive rows, in revolutions.

    Half of the total travel consists of steps up to this size.
    """
    return usual_step(np.concatenate([np.diff(run.angle) for run in runs])) / REV


def _averaged(run: Stretch, block: int) -> tuple[Stretch, Float[np.ndarray, " m"]]:
    """Return the run averaged over blocks of rows, and the width of each block in revolutions.

    A block has at most `block` rows, and all have nearly equal size.
    """
    count = -(-len(run.value) // block)
    if count == len(run.value):
        return run, np.zeros(count)
    first = np.arange(count) * len(run.value) // count
    size = np.diff(np.append(first, len(run.value)))
    angle, value, nuisance = (
        np.add.reduceat(part, first, axis=0) / size.reshape(-1, *[1] * (part.ndim - 1))
        for part in (run.angle, run.value, run.nuisance)
    )
    travel = np.abs(run.angle[first + size - 1] - run.angle[first]) / REV
    width = travel * size / np.maximum(size - 1, 1)
    return Stretch(angle, value, nuisance, run.group), width


_axpy: Any = get_blas_funcs("axpy", dtype=np.float64)
"""Return a x + y, written into y."""

HIGHEST_ORDER = 32
_ROWS_PER_LAG = 12
"""Highest order p of the autoregression, and least number of rows per unit of p (chosen)."""

_INDEPENDENT = 1e-8
"""The normal equations of the autoregression are solved if the least eigenvalue of the normalised
products is above this value; the coefficients then keep eight digits (chosen)."""


def noise_filter(rows: Rows, residual: Float[np.ndarray, " n"]) -> Float[np.ndarray, " taps"]:
    """Return the whitening filter (1, −a₁, …, −a_p) of a residual; BIC selects the order p."""
    longest = max(run.stop - run.start for run in rows.runs)
    most = min(HIGHEST_ORDER, len(residual) // _ROWS_PER_LAG, longest // 4)
    products = np.zeros(most + 1)
    for run in rows.runs:
        padded = np.pad(residual[run], (most, 0))
        products += np.correlate(padded, residual[run], mode="valid")[::-1]
    order = len(whitening_filter(products / len(residual), len(residual))) - 1
    return filter_of_order(rows, residual, order)


def filter_of_order(
    rows: Rows, residual: Float[np.ndarray, " n"], order: int
) -> Float[np.ndarray, " taps"]:
    """Return the whitening filter (1, −a₁, …, −a_p) of order p from a least-squares fit.

    Every value of the residual that has p predecessors in its run is regressed on them (covariance
    method). The Yule–Walker equations are not used, because the autocovariance treats the values
    beyond the ends of a run as zeros. In a short log this makes a resonance of the noise too broad,
    and the remaining part of the resonance looks like a line.
    """
    if order == 0:
        return np.ones(1)
    runs = [residual[run] for run in rows.runs if run.stop - run.start > order]
    products = np.sum([_products(values, order) for values in runs], axis=0)
    size = np.sqrt(np.maximum(np.diag(products), 1e-300))
    products /= np.outer(size, size)
    least = np.linalg.eigvalsh(products[1:, 1:])[0]
    if least > _INDEPENDENT:
        taps = np.linalg.solve(products[1:, 1:], products[1:, 0]) * size[0] / size[1:]
    else:
        windows = np.concatenate([sliding_window_view(values, order + 1) for values in runs])
        taps = np.linalg.lstsq(windows[:, -2::-1], windows[:, -1], rcond=None)[0]
    return np.concatenate([[1.0], -taps])


def _products(values: Float[np.ndarray, " n"], order: int) -> Float[np.ndarray, "lags lags"]:
    """Return Σ x[t − i] x[t − j] over all t that have `order` predecessors, for lags i and j.

    Row 0 is a correlation. Every other product is its upper left neighbour with the first term
    added and the last one removed.
    """
    products = np.empty((order + 1, order + 1))
    products[0] = products[:, 0] = np.correlate(values, values[order:], mode="valid")[::-1]
    first, last = values[:order][::-1], values[: -order - 1 : -1]
    change = np.outer(first, first) - np.outer(last, last)
    for lag in range(order):
        products[lag + 1, lag + 1 :] = products[lag, lag:-1] + change[lag, lag:]
        products[lag + 1 :, lag + 1] = products[lag + 1, lag + 1 :]
    return products


def whitened(
    rows: Rows, columns: Float[np.ndarray, " n *k"], taps: Float[np.ndarray, " taps"]
) -> Float[np.ndarray, " n *k"]:
    """Return the columns filtered along every run.

    The filter `taps` has order p. The first p rows of every run have too few predecessors and
    become 0.
    """
    order = len(taps) - 1
    if order == 0:
        return columns
    left = np.ascontiguousarray(columns.T)  # one column after the other
    filtered = np.zeros_like(left)
    for lag, tap in enumerate(taps):
        filtered = _axpy(left.ravel(), filtered.ravel(), n=left.size - lag, a=tap, offy=lag)
    filtered = filtered.reshape(left.shape)
    for run in rows.runs:
        filtered[..., run.start : min(run.start + order, run.stop)] = 0.0
    return filtered.T


def transposed(
    innovations: Float[np.ndarray, " n"], taps: Float[np.ndarray, " taps"]
) -> Float[np.ndarray, " n"]:
    """Return Wᵀ e, where e are the `innovations` and W is the matrix of the filter in `whitened`.

    The innovations must be 0 in the first rows of every run, as in a result of `whitened`.
    """
    count = len(innovations)
    result = np.zeros(count)
    for lag, tap in enumerate(taps[:count]):
        result = _axpy(innovations, result, n=count - lag, a=tap, offx=lag)
    return result


APART = 1.0
"""Least distance of two lines, in resolutions; a resolution is 1 / (revolutions of the log)
(chosen)."""

_STEPS = 16
_CONVERGED = 0.01
"""Largest number of Gauss–Newton steps. The iteration ends earlier if the step of every frequency
is at most `_CONVERGED` standard errors of this frequency (chosen)."""

_RANK = 1e-10
"""A column is independent if the part orthogonal to the other columns has at least this norm,
relative to the column (chosen)."""

_INDEPENDENT_COLUMNS = 1e-6
"""The normal equations are used if the least eigenvalue of the Gram matrix of normalised columns
reaches this value; the coefficients are then correct to ten digits (chosen)."""


def orthonormal(
    columns: Float[np.ndarray, "n q"],
) -> tuple[Float[np.ndarray, "n r"], Float[np.ndarray, "q r"]]:
    """Return an orthonormal basis of `columns`, and the matrix `mixing`: basis = columns @ mixing.

    Linearly dependent columns are omitted, so that r ≤ q.
    """
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    factors: Any = qr(columns / size, mode="economic", pivoting=True, check_finite=False)
    basis, upper, order = factors
    rank = int(np.count_nonzero(np.abs(np.diag(upper)) > _RANK))
    mixing = np.zeros((columns.shape[1], rank))
    mixing[order[:rank]] = np.linalg.inv(upper[:rank, :rank])
    return basis[:, :rank], mixing / size[:, None]


def scaled(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return a regressor over its largest magnitude; one that is zero everywhere stays zero."""
    return values / max(float(np.abs(values).max()), 1e-300)


def fitted(
    columns: Float[np.ndarray, "n q"], value: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q q"]]:
    """Return the least-squares coefficients of `columns` and their covariance for noise variance 1.

    The normal equations are solved if the columns are far from dependent; otherwise QR is used.
    """
    return _solved(columns.T @ columns, columns.T @ value, (columns,), value)


def _solved(
    products: Float[np.ndarray, "q q"],
    right: Float[np.ndarray, " q"],
    columns: tuple[Float[np.ndarray, "n _"], ...],
    value: Float[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q q"]]:
    """Return the result of `fitted` for columns side by side, whose products are known."""
    size = np.sqrt(np.diag(products))
    size[size == 0] = 1.0
    values, vectors = np.linalg.eigh(products / np.outer(size, size))
    if len(values) and values[0] < _INDEPENDENT_COLUMNS:
        basis, mixing = orthonormal(np.hstack(columns))
        return mixing @ (basis.T @ value), mixing @ mixing.T
    root = vectors / np.sqrt(values) / size[:, None]
    return root @ (root.T @ right), root @ root.T


class LineFit(NamedTuple):
    """Fit of lines at `frequencies`: coefficients of their columns, and the residual `rest`.

    `covariance` is that of the coefficients for innovations of variance 1. `products` and `right`
    are the products of the `columns` with each other and with the value.
    """

    frequencies: Float[np.ndarray, " k"]
    coefficients: Float[np.ndarray, " 2*k"]
    covariance: Float[np.ndarray, "2*k 2*k"]
    rest: Float[np.ndarray, " n"]
    columns: Float[np.ndarray, "n 2*k"]
    products: Float[np.ndarray, "2*k 2*k"]
    right: Float[np.ndarray, " 2*k"]

    @property
    def misfit(self) -> float:
        """Sum of squares that remains."""
        return float(self.rest @ self.rest)

    @property
    def drops(self) -> Float[np.ndarray, " k"]:
        """Decrease of the sum of squares by each line, relative to a fit of all other lines."""
        waves = [slice(k, k + 2) for k in range(0, len(self.coefficients), 2)]
        pairs = [(self.coefficients[w], np.linalg.pinv(self.covariance[w, w])) for w in waves]
        return np.array([pair @ inverse @ pair for pair, inverse in pairs])


@dataclass(frozen=True, eq=False)
class LineRegression:
    """Least-squares fit of lines to the whitened residual after a fit of the regressors.

    The regressors are projected out of the value and the lines before both are whitened.

    **Arguments**
    - `taps`: whitening filter along every run; (1,) without whitening.
    - `residual`: value minus its fit by the regressors, then whitened, rad, shape (n,).
    - `plain`: the same regression without whitening, which keeps the projected columns; None if
      this one is not whitened.
    """

    rows: Rows
    residual: Float[np.ndarray, " n"]
    taps: Float[np.ndarray, " taps"]
    plain: "LineRegression | None" = None

    def whitened(self, taps: Float[np.ndarray, " taps"]) -> "LineRegression":
        """Return the same regression, whitened with `taps`; `self` must not be whitened."""
        if len(taps) == 1:
            return self
        return LineRegression(self.rows, whitened(self.rows, self.residual, taps), taps, self)

    @cached_property
    def wave(self) -> Callable[[float], Wave]:
        """Function from a frequency to cosine and sine of its line, which keeps the last ones.

        They are made orthogonal to the regressors and whitened.
        """
        return self._made("wave")

    @cached_property
    def slope(self) -> Callable[[float], Wave]:
        """Function from a frequency to the derivatives of these columns with respect to it."""
        return self._made("slope")

    def _made(self, name: Literal["wave", "slope"]) -> Callable[[float], Wave]:
        """Return a function that keeps its last results, and not this regression, in memory."""
        rows, taps = self.rows, self.taps
        of_rows = getattr(rows if self.plain is None else self.plain, name)
        if self.plain is None:
            return lru_cache(_KNOWN)(lambda cycles: rows.without_regressors(of_rows(cycles)))
        return lru_cache(_KNOWN)(lambda cycles: whitened(rows, of_rows(cycles), taps))

    def fit(self, frequencies: Float[np.ndarray, " k"]) -> LineFit:
        """Fit cosine and sine of each line."""
        waves = [self.wave(float(cycles)).T for cycles in frequencies]
        columns = np.concatenate([np.empty((0, len(self.residual))), *waves]).T
        products, right = columns.T @ columns, columns.T @ self.residual
        found, covariance = _solved(products, right, (columns,), self.residual)
        rest = self.residual - columns @ found
        return LineFit(frequencies, found, covariance, rest, columns, products, right)

    def with_corrections(
        self, found: LineFit
    ) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, "c c"]]:
        """Fit the lines of `found` together with a linear correction of each frequency.

        **Returns** the coefficients (2 k of cosines and sines, then k corrections of frequencies in
        cycles per revolution) and their covariance for innovations of variance 1.
        """
        slopes = [self.slope(float(cycles)).T for cycles in found.frequencies]
        pairs = found.coefficients.reshape(-1, 2)
        moved = np.array([pair @ slope for pair, slope in zip(pairs, slopes, strict=True)])
        crossed = moved @ found.columns
        products = np.block([[found.products, crossed.T], [crossed, moved @ moved.T]])
        right = np.concatenate([found.right, moved @ self.residual])
        return _solved(products, right, (found.columns, moved.T), self.residual)

    def refine(self, frequencies: Float[np.ndarray, " k"], lowest_cycles: float) -> LineFit:
        """Return the fit of least misfit near `frequencies`, by Gauss–Newton iteration.

        A step that fails is halved, and a step moves only the lines that are not yet at their best
        frequency. Two lines keep a distance of at least the resolution; otherwise their amplitudes
        are undefined. No frequency falls below `lowest_cycles`.
        """
        count, resolution = len(frequencies), 1 / self.rows.span
        size, best = 1.0, self.fit(frequencies)
        coefficients, covariance = self.with_corrections(best)
        for _ in range(_STEPS):
            step = np.clip(coefficients[-count:], -0.25 * resolution, 0.25 * resolution)
            scatter = np.sqrt(np.diag(covariance)[-count:] * best.misfit / len(self.residual))
            moves = np.abs(size * step) > _CONVERGED * scatter
            if not moves.any():
                break
            trial = best.frequencies + np.where(moves, size * step, 0.0)
            apart = np.min(np.diff(np.sort(trial)), initial=np.inf)
            allowed = trial.min() >= lowest_cycles and apart >= APART * resolution
            found = self.fit(trial) if allowed else best
            if found.misfit < best.misfit:
                best = found
                coefficients, covariance = self.with_corrections(best)
            else:
                size *= 0.5
        return best

"""Levenberg–Marquardt search for the parameters of a flank model that the user gives.

The search minimises |y − m(θ) − Z q| over all block rows. y is the transmission error, m is the
model at the mean angle of each row, and q are the coefficients of all other columns Z: offsets,
harmonics, drift, delay and regressors. For every θ, linear least squares gives the best q (variable
projection: Golub and Pereyra 1973). Here each flank of each log has a separate q, and the rows
count as independent, because their noise is not yet known. The result is only the start value of
the passes, which average the model over the samples of each row.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.arrays import Number, Numbers
from .compress.block_rows import BlockRun
from .model.column_layout import is_given
from .model.given_model import GivenModel, error_of
from .preliminary.linear_fit import LinearFit

_MOST_STEPS = 200  # steps of the solver; chosen value
_TOLERANCE = 1e-6  # the search ends below this change, in standard errors of a parameter; chosen
_TOLD = 1e-5  # least part of a derivative that the other columns do not explain; chosen value
_RANK = 1e-9  # singular values below this share of the largest one count as zero; chosen value


class _Rows(eqx.Module):
    """Rows of one flank of one log.

    **Arguments**
    - `angle`: mean driving angle of every row, rad.
    - `error`: transmission error of the rows minus its projection on the other columns, rad.
    - `columns`: orthonormal basis of the other columns Z.
    - `side`: 0 for flank A, 1 for flank B.
    """

    angle: Float[np.ndarray, " rows"]
    error: Float[np.ndarray, " rows"]
    columns: Float[np.ndarray, "rows columns"]
    side: int = eqx.field(static=True)

    def left(self, model: Any, values: Float[Numbers, " p"]) -> Float[Numbers, " rows"]:
        """Return the residual, rad, after subtraction of the model and of the best fit of Z."""
        error = error_of(model, values, jnp.asarray(self.angle), self.side)
        columns = jnp.asarray(self.columns)
        return self.error - error + columns @ (columns.T @ error)


def searched(linear: LinearFit) -> GivenModel:
    """Return the flank model of a linear fit with the parameters of the smallest misfit.

    If the search does not reduce the misfit, the start parameters are kept.
    """
    given = linear.model.given
    assert given is not None  # the caller has a model
    parts = tuple(
        _rows_of(runs, [not is_given(name) for name, _ in log.columns.names], log.columns.own_slice)
        for log in linear.rows
        for runs in log.runs_by_flank().values()
    )
    found = _left_and_slopes(given.tree, parts, given.values)
    left, slopes, whole = (np.asarray(each) for each in found)
    size = np.linalg.norm(slopes, axis=0)
    # If the other columns explain the effect of a parameter, its slope is only a rounding error;
    # the parameter then keeps its start value.
    told = size > _TOLD * whole
    size[~told] = 1.0
    step = np.linalg.lstsq(slopes / size, left, rcond=_RANK)[0]
    unit = float(np.std(left - slopes / size @ step)) or 1.0
    scale = np.where(told, unit / size, 0.0)
    ended = _minimise(given.tree, parts, given.values, scale, np.asarray(unit))
    found, misfit = (np.asarray(each) for each in ended)
    better = np.all(np.isfinite(found)) and misfit <= np.linalg.norm(left) / unit
    return given.at(found) if better else given


def _rows_of(runs: list[BlockRun], others: list[bool], own: slice) -> _Rows:
    """Join the block rows of all runs of one log on one flank.

    The parameters of the given flank model are searched, so their columns must not be among the
    other columns Z. `own` is the slice of the columns that only this log has (offset, drift, delay,
    …); `others` has one entry for each of them, and it is False for a column of the flank model.
    """
    rows = np.concatenate([run.rows for run in runs])
    error = np.concatenate([run.error for run in runs])
    kept = np.ones(rows.shape[1] - 1, bool)
    kept[own] = others
    columns = rows[:, :-1][:, kept]
    size = np.linalg.norm(columns, axis=0)
    left, singular, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    basis = left[:, singular > _RANK * singular[0]]
    return _Rows(
        angle=np.concatenate([run.curve.driving_angle for run in runs]),
        error=error - basis @ (basis.T @ error),
        columns=basis,
        side="AB".index(runs[0].segment.flank),
    )


def _left(
    model: Any, parts: tuple[_Rows, ...], values: Float[Numbers, " p"]
) -> Float[Numbers, " r"]:
    return jnp.concatenate([part.left(model, values) for part in parts])


@eqx.filter_jit
def _left_and_slopes(
    model: Any, parts: tuple[_Rows, ...], values: Float[Numbers, " p"]
) -> tuple[Float[Numbers, " r"], Float[Numbers, "r p"], Float[Numbers, " p"]]:
    """Return the residual (rad) at `values`, its negative derivatives, and their lengths.
    Residual and derivatives are after the projection on the other columns Z. The lengths are those
    of the derivatives of the model before the projection, one for each parameter.
    """
    values = jnp.asarray(values)
    left = lambda some: _left(model, parts, some)  # noqa: E731
    whole = lambda some: jnp.concatenate(  # noqa: E731
        [error_of(model, some, jnp.asarray(part.angle), part.side) for part in parts]
    )
    sizes = jnp.linalg.norm(jax.jacfwd(whole)(values), axis=0)
    return left(values), -jax.jacfwd(left)(values), sizes


@eqx.filter_jit
def _minimise(
    model: Any,
    parts: tuple[_Rows, ...],
    start: Float[Numbers, " p"],
    scale: Float[Numbers, " p"],
    unit: Float[Number, ""],
) -> tuple[Float[Numbers, " p"], Float[Number, ""]]:
    """Return the parameters of the smallest misfit, and this misfit in units of `unit` (rad).

    The solver starts at `start`; `scale` is the step of each parameter that counts as one unit.
    """
    import optimistix as optx  # slow to import, and seldom needed

    def misfit(scaled: Float[Numbers, " p"], _: None) -> Float[Numbers, " r"]:
        return _left(model, parts, start + scale * scaled) / unit

    solution = optx.least_squares(
        misfit,
        optx.LevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE),
        jnp.zeros_like(start),
        max_steps=_MOST_STEPS,
        throw=False,
        # The solution is never differentiated, and the implicit adjoint doubles the tracing time.
        adjoint=optx.RecursiveCheckpointAdjoint(),
    )
    return start + scale * solution.value, jnp.linalg.norm(misfit(solution.value, None))

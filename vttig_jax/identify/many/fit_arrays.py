"""The fit of one log as a pure function of arrays, for `jit`, `vmap`, `shard_map` and `grad`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...base.arrays import Numbers
from ...base.numerics.partial_autocorrelation import filter_of
from ..compress.harmonic_summary import ROUNDING
from ..compress.row_products import (
    RowProducts,
    conditioned,
    inner,
    residual_autocovariance,
    row_products,
)
from ..model.column_layout import OFFSET
from ..noise.batched_reml import estimated_noise, needed_lags
from ..noise.noise_model import FORGOTTEN
from ..settings import HIGHEST_LAG
from .batch_model import BatchModel
from .codes import Code
from .log_arrays import LogArrays
from .optimum import estimate, row_std
from .rows import BlockTable, block_table

_LEAST = 1e-300  # smallest rounding, rad², so that logarithms stay finite; chosen value
_ROWS_A_LAG = 8  # at most one lag for every 8 rows of the longest run (as in a fit)


class ArrayFit(NamedTuple):
    """Fit of one log; a batch has a leading axis.

    **Arguments**
    - `values`, `covariance`: parameters in the order of `BatchModel.names`, mm and rad, and their
      covariance by the noise model.
    - `innovation_std`, `std`: standard deviations of the innovations and of the block rows, rad.
    - `partial`, `order`: partial autocorrelations of the noise, zero beyond its order; this order.
    - `code`: a `Code`. For codes 1 to 4 (`EMPTY` to `TOO_FEW_ROWS`) all numbers are zero. For a
      higher code the numbers are given, but they are not reliable for the reason of the code.
    """

    values: Float[Numbers, "*logs p"]
    covariance: Float[Numbers, "*logs p p"]
    innovation_std: Float[Numbers, "*logs"]
    std: Float[Numbers, "*logs"]
    partial: Float[Numbers, "*logs lags"]
    order: Int[Numbers, "*logs"]
    code: Int[Numbers, "*logs"]


class WhiteTable(NamedTuple):
    """Conditioned block rows of one log, and the number of lags that its noise needs.

    The block rows are Z = U F with a triangular matrix F, so that the columns of the conditioned
    rows U are nearly orthonormal.

    **Arguments**
    - `white`, `triangle`: rows U and matrix F. - `counts`: number of rows of every run.
    - `needed`: number of lags that the noise needs.
    - `level`: angle that was subtracted from y, rad.
    - `rounding`: a residual sum of squares up to this value, rad², is only rounding error.
    - `code`: code of the log from the checks before the fit.
    """

    white: Float[Array, "*logs flanks runs n q"]
    triangle: Float[Array, "*logs flanks q q"]
    counts: Int[Array, "*logs flanks runs"]
    needed: Int[Array, "*logs"]
    level: Float[Array, "*logs"]
    rounding: Float[Array, "*logs"]
    code: Int[Array, "*logs"]


class Compressed(NamedTuple):
    """Lag products of the rows of one log; the other fields are as in `WhiteTable`.

    A log that cannot be fitted has substitute products, with which the compiled fit gives no NaN.
    """

    products: RowProducts
    needed: Int[Numbers, "*logs"]
    level: Float[Numbers, "*logs"]
    rounding: Float[Numbers, "*logs"]
    code: Int[Numbers, "*logs"]


def fit_arrays(model: BatchModel, log: LogArrays) -> ArrayFit:
    """Return the parameters of one log, their covariance, its noise and a result code.

    The parameters are those of `vttig_jax.fit` with the same harmonics, drift and delay, least
    squares and no joining lines. The function is pure: it works under `jax.jit`, `jax.vmap` and
    `jax.shard_map`. Its derivatives are those of the maximum of the likelihood at the order of the
    noise that was found. Masks, lengths and padding have none, and padded samples have zero.

    **Arguments**
    - `model`: from `batch_model`. - `log`: arrays with the shapes of `model.shape`.

    **Returns** an `ArrayFit`. Nothing is raised for bad data; see its `code`.

    **Example**
    ```python
    >>> import jax, vttig_jax
    >>> from vttig_jax.identify import fit_arrays, prepared
    >>> from vttig_jax.rig import PassMotion, paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig(motion=PassMotion(speed_rpm=240.0, reversal_deg=3600.0))
    >>> model, arrays = prepared([rig.log(0), rig.log(1)], rig.pair, lags=4)
    >>> found = jax.jit(jax.vmap(lambda log: fit_arrays(model, log)))(arrays)
    >>> found.code.tolist(), found.values.shape == (2, len(model.names))
    ([0, 0], True)

    ```
    """
    return solved(model, compressed(model, white_table(model, log)))


def fit_batch(model: BatchModel, logs: LogArrays) -> ArrayFit:
    """Return the fits of a batch, the same as `jax.vmap` of `fit_arrays` in less time.

    The rows are compressed for one log after the other, so that they stay in the cache. Then noise
    and parameters of all logs are estimated in parallel. The function is pure, as `fit_arrays` is.
    """
    return fit_tables(model, jax.lax.map(lambda log: white_table(model, log), logs))


def fit_tables(model: BatchModel, tables: WhiteTable) -> ArrayFit:
    """Return the fits of a batch from the conditioned rows of its logs."""
    products = jax.lax.map(lambda table: compressed(model, table), tables)
    return jax.vmap(lambda one: solved(model, one))(products)


def white_table(model: BatchModel, log: LogArrays) -> WhiteTable:
    """Return the conditioned block rows of a log; this is the first part of `fit_arrays`."""
    table = block_table(model, log)
    white, triangle = conditioned(table.rows)
    rows = jnp.sum(table.counts, axis=1)
    most = jnp.clip(jnp.max(table.counts) // _ROWS_A_LAG, 1, HIGHEST_LAG)
    correlated = residual_autocovariance(white, rows.astype(float), HIGHEST_LAG)
    needed = needed_lags(jax.lax.stop_gradient(correlated), rows.astype(float), most)
    square = ROUNDING * jnp.sum(table.rows[..., -1] ** 2) + jnp.sum(rows) * log.last_digit**2
    return WhiteTable(
        white=white,
        triangle=triangle,
        counts=table.counts,
        needed=needed,
        level=table.level,
        rounding=jax.lax.stop_gradient(square),
        code=_code_of(model, log, table, needed),
    )


def compressed(model: BatchModel, table: WhiteTable) -> Compressed:
    """Return the lag products of the conditioned block rows of one log.

    This is the second part of `fit_arrays`. If the code of the first part is OK, the log gets the
    code `TOO_FEW_ROWS` if a run has no more rows than lags, or `MORE_LAGS` if the noise needs more
    lags than the model has.
    """
    lags = model.shape.lags
    is_short = jnp.any((table.counts > 0) & (table.counts <= lags))
    causes = [(Code.TOO_FEW_ROWS, is_short), (Code.MORE_LAGS, table.needed > lags)]
    code = _first(causes, table.code)
    products = row_products(table.white, table.triangle, table.counts, lags)
    products = jax.tree.map(
        lambda own, other: jnp.where(_is_usable(code), own, other), products, _harmless(products)
    )
    needed = jnp.minimum(table.needed, lags)
    return Compressed(products, needed, table.level, table.rounding, code)


def solved(model: BatchModel, data: Compressed) -> ArrayFit:
    """Return the fit of one log from its lag products; this is the last part of `fit_arrays`."""
    products = data.products
    rounding = jnp.maximum(data.rounding, _LEAST)
    noise = estimated_noise(products, data.needed, rounding)
    filter_ = filter_of(noise.partial)
    upper = inner(products, filter_)
    found = estimate(products, upper, model.relation, free=model.free, rounding=rounding)
    std = row_std(products, upper)
    gain = found.innovation_std / jnp.sum(filter_)
    run = jnp.sum(products.rows) / jnp.maximum(jnp.sum(products.runs), 1.0)
    late = [
        (Code.UNDETERMINED, ~found.determined),
        (Code.NOT_CONVERGED, ~found.converged),
        (Code.LONG_MEMORY, 2 * run * (std / gain) ** 2 < FORGOTTEN),
    ]
    offset = jnp.asarray([name == OFFSET for name in model.names])
    values = found.values + jnp.where(offset, data.level, 0.0)
    numbers = (values, found.covariance, found.innovation_std, std, noise.partial)
    # Very smooth noise makes the whitening lose all digits; the NaN is reported by the code.
    is_sound = jnp.stack([jnp.all(jnp.isfinite(one)) for one in numbers]).all()
    late.insert(0, (Code.LONG_MEMORY, ~is_sound))
    kept_at_all = _is_usable(data.code) & is_sound
    kept = (jnp.where(kept_at_all, one, 0.0) for one in numbers)
    order = jnp.where(kept_at_all, noise.order, 0)
    return ArrayFit(*kept, order=order, code=_first(late, data.code))


def _is_usable(code: Int[Numbers, ""]) -> Bool[Array, ""]:
    code = jnp.asarray(code)
    return (code == int(Code.OK)) | (code == int(Code.MORE_LAGS))


def _harmless(products: RowProducts) -> RowProducts:
    """Return products of white noise rows, which replace those of a log that cannot be fitted.

    They have the same shapes as `products`, and the fit of them contains no NaN.
    """
    one = jnp.eye(products.triangle.shape[-1])[None] * jnp.ones((len(products.rows), 1, 1))
    lagged = jnp.zeros_like(products.lag_products).at[:, 0].set(one)
    plenty = jnp.full_like(products.rows, 4.0 * one.shape[-1])
    ends, runs = jnp.zeros_like(products.ends), jnp.ones_like(products.runs)
    return RowProducts(one, lagged, ends, rows=plenty, runs=runs)


def _code_of(
    model: BatchModel, log: LogArrays, table: BlockTable, needed: Int[Array, ""]
) -> Int[Array, ""]:
    """Return the code of a log from checks of its rows before the fit."""
    rows = jnp.sum(table.counts, axis=1)
    usable = rows - needed * 2 * jnp.sum(table.counts > 0, axis=1)
    causes = [
        (Code.EMPTY, (log.length < 1) | jnp.all(table.counts == 0) & table.fits),
        (Code.NOT_FINITE, ~table.is_finite),
        (Code.NO_ROOM, ~table.fits),
        (Code.TOO_FEW_ROWS, jnp.any(usable <= model.width - 1)),
    ]
    return _first(causes, jnp.asarray(int(Code.OK)))


def _first(
    causes: list[tuple[Code, Bool[Array, ""]]], otherwise: Int[Numbers, ""]
) -> Int[Array, ""]:
    """Return the code of the first cause whose condition is true, or OK if none is true.

    If the earlier code `otherwise` is not OK, it is returned instead.
    """
    code = jnp.asarray(int(Code.OK))
    for cause, is_true in reversed(causes):
        code = jnp.where(is_true, int(cause), code)
    return jnp.where(jnp.asarray(otherwise) == int(Code.OK), code, otherwise)

"""Model of the fit and array sizes of the compiled program, common to all logs of a batch."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...base.arrays import Numbers
from ...pair.gear_pair import Drive, Flank, GearPair
from ..compress.regressors import Drift
from ..model.column_layout import OFFSET, ColumnLayout
from ..model.forward_model import ForwardModel, relation_of
from ..model.harmonics import TermPlan
from ..settings import HIGHEST_LAG, FitSettings
from .log_arrays import SIDES, LogArrays


class BatchShape(NamedTuple):
    """Sizes of the arrays of a compiled program; every log of a batch must fit in them.

    **Arguments**
    - `samples`: number of samples of a log after padding.
    - `runs`: largest number of runs on a flank. - `rows`: largest number of block rows of a run.
    - `height`: largest number of samples of a row.
    - `lags`: largest order of the autoregressive noise.
    """

    samples: int
    runs: int
    rows: int
    height: int
    lags: int = HIGHEST_LAG

    def rounded(self) -> "BatchShape":
        """Return the shape with all sizes but `lags` rounded up, so that batches share programs."""
        fine = (rounded_up(self.samples), rounded_up(self.runs), rounded_up(self.rows))
        return BatchShape(*fine, rounded_up(self.height), self.lags)

    def over(self, other: "BatchShape") -> "BatchShape":
        """Return the smallest shape that is large enough for both shapes."""
        return BatchShape(*map(max, self, other))


_STEPS = 8
"""Number of rounded sizes between two powers of two: rounding adds at most an eighth (chosen)."""


def rounded_up(size: int) -> int:
    """Return the size rounded up to the next of eight sizes between two powers of two."""
    step = max(1, (1 << (size - 1).bit_length()) // (2 * _STEPS)) if size > 0 else 1
    return -(-size // step) * step


def shape_of(arrays: LogArrays, lags: int = HIGHEST_LAG) -> BatchShape:
    """Return the sizes that the arrays of one log need; `lags` is only copied."""
    runs, rows = 1, 1
    for mask in arrays.on_flank:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
        lengths = edges[1::2] - edges[::2]
        runs = max(runs, len(lengths))
        rows = max(rows, int(lengths.max(initial=0)) // int(arrays.size))
    return BatchShape(arrays.time.shape[-1], runs, rows, int(arrays.size), lags)


class BatchModel(eqx.Module):
    """Model with which every log of a batch is fitted, and the array sizes of the program.

    **Arguments**
    - `relation`: forward model. - `orders`: orders (n₁, n₂) of the harmonics, free harmonics first.
    - `ratio`: driven speed divided by driving speed.
    - `free`: number of columns of free harmonics. - `drift`: highest power of time of the drift.
    - `sides`: indices of the measured flanks; 0 is flank A and 1 is flank B.
    - `delayed`: whether logs have a delay; without one the driving angle is taken as it is.
    - `shape`: sizes of the arrays.
    """

    relation: ForwardModel
    orders: Float[Numbers, "terms 2"]
    ratio: Float[Numbers, ""]
    free: int = eqx.field(static=True)
    drift: int = eqx.field(static=True)
    sides: tuple[int, ...] = eqx.field(static=True)
    delayed: bool = eqx.field(static=True)
    shape: BatchShape = eqx.field(static=True)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.relation.names

    @property
    def width(self) -> int:
        """Number of columns of the rows: harmonics, offset, drift and y."""
        return 2 * len(self.orders) + self.drift + 2

    def with_shape(self, shape: BatchShape) -> "BatchModel":
        """Return the same model for arrays of the sizes `shape`."""
        return replace(self, shape=shape)


def batch_model(
    pair: GearPair | Drive,
    terms: TermPlan,
    flanks: tuple[Flank, ...],
    shape: BatchShape,
    settings: FitSettings = FitSettings(),
) -> BatchModel:
    """Return the model that `vttig_jax.fit` uses for these harmonics, flanks and settings.

    It uses only these settings: `perfect_encoders`, `perfect_gears`, `drift_order` (0 if it is
    None), and whether `delay` is a number of seconds other than 0.
    """
    drift = settings.drift_order or 0
    own = (OFFSET, *Drift(drift).names(0.0))
    columns = ColumnLayout(
        tuple(h.term for h in terms.free), tuple(h.term for h in terms.tied), (own,)
    )
    trusted = settings.perfect_encoders or settings.perfect_gears
    relation = relation_of(
        pair,
        terms,
        columns,
        flanks,
        encoder_terms=len(flanks) == 2 and not trusted,
        gear_terms=not settings.perfect_gears,
    )
    return BatchModel(
        relation=relation,
        orders=np.asarray(columns.free + columns.tied, np.float64).reshape(-1, 2),
        ratio=np.asarray(float(pair.ratio)),
        free=columns.free_width,
        drift=drift,
        sides=tuple(SIDES.index(flank) for flank in flanks),
        delayed=not isinstance(settings.delay, str) and settings.delay != 0,
        shape=shape,
    )

"""Solution of a fit together with the compressed logs that it belongs to."""

from dataclasses import dataclass
from functools import cached_property

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...kinematics.harmonic import OrderModel
from ...kinematics.te_curve import TECurve
from ..compress.block_rows import BlockRun
from ..compress.harmonic_summary import HarmonicSummary
from ..model.column_layout import OFFSET
from ..noise.noise_model import NoiseModel, WhitenedFlank
from ..preliminary.linear_fit import LinearFit
from .least_squares import Solution
from .remembered_noise import RememberedNoise, Run
from .residuals import Weights, curves_and_residuals, flank_coefficients, weights_of_logs

_SHORTEST = 10  # least rows of a run in addition to the taps of the noise filter; chosen value
_APART_S = 1e9
"""Time between two logs in s, longer than any memory."""


@dataclass(frozen=True, eq=False)
class SolvedFit:
    """Parameters of a fit, and the logs and the noise from which they were estimated.

    **Arguments**
    - `linear`: rows of all logs. - `summary`: summary of the selected columns.
    - `noise`, `whitened`: noise model, and whitened factor of each flank.
    - `solution`: parameters with their covariance.
    - `model_covariance`: covariance of the parameters by the noise model alone.
    """

    linear: LinearFit
    summary: HarmonicSummary
    noise: NoiseModel
    whitened: tuple[WhitenedFlank, ...]
    solution: Solution
    model_covariance: Float[np.ndarray, "p p"]

    @cached_property
    def coefficients(self) -> list[Float[np.ndarray, " columns"]]:
        """Coefficients of all columns but y on every flank."""
        return flank_coefficients(self.whitened, self.solution)

    @cached_property
    def weights(self) -> list[Weights]:
        """Weights (−β, 1) of every flank for the rows of each log; row · weights is a residual."""
        return weights_of_logs(self.summary, self.coefficients)

    @cached_property
    def curves_and_residuals(
        self,
    ) -> tuple[tuple[TECurve, ...], tuple[Float[np.ndarray, " _"], ...]]:
        """Block means of the transmission error of every run, and their residuals, rad."""
        return curves_and_residuals(self.linear, self.weights)

    @cached_property
    def runs(self) -> tuple[tuple[int, BlockRun, Float[np.ndarray, "columns own"]], ...]:
        """Number of the log (from 0), run, and embedding of its rows, of every run.

        The embedding maps a row of the run to a row with the columns of all logs. The runs are in
        time order. A run is left out unless it has at least ten rows more than the whitening filter
        has taps.
        """
        flanks = {flank.flank for flank in self.summary.flanks}
        return tuple(
            (log, run, embedding[run.segment.flank])
            for log, (rows, embedding) in enumerate(
                zip(self.linear.rows, self.summary.embeddings, strict=True)
            )
            for run in sorted(rows.runs, key=lambda run: run.segment.start)
            if run.segment.flank in flanks
            and len(run.rows) >= len(self.noise.at(run.segment.speed).filter) + _SHORTEST
        )

    @cached_property
    def remembered_noise(self) -> RememberedNoise:
        """Noise model of all runs with correlation from run to run; see `RememberedNoise`.

        The times of the logs are shifted so far apart that different logs are not correlated.
        """
        flanks = [flank.flank for flank in self.summary.flanks]
        columns, runs = self.summary.columns, []
        for log, run, embedding in self.runs:
            rows = run.rows @ embedding.T
            design = np.zeros((len(rows), len(flanks), rows.shape[1] - 1))
            design[:, flanks.index(run.segment.flank)] = rows[:, :-1]
            runs.append(
                Run(
                    time=run.curve.time + log * _APART_S,
                    share=rows[:, columns.index(OFFSET, log)],
                    design=design.reshape(len(rows), -1),
                    value=rows[:, -1],
                )
            )
        return RememberedNoise.of(runs)

    @cached_property
    def model(self) -> OrderModel:
        """Order-complete flank model with the offset of the first log, rad.

        Fractional orders are left out, because no position of the gears determines their phase. The
        values of a flank that was not measured are NaN.
        """
        plan, columns = self.summary.terms, self.summary.columns
        places, terms = plan.locked
        count = len(places)
        offset, cosine, sine = (np.full(shape, np.nan) for shape in ((2,), (2, count), (2, count)))
        for flank, values in zip(self.summary.flanks, self.coefficients, strict=True):
            side = "AB".index(flank.flank)
            cells = [columns.cosine(position) for position in places]
            offset[side] = values[columns.index(OFFSET)] + self.linear.levels[0]
            cosine[side] = values[cells]
            sine[side] = values[[cell + 1 for cell in cells]]
        return OrderModel(
            ratio=jnp.asarray(float(plan.ratio)),
            terms=terms,
            offset=jnp.asarray(offset),
            cosine=jnp.asarray(cosine),
            sine=jnp.asarray(sine),
        )

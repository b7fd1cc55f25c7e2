"""Correlated noise of the block rows: its autoregressive model, and the whitening of the rows."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from ...base.numerics.autoregression import whitening_filter
from ...base.numerics.partial_autocorrelation import filter_of, partial_of
from ...base.units import DEG, REV
from ...pair.gear_pair import Flank
from ..compress.harmonic_summary import HarmonicSummary
from ..compress.noise_kinds import NOISE, RowNoise
from ..compress.orthogonal import residual_weights, triangle_of
from ..settings import NoiseSettings
from .reml import restricted_partial

_REPEATS = 2
"""Further rounds of autoregression and generalised least squares; the second changes nothing."""

FORGOTTEN = 20.0
"""Shortest run, in correlation times of the noise, for which the likelihood can distinguish noise
from structure that the model misses."""

_REMEMBERED = 100.0
"""In a run shorter than this many correlation times of the noise, low orders have more noise than
the other orders (chosen). Gear pairs whose standard errors are correct on a few turns have 600."""

_WHITE_SHARE = 1e-6
"""Share of the variance that is added as white noise if the noise is estimated from moments. In a
log without noise, the structure that a model misses is so predictable that its whitening would
leave only rounding errors."""

_ROWS_A_COEFFICIENT = 3
"""A speed has its own noise model if it has more rows per column of the fit than this."""


@dataclass(frozen=True)
class NoiseModel:
    """AR(p) noise of block means, ε_t = Σ_j coefficients_j ε_{t−j} + innovation.

    **Arguments**
    - `coefficients`: coefficients of the autoregression, shape (p,).
    - `innovation_std`, `std`: standard deviations of the innovations and of the block means, rad.
    - `block_s`: duration of a block, s.
    - `plateaus`: (speed in rad/s, noise) of every speed if each speed has a noise model of its own;
      this object is then the noise model of all speeds together.
    - `choice`: assumed kind of the noise model.
    - `by`: method of the estimate, "likelihood" or "moments"; "rounding" if the log has no noise
      and the residual is only rounding error of floating-point numbers.
    """

    coefficients: Float[np.ndarray, " p"]
    innovation_std: float
    std: float
    block_s: float
    plateaus: tuple[tuple[float, "NoiseModel"], ...] = ()
    choice: NoiseSettings = NoiseSettings()
    by: str = "likelihood"

    def at(self, speed: float) -> "NoiseModel":
        """Return the noise at a speed of the driving shaft, rad/s, in either direction."""
        if not self.plateaus:
            return self
        return min(self.plateaus, key=lambda one: abs(one[0] - abs(speed)))[1]

    def whitened(
        self, rows: Float[np.ndarray, "n ..."], time: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "m ..."]:
        """Return the innovations of the rows of one run, in units of their standard deviation.

        `time` holds the mean times of the rows in s. The first rows, as many as the order of the
        autoregression, have no complete history and are left out.
        """
        table = rows.reshape(len(rows), -1)
        white = self.kind.summary.whitened(table, time, self.filter, self.block_s)
        return white.reshape(-1, *rows.shape[1:]) / (self.innovation_std or 1.0)

    def whitening(self, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n n"]:
        """Return the matrix that whitens all rows of one run.

        Its first rows, as many as the order, are the prediction errors of lower orders.
        """
        order = len(self.coefficients)
        matrix = np.zeros((len(time), len(time)))
        matrix[order:] = self.whitened(np.eye(len(time)), time)
        matrix[:order, :order] = self._first_whitening
        return matrix

    @cached_property
    def _first_whitening(self) -> Float[np.ndarray, "p p"]:
        """The matrix that whitens the first p rows of a run by filters of lower orders."""
        matrix = np.zeros((len(self.coefficients), len(self.coefficients)))
        partial = self.partial
        for place in range(len(matrix)):
            std = self.innovation_std / np.sqrt(np.prod(1 - partial[place:] ** 2))
            matrix[place, : place + 1] = filter_of(partial[:place])[::-1] / (std or 1.0)
        return matrix

    def to_json(self) -> dict:
        """Return the fields of `noise` in the JSON object of a fit."""
        record = {
            "model": self.name,
            "coefficients": self.coefficients.tolist(),
            "block_s": self.block_s,
            "std_deg": self.std / DEG,
            "innovation_std_deg": self.innovation_std / DEG,
            "correlation_s": self.correlation_s,
            "stationary_in": self.choice.stationary_in,
            "of": self.choice.of,
            "by": self.by,
        }
        own = [{"speed_rpm": speed * 60 / REV} | model.to_json() for speed, model in self.plateaus]
        return record | ({"plateaus": own} if own else {})

    @property
    def name(self) -> str:
        """Name of the model, for example "AR(3)"."""
        return self.kind.name.format(order=len(self.coefficients))

    @property
    def kind(self) -> RowNoise:
        """The `RowNoise` of the assumed kind of noise: how rows are summarised for it."""
        return NOISE[self.choice.kind]

    @property
    def is_rounding(self) -> bool:
        """Whether the residual is only rounding error of floating-point numbers.

        The log then has no noise, for example in a simulation. The limit is
        `HarmonicSummary.rounding`; the steps of an encoder are larger and count as noise.
        """
        return self.by == "rounding"

    @property
    def filter(self) -> Float[np.ndarray, " taps"]:
        """Whitening filter (1, −a₁, …, −a_p)."""
        return np.concatenate([[1.0], -self.coefficients])

    @property
    def partial(self) -> Float[np.ndarray, " p"]:
        """Partial autocorrelations π_1 … π_p of the noise."""
        return partial_of(self.filter)

    @property
    def correlation_s(self) -> float:
        """Integrated correlation time of the blocks, s: half the two-sided sum of correlations."""
        gain = self.innovation_std / np.sum(self.filter)
        return 0.5 * self.block_s * float((gain / self.std) ** 2) if self.std else 0.0


@dataclass(frozen=True)
class WhitenedFlank:
    """Upper triangle R of the whitened rows of one flank, in units of the innovation std.

    The columns are the `free` free ones (f), then the own and tied ones (t), then y. For tied
    coefficients h and the best free coefficients, the misfit is the squared length of
    R_tt h − R_ty.
    """

    factor: Float[np.ndarray, "q q"]
    free: int

    @property
    def tied(self) -> tuple[Float[np.ndarray, "t t"], Float[np.ndarray, " t"]]:
        """Blocks R_tt and R_ty of the triangle."""
        return self.factor[self.free : -1, self.free : -1], self.factor[self.free : -1, -1]

    def free_given(self, tied: Float[np.ndarray, " t"]) -> Float[np.ndarray, " f"]:
        """Return the best free coefficients for given tied ones."""
        right = self.factor[: self.free, -1] - self.factor[: self.free, self.free : -1] @ tied
        return np.linalg.solve(self.factor[: self.free, : self.free], right)

    def covariance(self, of_tied: Float[np.ndarray, "t t"]) -> Float[np.ndarray, "c c"]:
        """Return the covariance of all coefficients (free, tied) of the flank.

        `of_tied` is the covariance of the tied coefficients.
        """
        inverse = np.linalg.inv(self.factor[: self.free, : self.free])
        follow = -inverse @ self.factor[: self.free, self.free : -1]
        spread = np.vstack([follow, np.eye(len(of_tied))])
        total = spread @ of_tied @ spread.T
        total[: self.free, : self.free] += inverse @ inverse.T
        return total


def whiten(
    summary: HarmonicSummary, variance_factor: float = 1.0, *, few_turns: bool = False
) -> tuple[NoiseModel, tuple[WhitenedFlank, ...]]:
    """Estimate the noise, and return it with the triangle of the whitened rows of every flank.

    `variance_factor` is the factor by which a robust loss increases the variance. If every speed
    has a noise model of its own, a speed with too few rows gets the noise model of all speeds. If
    `few_turns`, the restricted likelihood is used even for noise correlated over a whole run.
    """
    noise = _noise_of(summary, variance_factor, few_turns)
    parts = [(summary, noise)]
    if summary.plateaus:
        least = _ROWS_A_COEFFICIENT * summary.columns.width
        own = [
            (
                p,
                _noise_of(p.summary, variance_factor, few_turns)
                if p.summary.rows > least
                else noise,
            )
            for p in summary.plateaus
        ]
        noise = replace(noise, plateaus=tuple((p.speed, model) for p, model in own))
        parts = [(p.summary, model) for p, model in own]
    factors: dict[Flank, list[np.ndarray]] = {flank.flank: [] for flank in summary.flanks}
    for part, model in parts:
        for flank in part.flanks:
            factors[flank.flank].append(flank.factor(model.filter) / (model.innovation_std or 1.0))
    free = summary.columns.free_width
    return noise, tuple(
        WhitenedFlank(triangle_of(np.concatenate(several)) if several[1:] else several[0], free)
        for several in factors.values()
    )


def _noise_of(summary: HarmonicSummary, variance_factor: float, few_turns: bool) -> NoiseModel:
    """Estimate the noise by restricted likelihood, or by moments for a long correlation time.

    If the noise is correlated over a whole run, it cannot be distinguished from slow structure that
    the model misses. The likelihood would treat this structure as noise and fit only the fast part.
    On few turns of a drive the likelihood is used nevertheless, because moments underestimate the
    correlation.
    """
    found = _model(summary, filter_of(restricted_partial(summary)), variance_factor, "likelihood")
    if few_turns or not _lasts(found, summary, FORGOTTEN):
        return found
    return _model(summary, autoregression(summary), variance_factor, "moments")


def remembers(summary: HarmonicSummary) -> bool:
    """Return whether the correlation time of the noise is more than 1/100 of the mean run.

    Low orders then have more noise than other orders. The result is False if the noise is only
    rounding.
    """
    found = _model(summary, filter_of(restricted_partial(summary)), 1.0, "likelihood")
    return not found.is_rounding and _lasts(found, summary, _REMEMBERED)


def _lasts(noise: NoiseModel, summary: HarmonicSummary, times: float) -> bool:
    """Return whether a run, on average, is shorter than `times` correlation times of the noise."""
    runs = sum(len(flank.heads) for flank in summary.flanks)
    run_s = summary.block_s * summary.rows / max(runs, 1)
    return noise.correlation_s > run_s / times


def _model(
    summary: HarmonicSummary, filter_: Float[np.ndarray, " taps"], variance_factor: float, by: str
) -> NoiseModel:
    """Return the noise model with a given whitening filter; `by` is the method that estimated it.

    The innovations have the variance of the whitened residual times `variance_factor`. The
    variance is at least that of the floating-point rounding errors.
    """
    left = sum(flank.factor(filter_)[-1, -1] ** 2 for flank in summary.flanks)
    coefficients = len(summary.flanks) * (summary.columns.width - 1)
    variance = variance_factor * max(left, summary.rounding)
    variance /= max(summary.counted_rows - coefficients, 1)
    return NoiseModel(
        -filter_[1:],
        float(np.sqrt(variance)),
        residual_std(summary, filter_),
        summary.block_s,
        choice=summary.noise,
        by="rounding" if left <= summary.rounding else by,
    )


def autoregression(summary: HarmonicSummary) -> Float[np.ndarray, " taps"]:
    """Return the whitening filter of the residual of a linear fit, estimated by moments.

    It is used while the model is still being selected. The structure that such a model misses is
    correlated over the whole log. The likelihood would treat it as noise, and whitening would then
    remove all evidence of it. Autocovariances divided by the number of all rows at every lag avoid
    this. Ornstein–Uhlenbeck noise is nevertheless estimated by the likelihood.
    """
    if not summary.kind.summary.QUADRATIC:
        return filter_of(restricted_partial(summary))
    filter_ = np.ones(1)
    for _ in range(1 + _REPEATS):
        filter_ = whitening_filter(_autocovariance(summary, filter_), summary.rows)
    return filter_


def _autocovariance(
    summary: HarmonicSummary, filter_: Float[np.ndarray, " taps"]
) -> Float[np.ndarray, " lags"]:
    """Return the autocovariance of the least-squares residual under a filter, all flanks together.

    Its value at every lag is divided by the number of all rows. It is then positive definite, and
    the autoregression is stationary. The rounding of y counts as white noise.
    """
    flanks = summary.flanks
    lags = min(len(flank.lag_products) for flank in flanks)
    total = np.zeros(lags)
    for flank in flanks:
        residual = flank.residual(filter_)
        total += np.einsum("i,lij,j->l", residual, flank.lag_products[:lags], residual)
    total[0] = total[0] * (1 + _WHITE_SHARE) + summary.rounding
    return total / summary.rows


def residual_rows(
    summary: HarmonicSummary, filter_: Float[np.ndarray, " taps"]
) -> list[Float[np.ndarray, " q"]]:
    """Return for every flank the weights (−β, 1) that give the residual of a row.

    β is estimated by generalised least squares.
    """
    return [residual_weights(flank.factor(filter_)) for flank in summary.flanks]


def residual_std(summary: HarmonicSummary, filter_: Float[np.ndarray, " taps"]) -> float:
    """Return the rms residual of generalised least squares, rad.

    It is at least the rms of the floating-point rounding errors.
    """
    square = 0.0
    for flank in summary.flanks:
        residual = flank.residual(filter_)
        square += float(residual @ flank.lag_products[0] @ residual)
    return float(np.sqrt(max(square, summary.rounding) / max(summary.rows, 1)))

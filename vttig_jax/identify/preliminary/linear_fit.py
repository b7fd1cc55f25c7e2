"""Linear fit of the block rows of all logs, and the residuals of its single samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from ...base.errors import NoAnswerError
from ...base.numerics.counting import pieces
from ...logs.checks.ratio import SeenRatio
from ...logs.encoder_log import EncoderLog
from ...logs.motion.flank_assignment import Ramp
from ...logs.motion.segments import Segment, Segments
from ...pair.gear_pair import Drive, Flank, GearPair
from ..compress.block_rows import SHORT_RUN, LogRows, block_seconds, log_rows
from ..compress.harmonic_summary import HarmonicSummary, summarise
from ..compress.regressors import Drift, Regressors, Samples, read_channels
from ..model.column_layout import ColumnLayout
from ..model.given_model import GivenModel
from ..model.harmonics import TermPlan
from ..model.waves import Waves, product
from ..noise.noise_model import autoregression, residual_rows
from ..settings import NoiseSettings
from .alignment import Start, aligned
from .nuisance import NuisanceRegression, own_terms

_CHUNK = 8192  # samples whose waves are computed at once, so that they stay in cache (chosen)


def residual_of(
    channels: Regressors,
    segment: Segment,
    columns: ColumnLayout,
    weights: Float[np.ndarray, " columns"],
    stride: int = 1,
) -> Float[np.ndarray, " n"]:
    """Return the transmission error minus the model at every `stride`-th sample of a segment, rad.

    `columns` is the column layout of this log alone. `weights` are (−β, 1) with the coefficients β
    of the fit on the flank of the segment: the product of a row and `weights` is its residual.
    """
    part = slice(segment.start, segment.stop, stride)
    return _residual_at(channels, segment.flank, part, columns, weights)


def residuals_of(
    channels: Regressors,
    segments: Sequence[Segment],
    columns: ColumnLayout,
    weights: Mapping[Flank, Float[np.ndarray, " columns"]],
    stride: int = 1,
) -> list[Samples]:
    """Return `residual_of` of every segment, with the weights of its flank.

    Short segments are computed in one array, because a log may have hundreds of them.
    """
    found: dict[int, Samples] = {}
    short: dict[Flank, list[int]] = {}
    for place, segment in enumerate(segments):
        if segment.stop - segment.start <= SHORT_RUN:
            short.setdefault(segment.flank, []).append(place)
        else:
            found[place] = residual_of(channels, segment, columns, weights[segment.flank], stride)
    for flank, places in short.items():
        samples = [np.arange(segments[k].start, segments[k].stop, stride) for k in places]
        values = _residual_at(channels, flank, np.concatenate(samples), columns, weights[flank])
        edges = np.cumsum([len(own) for own in samples])[:-1]
        found |= zip(places, np.split(values, edges), strict=True)
    return [found[place] for place in range(len(segments))]


def _residual_at(
    channels: Regressors,
    flank: Flank,
    part: slice | Int[np.ndarray, " n"],
    columns: ColumnLayout,
    weights: Float[np.ndarray, " columns"],
) -> Float[np.ndarray, " n"]:
    """Return the residual on a flank at the samples `part`; see `residual_of`."""
    own = columns.own_slice
    coefficients = -weights[:-1]
    harmonics = np.delete(coefficients, own)
    values = np.full(len(channels.time[part]), coefficients[own.start])
    present = channels.own_on(flank)
    for place, name in enumerate(columns.own[0][1:], own.start + 1):
        values += coefficients[place] * present[name][part]
    driving, driven = channels.driving[part], channels.driven[part]
    for piece in pieces(len(values), _CHUNK):
        values[piece] += _harmonics(columns, harmonics, driving[piece], driven[piece])
    return channels.error[flank][part] - values


def _harmonics(
    columns: ColumnLayout,
    coefficients: Float[np.ndarray, " cells"],
    driving: Float[np.ndarray, " n"],
    driven: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Return the sum of all harmonics at the given shaft angles, rad.

    `coefficients` contains the cosine and the sine coefficient of each harmonic in turn.
    """
    terms, first, second = columns.free + columns.tied, Waves(driving), Waves(driven)
    table = np.empty((len(terms), len(driving)), np.complex128)
    for row, term in zip(table, terms, strict=True):
        row[:] = product(first, second, term)
    return (coefficients.view(np.complex128).conj() @ table).real


AnySamples = Float[np.ndarray, " _"]
"""One value per sample of one log; the logs of a sequence may have different lengths."""

_FINER = 8.0
"""Short ramps may shorten the rows (blocks of samples) by at most this factor; chosen value."""


@dataclass(frozen=True, eq=False)
class Input:
    """One log and its parts.

    **Arguments**
    - `found`: all segments that were found. - `segments`: segments of steady speed that are fitted.
    - `ramps`: parts with changing speed; they can help to determine the delay.
    - `ratio`: ratio that the log shows; None if it has not been estimated.
    """

    log: EncoderLog
    found: Segments
    segments: tuple[Segment, ...]
    ramps: tuple[Ramp, ...] = ()
    ratio: SeenRatio | None = None


@dataclass(frozen=True, eq=False)
class Model:
    """Model that all passes over the logs have in common.

    **Arguments**
    - `terms`: harmonics. - `regressors`: names of further columns, such as "delay" and "torque".
    - `same_zero`: whether the angles of all logs count from the same zero.
    - `given`: flank model of the user, linearised at its parameters; None without such a model.
    """

    pair: GearPair | Drive
    terms: TermPlan
    regressors: tuple[str, ...]
    drift: Drift
    same_zero: bool = True
    noise: NoiseSettings = NoiseSettings()
    given: GivenModel | None = None


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Block rows of all logs for one delay and one set of weights, and the linear fit of them.

    **Arguments**
    - `inputs`, `model`: logs, and model of all passes.
    - `channels`, `rows`: samples with regressors, and block rows, of every log.
    - `block_s`: duration of a row, s.
    - `segments`: segments of each log from which the rows are computed.
    - `base`: fit of the first runs of each log, if there is one. Its summary is reused, so that
      only the further runs are added.
    """

    inputs: tuple[Input, ...]
    model: Model
    channels: tuple[Regressors, ...]
    rows: tuple[LogRows, ...]
    block_s: float
    segments: tuple[tuple[Segment, ...], ...]
    base: "LinearFit | None" = None

    @cached_property
    def _aligned(self) -> tuple[HarmonicSummary, tuple[Start, ...]]:
        if self.model.same_zero or len(self.rows) == 1:
            none = (Start(),) * len(self.rows)
            base = self.base and (self.base.summary, self.base.rows)
            return summarise(self.rows, self.model.terms, base=base), none
        return aligned(self.rows, self.model.terms)

    def rows_of(self, log: int, segments: Sequence[Segment]) -> LogRows:
        """Return the block rows of the given segments; each row lasts `block_s`, as in this fit."""
        speeds = [abs(s.speed) for one in self.segments for s in one]
        return log_rows(
            self.channels[log],
            segments=segments,
            terms=self.model.terms,
            block_s=self.block_s,
            noise=self.model.noise,
            fastest=max(speeds, default=0.0),
        )

    @property
    def levels(self) -> tuple[float, ...]:
        """Level that was subtracted from the transmission error of every log, rad."""
        return tuple(one.level for one in self.channels)

    @property
    def summary(self) -> HarmonicSummary:
        """Summary of the rows of all logs, with offset, drift, delay and all regressors."""
        return self._aligned[0]

    @property
    def starts(self) -> tuple[Start, ...]:
        """Angles of both shafts at the zero of every log, relative to the first log, rad."""
        return self._aligned[1]

    @cached_property
    def filter(self) -> Float[np.ndarray, " taps"]:
        """Whitening filter of the residual of the linear model."""
        return autoregression(self.summary)

    @cached_property
    def own(self) -> NuisanceRegression:
        """Regression of drift, delay and regressors after the elimination of the harmonics."""
        return own_terms(self.summary, self.filter)

    @cached_property
    def residual_rows(self) -> tuple[dict[Flank, Float[np.ndarray, " q"]], ...]:
        """For each log: flank → weights (−β, 1) in the column layout of this log.

        β are the coefficients of the linear model; the product of a row and the weights is its
        residual, rad.
        """
        solved = residual_rows(self.summary, self.filter)
        flanks: list[Flank] = [f.flank for f in self.summary.flanks]
        return tuple(
            {
                flank: embedding[flank].T @ weights
                for flank, weights in zip(flanks, solved, strict=True)
            }
            for embedding in self.summary.embeddings
        )

    def residuals(self, log: int, stride: int = 1) -> list[Samples]:
        """Return the residuals of every `stride`-th sample of a log, one array per run, rad.

        They belong to the measured samples: what Huber's loss subtracted from a sample is added.
        """
        weights, channels, rows = self.residual_rows[log], self.channels[log], self.rows[log]
        segments = [run.segment for run in rows.runs]
        found = residuals_of(channels, segments, rows.columns, weights, stride)
        if channels.pull is None:
            return found
        pulls = [channels.pull[one.start : one.stop : stride] for one in segments]
        return [left + pull for left, pull in zip(found, pulls, strict=True)]


def linear_fit(
    inputs: Sequence[Input],
    model: Model,
    delay_s: float = 0.0,
    weights: Sequence[AnySamples | None] | None = None,
    block_s: float | None = None,
    finest_s: float = np.inf,
    segments: Sequence[tuple[Segment, ...]] | None = None,
    pulls: Sequence[AnySamples | None] | None = None,
) -> LinearFit:
    """Compute the block rows of all logs, and return the linear fit of these rows.

    The coefficients and residuals are computed when they are first read from the result.

    **Arguments**
    - `inputs`, `model`: logs with their segments in certain contact, and the columns of the rows.
    - `delay_s`: delay of the driven channel that is removed before the fit, s.
    - `weights`, `pulls`: weights of the samples of each log from a robust loss, and values that are
      subtracted from the samples, rad; see `Reweighted`.
    - `block_s`: duration of a row, s. By default it is the longest that the orders allow, or
      `finest_s` if that is shorter, but at least an eighth of the former.
    - `segments`: segments of each log; by default those of `inputs`.
    """
    none: list[Samples | None] = [None] * len(inputs)
    channels = tuple(
        read_channels(
            one.log,
            pair=model.pair,
            regressors=model.regressors,
            drift=model.drift,
            delay_s=delay_s,
            weight=weight,
            pull=pull,
            given=model.given,
        )
        for one, weight, pull in zip(inputs, weights or none, pulls or none, strict=True)
    )
    if block_s is None:
        highest = 0.0 if model.given is None else model.given.highest_order
        block_s = block_seconds(channels, [one.segments for one in inputs], model.terms, highest)
        block_s = max(min(block_s, finest_s), block_s / _FINER, min(c.sample_s for c in channels))
    used = tuple(one.segments for one in inputs) if segments is None else tuple(segments)
    linear = LinearFit(
        inputs=tuple(inputs),
        model=model,
        channels=channels,
        rows=(),
        block_s=block_s,
        segments=used,
    )
    rows = tuple(linear.rows_of(log, segments) for log, segments in enumerate(used))
    return _on_summarised_flanks(replace(linear, rows=rows))


def _on_summarised_flanks(linear: LinearFit) -> LinearFit:
    """Return the fit without segments on a flank whose runs are all too short for the noise.

    **Raises** `NoAnswerError` if no flank is left.
    """
    flanks = {flank.flank for flank in linear.summary.flanks}
    if not flanks:
        raise NoAnswerError(
            f"all {sum(map(len, linear.segments))} stretches in certain contact are too short to"
            " tell the noise; record longer strokes, or faster.",
            where=", ".join(one.log.source for one in linear.inputs),
        )
    if all(run.segment.flank in flanks for rows in linear.rows for run in rows.runs):
        return linear
    used = tuple(tuple(s for s in own if s.flank in flanks) for own in linear.segments)
    rows = tuple(linear.rows_of(log, segments) for log, segments in enumerate(used))
    return replace(linear, segments=used, rows=rows)

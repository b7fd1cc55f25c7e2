"""Preparation of every log of a batch for the compiled fit: checks, flanks, orders and arrays."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from ...base.errors import LogError, NoAnswerError
from ...base.runtime import require_x64
from ...base.threads import one_blas_thread
from ...logs.checks.ratio import check_ratio
from ...logs.checks.slip import refuse_slip
from ...logs.encoder_log import EncoderLog
from ...logs.motion.flank_assignment import assigned_segments
from ...logs.motion.segments import Segment
from ...pair.gear_pair import Drive, GearPair
from ...pair.schema import HarmonicOrders
from ..compress.block_rows import samples_per_row
from ..compress.regressors import trim
from ..model.identifiability import FEW_TURNS, Identifiability, find_identifiability
from ..preliminary.robust import has_outliers
from ..settings import HIGHEST_LAG, FitSettings, fields
from .batch_model import BatchModel, BatchShape, batch_model, shape_of
from .log_arrays import LogArrays, arrays_of, stacked

_AROUND = 9  # window of the running median that shows isolated readings, samples; as in `robust`

_BATCH = {
    "delay": "off",
    "loss": "square",
    "lines": "report",
    "drift_order": 0,
}
"""Default settings of a batch that differ from the defaults of a single fit."""

_OPEN = ("flank", "perfect_encoders", "perfect_gears", "delay", "loss", "drift_order")
"""Settings that the user of a batch can change; all other settings are fixed."""


def batch_settings(changes: dict[str, Any]) -> FitSettings:
    """Return the settings of a batch with the `changes` of the user.

    All logs of a batch have one model: no delay or a given one in seconds, no drift or powers of
    time up to `drift_order`, least squares, no lines that join the model, autoregressive noise.

    **Raises** `TypeError` for a keyword that is no setting, and `ValueError` for a setting that a
    batch does not have.
    """
    known = {field.name for field in fields()}
    if unknown := sorted(set(changes) - known):
        raise TypeError(
            f"`fit_many` has no argument `{unknown[0]}`; its settings are {', '.join(_OPEN)}."
        )
    settings = FitSettings(**{**_BATCH, **changes})
    plain = FitSettings(**_BATCH)
    for name in sorted(set(changes) - set(_OPEN)):
        if getattr(settings, name) != getattr(plain, name):
            raise ValueError(_one_value(name, getattr(plain, name), changes[name]))
    if settings.delay in ("auto", "free"):
        raise ValueError(_one_value("delay", '"off" or a number of seconds', settings.delay))
    if settings.loss != "square":
        raise ValueError(_one_value("loss", "square", settings.loss))
    if settings.drift_order is None:
        raise ValueError(_one_value("drift_order", "a power of time, 0 … 6", None))
    return settings


def _one_value(name: str, wanted: Any, seen: Any) -> str:
    return (
        f"Argument `{name}` must be {wanted} for a batch, which has one model for all logs, but is"
        f" {seen!r}; fit such logs one by one with `vttig_jax.fit`."
    )


class NeedsFitError(NoAnswerError):
    """The log must be fitted alone, because it needs terms that the model of a batch lacks."""


@dataclass(frozen=True, eq=False)
class PreparedLog:
    """Arrays of one log, its identifiable flanks and harmonics, and the sizes of its arrays."""

    arrays: LogArrays
    identifiable: Identifiability
    shape: BatchShape


def require_one_rig(logs: Sequence[EncoderLog], pair: GearPair | Drive) -> None:
    """Refuse logs that were read for another rig than `pair`.

    **Raises** `LogError` naming the first such log.
    """
    for log in logs:
        if log.ratio != pair.ratio:
            raise LogError(
                f"this log is of another rig: it was read with the ratio {log.ratio}, but the pair"
                f" of this batch has {pair.ratio}; give the logs of each rig with their own pair.",
                where=log.source,
            )


@one_blas_thread
def prepare(
    log: EncoderLog, pair: GearPair | Drive, settings: FitSettings, orders: HarmonicOrders
) -> PreparedLog:
    """Find the flanks of a log and what can be fitted of it, and return its arrays.

    **Raises** `LogError` for a log that contradicts the pair or has a slip, `NoAnswerError` for a
    log that is too short, and `NeedsFitError` for one that needs a fit of its own.
    """
    check_ratio(log)
    found = assigned_segments(log)
    scope = find_identifiability([log], [found.segments], pair, orders, settings.flank)
    segments = scope.segments[0]
    _refuse_other_models(log, scope, segments)
    refuse_slip(log, found)
    delay_s = 0.0 if isinstance(settings.delay, str) else settings.delay
    driving = log.driving.steady_angle(log.time)
    size = samples_per_row(driving, segments, scope.terms)
    interval = log.interval_s
    kept = [trim(segment, delay_s, interval) for segment in segments]
    arrays = arrays_of(log, kept, size, delay_s)
    return PreparedLog(arrays, scope, shape_of(arrays))


def prepared(
    logs: Sequence[EncoderLog],
    pair: GearPair | Drive,
    *,
    orders: HarmonicOrders | None = None,
    lags: int = HIGHEST_LAG,
    **changes: Any,
) -> tuple[BatchModel, LogArrays]:
    """Return the model of logs of one rig and their arrays as a batch, for `fit_arrays`.

    **Arguments**
    - `logs`, `pair`, `orders`: as for `fit_many`; all logs must allow the same parameters.
    - `lags`: most lags of the noise, 1 … 16. The time of a fit grows with them, and a log whose
      noise needs more has the code `MORE_LAGS`.
    - The settings of `fit_many` are keywords.

    **Raises** what `fit_many` puts in its rows, for the first log that cannot be fitted.
    """
    require_x64("prepared")
    if not logs:
        raise ValueError("Argument `logs` must hold at least one log, but is empty.")
    if not 1 <= lags <= HIGHEST_LAG:
        raise ValueError(f"Argument `lags` must be 1 … {HIGHEST_LAG}, but is {lags!r}.")
    settings, wanted = batch_settings(changes), orders or pair.fit
    require_one_rig(logs, pair)
    found = [prepare(log, pair, settings, wanted) for log in logs]
    first = found[0].identifiable
    for log, one in zip(logs, found, strict=True):
        own = one.identifiable
        if (own.flanks, own.terms) != (first.flanks, first.terms):
            raise LogError(
                "this log allows other flanks or harmonics than the first one; use `fit_many`,"
                " which fits such logs apart.",
                where=log.source,
            )
    shape = reduce(BatchShape.over, (one.shape for one in found))
    model = batch_model(pair, first.terms, first.flanks, shape._replace(lags=lags), settings)
    return model, stacked([one.arrays for one in found], shape.samples)


def _refuse_other_models(
    log: EncoderLog, scope: Identifiability, segments: Sequence[Segment]
) -> None:
    """Raise `NeedsFitError` if a log needs terms that the model of a batch does not have.

    Such a log has a torque or axial column, few turns of the driving shaft, or outliers.
    """
    seen = None
    if log.torque is not None:
        seen = "its torque column may show wind-up"
    elif log.axial_mm is not None:
        seen = "its axial position changes the transmission error"
    elif scope.turns["driving"] < FEW_TURNS:
        seen = f"it has only {scope.turns['driving']:.1f} turns of the driving shaft"
    elif has_outliers([_isolated(log.transmission_error[s.start : s.stop]) for s in segments]):
        seen = "it has outliers"
    if seen:
        raise NeedsFitError(
            f"{seen}, so that the model of a batch does not hold; fit it alone with vttig_jax.fit"
            " or vttig fit.",
            where=log.source,
        )


def _isolated(error: np.ndarray) -> np.ndarray:
    """Return every sample minus the running median, which shows isolated deviations."""
    return error - median_filter(error, _AROUND, mode="nearest")

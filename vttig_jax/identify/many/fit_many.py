"""Fits of many logs, each from a rig of its own: one table row for each log."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import Any, NamedTuple

import msgspec

from ...base.errors import LogError, NoAnswerError, VttigError
from ...base.runtime import require_x64
from ...base.threads import one_blas_thread, usable_cores
from ...logs.encoder_log import EncoderLog
from ...pair.gear_pair import Drive, GearPair
from ...pair.schema import HarmonicOrders
from ..checking import noise_of
from ..fit_settings import BATCH, FitSettings, from_keywords
from ..identification import conditions_of, identified, told_by
from .table import OK, PARTS, Columns, FitTable, Row, table_of

REFUSED, UNDETERMINED = "refused", "undetermined"
"""Codes of logs that were not fitted: `fit` refuses them, or they tell no parameter."""

_MOST_THREADS = 4
"""Number of threads (chosen). More would not help: only one at a time runs Python code."""


def fit_many(
    logs: Iterable[EncoderLog],
    pair: GearPair | Drive,
    *,
    settings: FitSettings | None = None,
    orders: HarmonicOrders | None = None,
    progress: Callable[[int], None] = lambda logs: None,
    **changes: Any,
) -> FitTable:
    """Identify the parameters of many logs, each of a rig of its own, in one table.

    Every log goes the way of `vttig_jax.fit` with the same settings and has its parameters and
    intervals. Logs of one design share compiled programs, also logs of unequal length. A log that
    cannot be fitted has a code and a reason in its row, and the others are fitted.

    **Arguments**
    - `logs`: logs that were read with `pair`; of a generator only a few are in memory at a time.
    - `pair`: the gear pair, or a drive without geometry, that all rigs are built to.
    - `settings`: settings of all fits; the fields of `FitSettings` are keywords too, without
      `same_zero` and `use_readings`, which concern several logs or readings of one rig.
    - `orders`: harmonic orders to model; those of the pair by default.
    - `progress`: called with the number of further logs that are done.

    **Returns** a `FitTable`, whose rows have the order of the logs.

    **Raises** `LogError` for a log that was read for another rig, `ValueError` for wrong settings
    and without 64-bit floats, `TypeError` for a keyword that is no setting, and for `logs` and a
    `pair` that are none.

    **Example**
    ```python
    >>> import vttig_jax
    >>> from vttig_jax.rig import PassMotion, paper_rig
    >>> vttig_jax.enable_x64()
    >>> rig = paper_rig(motion=PassMotion(speed_rpm=240.0, reversal_deg=3600.0))
    >>> table = vttig_jax.fit_many([rig.log(seed) for seed in range(3)], rig.pair)
    >>> table.columns["driving_eccentricity_mm"].round(2).tolist()
    [0.02, 0.02, 0.02]

    ```
    """
    require_x64("fit_many")
    if not isinstance(pair, GearPair | Drive):
        raise TypeError(
            "Argument `pair` must be a gear pair or a drive, such as `vttig_jax.load_pair` returns,"
            f" but is a {type(pair).__name__}."
        )
    if not isinstance(logs, Iterable) or isinstance(logs, str):
        raise TypeError(
            f"Argument `logs` must be an iterable of encoder logs, but is a {type(logs).__name__}."
        )
    settings = batch_settings(settings, changes)
    columns = fit_columns(logs, pair, settings, orders or pair.fit, progress=progress)
    return FitTable(columns=columns, pair=pair.name, settings=settings_table(settings))


def batch_settings(settings: FitSettings | None, changes: dict[str, Any]) -> FitSettings:
    """Return the settings of all fits of a batch.

    **Raises** `TypeError` for a keyword that is no setting, and `ValueError` for a setting that
    concerns several logs of one rig.
    """
    settings = from_keywords(settings, changes)
    for name in set(FitSettings.__struct_fields__) - set(BATCH):
        if getattr(settings, name):
            raise ValueError(
                f"Argument `{name}` concerns several logs or readings of one rig, but every log of"
                " a batch is of a rig of its own; fit such logs with `vttig_jax.fit`."
            )
    return settings


def settings_table(settings: FitSettings) -> dict[str, Any]:
    """Return name → value of the settings that the user of a batch can choose."""
    return {name: msgspec.to_builtins(getattr(settings, name)) for name in BATCH}


class Unread(NamedTuple):
    """A log that could not be read: its name and the error."""

    name: str
    error: VttigError


@one_blas_thread
def fit_columns(
    logs: Iterable[EncoderLog | Unread],
    pair: GearPair | Drive,
    settings: FitSettings,
    orders: HarmonicOrders,
    *,
    threads: int | None = None,
    progress: Callable[[int], None] = lambda logs: None,
) -> Columns:
    """Return the columns of the table of fits.

    `threads` fit logs at the same time, by default one for each core. `progress` is called with
    the number of further logs that are done.
    """

    def row(log: EncoderLog | Unread) -> Row:
        if isinstance(log, Unread):
            return _failed(log.name, log.error)
        try:
            return row_of(log, pair, settings, orders)
        except VttigError as error:
            return _failed(log.source, error)

    rows: list[Row] = []
    threads = min(threads or usable_cores(), _MOST_THREADS)
    logs = _of_one_design(logs, pair)
    # Threads overlap, because NumPy and compiled programs release Python's lock. A few logs at a
    # time, because `map` takes all that it is given into memory.
    with ThreadPoolExecutor(threads) as pool:
        while some := list(islice(logs, 2 * threads)):
            for found in pool.map(row, some):
                rows.append(found)
                progress(1)
    return table_of(rows, parameter_names(pair))


def _of_one_design(
    logs: Iterable[EncoderLog | Unread], pair: GearPair | Drive
) -> Iterator[EncoderLog | Unread]:
    """Yield the logs, and end the batch at one that was read for another rig."""
    for log in logs:
        if not isinstance(log, EncoderLog | Unread):
            raise TypeError(
                "Argument `logs` must hold encoder logs, such as `vttig_jax.read_log` returns, but"
                f" holds a {type(log).__name__}."
            )
        if isinstance(log, EncoderLog) and log.ratio != pair.ratio:
            raise LogError(
                f"this log is of another rig: it was read with the ratio {log.ratio}, but the pair"
                f" of this batch has {pair.ratio}; give the logs of each rig with their own pair.",
                where=log.source,
            )
        yield log


def row_of(
    log: EncoderLog, pair: GearPair | Drive, settings: FitSettings, orders: HarmonicOrders
) -> Row:
    """Fit one log as `vttig_jax.fit` does, and return its row.

    **Raises** what `vttig_jax.fit` raises.
    """
    core = identified([log], pair, settings, orders).core
    _, parameters = told_by(core, pair, settings, log.source)
    if not any(parameter.determined for parameter in parameters.values()):
        reason = next(iter(parameters.values())).reason
        raise NoAnswerError(f"it tells no parameter: {reason}.", where=log.source)
    cells: Row = {}
    for name, one in parameters.items():
        numbers = one.value, one.std, one.low95, one.high95
        cells |= {name + part: number for part, number in zip(PARTS, numbers, strict=True)}
    noise = noise_of(core)
    return cells | {
        "log": log.source,
        "code": OK,
        "flanks": "".join(core.scope.flanks),
        "conditional_on": " ".join(conditions_of(core, pair, settings, parameters)),
        "undetermined": " ".join(
            name for name, parameter in parameters.items() if not parameter.determined
        ),
        "samples_used": float(sum(rows.samples.size for rows in core.rows)),
        "noise_order": float(len(noise.coefficients)),
        "noise_std_deg": noise.std_deg,
    }


def parameter_names(pair: GearPair | Drive) -> tuple[str, ...]:
    """Return the names of the parameters in the table."""
    size = "amplitude_arcsec" if isinstance(pair, Drive) else "eccentricity_mm"
    kinds = (size, "phase_deg"), ("encoder_arcsec", "encoder_phase_deg")
    gears, encoders = (
        [f"{shaft}_{name}" for shaft in ("driving", "driven") for name in kind] for kind in kinds
    )
    return (*gears, "constant_backlash_deg", *encoders, "delay_s", "gap_over_angles_covered")


def _failed(name: str, error: VttigError) -> Row:
    code = UNDETERMINED if isinstance(error, NoAnswerError) else REFUSED
    return {"log": name, "code": code, "reason": str(error).removeprefix(f"{name}: ")}

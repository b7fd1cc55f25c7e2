"""From a text file to an `EncoderLog`."""

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..base.errors import UsageError
from ..base.units import ANGLE_UNITS
from ..pair.spec import LogLayout, UnitTable
from .channel import RawChannel
from .columns import LENGTH_UNITS, ROLES, TIME_UNITS, Column, find_columns, name_and_unit
from .encoder_log import EncoderLog, RawLog
from .shafts import TwoShafts
from .source import Source
from .table import find_table
from .text import read_text

logger = logging.getLogger("vttig_jax")


def read_log(
    path: str | Path,
    pair: TwoShafts,
    *,
    columns: Mapping[str, str] | None = None,
    decimal: str | None = None,
    sample_rate_hz: int | float | None = None,
) -> EncoderLog:
    """Read a CSV, TSV or TXT log of two encoders, or of one and the transmission error.

    **Arguments**
    - `pair`: the pair file or what `load_pair` makes of it: encoders, ratio, and in `log` and
      `unit` the names and units of the columns.
    - `columns`: role ("time", "driving", "driven", "transmission_error", "direction", "axial_mm",
      "torque") to column name; wins over `pair.log`.
    - `decimal`: "." or ","; wins over `pair.log`.
    - `sample_rate_hz`: samples per second instead of a time column; wins over `pair.log`.

    **Raises** `LogError` naming file, line or channel and the cure.
    """
    raw = read_raw(
        path,
        pair.log,
        pair.unit,
        columns=columns or {},
        decimal=decimal,
        sample_rate_hz=sample_rate_hz,
    )
    log = EncoderLog.from_raw(raw, pair)
    logger.info("%s: %d samples", path, len(log))
    for note in log.notes:
        logger.info("%s: %s", path, note)
    return log


def read_raw(
    path: str | Path,
    layout: LogLayout,
    units: UnitTable,
    *,
    columns: Mapping[str, str],
    decimal: str | None,
    sample_rate_hz: int | float | None,
) -> RawLog:
    """The columns of a log with their units, before unwrapping; arguments as `read_log`."""
    check_arguments(columns, decimal, sample_rate_hz)
    rate = sample_rate_hz
    if rate is None and "time" not in columns:
        rate = layout.sample_rate_hz
    text, digest, notes = read_text(path, layout.encoding)
    name = str(path)
    table = find_table(text, name, delimiter=layout.delimiter, decimal=decimal or layout.decimal)
    found = find_columns(table.names, layout, units, columns, name, timed=rate is None)
    source = Source(name, {role: c.name for role, c in found.items()}, table.line_of)
    arrays = table.columns([column.index for column in found.values()])
    values = dict(zip(found, arrays, strict=True))
    size = len(values["driving"])
    if rate is None:
        time = values["time"] * TIME_UNITS[found["time"].unit]
    else:
        time = np.arange(size) / rate
    if rate is None and name_and_unit(found["time"].name, tuple(TIME_UNITS), name)[1] is None:
        notes = (*notes, f"time: column `{found['time'].name}` names no unit, taken as seconds")
    error = values.get("transmission_error")
    axial = values.get("axial_mm")
    return RawLog(
        time,
        _channel(found["driving"], values, layout.driving_scale),
        _channel(found["driven"], values, layout.driven_scale) if "driven" in found else None,
        None if error is None else ANGLE_UNITS[found["transmission_error"].unit] * error,
        values.get("direction"),
        None if axial is None else LENGTH_UNITS[found["axial_mm"].unit] * axial,
        values.get("torque"),
        source,
        digest,
        notes,
    )


def _channel(
    column: Column, values: Mapping[str, np.ndarray], scale: str | int | float
) -> RawChannel:
    return RawChannel(values[column.role], column.unit, scale)


def check_arguments(
    columns: Mapping[str, str], decimal: str | None, sample_rate_hz: int | float | None
) -> None:
    """Raise `UsageError` for keywords that cannot be followed."""
    for role in columns:
        if role not in ROLES:
            raise UsageError(f"`{role}` is no role of a column; roles are {', '.join(ROLES)}.")
    if decimal not in (None, ".", ","):
        raise UsageError(f'decimal must be "." or ",", but is {decimal!r}.')
    if sample_rate_hz is not None and not 0 < sample_rate_hz < np.inf:
        raise UsageError(f"the sample rate must be a positive number, but is {sample_rate_hz!r}.")
    if sample_rate_hz is not None and "time" in columns:
        raise UsageError("both a sample rate and a time column given; keep the one the log has.")

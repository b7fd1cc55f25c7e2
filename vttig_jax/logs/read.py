"""Reading of a log file into an `EncoderLog`."""

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import LogError, UsageError
from ..base.units import ANGLE_UNITS
from ..pair.schema import LogLayout, UnitTable
from .channel.channel import RawChannel
from .encoder_log import EncoderLog, RawLog
from .protocols import TwoShafts
from .readers.column_names import (
    ACCELERATION_UNITS,
    LENGTH_UNITS,
    SPEED_UNITS,
    TIME_UNITS,
    name_and_unit,
)
from .readers.column_roles import ROLES, ROW_INDEX, Column, find_columns, requested_names
from .readers.open_table import open_table
from .source import Source

logger = logging.getLogger("vttig_jax")

UNITS = {
    "transmission_error": ANGLE_UNITS,
    "axial_mm": LENGTH_UNITS,
    "speed": SPEED_UNITS,
    "acceleration": ACCELERATION_UNITS,
}
"""Factors from the units of a column to rad, mm, rad/s or rad/s²; channels keep their units."""


def read_log(
    path: str | Path,
    pair: TwoShafts,
    *,
    columns: Mapping[str, str] | None = None,
    decimal: str | None = None,
    sample_rate_hz: int | float | None = None,
) -> EncoderLog:
    """Read a log of two encoders, or of one encoder and the transmission error.

    The file is delimited text (CSV, TSV, TXT), MATLAB (.mat) or HDF5 (.h5, .hdf5). Columns of
    nested files have paths as names, and the last part is enough: `rec.pos_deg(1,:)` or
    `pos_deg(1,:)`. In text `#1` is the first column; in all files `#row` is 0, 1, 2, ….

    **Arguments**
    - `pair`: pair file, or result of `load_pair`: encoders, ratio, and in `log` and `unit` the
      names and units of the columns.
    - `columns`: role ("time", "driving", "driven", "transmission_error", "direction", "axial_mm",
      "torque", "speed" and "acceleration" of the driving shaft) → column name. This argument and
      the next two override `pair.log`.
    - `decimal`: decimal mark, "." or ",".
    - `sample_rate_hz`: sampling rate in Hz if there is no time column.

    **Raises** `LogError` naming the file, line or channel and the cure; `UsageError` for HDF5
    without the package h5py.

    **Example**
    ```python
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from vttig_jax.logs import read_log
    >>> from vttig_jax.pair import parse_pair_spec
    >>> unit = {"driving": "deg", "driven": "deg"}
    >>> pair = parse_pair_spec({"drive": {"ratio": "1/2"}, "unit": unit})
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "log.csv"
    ...     _ = path.write_text("".join(f"{k}.0,{k / 2:.1f}\\n" for k in range(9)))
    ...     log = read_log(path, pair, columns={"driving": "#1", "driven": "#2"}, sample_rate_hz=50)
    >>> len(log), round(float(log.time[-1]), 2)
    (9, 0.16)

    ```
    """
    raw = read_raw(
        path,
        pair.log,
        pair.unit,
        columns=columns or {},
        decimal=decimal,
        sample_rate_hz=sample_rate_hz,
    )
    keywords: dict[str, Any] = {"decimal": decimal, "sample_rate_hz": sample_rate_hz}
    log = EncoderLog.from_raw(raw, pair)
    keywords["columns"] = dict(columns or {})
    log = replace(log, keywords=keywords, path=Path(path).resolve())
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
    """Read the columns of a log with their units before unwrapping; arguments as `read_log`."""
    check_arguments(columns, decimal, sample_rate_hz)
    rate = sample_rate_hz
    if rate is None and "time" not in columns:
        rate = layout.sample_rate_hz
    name = str(path)
    table, digest, notes = open_table(
        path,
        encoding=layout.encoding,
        delimiter=layout.delimiter,
        decimal=decimal or layout.decimal,
        requested=requested_names(layout, columns).values(),
    )
    roles = find_columns(table.names, layout, units, columns, name, timed=rate is None)
    indices = [column.index for column in roles.values() if column.index != ROW_INDEX]
    table, cut = table.without_cut_line(indices)
    source = Source(name, {role: c.name for role, c in roles.items()}, table.line_of)
    values = _values(roles, dict(zip(indices, table.columns(indices), strict=True)), source)
    if rate is None:
        time = values["time"] * TIME_UNITS[roles["time"].unit]
    else:
        time = np.arange(len(values["driving"])) / rate
    if rate is None and name_and_unit(roles["time"].name, tuple(TIME_UNITS), name)[1] is None:
        notes = (*notes, f"time: column `{roles['time'].name}` names no unit, taken as seconds")
    factors = {
        role: units_in[roles[role].unit] for role, units_in in UNITS.items() if role in roles
    }
    converted = {role: factor * values[role] for role, factor in factors.items()}
    return RawLog(
        time=time,
        driving=_channel(roles["driving"], values, layout.driving_scale),
        driven=_channel(roles["driven"], values, layout.driven_scale)
        if "driven" in roles
        else None,
        error=converted.get("transmission_error"),
        direction=values.get("direction"),
        axial_mm=converted.get("axial_mm"),
        torque=values.get("torque"),
        source=source,
        sha256=digest,
        notes=(*notes, *cut),
        speed=converted.get("speed"),
        acceleration=converted.get("acceleration"),
    )


def _values(
    roles: Mapping[str, Column], arrays: Mapping[int, np.ndarray], source: Source
) -> dict[str, np.ndarray]:
    """Return the values of every role; all must be as long as the driving column."""
    reference = roles["driving"].index
    if reference == ROW_INDEX:
        reference = next(iter(arrays))
    size = len(arrays[reference])
    for role, column in roles.items():
        length = len(arrays.get(column.index, arrays[reference]))
        if length != size:
            first = next(c.name for c in roles.values() if c.index == reference)
            raise LogError(
                f"it has {length} values, but `{first}` has {size}; name columns of equal length.",
                where=source.at(role),
            )
    rows = np.arange(size, dtype=np.int64)
    return {role: arrays.get(column.index, rows) for role, column in roles.items()}


def _channel(
    column: Column, values: Mapping[str, np.ndarray], scale: str | int | float
) -> RawChannel:
    return RawChannel(values[column.role], column.unit, scale)


def check_arguments(
    columns: Mapping[str, str], decimal: str | None, sample_rate_hz: int | float | None
) -> None:
    """Raise `UsageError` for invalid or contradictory keywords."""
    for role in columns:
        if role not in ROLES:
            raise UsageError(f"`{role}` is no role of a column; roles are {', '.join(ROLES)}.")
    if decimal not in (None, ".", ","):
        raise UsageError(f'decimal must be "." or ",", but is {decimal!r}.')
    if sample_rate_hz is not None and not 0 < sample_rate_hz < np.inf:
        raise UsageError(f"the sample rate must be a positive number, but is {sample_rate_hz!r}.")
    if sample_rate_hz is not None and "time" in columns:
        raise UsageError("a sample rate and a time column are both given; keep the one of the log.")

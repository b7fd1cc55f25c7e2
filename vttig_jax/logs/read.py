"""From a file to an `EncoderLog`."""

import logging
from collections.abc import Mapping
from pathlib import Path

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
from .readers.column_roles import ROLES, ROW_INDEX, Column, find_columns, names_asked
from .readers.open_table import open_table
from .source import Source

logger = logging.getLogger("vttig_jax")

UNITS = {
    "transmission_error": ANGLE_UNITS,
    "axial_mm": LENGTH_UNITS,
    "speed": SPEED_UNITS,
    "acceleration": ACCELERATION_UNITS,
}
"""What a unit of a column is inside (rad, mm, rad/s, rad/s²); channels keep theirs."""


def read_log(
    path: str | Path,
    pair: TwoShafts,
    *,
    columns: Mapping[str, str] | None = None,
    decimal: str | None = None,
    sample_rate_hz: int | float | None = None,
) -> EncoderLog:
    """Read a log of two encoders, or of one and the transmission error.

    The file is delimited text (CSV, TSV, TXT), or MATLAB (.mat) or HDF5 (.h5, .hdf5), whose
    columns are named by their path or its last part: `rec.pos_deg(1,:)` or `pos_deg(1,:)`. In text
    `#1` is the first column, with or without a header, and everywhere `#row` is 0, 1, 2, ….

    **Arguments**
    - `pair`: the pair file or what `load_pair` makes of it: encoders, ratio, and in `log` and
      `unit` the names and units of the columns.
    - `columns`: role ("time", "driving", "driven", "transmission_error", "direction", "axial_mm",
      "torque", "speed" and "acceleration" of the driving shaft) to column name; wins over
      `pair.log`.
    - `decimal`: "." or ","; wins over `pair.log`.
    - `sample_rate_hz`: samples per second instead of a time column; wins over `pair.log`.

    **Raises** `LogError` naming file, line or channel and the cure; `UsageError` for HDF5 without
    the package h5py.

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
    name = str(path)
    table, digest, notes = open_table(
        path,
        encoding=layout.encoding,
        delimiter=layout.delimiter,
        decimal=decimal or layout.decimal,
        asked=names_asked(layout, columns).values(),
    )
    found = find_columns(table.names, layout, units, columns, name, timed=rate is None)
    held = [column.index for column in found.values() if column.index != ROW_INDEX]
    table, cut = table.without_cut_line(held)
    source = Source(name, {role: c.name for role, c in found.items()}, table.line_of)
    values = _values(found, dict(zip(held, table.columns(held), strict=True)), source)
    if rate is None:
        time = values["time"] * TIME_UNITS[found["time"].unit]
    else:
        time = np.arange(len(values["driving"])) / rate
    if rate is None and name_and_unit(found["time"].name, tuple(TIME_UNITS), name)[1] is None:
        notes = (*notes, f"time: column `{found['time'].name}` names no unit, taken as seconds")
    sizes = {role: units_in[found[role].unit] for role, units_in in UNITS.items() if role in found}
    in_units = {role: size * values[role] for role, size in sizes.items()}
    return RawLog(
        time,
        _channel(found["driving"], values, layout.driving_scale),
        _channel(found["driven"], values, layout.driven_scale) if "driven" in found else None,
        in_units.get("transmission_error"),
        values.get("direction"),
        in_units.get("axial_mm"),
        values.get("torque"),
        source,
        digest,
        (*notes, *cut),
        speed=in_units.get("speed"),
        acceleration=in_units.get("acceleration"),
    )


def _values(
    found: Mapping[str, Column], arrays: Mapping[int, np.ndarray], source: Source
) -> dict[str, np.ndarray]:
    """The values of every role, all of the length of the driving column."""
    sized = found["driving"].index
    if sized == ROW_INDEX:
        sized = next(iter(arrays))
    size = len(arrays[sized])
    for role, column in found.items():
        length = len(arrays.get(column.index, arrays[sized]))
        if length != size:
            first = next(c.name for c in found.values() if c.index == sized)
            raise LogError(
                f"{length} values, but column `{first}` has {size}; name columns of one record.",
                where=source.at(role),
            )
    rows = np.arange(size, dtype=np.int64)
    return {role: arrays.get(column.index, rows) for role, column in found.items()}


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

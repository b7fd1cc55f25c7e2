"""Reading of the columns of a log by their roles, before unwrapping."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Real

from ..base.errors import LogError
from ..base.shown_text import name_of_file
from ..base.units import ANGLE_UNITS, REV
from ..pair.schema import LogLayout, as_fraction
from .channel.channel import EXACT_FLOAT, RawChannel
from .clocks import ClockedChannel, OneClock, common_clock
from .encoder_log import RawLog
from .protocols import TwoShafts
from .readers.column_names import ACCELERATION_UNITS, LENGTH_UNITS, SPEED_UNITS
from .readers.column_roles import ROW_INDEX, Column, find_columns, requested_names
from .readers.delimited import TextTable
from .readers.nested import NestedTable, has_clocks
from .readers.open_table import open_table
from .readers.times.column import column_seconds
from .source import Source

UNITS = {
    "transmission_error": ANGLE_UNITS,
    "axial_mm": LENGTH_UNITS,
    "speed": SPEED_UNITS,
    "acceleration": ACCELERATION_UNITS,
}
"""Role → unit → factor to rad, mm, rad/s or rad/s². The channels of the shafts keep their units."""


def read_raw(
    path: str | Path,
    pair: TwoShafts,
    *,
    columns: Mapping[str, str],
    decimal: str | None,
    sample_rate_hz: int | float | None,
) -> RawLog:
    """Read the columns of a log with their units, before unwrapping; arguments as in `read_log`."""
    layout, name = pair.log, name_of_file(path)
    rate = sample_rate_hz
    if rate is None and "time" not in columns:
        rate = layout.sample_rate_hz
    opened = partial(  # reads the file again for a line number, so that no text stays in memory
        open_table,
        path,
        encoding=layout.encoding,
        delimiter=layout.delimiter,
        decimal=decimal or layout.decimal,
        requested=tuple(requested_names(layout, columns).values()),
    )
    table, digest, notes = opened()
    own_time = requested_names(layout, columns)["time"] is None and has_clocks(table)
    timed = rate is None and not own_time
    roles = find_columns(table.names, layout, pair.unit, columns, name, timed=timed)
    source = Source(name, {r: c.name for r, c in roles.items()})
    line_of = partial(_line_of, opened) if isinstance(table, TextTable) else None
    reading = _Reading(table, roles, source, line_of)
    del table
    if rate is None and own_time:
        found = reading.on_common_clock(pair)
    else:
        found = OneClock(*reading.in_rows(rate, stated=pair.unit.time is not None))
    time, values, source = found.time, found.values, reading.source
    del reading  # and the text
    factors = {
        role: units_in[roles[role].unit] for role, units_in in UNITS.items() if role in roles
    }
    converted = {role: factor * values[role] for role, factor in factors.items()}
    return RawLog(
        time=time,
        driving=_clock_channel(time, layout)
        if "driving" not in roles
        else _channel(roles["driving"], found, layout),
        driven=_channel(roles["driven"], found, layout) if "driven" in roles else None,
        error=converted.get("transmission_error"),
        direction=values.get("direction"),
        axial_mm=converted.get("axial_mm"),
        torque=values.get("torque"),
        source=source,
        sha256=digest,
        notes=(*notes, *found.notes),
        speed=converted.get("speed"),
        acceleration=converted.get("acceleration"),
    )


def _line_of(opened: Callable[[], tuple[TextTable | NestedTable, str, Any]], row: int) -> int:
    """Return the line number of a row of a text file, which is opened again for this purpose."""
    table = opened()[0]
    assert isinstance(table, TextTable)  # other tables have no line numbers
    return table.line_of(row)


@dataclass
class _Reading:
    """Columns of one table that have a role, and their positions in the file for messages."""

    table: TextTable | NestedTable
    roles: Mapping[str, Column]
    source: Source
    line_of: Callable[[int], int] | None

    def in_rows(
        self, rate: int | float | None, *, stated: bool
    ) -> tuple[np.ndarray, dict[str, np.ndarray], tuple[str, ...]]:
        """Return time in s, role → readings, and notes, if all columns share the rows of the table.

        **Arguments**
        - `rate`: sampling rate in Hz; None if there is a column of time.
        - `stated`: whether the unit of the time was stated.
        """
        time = self.roles.get("time") if rate is None else None
        dated = time is not None and time.index != ROW_INDEX and self.table.is_dated(time.index)
        used = [
            c for c in self.roles.values() if c.index != ROW_INDEX and not (dated and c is time)
        ]
        indices = [column.index for column in used]
        self.table, notes = self.table.complete_rows(indices)
        self.source = Source(self.source.name, self.source.columns, self.line_of)
        arrays = dict(zip(indices, self.table.columns(indices), strict=True))
        if time is not None:
            if time.index == ROW_INDEX:
                arrays[ROW_INDEX] = np.arange(len(next(iter(arrays.values())))) * 1.0
            seconds, told = column_seconds(
                self.table, time, arrays.get(time.index), self.source.at("time"), stated=stated
            )
            arrays[time.index], notes = seconds, (*notes, *told)
        values = _values(self.roles, arrays, self.source)
        size = len(next(iter(values.values())))
        if rate is None:
            return values["time"], values, notes
        numbers = getattr(self.table, "sample_numbers", None)
        return (np.arange(size) if numbers is None else numbers) / rate, values, notes

    def on_common_clock(self, pair: TwoShafts) -> OneClock:
        """Return the readings of columns with separate time stamps at common time stamps."""
        assert isinstance(self.table, NestedTable)  # only such tables have clocks
        channels = {}
        for role, column in self.roles.items():
            if column.index not in self.table.clocks:
                raise LogError(
                    "this column has no time stamps, as the others have; give --sample-rate.",
                    where=self.source.at(role),
                )
            stamps, values = self.table.columns([self.table.clocks[column.index], column.index])
            channels[role] = self._channel(role, column, values, stamps, pair)
        return common_clock(channels, self.source.name)

    def _channel(
        self, role: str, column: Column, values: np.ndarray, stamps: np.ndarray, pair: TwoShafts
    ) -> ClockedChannel:
        """Return a column with its time stamps and, for a shaft, its scale and modulus."""
        held = isinstance(self.table, NestedTable) and column.index in self.table.held
        if role not in ("driving", "driven"):
            return ClockedChannel(stamps, values, held=held)
        encoder = getattr(pair, role).encoder
        if column.unit == "counts":
            per_turn = encoder.counts_per_rev
            radians = REV / (per_turn or 1)
        else:
            radians = ANGLE_UNITS[column.unit]
            per_turn = REV / radians
        return ClockedChannel(
            time=stamps,
            values=values,
            radians=radians,
            per_turn=per_turn,
            held=held,
            modulus=encoder.modulus if column.unit == "counts" else None,
        )


def _values(
    roles: Mapping[str, Column], arrays: Mapping[int, np.ndarray], source: Source
) -> dict[str, np.ndarray]:
    """Return role → values; raise `LogError` if a column differs in length from the driving one."""
    first_role = next(role for role in ("driving", "driven", *roles) if role in roles)
    reference = roles[first_role].index
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


def _channel(column: Column, found: OneClock, layout: LogLayout) -> RawChannel:
    """Return the channel of a shaft; if its readings are increments, they are summed."""
    readings = found.values[column.role]
    if getattr(layout, f"{column.role}_increments"):
        readings = np.cumsum(readings)
    if column.unit == "counts":
        readings = _whole(readings)
    scale = getattr(layout, f"{column.role}_scale")
    return RawChannel(readings, column.unit, scale, found.steps.get(column.role, 0.0))


def _whole(readings: Real[np.ndarray, " n"]) -> Real[np.ndarray, " n"]:
    """Return readings that are whole numbers as int64, and other readings unchanged.

    Therefore a log does not store the same counts in two types.
    """
    if readings.dtype.kind != "f" or not np.isfinite(readings).all():
        return readings
    largest = max(readings.max(initial=0.0), -readings.min(initial=0.0))
    if largest >= EXACT_FLOAT or not np.all(readings == np.rint(readings)):
        return readings
    return readings.astype(np.int64)


def _clock_channel(time: np.ndarray, layout: LogLayout) -> RawChannel:
    """Return the revolutions, speed × time, of a driving shaft that has no encoder."""
    assert layout.driving_rpm is not None  # checked by `find_columns`
    rpm = as_fraction(layout.driving_rpm, "log.driving_rpm")
    return RawChannel((time - time[0]) * float(rpm) / 60, "rev", layout.driving_scale)

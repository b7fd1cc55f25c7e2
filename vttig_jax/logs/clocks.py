"""Readings of all roles at common instants: of rows, or of channels with separate time stamps.

A channel with a sample at every common time stamp is not interpolated. A channel that is sampled
cyclically is interpolated linearly between its samples. The error of the interpolation is at most
|a| h²/8 for an angular acceleration a and a sampling interval h. A channel of which only changes
are logged ("held") keeps its value until one cycle before the next change, and is linear within
that cycle.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int, Real

from ..base.errors import LogError
from ..base.shown_text import name_of_file
from ..base.units import ARCSEC, per_turn
from .channel.unwrap import find_modulus, step_of, unwrap
from .readers.column_names import ROW_INDEX, TIME_UNITS, Column
from .readers.table import Table
from .readers.times import check_days, exact_numbers, seconds_of_numbers, seconds_of_stamps
from .recognition.assign import Roles
from .recognition.request import SHAFTS
from .source import FEWEST_SAMPLES, Source

CYCLE = 1.5
"""In a channel of which only changes are logged, the value was constant in an interval longer than
this many median intervals (chosen)."""

SAME = 1e-6
"""Stamps that differ by at most this fraction of the median interval are the same time (chosen)."""

FAR = 1e6
"""Stamps in text beyond this number are subtracted as whole numbers to keep all digits (chosen:
float64 represents 1e6 s with a step of 0.1 ns)."""


@dataclass(frozen=True, eq=False)
class ClockedChannel:
    """Readings of one channel with their time stamps.

    **Arguments**
    - `time`: stamps in s, shape (n,). - `values`: readings in their unit, shape (n,).
    - `radians`: radians per reading, or None for a column that is no angle.
    - `per_turn`: readings per revolution, at which they may wrap, or None.
    - `held`: whether the log holds only the changes of the readings.
    - `modulus`: given modulus of the readings, or None.
    """

    time: Float[np.ndarray, " n"]
    values: Real[np.ndarray, " n"]
    radians: float | None = None
    per_turn: float | None = None
    held: bool = False
    modulus: int | None = None


@dataclass(frozen=True, eq=False)
class OneClock:
    """Readings of all channels at common time stamps.

    **Arguments**
    - `time`: stamps in s, shape (m,). - `values`: role → readings. - `notes`: notes on the change.
    - `steps`: role → step of the readings before they were interpolated, in the unit of the
      channel; channels that were not interpolated have no entry.
    """

    time: Float[np.ndarray, " m"]
    values: dict[str, Real[np.ndarray, " m"]]
    notes: tuple[str, ...] = ()
    steps: Mapping[str, float] = field(default_factory=dict)


def at_common_times(table: Table, roles: Roles) -> tuple["OneClock", Source]:
    """Return the readings of the columns with a role at common instants, and their places.

    The instants are those of the time column or of the sample rate, or, if channels have separate
    stamps, those of the slowest channel. The table is closed.

    **Raises** `LogError` for columns of different lengths, and for stamps that cannot be read.
    """
    columns, names = roles.columns, {r: column.name for r, column in roles.columns.items()}
    if "time" not in columns and roles.statement.layout.sample_rate_hz is None and table.clocks:
        place = Source(name_of_file(table.source), names)
        channels = {role: _channel(table, one, roles, place) for role, one in columns.items()}
        table.close()
        return common_clock(channels, place.name), place
    time = columns.get("time")
    dated = time is not None and time.index != ROW_INDEX and table.is_dated(time.index)
    used = [c.index for c in columns.values() if c.index != ROW_INDEX and not (dated and c is time)]
    arrays, notes = dict(zip(used, table.columns(used), strict=True)), table.left_out(used)
    place = Source(name_of_file(table.source), names, table.line_of)
    size = _common_size(columns, arrays, place)
    if time is not None and time.index != ROW_INDEX:
        arrays[time.index], told = _seconds(table, time, arrays.get(time.index), size, place)
        notes += told
        _common_size(columns, arrays, place)
    rate, numbers = roles.statement.layout.sample_rate_hz, table.sample_numbers
    if rate is not None or ROW_INDEX in (column.index for column in columns.values()):
        arrays[ROW_INDEX] = np.arange(size, dtype=np.int64)
    values = {role: arrays[column.index] for role, column in columns.items()}
    if rate is None:
        stamps = np.asarray(values["time"], np.float64)
    else:
        stamps = (arrays[ROW_INDEX] if numbers is None else numbers) / rate
    del arrays
    table.close()
    return OneClock(stamps, values, notes), place


def _common_size(
    columns: Mapping[str, Column], arrays: Mapping[int, np.ndarray], place: Source
) -> int:
    """Return the number of rows; raise `LogError` if a column has another length than a shaft."""
    role = next((r for r in (*SHAFTS, *columns) if r in columns and columns[r].index in arrays), "")
    size = len(arrays[columns[role].index]) if role else 0
    for other, column in columns.items():
        if column.index in arrays and len(arrays[column.index]) != size:
            raise LogError(
                f"it has {len(arrays[column.index])} values, but `{columns[role].name}` has {size};"
                " name columns of equal length.",
                where=place.at(other),
            )
    return size


def _seconds(
    table: Table,
    column: Column,
    values: Real[np.ndarray, " n"] | None,
    size: int,
    place: Source,
) -> tuple[Float[np.ndarray, " n"], tuple[str, ...]]:
    """Return the time in s of `size` rows, and notes; `values` is None for dates.

    **Raises** `LogError` for stamps that cannot be read or that do not resolve the sampling.
    """
    where = place.at("time")
    if values is None:
        seconds, note = seconds_of_stamps(table.texts(column.index)[: size or None], where)
        return seconds, (note,)
    far = values.dtype.kind == "f" and size > 0 and abs(values[0]) > FAR
    if place.line_of is not None and (far or column.unit == "d"):
        fields = table.texts(column.index)[:size]
        exact = exact_numbers(fields)
        if exact is not None:
            seconds = exact * TIME_UNITS[column.unit]
            if column.unit == "d":
                check_days(fields, seconds, where)
            return seconds, ()
    return seconds_of_numbers(values, column.unit), ()


def _channel(table: Table, column: Column, roles: Roles, place: Source) -> ClockedChannel:
    """Return a column with its time stamps and, for a shaft, its scale and modulus."""
    if column.index not in table.clocks:
        raise LogError(
            "this column has no time stamps, as the others have; give --sample-rate.",
            where=place.at(column.role),
        )
    stamps, values = table.columns([table.clocks[column.index], column.index])
    held = column.index in table.held
    if column.role not in SHAFTS:
        return ClockedChannel(stamps, values, held=held)
    encoder = roles.statement.encoders[SHAFTS.index(column.role)]
    return ClockedChannel(
        time=stamps,
        values=values,
        radians=roles.statement.radians(column.role, column.unit),
        per_turn=per_turn(column.unit, encoder.counts_per_rev),
        held=held,
        modulus=encoder.modulus if column.unit == "counts" else None,
    )


def common_clock(channels: Mapping[str, ClockedChannel], source: str) -> "OneClock":
    """Return the readings of all channels at the time stamps of the slowest channel.

    The faster channels are interpolated, because the error of interpolation is smaller for closer
    samples. Only the stamps within the common time of all channels are kept.

    **Raises** `LogError` for stamps that run backwards and for channels without a common time.
    """
    for role, channel in channels.items():
        _check(role, channel, source)
    slowest = min(channels, key=lambda role: len(channels[role].time))
    stamps = channels[slowest].time
    first = max(channel.time[0] for channel in channels.values())
    last = min(channel.time[-1] for channel in channels.values())
    inside = (stamps >= first) & (stamps <= last)
    if np.count_nonzero(inside) < FEWEST_SAMPLES:
        raise LogError(
            f"the channels of {' and '.join(channels)} have no common time: they cover"
            f" {_ranges(channels)}; export channels of one recording.",
            where=source,
        )
    time, values, steps, notes = stamps[inside], {}, {}, []
    for role, channel in channels.items():
        if len(channel.time) == len(stamps) and np.array_equal(channel.time, stamps):
            values[role] = channel.values[inside]
            continue
        rows = _rows_at(channel.time, time)
        if rows is not None:
            values[role] = (
                _continuous(channel)[rows] if channel.modulus is None else channel.values[rows]
            )
            notes.append(f"{role}: only its samples at the times of {slowest} are used")
            continue
        values[role], steps[role] = _at(channel, time), step_of(channel.values)
        notes.append(f"{role}: brought onto the clock of {slowest}, {_bound(channel)}")
    if steps:
        notes.append("a constant offset between the clocks is part of the delay of the fit")
    return OneClock(time, values, tuple(notes), steps)


def _check(role: str, channel: ClockedChannel, source: str) -> None:
    if len(channel.time) != len(channel.values):
        raise LogError(
            f"the {role} channel has {len(channel.values)} values, but {len(channel.time)} stamps;"
            " export the log again.",
            where=source,
        )
    if len(channel.time) < FEWEST_SAMPLES:
        raise LogError(
            f"the {role} channel has only {len(channel.time)} samples; record at least"
            f" {FEWEST_SAMPLES}.",
            where=source,
        )
    backwards = np.flatnonzero(np.diff(channel.time) < 0)
    if backwards.size:
        raise LogError(
            f"the time of the {role} channel runs backwards at its sample {backwards[0] + 1}; sort"
            " the log or cut it there.",
            where=source,
        )


def _ranges(channels: Mapping[str, ClockedChannel]) -> str:
    return " and ".join(
        f"{channel.time[0]:.6g} s to {channel.time[-1]:.6g} s" for channel in channels.values()
    )


def _continuous(channel: ClockedChannel) -> np.ndarray:
    """Return the readings unwrapped, with the given or a detected modulus."""
    values = channel.values
    if channel.radians is None:
        return values
    modulus = channel.modulus or find_modulus(values, channel.per_turn)
    return values if modulus is None else unwrap(values, modulus)


def _rows_at(
    stamps: Float[np.ndarray, " n"], time: Float[np.ndarray, " m"]
) -> Int[np.ndarray, " m"] | None:
    """Return the rows of `stamps` that are the times `time`, or None if one is missing."""
    near = SAME * float(np.median(np.diff(stamps)))
    rows = np.minimum(np.searchsorted(stamps, time - near), len(stamps) - 1)
    return rows if np.all(np.abs(stamps[rows] - time) <= near) else None


def _at(channel: ClockedChannel, time: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Return the readings interpolated at the stamps `time` (s); they wrap at a given modulus."""
    stamps, values = channel.time, _continuous(channel)
    offset = values[0]
    values = (values - offset).astype(np.float64)
    if channel.held:
        stamps, values = _with_held(stamps, values)
    found = np.interp(time, stamps, values) + float(offset)
    return found if channel.modulus is None else np.mod(found, channel.modulus)


def _with_held(
    time: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Return time and values with one inserted sample before each change after a long interval.

    The inserted sample has the unchanged value, one cycle (median interval) before the change.
    """
    interval = np.diff(time)
    cycle = float(np.median(interval))
    left_out = np.flatnonzero(interval > CYCLE * cycle)
    stamps = np.insert(time, left_out + 1, time[left_out + 1] - cycle)
    return stamps, np.insert(values, left_out + 1, values[left_out])


def _bound(channel: ClockedChannel) -> str:
    """Return a text on how a channel was interpolated, with the bound of the error for an angle."""
    how = "held between changes" if channel.held else "interpolated linearly"
    if channel.radians is None:
        return how
    bend = np.abs(np.diff(_continuous(channel).astype(np.float64), 2)) / 8
    usual, most = abs(channel.radians) / ARCSEC * np.quantile(bend, (0.95, 1.0))
    return (
        f"{how}; the error |a|h²/8 is at most {most:.2g}″, and {usual:.2g}″ for 95 % of the samples"
    )

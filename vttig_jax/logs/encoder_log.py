"""`EncoderLog`: angles of two shafts, or of one shaft with the transmission error, over time.

`at_common_times` takes the columns of a `Table` (`readers/table.py`) that have `Roles`
(`recognition/assign.py`), and brings them to common instants. `make_channel` (`channel/channel.py`)
makes the angle of a shaft of each, and a `Source` says the file, line and column of a value.

A channel with a sample at every common time stamp is not interpolated. A channel that is sampled
cyclically is interpolated linearly between its samples. The error of the interpolation is at most
|a| h²/8 for an angular acceleration a and a sampling interval h. A channel of which only changes
are logged ("held") keeps its value until one cycle before the next change, and is linear within
that cycle.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int8, Real
from numpy.typing import ArrayLike

from ..base.errors import LogError
from ..base.files.text_tables import key_values
from ..base.numerics.counting import pieces
from ..base.shown_text import name_of_file
from ..base.units import ANGLE_UNITS, ARCSEC, DEG, LENGTH_UNITS, REV, per_turn, radians_of
from ..pair.schema import Encoder, PairSpec, as_fraction
from .channel.channel import (
    Channel,
    make_channel,
    refuse_stuck,
    together,
    without_shared_spikes,
)
from .channel.speed import Speed, is_at_standstill, looks_like_speed, smooth_speed, steps_of
from .channel.unwrap import find_modulus, joined, kept_rows, step_of, unwrap, whole
from .readers.column_names import (
    ACCELERATION_UNITS,
    ROW_INDEX,
    SHAFT_UNITS,
    SPEED_UNITS,
    TIME_UNITS,
    Column,
)
from .readers.table import Table
from .readers.times import check_days, exact_numbers, read_stamps, seconds_of_numbers
from .recognition.assign import Roles
from .recognition.request import SHAFTS, Statement, TwoShafts
from .source import FEWEST_SAMPLES, MOST_TURNS, Source, check_time, refuse_values


def as_column(name: str, values: ArrayLike, size: int | None) -> Real[np.ndarray, " n"]:
    """Copy values to a one-dimensional array of numbers of length `size` (None: any length).

    **Raises** `ValueError` naming the argument.
    """
    column = np.asarray(values)
    if column.ndim != 1 or (size is not None and len(column) != size):
        wanted = "one-dimensional" if size is None else f"of shape ({size},)"
        raise ValueError(f"Argument `{name}` must be {wanted}, but has shape {column.shape}.")
    if column.dtype.kind not in "iuf":
        raise ValueError(f"Argument `{name}` must hold numbers, but holds {column.dtype}.")
    return column.astype(np.int64 if column.dtype.kind in "iu" else np.float64)


STANDSTILL = DEG
"""Least travel of the driving shaft in rad; with less travel the shaft stands still (chosen)."""


UNITS = {
    "transmission_error": ANGLE_UNITS,
    "axial_mm": LENGTH_UNITS,
    "speed": SPEED_UNITS,
    "acceleration": ACCELERATION_UNITS,
}
"""Role → unit → factor to rad, mm, rad/s or rad/s². The channels of the shafts keep their units."""


@dataclass(frozen=True, eq=False)
class EncoderLog:
    """Validated log with exactly one of `driven` and `error`.

    **Arguments**
    - `time`: time in s, not decreasing.
    - `driving`, `driven`: encoder channels.
    - `error`: transmission error of a TE-curve log as read, in rad of the driven shaft.
    - `direction`: +1, 0 or −1 per sample; `axial_mm`: axial position of the driven gear in mm;
      `torque`: torque in the unit of its column, positive if it accelerates φ₁ forward; `speed`
      (rad/s), `acceleration` (rad/s²): of the driving shaft. Each is None without a column.
    - `ratio`: ratio i of the driven to the driving speed.
    - `zero`: zero of the angles: the first sample ("start") or the reading 0 of each channel
      ("reading").
    - `source`, `sha256`: file name and digest of its bytes ("" for arrays).
    - `notes`: sentences on detected properties and assumptions.
    - `keywords`: keyword arguments with which `read_log` read the log.
    - `path`: absolute path of the file; None for arrays.
    - `spec`: if the log was read without a pair file, the equivalent pair file from the stated and
      recognised facts; None otherwise.
    """

    time: Float[np.ndarray, " n"]
    driving: Channel
    driven: Channel | None
    error: Float[np.ndarray, " n"] | None
    direction: Int8[np.ndarray, " n"] | None
    axial_mm: Float[np.ndarray, " n"] | None
    torque: Float[np.ndarray, " n"] | None
    ratio: Fraction
    zero: Literal["start", "reading"]
    source: str
    sha256: str = ""
    notes: tuple[str, ...] = ()
    place: Source = field(default_factory=lambda: Source("log"), repr=False)
    speed: Float[np.ndarray, " n"] | None = None
    acceleration: Float[np.ndarray, " n"] | None = None
    keywords: Mapping[str, Any] = field(default_factory=dict, repr=False)
    path: Path | None = None
    spec: PairSpec | None = field(default=None, repr=False)

    @property
    def driving_angle(self) -> Float[np.ndarray, " n"]:
        """Driving angle φ₁ in rad."""
        return self.driving.angle

    @cached_property
    def driven_angle(self) -> Float[np.ndarray, " n"]:
        """Driven angle φ₂ in rad; for a TE-curve log it is i φ₁ + TE."""
        if self.driven is not None:
            return self.driven.angle
        return float(self.ratio) * self.driving_angle + self.transmission_error

    @cached_property
    def transmission_error(self) -> Float[np.ndarray, " n"]:
        """Transmission error TE = φ₂ − i φ₁ in rad of the driven shaft.

        Whole turns of counts are combined as integers, so that long logs keep all digits.
        """
        if self.driven is None:
            assert self.error is not None  # checked by `from_raw`
            return self.error
        i, error = self.ratio, np.empty(len(self))
        for part in pieces(len(self)):
            turns1, rest1 = self.driving.turns_and_rest(part)
            turns2, rest2 = self.driven.turns_and_rest(part)
            turns = i.denominator * turns2 - i.numerator * turns1
            error[part] = (REV / i.denominator) * turns + (rest2 - float(i) * rest1)
        return error

    @cached_property
    def interval_s(self) -> float:
        """Median time between two samples, s."""
        return float(np.median(np.diff(self.time)))

    @cached_property
    def driving_speed(self) -> Speed:
        """Smoothed speed of the driving shaft, from its angle with spikes."""
        return smooth_speed(self.time, self.driving_angle, self.driving.resolution)

    def smooth_speed(self, angle: Float[np.ndarray, " n"]) -> Speed:
        """Return the smoothed driving speed from the driving angle without spikes, rad."""
        if angle is self.driving_angle:
            return self.driving_speed
        return smooth_speed(self.time, angle, self.driving.resolution)

    @cached_property
    def rounding(self) -> float:
        """Floating-point rounding error of the transmission error in rad."""
        return float(np.finfo(np.float64).eps * np.abs(self.driven_angle).max())

    @cached_property
    def spikes(self) -> Bool[np.ndarray, " n"]:
        """Mask of the samples at which a channel has a spike."""
        mask = np.zeros(len(self), bool)
        for channel in (self.driving, self.driven):
            if channel is not None and channel.spikes is not None:
                mask |= channel.spikes
        return mask

    def __len__(self) -> int:
        return len(self.time)

    def __str__(self) -> str:
        if self.driven is None:
            driven = f"transmission error, {np.ptp(self.transmission_error) / ARCSEC:.4g}″ wide"
        else:
            driven = f"{self.driven.turns:.4g} turns, in {self.driven.unit}"
        rows = [
            ("samples", f"{len(self)} in {np.ptp(self.time):.6g} s"),
            ("driving shaft", f"{self.driving.turns:.4g} turns, in {self.driving.unit}"),
            ("driven shaft", driven),
            ("ratio i", f"{self.ratio} = {float(self.ratio):.6g}"),
            ("angle zero", "first sample" if self.zero == "start" else "reading zero"),
        ]
        return "\n".join([key_values(rows, title=self.source), *self.notes])

    @classmethod
    def from_arrays(
        cls,
        time_s: ArrayLike,
        driving: ArrayLike,
        driven: ArrayLike | None = None,
        *,
        pair: TwoShafts,
        unit: str | tuple[str, str] = "counts",
        transmission_error: ArrayLike | None = None,
        transmission_error_unit: str = "arcsec",
        direction: ArrayLike | None = None,
        axial_mm: ArrayLike | None = None,
        torque: ArrayLike | None = None,
        speed: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        source: str = "arrays",
    ) -> "EncoderLog":
        """Create a log from arrays of shape (n,), which are validated like the columns of a file.

        **Arguments**
        - `time_s`: time in s. `driving`, `driven`: readings in `unit` (one unit, or one per shaft):
          "counts" (with the encoder of `pair`), "deg", "rad", "rev", "arcsec" or "urad", or "mm" or
          "um" with the lead in `pair.log`.
        - `transmission_error`: replaces `driven`, in `transmission_error_unit`.
        - `pair`: ratio and encoders; its `log` contains the zero and the scales.
        - `direction` (+1, 0, −1), `axial_mm`, `torque`, `speed` (rad/s), `acceleration` (rad/s²):
          as in `EncoderLog`.

        **Raises** `ValueError` for wrong arguments, `LogError` for invalid data.

        **Example**
        ```python
        >>> import numpy as np
        >>> from vttig_jax.logs import EncoderLog
        >>> from vttig_jax.pair import parse_pair_spec
        >>> drive = parse_pair_spec({"drive": {"ratio": "9/16"}})
        >>> turns = np.linspace(0.0, 4.0, 801)
        >>> log = EncoderLog.from_arrays(turns, turns, 9 / 16 * turns, pair=drive, unit="rev")
        >>> len(log), log.ratio, log.driven.turns
        (801, Fraction(9, 16), 2.25)

        ```
        """
        units = (unit, unit) if isinstance(unit, str) else unit
        if (driven is None) == (transmission_error is None):
            seen = "neither is" if driven is None else "both are"
            raise ValueError(
                "Argument `driven` must be given, or `transmission_error` instead, but"
                f" {seen} given."
            )
        of_error = "transmission_error_unit", transmission_error_unit, ANGLE_UNITS
        for name, one, known in (*(("unit", one, SHAFT_UNITS) for one in units), of_error):
            if one not in known:
                told = f"must be one of {', '.join(known)}, but is {one!r}."
                raise ValueError(f"Argument `{name}` {told}")
        time = as_column("time_s", time_s, None).astype(np.float64, copy=False)
        columns = {"driving": driving, "driven": driven, "transmission_error": transmission_error}
        columns |= {"direction": direction, "axial_mm": axial_mm, "torque": torque}
        columns |= {"speed": speed, "acceleration": acceleration}
        sizes = {"transmission_error": ANGLE_UNITS[transmission_error_unit]}
        values = {
            role: as_column(role, one, len(time)) * (1 if role in SHAFTS else sizes.get(role, 1.0))
            for role, one in columns.items()
            if one is not None
        }
        place = Source(source, {"time": "time_s"}, kind="argument")
        shafts = {"driving": units[0], "driven": units[1]}
        return cls._validated(OneClock(time, values), shafts, Statement.of(pair), place)

    @classmethod
    def of(cls, table: Table, roles: Roles) -> "EncoderLog":
        """Create a log from the columns of a table, which is closed.

        **Raises** `LogError` naming the line or column of invalid data and the cure.
        """
        sha256, notes, layout = table.digest, table.notes, roles.statement.layout
        found, place = at_common_times(table, roles)
        values, units = found.values, {role: one.unit for role, one in roles.columns.items()}
        if "driving" not in values:
            assert layout.driving_rpm is not None  # `assign` asks for the driving shaft
            rpm = as_fraction(layout.driving_rpm, "log.driving_rpm")
            values["driving"] = (found.time - found.time[0]) * float(rpm) / 60
            units["driving"] = "rev"
        for role in (role for role in SHAFTS if role in values):
            if getattr(layout, f"{role}_increments"):
                values[role] = np.cumsum(values[role])
            if units[role] == "counts":
                values[role] = whole(values[role])
        for role in UNITS.keys() & values.keys():
            factor = UNITS[role].get(units[role]) or radians_of(units[role], None, layout.lead_mm)
            assert factor is not None  # `assign` asks for the lead of an error that is a length
            # The error of an encoder that counts backwards has the other sign.
            sign = roles.statement.encoders[1].sign if role == "transmission_error" else 1
            values[role] = sign * factor * values[role]
        found = replace(found, notes=(*notes, *found.notes))
        return cls._validated(found, units, roles.statement, place, sha256=sha256)

    @classmethod
    def _validated(
        cls,
        found: "OneClock",
        units: Mapping[str, str],
        statement: Statement,
        place: Source,
        *,
        sha256: str = "",
    ) -> "EncoderLog":
        """Validate the columns, unwrap the channels, set the zero angle, and return the log.

        `found` holds the shafts in `units`, other columns as in `EncoderLog`; the columns of the
        shafts are taken out of it, so that their memory is free once they are unwrapped.
        """
        found, place, encoders = _kept(found, units, statement, place)
        time, values, layout = found.time, found.values, statement.layout
        for role, column in ({"time": time} | values).items():
            refuse_values(role, column, place)
        notes, channels, still = [*found.notes, *check_time(time, place)], {}, False
        for role, encoder in zip(SHAFTS, encoders, strict=True):
            if role in values:
                one, step = (values.pop(role), units[role], encoder), found.steps.get(role, 0.0)
                channel, told = make_channel(role, *one, time, layout, place, step, still=still)
                channels[role], notes = channel, [*notes, *told]
                if role == "driving":
                    turn, clock = REV / abs(channel.radians_per_unit), "time" in place.columns
                    still = is_at_standstill(steps_of(channel.reading, turn), time, clock=clock)
        ratio = None if statement.ratio is None else float(statement.ratio)
        channels, told = without_shared_spikes(channels, time, ratio)
        notes += told
        driving, driven = channels["driving"], channels.get("driven")
        _ = [one.resolution for one in channels.values()]  # before the angles take memory
        if driven is not None and statement.ratio is not None:
            if still:
                driving, driven = together(driving, driven, float(statement.ratio))
            elif looks_like_speed(driving.reading) and looks_like_speed(driven.reading):
                names = "` and `".join(place.columns.get(role, role) for role in SHAFTS)
                notes.append(
                    f"`{names}` rest at 0 and at readings of both signs, as speeds do and angles"
                    " seldom: if tachometers gave them, integrate both columns first"
                )
        error = values.get("transmission_error")
        if driven is None and layout.driven_scale != 1:
            raise LogError(
                "the log has no driven channel; remove this scale.", where="log.driven_scale"
            )
        if error is not None and np.ptp(error) == 0:
            raise LogError(
                "the transmission error is constant; record a measured one.",
                where=place.at("transmission_error"),
            )
        if driving.turns * REV < STANDSTILL:
            raise LogError(
                f"standstill: the driving shaft moves by only {driving.turns * 360:.3g}° in the"
                " whole log; log a shaft that turns, or correct the unit or counts_per_rev.",
                where=place.at("driving"),
            )
        if driving.turns > MOST_TURNS * len(time):
            raise LogError(
                f"the driving shaft makes {driving.turns:.4g} turns in {len(time)} samples, more"
                " than any shaft does; correct the unit, the decimal mark or counts_per_rev.",
                where=place.at("driving"),
            )
        assert statement.ratio is not None  # `assign` asks for columns without a ratio
        if driven is not None:
            refuse_stuck(driving, driven, statement.ratio, time, place)
        direction = values.get("direction")
        if direction is not None:
            invalid = ~np.isin(direction, (-1, 0, 1))
            if invalid.any():
                row = int(np.argmax(invalid))
                raise LogError(
                    f"{direction[row]:g} is not a direction; write +1, 0 or -1.",
                    where=place.at("direction", row),
                )
            direction = direction.astype(np.int8)
            if word := units.get("direction"):  # such as `cw`, from the one side or the other
                direction = direction * (1 if direction[1:] @ np.diff(driving.angle) >= 0 else -1)
                way = "rise" if direction[0] > 0 else "fall"
                notes.append(f"direction: the positions {way} in the rows `{word}`, by their order")
        measured = "axial_mm", "torque", "speed", "acceleration"
        others: dict[str, Any] = {role: values.get(role) for role in measured}
        return cls(
            time=time,
            driving=driving,
            driven=driven,
            error=error,
            direction=direction,
            ratio=statement.ratio,
            zero=layout.zero,
            source=place.name,
            sha256=sha256,
            notes=tuple(notes),
            place=replace(place, line_of=None),  # it may hold the text
            **others,
        )


def _kept(
    found: "OneClock", units: Mapping[str, str], statement: Statement, place: Source
) -> tuple["OneClock", Source, tuple[Encoder, ...]]:
    """Return the rows that the statement keeps, their places, and the encoders.

    Where rows between others are left out, the shafts are unwrapped before, and the encoders have
    no modulus any more.
    """

    if not statement.layout.leaves_out_rows:
        return found, place, statement.encoders
    values, encoders, turn = dict(found.values), statement.encoders, float(statement.ratio or 0)
    moduli: dict[str, int | float | None] = {}
    sizes: dict[str, float] = {}
    for role, encoder, ratio in zip(SHAFTS, encoders, (turn, 1.0), strict=True):
        if role in values:
            numbers, unit = values[role][np.isfinite(values[role])], units[role]
            given = encoder.modulus if unit == "counts" else None
            moduli[role] = given or find_modulus(numbers, per_turn(unit, encoder.counts_per_rev))
            scale = as_fraction(getattr(statement.layout, f"{role}_scale"), f"log.{role}_scale")
            sizes[role] = ratio * encoder.sign * float(scale) * (statement.radians(role, unit) or 0)

    def turns() -> Float[np.ndarray, " n"]:
        return unwrap(values["driving"], moduli["driving"]) * (sizes["driving"] / turn / REV)

    rows, notes = kept_rows(statement.layout, {**values, "time": found.time}, turns, place)
    assert rows is not None
    kept = {role: one[rows] for role, one in values.items()}
    if len(rows) <= rows[-1] - rows[0]:
        kept |= joined({role: values[role] for role in moduli}, rows, moduli, sizes)
        encoders = tuple(msgspec.structs.replace(one, modulus=None) for one in encoders)
    left = replace(found, time=found.time[rows], values=kept, notes=(*found.notes, *notes))
    return left, replace(place, rows=rows), encoders


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

    @property
    def unwrapped(self) -> Real[np.ndarray, " n"]:
        """Readings unwrapped with the given or a detected modulus."""
        if self.radians is None:
            return self.values
        return unwrap(self.values, self.modulus or find_modulus(self.values, self.per_turn))


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
        ticks = arrays.get(time.index)
        arrays[time.index], told = _seconds(table, time, ticks, size, place)
        stamps = arrays[time.index]
        if ticks is not None and np.any(stamps[1:] < stamps[:-1]) and not np.any(ticks % 1):
            period = 2**32 * TIME_UNITS[time.unit]
            falls = np.abs(np.diff(stamps) / period + 1) < 0.01
            if falls.any():  # such as `micros()` of an Arduino, after 71 minutes
                arrays[time.index] = stamps + period * np.cumsum(np.append(False, falls))
                told = (*told, f"time: unwrapped, as its counter passed 2³² {falls.sum()} times")
        notes += told
        _common_size(columns, arrays, place)
    rate, numbers = roles.statement.layout.sample_rate_hz, table.sample_numbers
    if rate is not None or ROW_INDEX in (column.index for column in columns.values()):
        arrays[ROW_INDEX] = np.arange(size, dtype=np.int64)
    values = {role: arrays[column.index] for role, column in columns.items()}
    if rate is None:
        stamps = np.asarray(values["time"], np.float64)
    else:
        stamps = (arrays[ROW_INDEX] if numbers is None else numbers[:size]) / rate
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
    table: Table, column: Column, values: Real[np.ndarray, " n"] | None, size: int, place: Source
) -> tuple[Float[np.ndarray, " n"], tuple[str, ...]]:
    """Return the time in s of `size` rows, and notes; `values` is None for dates.

    **Raises** `LogError` for stamps that cannot be read or that do not resolve the sampling.
    """
    if values is None:
        fields = table.texts(column.index)[: size or None]
        seconds, note = read_stamps(fields, partial(place.at, "time"))
        return seconds, (note,)
    far = values.dtype.kind == "f" and size > 0 and abs(values[0]) > FAR
    if place.line_of is not None and column.index < table.own and (far or column.unit == "d"):
        fields = table.texts(column.index)[:size]
        exact = exact_numbers(fields)
        if exact is not None:
            seconds = exact * TIME_UNITS[column.unit]
            if column.unit == "d":
                check_days(fields, seconds, place.at("time"))
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
        backwards, told = np.flatnonzero(np.diff(channel.time) < 0), ""
        if len(channel.time) != len(channel.values):
            told = (
                f"the {role} channel has {len(channel.values)} values, but {len(channel.time)}"
                " stamps; export the log again."
            )
        elif len(channel.time) < FEWEST_SAMPLES:
            told = (
                f"the {role} channel has only {len(channel.time)} samples; record at least"
                f" {FEWEST_SAMPLES}."
            )
        elif backwards.size:
            told = (
                f"the time of the {role} channel runs backwards at its sample {backwards[0] + 1};"
                " sort the log or cut it there."
            )
        if told:
            raise LogError(told, where=source)
    slowest = min(channels, key=lambda role: len(channels[role].time))
    stamps = channels[slowest].time
    first = max(channel.time[0] for channel in channels.values())
    last = min(channel.time[-1] for channel in channels.values())
    inside = (stamps >= first) & (stamps <= last)
    if np.count_nonzero(inside) < FEWEST_SAMPLES:
        cover = (f"{c.time[0]:.6g} s to {c.time[-1]:.6g} s" for c in channels.values())
        raise LogError(
            f"the channels of {' and '.join(channels)} have no common time: they cover"
            f" {' and '.join(cover)}; export channels of one recording.",
            where=source,
        )
    time, values, steps, notes = stamps[inside], {}, {}, []
    for role, channel in channels.items():
        if len(channel.time) == len(stamps) and np.array_equal(channel.time, stamps):
            values[role] = channel.values[inside]
            continue
        near = SAME * float(np.median(np.diff(channel.time)))
        rows = np.minimum(np.searchsorted(channel.time, time - near), len(channel.time) - 1)
        if np.all(np.abs(channel.time[rows] - time) <= near):
            exact = channel.values if channel.modulus is not None else channel.unwrapped
            values[role] = exact[rows]
            notes.append(f"{role}: only its samples at the times of {slowest} are used")
            continue
        values[role], how = _interpolated(channel, time)
        steps[role] = step_of(channel.values)
        notes.append(f"{role}: brought onto the clock of {slowest}, {how}")
    if steps:
        notes.append("a constant offset between the clocks is part of the delay of the fit")
    return OneClock(time, values, tuple(notes), steps)


def _interpolated(
    channel: ClockedChannel, time: Float[np.ndarray, " m"]
) -> tuple[Float[np.ndarray, " m"], str]:
    """Return the readings interpolated at the stamps `time` (s), and a text on how.

    They wrap at a given modulus. For an angle the text says the bound of the error.
    """
    stamps, unwrapped = channel.time, channel.unwrapped
    offset, how = unwrapped[0], "interpolated linearly"
    values = (unwrapped - offset).astype(np.float64)
    if channel.held:  # the unchanged value is inserted one cycle before a late change
        how, interval = "held between changes", np.diff(stamps)
        cycle = float(np.median(interval))
        late = np.flatnonzero(interval > CYCLE * cycle)
        inserted = stamps[late + 1] - cycle
        stamps = np.insert(stamps, late + 1, inserted)
        values = np.insert(values, late + 1, values[late])
    found = np.interp(time, stamps, values) + float(offset)
    if channel.radians is not None:
        bend = np.abs(np.diff(unwrapped.astype(np.float64), 2)) / 8
        usual, most = abs(channel.radians) / ARCSEC * np.quantile(bend, (0.95, 1.0))
        how += (
            f"; the error |a|h²/8 is at most {most:.2g}″, and {usual:.2g}″ for 95 % of the samples"
        )
    return found if channel.modulus is None else np.mod(found, channel.modulus), how

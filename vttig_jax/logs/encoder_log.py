"""`EncoderLog`: angles of two shafts, or of one shaft with the transmission error, over time."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int8, Real
from numpy.typing import ArrayLike

from ..base.errors import LogError
from ..base.files.text_tables import key_values
from ..base.numerics.counting import pieces
from ..base.units import ANGLE_UNITS, ARCSEC, DEG, LENGTH_UNITS, REV, per_turn
from ..pair.schema import Encoder, PairSpec, as_fraction
from .channel.channel import EXACT_FLOAT, Channel, RawChannel, make_channel, refuse_stuck
from .channel.speed import Speed, is_at_standstill, smooth_speed
from .channel.unwrap import find_modulus
from .clocks import OneClock, at_common_times
from .readers.column_names import ACCELERATION_UNITS, SHAFT_UNITS, SPEED_UNITS
from .readers.table import Table
from .recognition.assign import Roles
from .recognition.request import SHAFTS, Statement, TwoShafts
from .rows import joined, kept_rows, unwrapped
from .source import Source, check_time, refuse_turns, refuse_values


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


def check_arguments(
    with_driven: bool, with_error: bool, units: tuple[str, str], error_unit: str
) -> None:
    """Raise `ValueError` for wrong combinations of arguments or unknown units.

    Exactly one of `driven` and `transmission_error` must be given. `units` are those of the shafts.
    """
    if with_driven == with_error:
        seen = "both are" if with_driven else "neither is"
        raise ValueError(
            f"Argument `driven` must be given, or `transmission_error` instead, but {seen} given."
        )
    for unit in units:
        if unit not in SHAFT_UNITS:
            known = ", ".join(SHAFT_UNITS)
            raise ValueError(f"Argument `unit` must be {known}, but is {unit!r}.")
    if error_unit not in ANGLE_UNITS:
        raise ValueError(
            f"Argument `transmission_error_unit` must be one of {', '.join(ANGLE_UNITS)}, but is"
            f" {error_unit!r}."
        )


def check_direction(direction: Real[np.ndarray, " n"], source: Source) -> Int8[np.ndarray, " n"]:
    """Return the direction column as int8; raise `LogError` for values other than +1, 0 and −1."""
    invalid = ~np.isin(direction, (-1, 0, 1))
    if invalid.any():
        row = int(np.argmax(invalid))
        raise LogError(
            f"{direction[row]:g} is not a direction; write +1, 0 or -1.",
            where=source.at("direction", row),
        )
    return direction.astype(np.int8)


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
        rows = [
            ("samples", f"{len(self)} in {np.ptp(self.time):.6g} s"),
            ("driving shaft", f"{self.driving.turns:.4g} turns, in {self.driving.unit}"),
            (
                "driven shaft",
                f"{self.driven.turns:.4g} turns, in {self.driven.unit}"
                if self.driven is not None
                else f"transmission error, {np.ptp(self.transmission_error) / ARCSEC:.4g}″ wide",
            ),
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
        given = driven is not None, transmission_error is not None
        check_arguments(*given, units, transmission_error_unit)
        time = as_column("time_s", time_s, None).astype(np.float64, copy=False)
        columns = {
            "driving": driving,
            "driven": driven,
            "transmission_error": transmission_error,
            "direction": direction,
            "axial_mm": axial_mm,
            "torque": torque,
            "speed": speed,
            "acceleration": acceleration,
        }
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
                values[role] = _whole(values[role])
        for role in UNITS.keys() & values.keys():
            values[role] = UNITS[role][units[role]] * values[role]
        found = replace(found, notes=(*notes, *found.notes))
        return cls._validated(found, units, roles.statement, place, sha256=sha256)

    @classmethod
    def _validated(
        cls,
        found: OneClock,
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
        refuse_values("time", time, place)
        for role, column in values.items():
            if role != "time":
                refuse_values(role, column, place)
        notes, channels = [*found.notes, *check_time(time, place)], {}
        for role, encoder in zip(SHAFTS, encoders, strict=True):
            if role in values:
                scale, step = getattr(layout, f"{role}_scale"), found.steps.get(role, 0.0)
                raw = RawChannel(values.pop(role), units[role], scale, step, layout.lead_mm)
                channels[role], told = make_channel(role, raw, encoder, time, layout.zero, place)
                notes += told
        driving, driven = channels["driving"], channels.get("driven")
        _ = [one.resolution for one in channels.values()]  # before the angles take memory
        if driven is not None and statement.ratio is not None:
            clock = "time" in place.columns
            if is_at_standstill(driving.reading, time, clock=clock):
                driven = driven.following(float(statement.ratio) * driving.angle)
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
        refuse_turns(driving.turns, len(time), place)
        assert statement.ratio is not None  # `assign` asks for columns without a ratio
        if driven is not None:
            refuse_stuck(driving, driven, statement.ratio, time, place)
        direction = values.get("direction")
        return cls(
            time=time,
            driving=driving,
            driven=driven,
            error=error,
            direction=None if direction is None else check_direction(direction, place),
            axial_mm=values.get("axial_mm"),
            torque=values.get("torque"),
            ratio=statement.ratio,
            zero=layout.zero,
            source=place.name,
            sha256=sha256,
            notes=tuple(notes),
            place=replace(place, line_of=None),  # it may hold the text
            speed=values.get("speed"),
            acceleration=values.get("acceleration"),
        )


def _kept(
    found: OneClock, units: Mapping[str, str], statement: Statement, place: Source
) -> tuple[OneClock, Source, tuple[Encoder, ...]]:
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
        return unwrapped(values["driving"], moduli["driving"]) * (sizes["driving"] / turn / REV)

    rows, notes = kept_rows(statement.layout, {**values, "time": found.time}, turns, place)
    assert rows is not None
    kept = {role: one[rows] for role, one in values.items()}
    if len(rows) <= rows[-1] - rows[0]:
        kept |= joined({role: values[role] for role in moduli}, rows, moduli, sizes)
        encoders = tuple(msgspec.structs.replace(one, modulus=None) for one in encoders)
    left = replace(found, time=found.time[rows], values=kept, notes=(*found.notes, *notes))
    return left, replace(place, rows=rows), encoders


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

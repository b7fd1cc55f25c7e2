"""`EncoderLog`: two shafts over time, or one shaft and its transmission error."""

from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int8, Real
from numpy.typing import ArrayLike

from ..base.errors import LogError
from ..base.files.text_tables import key_values
from ..base.units import ANGLE_UNITS, ARCSEC, DEG, REV
from .channel.channel import Channel, RawChannel, make_channel
from .channel.stuck import refuse_stuck
from .protocols import TwoShafts
from .source import Source

FEWEST_SAMPLES = 4

PAUSE = 5.0
"""Sampling intervals longer than this many median ones are pauses."""


def as_column(name: str, values: ArrayLike, size: int | None) -> Real[np.ndarray, " n"]:
    """A copy as a one-dimensional array of numbers of length `size` (any length for None).

    **Raises** `ValueError` naming the argument.
    """
    column = np.array(values)
    if column.ndim != 1 or (size is not None and len(column) != size):
        wanted = "one-dimensional" if size is None else f"of shape ({size},)"
        raise ValueError(f"Argument `{name}` must be {wanted}, but has shape {column.shape}.")
    if column.dtype.kind not in "iuf":
        raise ValueError(f"Argument `{name}` must hold numbers, but holds {column.dtype}.")
    return column.astype(np.int64) if column.dtype.kind in "iu" else column.astype(np.float64)


def check_arguments(
    with_driven: bool, with_error: bool, units: tuple[str, str], error_unit: str
) -> None:
    """Raise `ValueError` unless exactly one of both is given, in units there are."""
    if with_driven == with_error:
        seen = "both are" if with_driven else "neither is"
        raise ValueError(
            f"Argument `driven` must be given, or `transmission_error` instead, but {seen} given."
        )
    for unit in units:
        if unit not in ("counts", *ANGLE_UNITS):
            raise ValueError(
                f"Argument `unit` must be counts, {', '.join(ANGLE_UNITS)}, but is {unit!r}."
            )
    if error_unit not in ANGLE_UNITS:
        raise ValueError(
            f"Argument `transmission_error_unit` must be one of {', '.join(ANGLE_UNITS)}, but is"
            f" {error_unit!r}."
        )


def check_finite(raw: "RawLog") -> None:
    """Raise `LogError` at the first NaN or infinity of any column."""
    columns: dict[str, Any] = {
        "time": raw.time,
        "driving": raw.driving.values,
        "driven": None if raw.driven is None else raw.driven.values,
        "transmission_error": raw.error,
        "direction": raw.direction,
        "axial_mm": raw.axial_mm,
        "torque": raw.torque,
    }
    for role, column in columns.items():
        if column is None:
            continue
        finite = np.isfinite(column)
        if not finite.all():
            row = int(np.argmin(finite))
            raise LogError(
                f"{column[row]} is no measured value; remove the line or repair the reading.",
                where=raw.source.at(role, row),
            )


def check_time(time: Float[np.ndarray, " n"], source: Source) -> list[str]:
    """Raise `LogError` for too few samples or time running backwards; note repeated stamps."""
    if len(time) < FEWEST_SAMPLES:
        raise LogError(
            f"only {len(time)} samples; a log needs at least {FEWEST_SAMPLES}.",
            where=source.at("time"),
        )
    interval = np.diff(time)
    if np.any(interval < 0):
        row = int(np.argmax(interval < 0)) + 1
        raise LogError(
            f"time runs backwards, from {time[row - 1]:.9g} s to {time[row]:.9g} s; sort the log"
            " or cut it there.",
            where=source.at("time", row),
        )
    same = int(np.count_nonzero(interval == 0))
    if 2 * same > len(interval):
        raise LogError(
            f"{same} of {len(interval)} time steps are zero; write the time with more digits or"
            " give --sample-rate.",
            where=source.at("time"),
        )
    notes = [f"time: {same} stamps repeat the one before"] if same else []
    long = interval > PAUSE * np.median(interval)
    if long.any():
        count = int(long.sum())
        pauses = "pause" if count == 1 else "pauses"
        notes.append(f"time: {count} {pauses}, the longest of {interval.max():.4g} s")
    return notes


def check_direction(direction: Real[np.ndarray, " n"], source: Source) -> Int8[np.ndarray, " n"]:
    """The direction column as int8; `LogError` for anything but +1, 0 and −1."""
    odd = ~np.isin(direction, (-1, 0, 1))
    if odd.any():
        row = int(np.argmax(odd))
        raise LogError(
            f"{direction[row]:g} is no direction; write +1, 0 or -1.",
            where=source.at("direction", row),
        )
    return direction.astype(np.int8)


STANDSTILL = DEG
"""A driving shaft that never leaves one degree has not moved."""


@dataclass(frozen=True)
class RawLog:
    """Columns with units, before unwrapping; all of one length, time in s, error in rad."""

    time: Float[np.ndarray, " n"]
    driving: RawChannel
    driven: RawChannel | None
    error: Float[np.ndarray, " n"] | None
    direction: np.ndarray | None
    axial_mm: Float[np.ndarray, " n"] | None
    torque: Float[np.ndarray, " n"] | None
    source: Source
    sha256: str = ""
    notes: tuple[str, ...] = ()
    speed: Float[np.ndarray, " n"] | None = None
    acceleration: Float[np.ndarray, " n"] | None = None


@dataclass(frozen=True, eq=False)
class EncoderLog:
    """A validated log. Exactly one of `driven` and `error` is present.

    **Arguments**
    - `time`: s, never running backwards.
    - `driving`, `driven`: the encoder channels.
    - `error`: transmission error of a TE-curve log, rad of the driven shaft, as read.
    - `direction`: +1, 0, −1 per sample where the log has such a column; `axial_mm`: axial position
      of the driven gear; `torque`: in the column's unit, positive where it pushes φ₁ forward;
      `speed` (rad/s), `acceleration` (rad/s²): of the driving shaft, where they were logged.
    - `ratio`: driven over driving speed, i.
    - `zero`: where angles are zero: at the first sample ("start") or where the channels read 0
      ("reading").
    - `source`, `sha256`: file name and digest of its bytes ("" for arrays).
    - `notes`: sentences on what was detected or assumed.
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

    @property
    def driving_angle(self) -> Float[np.ndarray, " n"]:
        """φ₁ in rad."""
        return self.driving.angle

    @cached_property
    def driven_angle(self) -> Float[np.ndarray, " n"]:
        """φ₂ in rad; of a TE-curve log i φ₁ + TE."""
        if self.driven is not None:
            return self.driven.angle
        return float(self.ratio) * self.driving_angle + self.transmission_error

    @cached_property
    def transmission_error(self) -> Float[np.ndarray, " n"]:
        """TE = φ₂ − i φ₁ in rad of the driven shaft.

        Whole turns of counts are combined as integers, so that long logs lose no digits.
        """
        if self.driven is None:
            assert self.error is not None  # held by `from_raw`
            return self.error
        (turns1, rest1), (turns2, rest2) = self.driving.turns_and_rest, self.driven.turns_and_rest
        i = self.ratio
        turns = i.denominator * turns2 - i.numerator * turns1
        return (REV / i.denominator) * turns + (rest2 - float(i) * rest1)

    @cached_property
    def rounding(self) -> float:
        """Rad by which the last digit of the readings may change a transmission error."""
        return float(np.finfo(np.float64).eps * np.abs(self.driven_angle).max())

    @cached_property
    def spikes(self) -> Bool[np.ndarray, " n"]:
        """Samples at which a channel stands off its neighbours and comes back."""
        apart = np.zeros(len(self), bool)
        for channel in (self.driving, self.driven):
            if channel is not None and channel.spikes is not None:
                apart |= channel.spikes
        return apart

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
        """A log from arrays of shape (n,), validated like a file.

        **Arguments**
        - `time_s`: s. `driving`, `driven`: readings in `unit` (one unit, or one for each shaft):
          "counts" (with the encoder of `pair`), "deg", "rad", "rev", "arcsec" or "urad".
        - `transmission_error`: instead of `driven`, in `transmission_error_unit`.
        - `pair`: ratio, encoders and, in its `log`, the zero and the scales.
        - `direction` (+1, 0, −1), `axial_mm`, `torque`, `speed` (rad/s), `acceleration` (rad/s²):
          as in `EncoderLog`.

        **Raises** `ValueError` for wrong arguments, `LogError` for data that is no log.

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
        time = as_column("time_s", time_s, None).astype(np.float64)

        def column(name: str, values: ArrayLike | None, size: float = 1.0):
            return None if values is None else size * as_column(name, values, len(time))

        second = None if driven is None else as_column("driven", driven, len(time))
        raw = RawLog(
            time,
            RawChannel(as_column("driving", driving, len(time)), units[0], pair.log.driving_scale),
            None if second is None else RawChannel(second, units[1], pair.log.driven_scale),
            column("transmission_error", transmission_error, ANGLE_UNITS[transmission_error_unit]),
            column("direction", direction),
            column("axial_mm", axial_mm),
            column("torque", torque),
            Source(source, {"time": "time_s"}, kind="argument"),
            speed=column("speed", speed),
            acceleration=column("acceleration", acceleration),
        )
        return cls.from_raw(raw, pair)

    @classmethod
    def from_raw(cls, raw: RawLog, pair: TwoShafts) -> "EncoderLog":
        """Validate columns, unwrap the channels and put the angles at the pair's zero."""
        check_finite(raw)
        notes = [*raw.notes, *check_time(raw.time, raw.source)]
        zero = pair.log.zero
        driving, found = make_channel(
            "driving", raw.driving, pair.driving.encoder, raw.time, zero, raw.source
        )
        notes += found
        driven = None
        if raw.driven is not None:
            driven, found = make_channel(
                "driven", raw.driven, pair.driven.encoder, raw.time, zero, raw.source
            )
            notes += found
        elif pair.log.driven_scale != 1:
            raise LogError(
                "a scale for a log without a driven channel; remove it.", where="log.driven_scale"
            )
        elif raw.error is not None and np.ptp(raw.error) == 0:
            raise LogError(
                "the transmission error is constant; log one that was measured.",
                where=raw.source.at("transmission_error"),
            )
        if driving.turns * REV < STANDSTILL:
            raise LogError(
                f"standstill: the driving shaft moves by only {driving.turns * 360:.3g}° in the"
                " whole log; log a shaft that turns, or correct the unit or counts_per_rev.",
                where=raw.source.at("driving"),
            )
        if driven is not None:
            refuse_stuck(driving, driven, pair.ratio, raw.time, raw.source)
        return cls(
            raw.time,
            driving,
            driven,
            raw.error,
            None if raw.direction is None else check_direction(raw.direction, raw.source),
            raw.axial_mm,
            raw.torque,
            pair.ratio,
            zero,
            raw.source.name,
            raw.sha256,
            tuple(notes),
            replace(raw.source, line_of=None),  # it would keep the whole text alive
            raw.speed,
            raw.acceleration,
        )

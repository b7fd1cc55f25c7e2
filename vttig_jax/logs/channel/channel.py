"""Encoder channel: unwrapped readings and their conversion to a shaft angle."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Real

from ...base.errors import LogError
from ...base.numerics.counting import pieces
from ...base.units import LENGTH_UNITS, REV, per_turn, radians_of
from ...pair.schema import Encoder, as_fraction
from ..source import LEAST_RANGE, Source
from .continuous import GAP as GAP
from .continuous import Continuous, Origin, make_continuous
from .spikes import without_spikes
from .steps import digits_note, step_of

EXACT_FLOAT = 2**53
"""Largest count up to which float64 represents every whole number (53-bit significand)."""

WIDEST = 2**61
"""Limit of the counts; differences of larger int64 counts could overflow."""

_FAR_OFF = 3.0
"""The first reading is not the origin if it is a spike whose distance from the next valid reading
exceeds this multiple of the step between the next two valid readings (chosen factor)."""


@dataclass(frozen=True)
class RawChannel:
    """Column of a log before unwrapping: values in `unit` and the rational scale of the pair file.

    `lead_mm` is the travel in one turn of a column that is a length. `step` is the step (in `unit`)
    that the readings had before they were interpolated in time; it is 0 for readings that were not
    interpolated.
    """

    values: Real[np.ndarray, " n"]
    unit: str
    scale: str | int | float = 1
    step: float = 0.0
    lead_mm: float | None = None


@dataclass(frozen=True, eq=False)
class Channel:
    """Encoder channel with shaft angle φ = `radians_per_unit` · (`reading` − `origin`).

    **Arguments**
    - `reading`: unwrapped int64 counts or float64 values in `unit`, before scale and sign.
    - `radians_per_unit`: factor in rad per `unit`, including sign and scale.
    - `origin`: reading at angle zero, in `unit`.
    - `per_turn`: counts per revolution if whole turns can be separated exactly, else None.
    - `modulus`: modulus of the wrapped readings in `unit`; None without wraps.
    - `wraps`: number of wraps.
    - `spikes`: true at readings far from their neighbours (see `spikes.py`); None without spikes.
    - `step`: step (in `unit`) of the readings before they were interpolated in time; 0 for readings
      that were not interpolated.
    """

    reading: Real[np.ndarray, " n"]
    radians_per_unit: float
    origin: int | float
    unit: str
    per_turn: int | None = None
    modulus: int | float | None = None
    wraps: int = 0
    spikes: Bool[np.ndarray, " n"] | None = None
    step: float = 0.0

    def turns_and_rest(
        self, part: slice = slice(None)
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return whole turns and the remaining angle, rad, of some samples; φ = 2π turns + rest.

        Whole turns of integer counts are subtracted as integers; without `per_turn` turns are 0.
        """
        travel = self.reading[part] - self.origin
        if self.per_turn is None:
            return np.zeros(len(travel), np.int64), self.radians_per_unit * travel
        turns = travel // self.per_turn
        rest = travel - turns * self.per_turn
        sign = 1 if self.radians_per_unit > 0 else -1
        return sign * turns, self.radians_per_unit * rest

    @cached_property
    def angle(self) -> Float[np.ndarray, " n"]:
        """Unwrapped shaft angle φ in rad."""
        angle = np.empty(len(self.reading))
        for part in pieces(len(angle)):
            turns, rest = self.turns_and_rest(part)
            angle[part] = REV * turns + rest
        return angle

    def steady_angle(self, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return φ, rad, in which values interpolated over `time` (s) replace the spikes.

        It is the angle from which speeds, segments and the regressors of a fit are computed.
        """
        if self.spikes is None:
            return self.angle
        return without_spikes(self.angle, time, self.spikes)

    def following(self, expected: Float[np.ndarray, " n"]) -> "Channel":
        """Return the channel with whole turns added where it steps by them beside an angle, rad.

        A table of readings at standstill does not show where a channel wraps; the other shaft does.
        """
        turns = np.concatenate([[0.0], np.cumsum(np.rint(np.diff(expected - self.angle) / REV))])
        if not turns.any():
            return self
        turn = REV / self.radians_per_unit
        added = turns * (turn if self.reading.dtype.kind == "f" else round(turn))
        return replace(self, reading=self.reading + added.astype(self.reading.dtype))

    @cached_property
    def resolution(self) -> float:
        """Quantisation step of the readings as a shaft angle in rad; 0 if no step is found."""
        return abs(self.radians_per_unit) * step_of(self.reading)

    @property
    def turns(self) -> float:
        """Revolutions between the lowest and the highest angle."""
        return float(np.ptp(self.angle)) / REV


def make_channel(
    role: str,
    raw: RawChannel,
    encoder: Encoder,
    time: Float[np.ndarray, " n"],
    zero: str,
    source: Source,
) -> tuple[Channel, tuple[str, ...]]:
    """Unwrap a column, set its scale and zero angle, and return the channel and notes.

    The notes are sentences on assumptions. With `zero` = "start" the angle is zero at the first
    valid reading, otherwise at the reading 0.

    **Raises** `LogError` for counts without counts per revolution, constant readings, readings
    beyond the given modulus, jumps that are not wraps, and pauses that hide wraps.
    """
    values, notes = _exact_values(role, raw, source)
    is_integer = np.issubdtype(values.dtype, np.integer)
    radians = radians_of(raw.unit, encoder.counts_per_rev, raw.lead_mm)
    if radians is None:
        cure = f"add `encoder = {{ counts_per_rev = … }}` to [{role}]"
        if raw.unit in LENGTH_UNITS:
            cure = "give --lead-mm, the travel in one turn, or `lead_mm` in [log]"
        raise LogError(
            f"the {role} channel is in {raw.unit}, and nothing says how many make a turn; {cure}.",
            where=source.at(role),
        )
    if np.ptp(values) < LEAST_RANGE:
        raise _constant(role, f"at {values[0]} {raw.unit}", source)
    given = encoder.modulus if raw.unit == "counts" else None
    if encoder.modulus is not None and given is None:
        notes.append(f"{role}: `modulus` counts do not apply to a column in {raw.unit}")
    scale = as_fraction(str(raw.scale), f"log.{role}_scale")
    radians = encoder.sign * radians * scale.numerator / scale.denominator
    continuous = make_continuous(
        values,
        time,
        Origin(
            role=role,
            unit=raw.unit,
            source=source,
            modulus=given,
            per_turn=per_turn(raw.unit, encoder.counts_per_rev),
            radians=radians,
        ),
    )
    if np.ptp(continuous.readings[~continuous.spikes]) == 0:
        single = np.count_nonzero(continuous.spikes)
        raise _constant(role, f"apart from {single} single readings", source)
    channel = Channel(
        reading=continuous.readings,
        radians_per_unit=radians,
        origin=_first_reading(continuous) if zero == "start" else 0,
        unit=raw.unit,
        per_turn=encoder.counts_per_rev
        if is_integer and raw.unit == "counts" and scale == 1
        else None,
        modulus=continuous.modulus,
        wraps=continuous.wraps,
        spikes=continuous.spikes if continuous.spikes.any() else None,
        step=raw.step,
    )
    notes += digits_note(role, values, abs(radians))
    return channel, (*notes, *continuous.notes)


def _constant(role: str, how: str, source: Source) -> LogError:
    return LogError(
        f"the {role} channel is constant {how}; log a shaft that turns, or name another column with"
        f" --column {role}=NAME.",
        where=source.at(role),
    )


def _first_reading(channel: Continuous) -> int | float:
    """Return the reading that defines angle zero: the first reading, unless it is a far spike.

    Then it is the first valid reading, because a far spike would shift the phases of all orders.
    """
    valid = np.flatnonzero(~channel.spikes)[:2]
    if channel.spikes[0] and len(valid) == 2:
        first, second = channel.readings[valid].astype(np.float64)
        if abs(channel.readings[0] - first) > _FAR_OFF * abs(second - first):
            return channel.readings[valid[0]].item()
    return channel.readings[0].item()


def _exact_values(role: str, raw: RawChannel, source: Source) -> tuple[np.ndarray, list[str]]:
    """Return the values (whole counts as int64, all other values as float64) and notes."""
    values = raw.values
    if raw.unit != "counts":
        return values.astype(np.float64), []
    if np.issubdtype(values.dtype, np.integer):
        values = values.astype(np.int64, copy=False)
        too_large = (values >= WIDEST) | (values <= -WIDEST)
        if too_large.any():
            row = int(np.argmax(too_large))
            raise LogError(
                f"{values[row]} counts are more than any encoder has; correct the reading or remove"
                " the line.",
                where=source.at(role, row),
            )
        return values, []
    if np.abs(values).max() >= EXACT_FLOAT:
        raise LogError(
            "counts beyond 2^53 lose their last digits as floating-point numbers; write them as"
            " integers.",
            where=source.at(role, int(np.argmax(np.abs(values)))),
        )
    if np.all(values == np.rint(values)):
        return values.astype(np.int64), []
    return values, [f"{role}: counts are not whole numbers, read as interpolated counts"]

"""One encoder channel: readings as logged, made continuous, and the angle they stand for."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Real

from ...base.errors import LogError
from ...base.units import ANGLE_UNITS, REV
from ...pair.schema import Encoder, as_fraction
from ..source import Source
from .continuous import GAP as GAP
from .continuous import Continuous, Origin, make_continuous
from .spikes import without_spikes

EXACT_FLOAT = 2**53
"""Whole numbers beyond it are no longer all floats."""

WIDEST = 2**61
"""Counts beyond it overflow when differences are taken."""


_SAME = 1e-10
"""Share of the largest reading by which readings of one value may differ: that is rounding."""

_WHOLE = 0.01
"""Share of a step by which a reading may lie beside a multiple of it."""

_FAR_OFF = 3.0
"""A first reading stands far off where it differs by more than this many of the steps after it."""


@dataclass(frozen=True)
class RawChannel:
    """A column as read: values in `unit`, and the rational factor of the pair file."""

    values: Real[np.ndarray, " n"]
    unit: str
    scale: str | int | float = 1


@dataclass(frozen=True, eq=False)
class Channel:
    """An encoder channel; φ = `radians_per_unit` · (`reading` − `origin`).

    **Arguments**
    - `reading`: int64 counts or float64 values in `unit`, unwrapped, before scale and sign.
    - `radians_per_unit`: includes sign and scale.
    - `origin`: the reading that is angle zero.
    - `per_turn`: counts per revolution where whole turns can be split off exactly, else None.
    - `modulus`: where the readings wrapped, in `unit`; None where they did not.
    - `wraps`: how often they did.
    - `spikes`: true where a reading stands off its neighbours (`logs.spikes`); None for none.
    """

    reading: Real[np.ndarray, " n"]
    radians_per_unit: float
    origin: int | float
    unit: str
    per_turn: int | None = None
    modulus: int | float | None = None
    wraps: int = 0
    spikes: Bool[np.ndarray, " n"] | None = None

    @cached_property
    def turns_and_rest(self) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Whole turns, and the angle in rad beyond them; φ = 2π turns + rest.

        Whole turns of integer counts are subtracted as integers; without `per_turn` they are 0.
        """
        moved = self.reading - self.origin
        if self.per_turn is None:
            return np.zeros(len(moved), np.int64), self.radians_per_unit * moved
        turns = moved // self.per_turn
        rest = moved - turns * self.per_turn
        sign = 1 if self.radians_per_unit > 0 else -1
        return sign * turns, self.radians_per_unit * rest

    @cached_property
    def angle(self) -> Float[np.ndarray, " n"]:
        """φ in rad, not wrapped."""
        turns, rest = self.turns_and_rest
        return REV * turns + rest

    def steady_angle(self, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """φ in rad with the spikes interpolated in `time` (s): for the motion, not for a fit."""
        if self.spikes is None:
            return self.angle
        return without_spikes(self.angle, time, self.spikes)

    @cached_property
    def resolution(self) -> float:
        """Step of the readings as an angle in rad; 0 where they have none."""
        return abs(self.radians_per_unit) * step_of(self.reading)

    @property
    def turns(self) -> float:
        """Revolutions between the lowest and the highest angle."""
        return float(np.ptp(self.angle)) / REV


def step_of(values: Real[np.ndarray, " n"]) -> float:
    """The step all values are multiples of: 1 for integers, else the least difference or a decimal.

    0 where there is none down to nine decimals.
    """
    if np.issubdtype(values.dtype, np.integer):
        return 1.0
    for step in (_least_step(values), *(10.0**-k for k in range(10))):
        if step > _SAME * np.abs(values).max():
            multiples = (values - values[0]) / step
            if np.abs(multiples - np.rint(multiples)).max() < _WHOLE:
                return step
    return 0.0


def _least_step(values: Real[np.ndarray, " n"]) -> float:
    """The least difference of two readings, as exact as their whole range; 0 where there is none.

    Readings that differ by rounding alone are one reading.
    """
    gaps = np.diff(np.unique(values))
    gaps = gaps[gaps > _SAME * np.abs(values).max()]
    if len(gaps) == 0:
        return 0.0
    steps = np.rint(gaps / gaps.min())
    whole = np.abs(gaps / gaps.min() - steps).max() < _WHOLE
    return float(np.ptp(values) / steps.sum()) if whole else 0.0


def make_channel(
    role: str,
    raw: RawChannel,
    encoder: Encoder,
    time: Float[np.ndarray, " n"],
    zero: str,
    source: Source,
) -> tuple[Channel, tuple[str, ...]]:
    """Unwrap a column, find its unit and zero; returns the channel and notes on what was assumed.

    **Raises** `LogError` for counts without counts per revolution, constant readings, readings
    beyond the given modulus, jumps that are no wrap, and pauses that hide wraps.
    """
    values, notes = _exact(role, raw, source)
    whole = np.issubdtype(values.dtype, np.integer)
    per_turn = radians = None
    if raw.unit == "counts":
        if encoder.counts_per_rev is None:
            raise LogError(
                f"the {role} channel is in counts, but the pair file does not say how many make a"
                f" revolution; add `encoder = {{ counts_per_rev = … }}` to [{role}].",
                where=source.at(role),
            )
        per_turn, radians = encoder.counts_per_rev, REV / encoder.counts_per_rev
    else:
        per_turn, radians = REV / ANGLE_UNITS[raw.unit], ANGLE_UNITS[raw.unit]
    if np.ptp(values) == 0:
        raise LogError(
            f"the {role} channel is constant at {values[0]} {raw.unit}; log a shaft that turns, or"
            f" name another column with --column {role}=NAME.",
            where=source.at(role),
        )
    given = encoder.modulus if raw.unit == "counts" else None
    if encoder.modulus is not None and given is None:
        notes.append(f"{role}: `modulus` counts do not apply to a column in {raw.unit}")
    scale = as_fraction(str(raw.scale), f"log.{role}_scale")
    radians = encoder.sign * radians * scale.numerator / scale.denominator
    made = make_continuous(values, time, Origin(role, raw.unit, source, given, per_turn, radians))
    channel = Channel(
        made.readings,
        radians,
        _start(made) if zero == "start" else 0,
        raw.unit,
        encoder.counts_per_rev if whole and raw.unit == "counts" and scale == 1 else None,
        made.modulus,
        made.wraps,
        made.spikes if made.spikes.any() else None,
    )
    return channel, (*notes, *made.notes)


def _start(made: Continuous) -> int | float:
    """The first reading, or the next good one where it is far off: it would turn every phase."""
    good = np.flatnonzero(~made.spikes)[:2]
    if made.spikes[0] and len(good) == 2:
        first, second = made.readings[good].astype(np.float64)
        if abs(made.readings[0] - first) > _FAR_OFF * abs(second - first):
            return made.readings[good[0]].item()
    return made.readings[0].item()


def _exact(role: str, raw: RawChannel, source: Source) -> tuple[np.ndarray, list[str]]:
    """Whole counts as int64, everything else as float64."""
    values = raw.values
    if raw.unit != "counts":
        return values.astype(np.float64), []
    if np.issubdtype(values.dtype, np.integer):
        values = values.astype(np.int64)
        wide = (values >= WIDEST) | (values <= -WIDEST)
        if wide.any():
            row = int(np.argmax(wide))
            raise LogError(
                f"{values[row]} counts are beyond any encoder; correct the reading or remove the"
                " line.",
                where=source.at(role, row),
            )
        return values, []
    if np.abs(values).max() >= EXACT_FLOAT:
        raise LogError(
            "counts beyond 2^53 lose their last digits as floating-point numbers; give them as"
            " integers.",
            where=source.at(role, int(np.argmax(np.abs(values)))),
        )
    if np.all(values == np.rint(values)):
        return values.astype(np.int64), []
    return values, [f"{role}: counts are not whole numbers, read as interpolated counts"]

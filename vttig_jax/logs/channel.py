"""One encoder channel: readings as logged, made continuous, and the angle they stand for."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int, Real

from ..base.errors import LogError
from ..base.units import ANGLE_UNITS, REV
from ..pair.spec import Encoder, as_fraction
from .source import Source
from .unwrap import find_modulus, stray_jump, unwrap, wrap_steps

EXACT_FLOAT = 2**53
"""Whole numbers beyond it are no longer all floats."""

GAP = 5.0
"""Sampling intervals longer than this many median ones are gaps."""


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
    """

    reading: Real[np.ndarray, " n"]
    radians_per_unit: float
    origin: int | float
    unit: str
    per_turn: int | None = None
    modulus: int | float | None = None
    wraps: int = 0

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
    gaps = np.diff(np.unique(values))
    steps = [float(gaps.min(initial=np.inf)), *(10.0**-k for k in range(10))]
    for step in steps:
        if np.isfinite(step) and step > 1e-12 * np.abs(values).max():
            multiples = (values - values[0]) / step
            if np.abs(multiples - np.rint(multiples)).max() < 0.01:
                return step
    return 0.0


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
    values, modulus, wraps, note = _continuous(role, values, time, given, per_turn, raw, source)
    scale = as_fraction(str(raw.scale), f"log.{role}_scale")
    channel = Channel(
        values,
        encoder.sign * radians * scale.numerator / scale.denominator,
        values[0].item() if zero == "start" else 0,
        raw.unit,
        encoder.counts_per_rev if whole and raw.unit == "counts" and scale == 1 else None,
        modulus,
        wraps,
    )
    return channel, (*notes, *note)


def _exact(role: str, raw: RawChannel, source: Source) -> tuple[np.ndarray, list[str]]:
    """Whole counts as int64, everything else as float64."""
    values = raw.values
    if raw.unit != "counts":
        return values.astype(np.float64), []
    if np.issubdtype(values.dtype, np.integer):
        return values.astype(np.int64), []
    if np.abs(values).max() >= EXACT_FLOAT:
        raise LogError(
            "counts beyond 2^53 lose their last digits as floating-point numbers; give them as"
            " integers.",
            where=source.at(role, int(np.argmax(np.abs(values)))),
        )
    if np.all(values == np.rint(values)):
        return values.astype(np.int64), []
    return values, [f"{role}: counts are not whole numbers, read as interpolated counts"]


def _continuous(
    role: str,
    values: np.ndarray,
    time: np.ndarray,
    given: int | None,
    per_turn: int | float,
    raw: RawChannel,
    source: Source,
) -> tuple[np.ndarray, int | float | None, int, list[str]]:
    """Unwrap with the modulus given or found; refuse what no wrap explains."""
    if given is not None and np.ptp(values) >= given:
        raise LogError(
            f"readings span {np.ptp(values)} counts, more than the modulus {given} of the pair"
            " file; correct or remove `modulus`.",
            where=source.at(role),
        )
    modulus = given if given is not None else find_modulus(values, per_turn)
    steps = np.zeros(len(values) - 1, np.int64)
    if modulus is not None:
        steps = wrap_steps(values, modulus)
    wraps = int(np.count_nonzero(steps))
    smooth = unwrap(values, modulus) if modulus is not None and wraps else values
    quantum = 1.0 if raw.unit == "counts" else 0.0
    row = stray_jump(smooth, time, quantum)
    if row is not None:
        raise LogError(
            f"a jump of {(values[row] - values[row - 1]).item():g} {raw.unit} from one sample to"
            " the next is neither motion nor a wrap"
            + (f" of {modulus:g}" if modulus is not None else "")
            + "; cut the log there"
            + (f", or give `modulus` in [{role}] encoder." if raw.unit == "counts" else "."),
            where=source.at(role, row),
        )
    if modulus is None or not wraps:
        return values, None, 0, []
    _refuse_blind_pause(role, smooth, time, modulus, raw.unit, source)
    origin = "as given" if given is not None else "detected from the jumps"
    note = f"{role}: wraps at {modulus:g} {raw.unit} ({origin}), unwrapped {wraps} times"
    return smooth, modulus, wraps, [note]


def _refuse_blind_pause(
    role: str, smooth: np.ndarray, time: np.ndarray, modulus: int | float, unit: str, source: Source
) -> None:
    """A counter that may have turned by half its modulus during a pause has lost its turns."""
    interval = np.diff(time)
    step = np.abs(np.diff(smooth)).astype(np.float64)
    for k in np.flatnonzero(interval > GAP * np.median(interval)):
        beside = slice(max(0, k - 5), k), slice(k + 1, k + 6)
        before, after = (step[s].sum() / max(interval[s].sum(), 1e-300) for s in beside)
        if max(before, after) * interval[k] > 0.4 * modulus:
            raise LogError(
                f"the log pauses for {interval[k]:.4g} s while the {role} channel wraps at"
                f" {modulus:g} {unit}, so whole turns are lost; cut the log there.",
                where=source.at(role, int(k) + 1),
            )

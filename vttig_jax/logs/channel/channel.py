"""One encoder channel: its readings made continuous, and the shaft angle that they are.

The readings are unwrapped, spikes are marked, and lasting steps are refused, as is a channel that
stands still while the other shaft turns. All limits are chosen values.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import product
from operator import itemgetter

import numpy as np
from jaxtyping import Bool, Float, Int, Real

from ...base.errors import LogError
from ...base.numerics.counting import pieces
from ...base.units import DEG, LENGTH_UNITS, REV, per_turn, radians_of
from ...pair.schema import Encoder, LogLayout, as_fraction
from ..source import LEAST_RANGE, Source
from .speed import (
    QUANTA,
    is_at_standstill,
    repeats,
    spikes,
    stalls,
    steps_of,
    usual_step,
    without_spikes,
)
from .unwrap import (
    EXACT_FLOAT,
    digits_note,
    find_modulus,
    step_of,
    stray_jump,
    unwrap,
    whole,
    wrap_steps,
)

_GAP = 5.001
"""Sampling intervals longer than this many usual intervals are gaps in time (chosen)."""

_NEAR = 8
"""Number of intervals whose mean is the usual one in the median, because a log with a row at each
edge has short and long ones in turn (chosen)."""

_FROZEN = 30
"""A channel with at least this many equal readings before a jump was frozen (chosen)."""


_ALIKE = 0.1
"""Readings of both shafts deviate alike if their sizes, by the ratio, differ by less than this
share of the larger one (chosen)."""

_LEFT = {"driving": "interpolates {}", "driven": "leaves {} out"}
"""What a fit does with the spikes of a shaft."""


def gaps_of(time: Real[np.ndarray, " n"]) -> Bool[np.ndarray, " steps"]:
    """Return which intervals between samples are gaps in time."""
    size = max(1, min(_NEAR, len(time) // 3))
    usual = np.median(time[size:] - time[:-size], overwrite_input=True) / size
    return np.diff(time) > _GAP * usual


def _one_side(time: Real[np.ndarray, " n"], row: int | np.int64) -> str:
    """Return the option that reads the longer part of a log, before or behind a row."""
    seconds = time - time[0]
    if 2 * row > len(time):
        return f"read the part before it with --to {seconds[row - 1]:.9g}"
    return f"read the part behind it with --from {seconds[row]:.9g}"


def _continuous(
    channel: "Channel",
    role: str,
    given: int | None,
    turn: int | float | None,
    time: Real[np.ndarray, " n"],
    source: Source,
    *,
    still: bool,
) -> tuple["Channel", list[str]]:
    """Return a channel with unwrapped readings, spikes, modulus and number of wraps, and notes.

    The modulus is `given`, that of the pair file, or a detected one; `turn` is a revolution in the
    unit of the readings. Spikes keep their values and are reported in a note. `still`: whether the
    other shaft shows that the readings were taken at standstill.

    **Raises** `LogError` for readings beyond the modulus, steps that are not wraps, and pauses that
    hide wraps.
    """
    values, quantum = channel.reading, 0.0
    if channel.unit == "counts" and turn is not None:
        # Those of an analogue encoder are volts, and no counts.
        quantum = 1.0 if values.dtype.kind == "i" else min(1.0, turn / 360)
    if still or is_at_standstill(steps_of(values, turn), time, clock="time" in source.columns):
        # There is no motion that a reading could contradict, and a step tells no wrap.
        return channel, []
    raw_spikes = spikes(values, time, quantum)
    bases = [values]
    if raw_spikes.any():  # the last value before each spike replaces it
        last = np.maximum.accumulate(np.where(raw_spikes, -1, np.arange(len(values))))
        bases.insert(0, values[np.where(last < 0, int(np.argmin(raw_spikes)), last)])
        del last
    if given is not None and np.ptp(bases[0]) >= given:
        raise LogError(
            f"readings span {np.ptp(bases[0])} counts, more than the modulus {given} of the pair"
            " file; correct or remove `modulus`.",
            where=source.at(role),
        )

    def attempt(
        base: Real[np.ndarray, " n"], tried: int | float | None
    ) -> tuple[float, int | float | None, int, Bool[np.ndarray, " n"], Real[np.ndarray, " n"]]:
        """Return cost, modulus, wraps, spikes and readings, unwrapped where `base` wraps.

        The cost is the total travel without spikes plus one fast step (95 % quantile of the steps)
        for each spike.
        """
        wraps = 0 if tried is None else int(np.count_nonzero(wrap_steps(base, tried)))
        readings, outliers, cost = values, raw_spikes, 0.0
        if tried is not None and wraps:
            readings = _unwrapped(values, base, tried)
            outliers = spikes(readings, time, quantum)
        if raw_spikes.any():
            travel = np.abs(np.diff(without_spikes(readings, time, outliers)))
            fast = np.quantile(travel, 0.95)
            cost = travel.sum(dtype=np.float64) + (quantum + fast) * outliers.sum()
        return float(cost), tried, wraps, outliers, readings

    moduli = [given] if given is not None else [find_modulus(base, turn) for base in bases]
    # Spikes can hide or imitate a modulus, and a counter that dithers at its wrap looks like them.
    ways = (attempt(base, modulus) for modulus, base in product(dict.fromkeys(moduli), bases))
    _, tried, wraps, outliers, readings = min(ways, key=itemgetter(0))
    modulus = tried if wraps else None
    del bases, ways  # before other arrays take memory
    repetition = repeats(readings, quantum)
    stalled = stalls(readings, time, quantum, 2 * repetition)
    if stalled.any():
        outliers = stalled | spikes(without_spikes(readings, time, stalled), time, quantum)
    smooth = without_spikes(readings, time, outliers)
    found = {"reading": readings, "modulus": modulus, "wraps": wraps, "stalled": stalled}
    channel = replace(channel, **found, spikes=outliers if outliers.any() else None)
    _refuse_lost_turns(channel, smooth, time, tried, quantum, role, source)
    notes = []
    if repetition > 1:
        delay = 0.5 * (repetition - 1)
        notes.append(
            f"{role}: while it moves every reading stands {repetition} times: the channel is"
            f" sampled at 1/{repetition} of the rate, which delays it by {delay:g} samples"
            f" ({1e3 * delay * np.median(np.diff(time)):.3g} ms) on average; log both channels at"
            " one rate, or expect that much in `delay_s`"
        )
    if modulus is not None:
        how = "as given" if given is not None else "detected from the jumps"
        notes.append(
            f"{role}: wraps at {modulus:g} {channel.unit} ({how}), unwrapped {wraps} times"
        )
    if stalled.any():
        ends = np.flatnonzero(np.diff(stalled, prepend=False, append=False)).reshape(-1, 2)
        first, last = ends[np.argmax(np.diff(time[ends - 1])[:, 0])] - 1
        count = f"{len(ends)} times, the longest" if len(ends) > 1 else "once,"
        left = _LEFT[role].format(f"{np.count_nonzero(stalled)} readings")
        notes.append(
            f"{role}: while it moves it stands still {count} from {time[first]:.6g} s to"
            f" {time[last]:.6g} s, and then jumps to where it would be: the channel froze or the"
            f" logger stalled; a fit {left}"
        )
    return channel, notes


def _unwrapped(
    values: Real[np.ndarray, " n"], base: Real[np.ndarray, " n"], modulus: int | float
) -> Real[np.ndarray, " n"]:
    """Return `values` unwrapped at the rows where `base` wraps.

    `base` is either `values` itself or `values` with filled spikes. In the second case each spike
    of `values` is placed within half a modulus of `base`, so that it does not shift the later
    readings.
    """
    readings = unwrap(base, modulus)
    rows = np.flatnonzero(values != base)
    offset = values[rows] - base[rows]
    if np.issubdtype(values.dtype, np.integer):
        size = int(modulus)
        readings[rows] += (offset + size // 2) % size - size // 2
    else:
        readings[rows] = readings[rows] + offset - modulus * np.rint(offset / modulus)
    return readings


def _refuse_lost_turns(
    channel: "Channel",
    smooth: Real[np.ndarray, " n"],
    time: Real[np.ndarray, " n"],
    modulus: int | float | None,
    quantum: float,
    role: str,
    source: Source,
) -> None:
    """Raise `LogError` for a jump of the readings that stays, and for a pause that hides wraps.

    The causes of a jump are a counter reset, an index reload, a frozen channel or an unknown
    modulus; `modulus` is the one that was tried. In a pause that hides wraps the shaft may turn by
    over 0.4 of the modulus.

    **Arguments**
    - `channel`: the unwrapped channel. `smooth`: its readings without spikes.
    """
    unit = channel.unit
    row = stray_jump(smooth, time, quantum)
    if row is not None:
        frozen = int(np.argmax(smooth[row - 1 :: -1] != smooth[row - 1]))
        if frozen >= _FROZEN:
            raise LogError(
                f"the {role} channel stands still for {frozen} samples from"
                f" {time[row - frozen]:.9g} s to {time[row - 1]:.9g} s and then jumps, so it froze;"
                " cut these lines out and fit both parts as two logs.",
                where=source.at(role, row - frozen),
            )
        raise LogError(
            f"a jump of {(smooth[row] - smooth[row - 1]).item():g} {unit} from one sample to"
            f" the next at {time[row]:.9g} s stays, and it is neither motion nor a wrap"
            + (f" of {modulus:g}" if modulus is not None else "")
            + f"; {_one_side(time, row)}"
            + (f", or give `modulus` in [{role}] encoder." if unit == "counts" else "."),
            where=source.at(role, row),
        )
    if channel.modulus is None:
        return
    interval = np.diff(time)
    step = np.abs(np.diff(smooth)).astype(np.float64)
    for k in np.flatnonzero(gaps_of(time)):
        neighbours = slice(max(0, k - 5), k), slice(k + 1, k + 6)
        before, after = (step[s].sum() / max(interval[s].sum(), 1e-300) for s in neighbours)
        if max(before, after) * interval[k] > 0.4 * channel.modulus:
            raise LogError(
                f"the log pauses for {interval[k]:.4g} s while the {role} channel wraps at"
                f" {channel.modulus:g} {unit}, so whole turns are lost; {_one_side(time, k + 1)}.",
                where=source.at(role, int(k) + 1),
            )


WIDEST = 2**61
"""Limit of the counts; differences of larger int64 counts could overflow."""

_FAR_OFF = 3.0
"""The first reading is not the origin if it is a spike whose distance from the next valid reading
exceeds this multiple of the step between the next two valid readings (chosen factor)."""


def without_shared_spikes(
    channels: Mapping[str, "Channel"], time: Float[np.ndarray, " n"], ratio: float | None
) -> tuple[dict[str, "Channel"], list[str]]:
    """Return the channels without the spikes that both shafts share, and notes on the others.

    Both deviate alike where they start or stop within a sample, and where a row is late; a
    deviation by a few steps of the readings is none.
    """
    spiky = {role: one for role, one in channels.items() if one.spikes is not None}
    off = {role: one.angle - one.steady_angle(time) for role, one in spiky.items()}
    alone = np.True_
    if len(spiky) == 2 and ratio is not None:
        a, b = np.abs(ratio * off["driving"]), np.abs(off["driven"])
        alone = np.abs(a - b) > _ALIKE * np.maximum(a, b)
    notes = []
    for role, one in spiky.items():
        seen = np.abs(off[role]) > QUANTA * one.resolution
        mask = np.asarray(one.spikes) & (alone & seen | one.stalled)
        spiky[role] = one = replace(one, spikes=mask if mask.any() else None)
        if one.spikes is not None and (others := one.spikes & ~one.stalled).any():
            number, share = int(np.count_nonzero(others)), float(np.mean(others))
            notes.append(
                f"{role}: {number} of {len(others)} readings ({share:.2g})"
                f" {'differs' if number == 1 else 'differ'} from their neighbours by up to"
                f" {np.abs(off[role])[others].max() / DEG:.3g}°, as late or disturbed readings do;"
                f" a fit {_LEFT[role].format('it' if number == 1 else 'them')}"
            )
    return {**channels, **spiky}, notes


def together(driving: "Channel", driven: "Channel", ratio: float) -> tuple["Channel", "Channel"]:
    """Return both channels of a table of readings at standstill with the turns that it leaves out.

    Such a table does not show where a channel wraps; the other shaft does. Of the ways of the
    slower shaft, the step that was read and one turn less or more, that counts from which the other
    shaft lies the fewest whole turns off, and of equal ones a way no longer than twice the usual
    step. A channel that covers a turn does not wrap, except that the driven one follows.
    """
    both, gain = ((driving, driven), ratio) if ratio >= 1 else ((driven, driving), 1 / ratio)
    slow, fast = (np.diff(one.angle) for one in both)
    turns = np.array([0.0, -1.0, 1.0])[: 3 if both[0].turns < 1 else 1, None]
    way = slow + REV * turns
    follows = np.rint((gain * way - fast) / REV) * (ratio >= 1 or driving.turns < 1)
    off = np.abs(gain * way - fast - REV * follows) / gain
    usual = min(2 * usual_step(steps_of(both[0].angle, REV)), REV / 4)
    best = np.argmin(off + 1e-6 * (turns != 0) * np.where(np.abs(way) > usual, 1, -1), axis=0)
    own = turns[best, 0], follows[best, np.arange(len(slow))]
    moved = [one.turned(counts) for one, counts in zip(both, own, strict=True)]
    return (moved[0], moved[1]) if ratio >= 1 else (moved[1], moved[0])


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
    - `spikes`: true at readings far from their neighbours (see `speed.py`); None without spikes.
    - `stalled`: those of them at which the channel or the logger stood still.
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
    stalled: Bool[np.ndarray, " n"] | bool = False
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

    def turned(self, turns: Float[np.ndarray, " n"]) -> "Channel":
        """Return the channel with whole turns added to the steps between its readings."""
        if not turns.any():
            return self
        turn, wraps = REV / self.radians_per_unit, int(np.count_nonzero(turns))
        turn = round(turn, 9) if self.reading.dtype.kind == "f" else round(turn)
        added = np.append(0.0, np.cumsum(turns * turn)).astype(self.reading.dtype)
        return replace(self, reading=self.reading + added, modulus=abs(turn), wraps=wraps)

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
    values: Real[np.ndarray, " n"],
    unit: str,
    encoder: Encoder,
    time: Float[np.ndarray, " n"],
    layout: LogLayout,
    source: Source,
    step: float = 0.0,
    *,
    still: bool = False,
) -> tuple[Channel, tuple[str, ...]]:
    """Unwrap a column, set its scale and zero angle, and return the channel and notes.

    `values` are in `unit`, with the scale, the lead and the zero of `layout`: if the latter is
    "start" the angle is zero at the first valid reading, otherwise at the reading 0. `step` is that
    of `Channel`. `still`: whether the other shaft shows that the readings were taken at standstill.
    The notes are sentences on assumptions.

    **Raises** `LogError` for counts without counts per revolution, constant readings, readings
    beyond the given modulus, jumps that are not wraps, and pauses that hide wraps.
    """
    notes = []
    if unit != "counts":
        values = values.astype(np.float64, copy=False)
    else:
        values = _exact_counts(role, values, source)
        if values.dtype.kind == "f":
            notes.append(f"{role}: counts are not whole numbers, read as interpolated counts")
    radians = radians_of(unit, encoder.counts_per_rev, layout.lead_mm)
    if radians is None:
        cure = f"add `encoder = {{ counts_per_rev = … }}` to [{role}]"
        if unit in LENGTH_UNITS:
            cure = "give --lead-mm, the travel in one turn, or `lead_mm` in [log]"
        raise LogError(
            f"the {role} channel is in {unit}, and nothing says how many make a turn; {cure}.",
            where=source.at(role),
        )
    if np.ptp(values) < LEAST_RANGE:
        raise _constant(role, f"at {values[0]} {unit}", source)
    given = encoder.modulus if unit == "counts" else None
    if encoder.modulus is not None and given is None:
        notes.append(f"{role}: `modulus` counts do not apply to a column in {unit}")
    scale = as_fraction(str(getattr(layout, f"{role}_scale")), f"log.{role}_scale")
    whole_turns = values.dtype.kind == "i" and scale == 1
    channel, told = _continuous(
        Channel(
            reading=values,
            radians_per_unit=encoder.sign * radians * scale.numerator / scale.denominator,
            origin=0,
            unit=unit,
            per_turn=encoder.counts_per_rev if whole_turns else None,
            step=step,
        ),
        role,
        given,
        per_turn(unit, encoder.counts_per_rev),
        time,
        source,
        still=still,
    )
    steady = channel.reading if channel.spikes is None else channel.reading[~channel.spikes]
    if np.ptp(steady) == 0:
        single = len(values) - len(steady)
        raise _constant(role, f"apart from {single} single readings", source)
    notes += digits_note(role, values, abs(channel.radians_per_unit))
    if layout.zero == "start":
        first = channel.reading[0]
        if channel.spikes is not None and channel.spikes[0] and len(steady) > 1:
            # A far spike as the origin would shift the phases of all orders.
            apart, step = np.abs(np.diff([first, *steady[:2]]).astype(np.float64))
            first = steady[0] if apart > _FAR_OFF * step else first
        channel = replace(channel, origin=first.item())
    return channel, (*notes, *told)


def _constant(role: str, how: str, source: Source) -> LogError:
    return LogError(
        f"the {role} channel is constant {how}; log a shaft that turns, or name another column with"
        f" --column {role}=NAME.",
        where=source.at(role),
    )


def _exact_counts(
    role: str, values: Real[np.ndarray, " n"], source: Source
) -> Real[np.ndarray, " n"]:
    """Return counts as int64 if they are whole numbers, and else as float64."""
    values = whole(values)
    if values.dtype.kind == "f":
        if np.abs(values).max() >= EXACT_FLOAT:
            raise LogError(
                "counts beyond 2^53 lose their last digits as floating-point numbers; write them as"
                " integers.",
                where=source.at(role, int(np.argmax(np.abs(values)))),
            )
        return values
    values = values.astype(np.int64, copy=False)
    too_large = (values >= WIDEST) | (values <= -WIDEST)
    if too_large.any():
        row = int(np.argmax(too_large))
        raise LogError(
            f"{values[row]} counts are more than any encoder has; correct the reading or remove"
            " the line.",
            where=source.at(role, row),
        )
    return values


FAR = 5 * DEG
"""Least turn of the moving shaft for a test, in rad of the driven shaft; it is much larger than any
backlash."""

LEAST_TURN = 8.0
"""Least turn for a test, in steps of the coarser of the two encoders."""

STILL = 0.02
"""A channel is stuck if it moves by at most this fraction of the motion of the other shaft."""

ONE_WAY = 0.9
"""A shaft turns one way if the angle between the ends is at least this share of its range."""

SOON = 0.5
"""A crossing of the gap begins within this share of its length after the reversal. The driven shaft
may follow at first, because its friction and a soft drive hold the contact."""

LONGER = 1.2
"""Largest crossing at the end of a log, as a multiple of the widest crossing before (chosen)."""

SHORTEST = 20
"""Length of the shortest tested stretch in samples; each next length is 4 times as long."""


def refuse_stuck(
    driving: Channel,
    driven: Channel,
    ratio: Fraction,
    time: Float[np.ndarray, " n"],
    source: Source,
) -> None:
    """Raise `LogError` naming the lines where one channel stands still while the other turns.

    A driven channel that stands still only behind a reversal of the driving shaft, and follows it
    again, crosses a gap and is not refused.

    **Arguments**
    - `driving`, `driven`: the channels. `ratio`: driven over driving speed. `time`: time in s.
    """
    size = abs(float(ratio))
    first, second = (driving.steady_angle(time), size), (driven.steady_angle(time), 1.0)
    quantum = max(driven.resolution, size * driving.resolution)
    for role, one, other in (("driven", second, first), ("driving", first, second)):
        # The scale comes from the log, because a wrong ratio in the pair file is no standstill.
        turn, span = (gain * float(np.ptp(angle)) for angle, gain in (one, other))
        scale = min(1.0, turn / max(span, 1e-300))
        moved = other[0], scale * other[1]
        least = max(FAR, LEAST_TURN * quantum)
        stretch = _stuck(one, moved, least, 2 * quantum, gaps=role == "driven")
        if stretch is None:
            continue
        start, stop = stretch
        turned = float(np.ptp(other[0][start:stop])) / DEG
        moving = "driven" if role == "driving" else "driving"
        last = source.at(role, stop - 1).rpartition(": ")[2].partition(",")[0]
        raise LogError(
            f"the {role} channel stands still from {time[start]:.6g} s to {time[stop - 1]:.6g} s"
            f" ({last}) while the {moving} shaft turns by {turned:.3g}°: its encoder is stuck,"
            " saturated or not connected, or the gears are out of mesh; cut these lines out or log"
            " again.",
            where=source.at(role, start),
        )


Gained = tuple[Float[np.ndarray, " n"], float]
"""Angle of a shaft in rad, and the factor that makes it an angle of the driven shaft."""


def _stuck(
    one: Gained, other: Gained, far: float, dither: float, *, gaps: bool
) -> tuple[int, int] | None:
    """Return the first stretch [start, stop) where `other` moves and `one` stands still, or None.

    `other` must move by at least `far`; `one` may move by `STILL` of that motion, or by `dither`.
    Both are in rad of the driven shaft. With `gaps`, stretches behind a reversal do not count.
    """
    (angle, gain), length = one, SHORTEST
    while length <= len(angle):
        edges = np.arange(0, len(angle) - length + 1, length)
        spans = [
            factor * (np.maximum.reduceat(shaft, edges) - np.minimum.reduceat(shaft, edges))
            for shaft, factor in (one, other)
        ]
        stuck = (spans[1] >= far) & (spans[0] <= np.maximum(STILL * spans[1], dither))
        stop, widest = 0, 0.0
        for row in edges[stuck].tolist():
            if row < stop:
                continue
            start, stop = _extent(angle, row, row + length, max(STILL * far, dither) / gain)
            turned = float(np.ptp(other[0][start:stop]))
            # At the end of a log only the earlier crossings show that the shaft follows again.
            follows = stop < len(angle) or turned <= LONGER * widest
            if not (gaps and follows and _is_crossing(other[0], start, stop)):
                return start, stop
            widest = max(widest, turned)
        length *= 4
    return None


def _is_crossing(angle: Float[np.ndarray, " n"], start: int, stop: int) -> bool:
    """Return whether a shaft turns one way in [start, stop), shortly after a reversal."""
    part = angle[start:stop]
    turned, span = float(part[-1] - part[0]), float(np.ptp(part))
    if abs(turned) < ONE_WAY * span:
        return False
    ahead = (angle[:start] - part[0]) * np.sign(turned)
    earlier = np.flatnonzero(ahead > (1 - ONE_WAY) * span)
    since = ahead[earlier[-1] + 1 :] if len(earlier) else ahead
    return float(-since.min(initial=0.0)) <= SOON * span


def _extent(angle: Float[np.ndarray, " n"], start: int, stop: int, slack: float) -> tuple[int, int]:
    """Return the longest stretch around [start, stop) in which the angle stays constant.

    It may differ by up to `slack`, in rad, from its value in the middle of [start, stop).
    """
    level = angle[(start + stop) // 2]
    outside = np.abs(angle - level) > slack
    before = np.flatnonzero(outside[:start])
    after = np.flatnonzero(outside[stop:])
    return (
        int(before[-1]) + 1 if len(before) else 0,
        stop + int(after[0]) if len(after) else len(angle),
    )

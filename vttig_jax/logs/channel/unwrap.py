"""Unwrapping of counters and single-turn angles, exact for integers, and the step of readings.

A reading r of a counter with modulus M represents r + kM. If the shaft turns less than M/2 between
two samples, the true step is the smallest possible one, and k decreases by ⌊(Δr + ⌊M/2⌋)/M⌋. Shafts
are unwrapped also through the rows that a user leaves out: those without a number, outside a window
or in cuts.

The step of the readings of a channel is that of its encoder or of the digits that the log stores.
"""

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float, Int, Real

from ...base.errors import LogError
from ...base.numerics.counting import pieces
from ...base.units import ARCSEC, DEG
from ...pair.schema import LogLayout, as_cut, as_edge
from ..source import FEWEST_SAMPLES, Source

SMALLEST_COUNTER = 2**8
LARGEST_COUNTER = 2**53
"""Smallest and largest modulus in counts that is detected as a power of two (chosen). Readings with
a range beyond the largest one contain a wrong reading."""

EXACT_FLOAT = 2**53
"""Largest count up to which float64 represents every whole number (53-bit significand)."""

MAX_ROUGHNESS = 0.15
"""A modulus is accepted if unwrapping leaves less than this fraction of the roughness at the jumps
(chosen); see `_roughness`."""


def whole(readings: Real[np.ndarray, " n"]) -> Real[np.ndarray, " n"]:
    """Return readings that are whole numbers as int64, and other readings unchanged.

    Therefore a log does not store the same counts in two types.
    """
    if readings.dtype.kind != "f" or not np.isfinite(readings).all():
        return readings
    largest = max(readings.max(initial=0.0), -readings.min(initial=0.0))
    if largest >= EXACT_FLOAT or not np.all(readings == np.rint(readings)):
        return readings
    return readings.astype(np.int64)


def wrap_steps(reading: Real[np.ndarray, " n"], modulus: int | float) -> Int[np.ndarray, " steps"]:
    """Return the wraps between neighbouring samples: +1 upwards, −1 downwards and 0 without a wrap.

    Upwards means past the upper end of the counter to 0. The shape is (n − 1,).
    """
    wraps = np.empty(max(len(reading) - 1, 0), np.int64)
    for part in pieces(len(wraps)):
        step = np.diff(reading[part.start : part.stop + 1])
        if step.dtype.kind in "iu":
            wraps[part] = -((step.astype(np.int64, copy=False) + int(modulus) // 2) // int(modulus))
        else:
            wraps[part] = -np.rint(step / modulus).astype(np.int64)
    return wraps


def unwrap(reading: Real[np.ndarray, " n"], modulus: int | float | None) -> Real[np.ndarray, " n"]:
    """Return the continuous values `reading` + kM (k = 0 at the first sample); int64 stays exact.

    Rows without a number are passed over.

    **Arguments**
    - `reading`: counts (int64) or angles (float64) in one unit, shape (n,).
    - `modulus`: M in that unit; the shaft must turn less than M/2 between samples. None: no wraps.
    """
    if modulus is None:
        return reading
    found, turns, numbers = reading.copy(), 0, np.isfinite(reading)
    if not numbers.all():
        found[numbers] = unwrap(reading[numbers], modulus)
        return found
    whole = (int if reading.dtype.kind in "iu" else float)(modulus)
    for part in pieces(len(reading) - 1):
        wraps = turns + np.cumsum(wrap_steps(reading[part.start : part.stop + 1], modulus))
        found[part.start + 1 : part.stop + 1] += whole * wraps
        turns = wraps[-1]
    return found


def find_modulus(
    reading: Real[np.ndarray, " n"], per_turn: int | float | None
) -> int | float | None:
    """Detect the modulus of a channel from the size of its jumps; return None without wraps.

    Integer counts may wrap at a power of two or at `per_turn` (counts per revolution), angles only
    at `per_turn` (one revolution in their unit). Candidates exceed the range of the readings. The
    best one leaves the smoothest steps at its wraps; it is accepted if they are smooth enough.
    """
    low, high = reading.min(), reading.max()
    span = high - low if isinstance(high, np.floating) else int(high) - int(low)
    step = np.diff(reading)
    candidates = []
    if np.issubdtype(reading.dtype, np.integer):
        power = max(SMALLEST_COUNTER, 1 << int(span).bit_length())
        if power <= LARGEST_COUNTER:
            candidates.append(power)
        if per_turn is not None and per_turn > span:
            candidates.append(int(per_turn))
    elif per_turn is not None and span <= 1.01 * per_turn:  # with noise of an analogue encoder
        candidates.append(per_turn)
    best, lowest = None, MAX_ROUGHNESS
    for candidate in candidates:
        wraps = wrap_steps(reading, candidate)
        at = np.flatnonzero(wraps)
        if len(at) == 0:
            continue
        before = _roughness(step, at)
        remaining = _roughness(np.multiply(wraps, candidate, dtype=step.dtype) + step, at) / before
        if remaining < lowest:
            best, lowest = candidate, remaining
    return best


def stray_jump(
    reading: Real[np.ndarray, " n"], time: Float[np.ndarray, " n"], quantum: int | float
) -> int | None:
    """Return the row after the first step that motion cannot explain, or None.

    A step is isolated if it exceeds 8 times the steps two samples before and after it; then both
    steps of one bad sample are isolated. It is stray if it also exceeds 4 times every step that is
    not isolated. 8 `quantum` (step of the readings) are added to both limits. Steps refer to the
    median sampling interval, so that a pause of the log is not a jump. A shaft that moves only by
    isolated steps has no stray step.
    """
    step = steps_per_interval(reading, time)
    if len(step) < 5:
        return None
    np.abs(step, out=step)
    around = np.pad(step, 2, mode="edge")
    limit = np.maximum(around[:-4], around[4:])  # two samples before and after
    del around
    limit *= 8
    limit += 8 * quantum
    isolated = step > limit
    del limit
    if not isolated.any():
        return None
    others = step[~isolated]
    if isolated.sum() >= 3 and others.sum() < 0.1 * step[isolated].sum():
        return None
    stray = isolated & (step > 4 * others.max(initial=0) + 8 * quantum)
    return int(np.argmax(stray)) + 1 if stray.any() else None


def steps_per_interval(
    reading: Real[np.ndarray, " n"], time: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " steps"]:
    """Return the steps between successive readings, scaled to the median sampling interval.

    Steps over an interval shorter than the median are not scaled.
    """
    weight = np.diff(time)
    weight /= np.median(weight)  # not 0: `check_time` refuses stamps that mostly repeat
    np.maximum(weight, 1.0, out=weight)
    return np.divide(np.diff(reading), weight, out=weight)


def _roughness(step: Real[np.ndarray, " steps"], at: Int[np.ndarray, " wraps"]) -> float:
    """Return the roughness at the wraps: the sum of the changes of the step before and after `at`.

    `at` holds the indices of the steps that wrap. 1 is added to the sum against division by 0.
    """
    before, after = at[at > 0] - 1, at[at < len(step) - 1]
    sums = (
        np.abs(step[one + 1].astype(np.float64) - step[one].astype(np.float64)).sum()
        for one in (before, after)
    )
    return 1.0 + float(sum(sums))


def kept_rows(
    layout: LogLayout,
    columns: Mapping[str, Real[np.ndarray, " n"]],
    turns: Callable[[], Float[np.ndarray, " n"]],
    source: Source,
) -> tuple[Int[np.ndarray, " m"] | None, tuple[str, ...]]:
    """Return the rows that a table [log] keeps, and notes; None for all rows.

    `columns` is role → values of the columns that are used, with the time in s, and `turns` returns
    the driving angle in turns. Places in a log count from its first sample with numbers.

    **Raises** `LogError` if fewer than `FEWEST_SAMPLES` rows are left.
    """
    if not layout.leaves_out_rows:
        return None, ()
    numbers = np.logical_and.reduce([np.isfinite(one) for one in columns.values()])
    keep, notes = np.ones(len(numbers), bool), []
    if layout.missing == "skip" and not numbers.all():
        keep, first = numbers.copy(), int(np.argmin(numbers))
        lacking = [r for r, one in columns.items() if not np.isfinite(one).all()]
        names = " and ".join(f"`{source.columns.get(role, role)}`" for role in lacking)
        where = f"line {source.line_of(first)}" if source.line_of else f"sample {first}"
        count = len(numbers) - np.count_nonzero(numbers)
        notes.append(
            f"{count} of {len(numbers)} rows have no number in {names} and are left out, {where}"
            " first"
        )
    start = int(np.argmax(numbers))

    def along(unit: str) -> Real[np.ndarray, " n"]:
        values = turns() if unit == "rev" else columns["time"]
        return values - values[start]

    for edge, sign in ((layout.start, 1), (layout.stop, -1)):
        if edge is not None:
            value, unit = as_edge(edge, "log")
            keep &= sign * (along(unit) - value) >= 0
    for text in layout.cut:
        low, high, unit = as_cut(text, "log.cut")
        place = along(unit)
        keep &= ~((place >= low) & (place <= high))
    given = [("--from", layout.start), ("--to", layout.stop), *(("--cut", c) for c in layout.cut)]
    words = " ".join(f"{option} {value}" for option, value in given if value is not None)
    rows = np.flatnonzero(keep)
    if len(rows) < FEWEST_SAMPLES:
        lasts = float(np.nanmax(along("s")))
        raise LogError(
            f"{words or '--missing skip'} leaves {len(rows)} of {len(keep)} samples, and a log has"
            f" at least {FEWEST_SAMPLES}; it lasts {lasts:.6g} s, and places count from its first"
            " sample.",
            where=source.name,
        )
    if words:
        notes.append(f"{len(rows)} of {len(keep)} samples are read, with {words}")
    return rows, tuple(notes)


def joined(
    readings: Mapping[str, Real[np.ndarray, " n"]],
    rows: Int[np.ndarray, " m"],
    moduli: Mapping[str, int | float | None],
    sizes: Mapping[str, float],
) -> dict[str, Real[np.ndarray, " m"]]:
    """Return the readings of the shafts in the kept rows, unwrapped through the rows left out.

    A gap may hold whole turns, which the readings in it count, or damaged readings, which do not.
    Of both ways through a gap, that over its readings and that of the smallest step, each shaft
    takes the one with which both shafts turn alike.

    `moduli` is role → readings at which they wrap, or None; `sizes` is role → radians of the driven
    shaft per reading.
    """
    gaps = np.flatnonzero(np.diff(rows) > 1)
    found, steps = {}, {}
    for role, values in readings.items():
        found[role] = near = unwrap(values[rows], moduli[role])
        through = unwrap(values, moduli[role])[rows]
        steps[role] = np.array([np.diff(through)[gaps], np.diff(near)[gaps]])
    ways = dict.fromkeys(readings, np.zeros(len(gaps), np.int64))
    if len(readings) == 2:
        x, y = (sizes[role] * steps[role] for role in ("driving", "driven"))
        best = np.abs(y - x[:, None]).reshape(4, -1).argmin(axis=0)
        ways = {"driving": best // 2, "driven": best % 2}
    for role, near in found.items():
        chosen = steps[role][ways[role], np.arange(len(gaps))]
        turns = np.zeros(len(rows), near.dtype)
        turns[gaps + 1] = chosen - steps[role][1]
        found[role] = near + np.cumsum(turns)
    return found


def complete(columns: Mapping[int, Real[np.ndarray, " _"]]) -> dict[int, Real[np.ndarray, " _"]]:
    """Return the columns in rows in which each of them has a number, to compare them.

    A column that leaves fewer than three times `FEWEST_SAMPLES` of these rows is left out.
    """
    found: dict[int, np.ndarray] = {}
    for size in {len(one) for one in columns.values()}:
        numbers = {k: np.isfinite(one) for k, one in columns.items() if len(one) == size}
        rows, kept = np.ones(size, bool), []
        for k in sorted(numbers, key=lambda k: -np.count_nonzero(numbers[k])):
            both = rows & numbers[k]
            if np.count_nonzero(both) >= min(3 * FEWEST_SAMPLES, size):
                rows, kept = both, [*kept, k]
        found |= {k: columns[k][rows] for k in kept}
    return dict(sorted(found.items()))


_ROUNDING = 1e-10
"""Readings that differ by at most this fraction of the largest reading are equal (chosen)."""

_STEP_TOLERANCE = 0.01
"""Largest deviation from a multiple of the step, as a fraction of the step (chosen tolerance)."""

_LEAST_CHANGES = 1e-3
"""Least share of the samples at which the difference of successive readings must change; otherwise
the speed is exactly constant and shows no encoder step (chosen)."""

_MOST_DIVISIONS = 20
"""Largest number of divisions in Euclid's algorithm; each at least halves the step (chosen)."""

_SAMPLE = 4000  # largest number of readings in the test of the digits (chosen)
_COARSER = 5.0
"""If the step of large readings exceeds that of small readings by this factor, the printed digits
limit the large ones (chosen); one digit fewer is a factor of ten."""

_FEWEST = 4
"""Fewest different readings whose digits count: a shaft that stops at 100.0000 shows no digits, and
one reading in ten ends in a zero by chance (chosen)."""

_LEAST_ARCSEC = 0.1
"""Smallest step in arcsec that is worth a note; no encoder is more accurate (chosen)."""


def step_of(values: Real[np.ndarray, " n"]) -> float:
    """Return the step s for which all values differ by multiples of s, or 0 without such a step.

    Integers have the step 1. Candidates for floats are the greatest common divisor of the
    differences and 1 … 1e-9.
    """
    if np.issubdtype(values.dtype, np.integer):
        return 1.0
    for step in (common_step(values), *(10.0**-k for k in range(10))):
        if are_multiples(values, step):
            return step
    return 0.0


def are_multiples(values: Real[np.ndarray, " n"], step: float) -> bool:
    """Return whether all values differ by multiples of `step`.

    A step that is not larger than the rounding errors of the values gives False.
    """
    if step <= _ROUNDING * _largest(values):
        return False
    for part in pieces(len(values)):
        multiples = (values[part] - values[0]) / step
        if not np.abs(multiples - np.rint(multiples)).max() < _STEP_TOLERANCE:
            return False
    return True


def _largest(values: Real[np.ndarray, " n"]) -> float:
    return max(float(values.max()), -float(values.min()))


def common_step(values: Real[np.ndarray, " n"]) -> float:
    """Return the greatest common divisor of the differences of readings, or 0 if there is none.

    Readings that differ only by rounding count as one reading. A shaft of exactly constant speed
    moves by equal steps, which say nothing about its encoder.
    """
    rounding = _ROUNDING * _largest(values)
    change = np.diff(values, 2)
    if not len(change) or np.mean(np.abs(change, out=change) > rounding) < _LEAST_CHANGES:
        return 0.0
    del change
    ordered = np.unique(values)
    gaps = np.unique(np.diff(ordered))
    gaps = gaps[gaps > rounding]
    if len(gaps) == 0:
        return 0.0
    few = values[:: -(-len(values) // _SAMPLE)].astype(np.float64)
    largest = few[np.abs(few) >= 0.1 * np.abs(few).max()]
    step, stored = gaps[0], max(_last_place(largest), _binary_step(few), rounding)
    for _ in range(_MOST_DIVISIONS):
        steps = np.rint(gaps / step)
        left = np.abs(gaps - step * steps)
        # Places that a motor goes to are alike within more than what rounding moves a reading by.
        left = left[left > np.minimum(_STEP_TOLERANCE * step, stored * (1 + steps))]
        if len(left) == 0:
            return float(np.ptp(values) / np.rint(np.diff(ordered) / step).sum())
        step = left.min()
    return 0.0


def digits_note(role: str, values: Real[np.ndarray, " n"], radians: float) -> list[str]:
    """Return a note if the stored digits are too coarse for small angles, else an empty list.

    Floating-point numbers of 32 bits have 24 binary digits, and a program that prints six digits
    writes 5345.67. Both are coarse where the angle is large.

    **Arguments**
    - `role`: "driving" or "driven". `values`: readings.
    - `radians`: angle of one unit of the readings, rad.
    """
    if np.issubdtype(values.dtype, np.integer):
        return []
    values = values[:: -(-len(values) // _SAMPLE)].astype(np.float64)
    top = float(np.abs(values).max())
    step = _binary_step(values)
    found = step if step and step_of(values) < step else 0.0, _step_of_digits(values)
    step, reason = max(zip(found, ("numbers of 32 bits", "the printed digits"), strict=True))
    seen = step * radians / ARCSEC
    if seen < _LEAST_ARCSEC:
        return []
    return [
        f"{role}: this log cannot show less than {seen:.3g}″, the step of {reason} at"
        f" {top * radians / DEG:.5g}°; log from a zero nearby, or with more digits"
    ]


def _binary_step(values: Float[np.ndarray, " n"]) -> float:
    """Return the step of the largest of values that are numbers of 32 bits, else 0."""
    short = values.astype(np.float32)
    return float(np.spacing(np.abs(short).max())) if np.array_equal(short, values) else 0.0


def _step_of_digits(values: Float[np.ndarray, " n"]) -> float:
    """Return the step of the values with the most digits before the point, or 0.

    It is 0 unless the smaller values have a much finer step, so that printed digits are the cause.
    """
    size = np.abs(values)
    if size.max() == 0:
        return 0.0
    large = size >= 10.0 ** np.floor(np.log10(size.max()))
    if min(len(np.unique(values[large])), np.count_nonzero(~large)) < _FEWEST:
        return 0.0
    step, finer = _last_place(values[large]), _last_place(values[~large])
    return step if finer > 0 and step > _COARSER * finer else 0.0


def _last_place(values: Float[np.ndarray, " n"]) -> float:
    """Return the largest of 1, 0.1 … 1e-9 of which all values are multiples, or 0.

    The differences of the values would not do: a counter that moves by equal steps has larger ones.
    """
    rounding = _ROUNDING * np.abs(values).max()
    places = (k for k in range(10) if np.abs(np.round(values, k) - values).max() <= rounding)
    found = 10.0 ** -next(places, 10)
    return found if found > max(rounding, 1e-10) else 0.0

"""Unwrapping of one channel, with detection of spikes and rejection of lasting steps."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Real

from ...base.errors import LogError
from ...base.units import DEG
from ..source import Source
from .spikes import spikes, without_spikes
from .stalls import repeats, stalls
from .standstill import is_at_standstill
from .unwrap import find_modulus, stray_jump, unwrap, wrap_steps

GAP = 5.001
"""Sampling intervals longer than this many median intervals are gaps in time (chosen)."""

_FROZEN = 30
"""A channel with at least this many equal readings before a jump was frozen (chosen)."""


@dataclass(frozen=True)
class Origin:
    """Description of a channel for unwrapping: role, unit, source in the log, modulus and scale.

    **Arguments**
    - `role`: "driving" or "driven". `unit`: unit of the readings.
    - `modulus`: modulus in the pair file, or None. `per_turn`: units per revolution.
    - `radians`: angle of one unit of the readings in rad, including the scale.
    """

    role: str
    unit: str
    source: Source
    modulus: int | None
    per_turn: int | float | None
    radians: float


@dataclass(frozen=True, eq=False)
class Continuous:
    """Unwrapped `readings` with their `spikes` (true at a spike), modulus and number of wraps."""

    readings: Real[np.ndarray, " n"]
    spikes: Bool[np.ndarray, " n"]
    modulus: int | float | None
    wraps: int
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Attempt:
    """Result of unwrapping with one candidate of the modulus, and its `cost`.

    The cost is the total travel without spikes plus one fast step (95 % quantile of the steps) for
    each spike. Spikes can hide or imitate a modulus, and a counter that dithers at its wrap looks
    like spikes. Therefore the candidate with the lowest cost is chosen.
    """

    modulus: int | float | None
    readings: Real[np.ndarray, " n"]
    spikes: Bool[np.ndarray, " n"]
    wraps: int
    cost: float


def make_continuous(
    values: Real[np.ndarray, " n"], time: Real[np.ndarray, " n"], origin: Origin
) -> Continuous:
    """Unwrap the readings with the modulus of the pair file or with a detected one.

    **Raises** `LogError` for readings beyond the modulus, steps that are not wraps, and pauses that
    hide wraps. Spikes keep their values and are reported in a note.
    """
    quantum = 1.0 if origin.unit == "counts" else 0.0
    if is_at_standstill(values, time, clock="time" in origin.source.columns):
        # There is no motion that a reading could contradict, and a step tells no wrap.
        return Continuous(values, np.zeros(len(values), bool), None, 0, ())
    raw_spikes = spikes(values, time, quantum)
    steady = _filled(values, raw_spikes)
    given = origin.modulus
    if given is not None and np.ptp(steady) >= given:
        raise LogError(
            f"readings span {np.ptp(steady)} counts, more than the modulus {given} of the pair"
            " file; correct or remove `modulus`.",
            where=origin.source.at(origin.role),
        )
    candidates = [given] if given is not None else _moduli(values, steady, origin.per_turn)
    attempts = [
        _unwrapped(
            values, base=base, time=time, modulus=modulus, quantum=quantum, raw_spikes=raw_spikes
        )
        for modulus in candidates
        for base in ([steady] if steady is values else [steady, values])
    ]
    best = min(attempts, key=lambda attempt: attempt.cost)
    readings, outliers, wraps = best.readings, best.spikes, best.wraps
    modulus = best.modulus if wraps else None
    repetition = repeats(readings, quantum)
    stalled = stalls(readings, time, quantum, 2 * repetition)
    if stalled.any():
        outliers = stalled | spikes(without_spikes(readings, time, stalled), time, quantum)
    smooth = without_spikes(readings, time, outliers)
    _refuse_step(smooth, time, quantum, best.modulus, origin)
    notes = []
    if repetition > 1:
        delay = 0.5 * (repetition - 1)
        notes.append(
            f"{origin.role}: while it moves every reading stands {repetition} times: the channel is"
            f" sampled at 1/{repetition} of the rate, which delays it by {delay:g} samples"
            f" ({1e3 * delay * np.median(np.diff(time)):.3g} ms) on average; log both channels at"
            " one rate, or expect that much in `delay_s`"
        )
    if modulus is not None:
        _refuse_blind_pause(smooth, time, modulus, origin)
        how = "as given" if given is not None else "detected from the jumps"
        notes.append(
            f"{origin.role}: wraps at {modulus:g} {origin.unit} ({how}), unwrapped {wraps} times"
        )
    left = "interpolates" if origin.role == "driving" else "leaves out"
    if stalled.any():
        ends = np.flatnonzero(np.diff(stalled, prepend=False, append=False)).reshape(-1, 2)
        first, last = ends[np.argmax(np.diff(time[ends - 1])[:, 0])] - 1
        count = f"{len(ends)} times, the longest" if len(ends) > 1 else "once,"
        notes.append(
            f"{origin.role}: while it moves it stands still {count} from {time[first]:.6g} s to"
            f" {time[last]:.6g} s, and then jumps to where it would be: the channel froze or the"
            f" logger stalled; a fit {left} {np.count_nonzero(stalled)} readings"
        )
    others = outliers & ~stalled
    if others.any():
        number, off = int(np.count_nonzero(others)), np.abs(readings - smooth)[others].max()
        verb = "differs" if number == 1 else "differ"
        notes.append(
            f"{origin.role}: {number} of {len(values)} readings ({number / len(values):.2g}) {verb}"
            f" from their neighbours by up to {off * abs(origin.radians) / DEG:.3g}°, as late or"
            f" disturbed readings do; a fit {left} them"
        )
    return Continuous(readings, outliers, modulus, wraps, tuple(notes))


def _filled(values: Real[np.ndarray, " n"], mask: Bool[np.ndarray, " n"]) -> Real[np.ndarray, " n"]:
    """Return `values` with each masked value replaced by the last unmasked value before it."""
    if not mask.any():
        return values
    last = np.maximum.accumulate(np.where(mask, -1, np.arange(len(values))))
    return values[np.where(last < 0, int(np.argmin(mask)), last)]


def _moduli(
    values: Real[np.ndarray, " n"], steady: Real[np.ndarray, " n"], per_turn: int | float | None
) -> list[int | float | None]:
    """Return one or two candidates of the modulus.

    The first is found in `steady` (readings without spikes), the second in `values` if it differs.
    """
    modulus = find_modulus(steady, per_turn)
    with_spikes = modulus if steady is values else find_modulus(values, per_turn)
    return [modulus] if modulus == with_spikes else [modulus, with_spikes]


def _unwrapped(
    values: Real[np.ndarray, " n"],
    base: Real[np.ndarray, " n"],
    time: Real[np.ndarray, " n"],
    modulus: int | float | None,
    quantum: float,
    raw_spikes: Bool[np.ndarray, " n"],
) -> _Attempt:
    """Unwrap `values` at the rows where `base` wraps, and return the result with its cost.

    `base` is either `values` itself or `values` with filled spikes (`raw_spikes`). In the second
    case each spike of `values` is placed within half a modulus of `base`, so that it does not shift
    the later readings. `quantum` is the step of the readings, 0 if they have none.
    """
    wraps = 0 if modulus is None else int(np.count_nonzero(wrap_steps(base, modulus)))
    if modulus is None or not wraps:
        readings, outliers = values, raw_spikes
    else:
        offset = values - base
        if np.issubdtype(values.dtype, np.integer):
            whole = int(modulus)
            readings = unwrap(base, modulus) + (offset + whole // 2) % whole - whole // 2
        else:
            readings = unwrap(base, modulus) + offset - modulus * np.rint(offset / modulus)
        outliers = spikes(readings, time, quantum)
    cost = 0.0
    if base is not values or raw_spikes.any():
        travel = np.abs(np.diff(without_spikes(readings, time, outliers)).astype(np.float64))
        cost = float(travel.sum() + (quantum + np.quantile(travel, 0.95)) * outliers.sum())
    return _Attempt(modulus, readings, outliers, wraps, cost)


def _refuse_step(
    smooth: Real[np.ndarray, " n"],
    time: Real[np.ndarray, " n"],
    quantum: float,
    modulus: int | float | None,
    origin: Origin,
) -> None:
    """Raise `LogError` for a jump after which the readings do not return.

    The causes are a counter reset, an index reload, a frozen channel or an unknown modulus.
    """
    row = stray_jump(smooth, time, quantum)
    if row is None:
        return
    frozen = int(np.argmax(smooth[row - 1 :: -1] != smooth[row - 1]))
    if frozen >= _FROZEN:
        raise LogError(
            f"the {origin.role} channel stands still for {frozen} samples from"
            f" {time[row - frozen]:.9g} s to {time[row - 1]:.9g} s and then jumps, so it froze;"
            " cut these lines out and fit both parts as two logs.",
            where=origin.source.at(origin.role, row - frozen),
        )
    raise LogError(
        f"a jump of {(smooth[row] - smooth[row - 1]).item():g} {origin.unit} from one sample to"
        f" the next at {time[row]:.9g} s stays, and it is neither motion nor a wrap"
        + (f" of {modulus:g}" if modulus is not None else "")
        + "; cut the log there"
        + (f", or give `modulus` in [{origin.role}] encoder." if quantum else "."),
        where=origin.source.at(origin.role, row),
    )


def _refuse_blind_pause(
    smooth: Real[np.ndarray, " n"],
    time: Real[np.ndarray, " n"],
    modulus: int | float,
    origin: Origin,
) -> None:
    """Raise `LogError` if the shaft may turn by over 0.4 of the modulus in a pause of the log."""
    interval = np.diff(time)
    step = np.abs(np.diff(smooth)).astype(np.float64)
    for k in np.flatnonzero(interval > GAP * np.median(interval)):
        neighbours = slice(max(0, k - 5), k), slice(k + 1, k + 6)
        before, after = (step[s].sum() / max(interval[s].sum(), 1e-300) for s in neighbours)
        if max(before, after) * interval[k] > 0.4 * modulus:
            raise LogError(
                f"the log pauses for {interval[k]:.4g} s while the {origin.role} channel wraps at"
                f" {modulus:g} {origin.unit}, so whole turns are lost; cut the log there.",
                where=origin.source.at(origin.role, int(k) + 1),
            )

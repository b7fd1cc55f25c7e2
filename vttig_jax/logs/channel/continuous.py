"""Readings of one channel made continuous: wraps undone, spikes found, steps refused."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Real

from ...base.errors import LogError
from ...base.units import DEG
from ..source import Source
from .spikes import spikes, without_spikes
from .stalls import repeats, stalls
from .unwrap import find_modulus, stray_jump, unwrap, wrap_steps

GAP = 5.001
"""Sampling intervals longer than this many median ones are gaps."""


_FROZEN = 30
"""Equal readings before a jump that say that the channel froze."""


@dataclass(frozen=True)
class Origin:
    """Where readings come from, and what they stand for.

    **Arguments**
    - `role`: "driving" or "driven". `unit`: of the readings.
    - `modulus`: of the pair file, None where it gives none. `per_turn`: readings per revolution.
    - `radians`: angle of one unit of the readings in rad, scale included.
    """

    role: str
    unit: str
    source: Source
    modulus: int | None
    per_turn: int | float
    radians: float


@dataclass(frozen=True, eq=False)
class Continuous:
    """Unwrapped `readings`, which of them are `spikes`, and where and how often they wrapped."""

    readings: Real[np.ndarray, " n"]
    spikes: Bool[np.ndarray, " n"]
    modulus: int | float | None
    wraps: int
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Attempt:
    """One way to unwrap; `cost` is the travel left, each spike counted as a fast step.

    Spikes hide a modulus or feign one, and a counter that dithers at its wrap feigns spikes: what
    is cheapest is right.
    """

    modulus: int | float | None
    readings: Real[np.ndarray, " n"]
    spikes: Bool[np.ndarray, " n"]
    wraps: int
    cost: float


def make_continuous(
    values: Real[np.ndarray, " n"], time: Real[np.ndarray, " n"], origin: Origin
) -> Continuous:
    """Unwrap with the modulus given or found.

    **Raises** `LogError` for readings beyond the modulus, steps that are no wrap, and pauses that
    hide wraps. Spikes are kept as they are, and noted.
    """
    quantum = 1.0 if origin.unit == "counts" else 0.0
    raw_spikes = spikes(values, time, quantum)
    steady = _held(values, raw_spikes)
    given = origin.modulus
    if given is not None and np.ptp(steady) >= given:
        raise LogError(
            f"readings span {np.ptp(steady)} counts, more than the modulus {given} of the pair"
            " file; correct or remove `modulus`.",
            where=origin.source.at(origin.role),
        )
    candidates = [given] if given is not None else _moduli(values, steady, origin.per_turn)
    tried = [
        _unwrapped(values, base, time, modulus, quantum, raw_spikes)
        for modulus in candidates
        for base in ([steady] if steady is values else [steady, values])
    ]
    best = min(tried, key=lambda one: one.cost) if len(tried) > 1 else tried[0]
    readings, found, wraps = best.readings, best.spikes, best.wraps
    modulus = best.modulus if wraps else None
    times = repeats(readings, quantum)
    held = stalls(readings, time, quantum, 2 * times)
    if held.any():
        found = held | spikes(without_spikes(readings, time, held), time, quantum)
    smooth = without_spikes(readings, time, found)
    _refuse_step(smooth, time, quantum, best.modulus, origin)
    notes = []
    if times > 1:
        late = 0.5 * (times - 1)
        notes.append(
            f"{origin.role}: while it moves every reading stands {times} times: the channel is"
            f" sampled at 1/{times} of the rate, which delays it by {late:g} samples"
            f" ({1e3 * late * np.median(np.diff(time)):.3g} ms) on average; log both channels at"
            " one rate, or expect that much in `delay_s`"
        )
    if modulus is not None:
        _refuse_blind_pause(smooth, time, modulus, origin)
        how = "as given" if given is not None else "detected from the jumps"
        notes.append(
            f"{origin.role}: wraps at {modulus:g} {origin.unit} ({how}), unwrapped {wraps} times"
        )
    if found.any():
        number, off = int(np.count_nonzero(found)), np.abs(readings - smooth).max()
        verb = "stands" if number == 1 else "stand"
        notes.append(
            f"{origin.role}: {number} of {len(values)} readings ({number / len(values):.2g}) {verb}"
            f" off their neighbours by up to {off * abs(origin.radians) / DEG:.3g}°, as late or"
            " disturbed readings do; "
            + (
                "a fit bridges them"
                if origin.role == "driving"
                else "a robust loss leaves them out"
            )
        )
    return Continuous(readings, found, modulus, wraps, tuple(notes))


def _held(values: Real[np.ndarray, " n"], found: Bool[np.ndarray, " n"]) -> Real[np.ndarray, " n"]:
    """`values` with each spike replaced by the last good reading before it."""
    if not found.any():
        return values
    last = np.maximum.accumulate(np.where(found, -1, np.arange(len(values))))
    return values[np.where(last < 0, int(np.argmin(found)), last)]


def _moduli(
    values: Real[np.ndarray, " n"], steady: Real[np.ndarray, " n"], per_turn: int | float
) -> list[int | float | None]:
    """Moduli to try, that of the readings without spikes first."""
    found = find_modulus(steady, per_turn)
    also = found if steady is values else find_modulus(values, per_turn)
    return [found] if found == also else [found, also]


def _unwrapped(
    values: Real[np.ndarray, " n"],
    base: Real[np.ndarray, " n"],
    time: Real[np.ndarray, " n"],
    modulus: int | float | None,
    quantum: float,
    raw_spikes: Bool[np.ndarray, " n"],
) -> _Attempt:
    """Unwrap `values` by the wraps of `base`.

    Where `base` is without spikes each of them is put as near to it as wraps allow, so that none
    shifts what follows.
    """
    wraps = 0 if modulus is None else int(np.count_nonzero(wrap_steps(base, modulus)))
    if modulus is None or not wraps:
        readings, found = values, raw_spikes
    else:
        apart = values - base
        if np.issubdtype(values.dtype, np.integer):
            whole = int(modulus)
            readings = unwrap(base, modulus) + (apart + whole // 2) % whole - whole // 2
        else:
            readings = unwrap(base, modulus) + apart - modulus * np.rint(apart / modulus)
        found = spikes(readings, time, quantum)
    cost = 0.0
    if base is not values or raw_spikes.any():
        travel = np.abs(np.diff(without_spikes(readings, time, found)).astype(np.float64))
        cost = float(travel.sum() + (quantum + np.quantile(travel, 0.95)) * found.sum())
    return _Attempt(modulus, readings, found, wraps, cost)


def _refuse_step(
    smooth: Real[np.ndarray, " n"],
    time: Real[np.ndarray, " n"],
    quantum: float,
    modulus: int | float | None,
    origin: Origin,
) -> None:
    """Readings that jump and stay off: a reset, an index reload, a wrap at an unknown modulus."""
    row = stray_jump(smooth, time, quantum)
    if row is None:
        return
    stood = int(np.argmax(smooth[row - 1 :: -1] != smooth[row - 1]))
    if stood >= _FROZEN:
        raise LogError(
            f"the {origin.role} channel stands still for {stood} samples from"
            f" {time[row - stood]:.9g} s to {time[row - 1]:.9g} s and then jumps: it froze; cut"
            " these lines out and fit both parts as two logs.",
            where=origin.source.at(origin.role, row - stood),
        )
    raise LogError(
        f"a jump of {(smooth[row] - smooth[row - 1]).item():g} {origin.unit} from one sample to"
        f" the next at {time[row]:.9g} s stays and is neither motion nor a wrap"
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
    """A counter that may have turned by half its modulus during a pause has lost its turns."""
    interval = np.diff(time)
    step = np.abs(np.diff(smooth)).astype(np.float64)
    for k in np.flatnonzero(interval > GAP * np.median(interval)):
        beside = slice(max(0, k - 5), k), slice(k + 1, k + 6)
        before, after = (step[s].sum() / max(interval[s].sum(), 1e-300) for s in beside)
        if max(before, after) * interval[k] > 0.4 * modulus:
            raise LogError(
                f"the log pauses for {interval[k]:.4g} s while the {origin.role} channel wraps at"
                f" {modulus:g} {origin.unit}, so whole turns are lost; cut the log there.",
                where=origin.source.at(origin.role, int(k) + 1),
            )

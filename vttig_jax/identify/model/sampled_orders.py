"""Orders that look alike at the sampled angles.

If the samples are locked to the rotation, for example ten in every turn at the same places, then
orders 2 and 8 have the same values at all samples up to a sign, and no fit can tell them apart.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...base.units import REV
from ...logs.encoder_log import EncoderLog
from ...logs.motion.segments import Segment
from .harmonics import Harmonic, TermPlan, names_of

_ALIKE = 0.995
"""Two orders look alike above this correlation of their columns; their variances are then more than
a hundred times as large as those of a single order (chosen)."""

_MOST_SAMPLES = 4096  # samples compared, drawn at random from a longer log (chosen)


def told_apart(
    plan: TermPlan, logs: Sequence[EncoderLog], segments: Sequence[Sequence[Segment]]
) -> TermPlan:
    """Return the plan without the free orders that look like another one at the sampled angles.

    Two frequencies f and g look alike on a flank if |mean exp(2πj (f ± g) φ)| is nearly 1 over the
    sampled angles φ, in driving turns. The other frequency may be that of a constant, 0, or f
    itself, which then shows one phase only. Of two orders that look alike the higher one is left
    out. `segments` are the segments of each log in which a flank is in contact.
    """
    rate = min(_samples_per_turn(logs, segments), default=np.inf)
    highest = max((float(plan.frequency(term)) for term in plan.terms), default=0.0)
    if rate > 2 * highest:
        return plan  # f ± g is a multiple of the samples in a turn for no two orders
    flanks = [
        np.concatenate(found) for flank in ("A", "B") if (found := _turns_of(logs, segments, flank))
    ]
    ranked = [*plan.tied, *sorted(plan.free, key=lambda h: float(plan.frequency(h.term)))]
    alike = _alike([float(plan.frequency(h.term)) for h in ranked], flanks)
    kept: list[int] = []
    same: list[tuple[Harmonic, Harmonic]] = []
    single: list[Harmonic] = []
    for place, harmonic in enumerate(ranked):
        others = [other for other in kept if alike[place, other]]
        if place < len(plan.tied) or not (others or alike[place, place] or alike[place, -1]):
            kept.append(place)
        elif others:
            same.append((harmonic, ranked[others[0]]))
        else:
            single.append(harmonic)
    left_out = {harmonic for harmonic, _ in same} | set(single)
    free = tuple(harmonic for harmonic in plan.free if harmonic not in left_out)
    told = (*_same_sentence(same, rate), *_single_sentence(single, rate))
    return replace(plan, free=free, dropped=(*plan.dropped, *told))


def _turns_of(
    logs: Sequence[EncoderLog], segments: Sequence[Sequence[Segment]], flank: str
) -> list[Float[np.ndarray, " _"]]:
    """Return the driving angles of all samples on a flank, turns, one array for each segment."""
    return [
        log.driving_angle[one.start : one.stop] / REV
        for log, own in zip(logs, segments, strict=True)
        for one in own
        if one.flank == flank
    ]


def _samples_per_turn(
    logs: Sequence[EncoderLog], segments: Sequence[Sequence[Segment]]
) -> list[float]:
    """Return the samples in a driving turn of every segment."""
    return [
        (one.stop - one.start - 1) * REV / max(abs(float(ends[1] - ends[0])), 1e-300)
        for log, own in zip(logs, segments, strict=True)
        for one in own
        for ends in (log.driving_angle[[one.start, one.stop - 1]],)
    ]


def _alike(frequencies: Sequence[float], flanks: Sequence[Float[np.ndarray, " _"]]) -> np.ndarray:
    """Return which frequencies look alike on any flank; the last column is that of a constant.

    The diagonal tells whether a frequency shows one phase only.
    """
    count = len(frequencies)
    found = np.zeros((count, count + 1), bool)
    for turns in flanks:
        if len(turns) > _MOST_SAMPLES:
            turns = np.random.default_rng(0).choice(turns, _MOST_SAMPLES, replace=False)
        waves = np.exp(1j * REV * np.multiply.outer([*frequencies, 0.0], turns))
        difference = np.abs(waves[:-1] @ waves.conj().T) / len(turns)
        total = np.abs(waves[:-1] @ waves.T) / len(turns)
        np.fill_diagonal(difference, 0.0)
        found |= np.maximum(difference, total) > _ALIKE
    return found


def _same_sentence(same: Sequence[tuple[Harmonic, Harmonic]], rate: float) -> tuple[str, ...]:
    if not same:
        return ()
    left, kept = (list(dict.fromkeys(part)) for part in zip(*same, strict=True))
    looks = "look" if len(left) > 1 else "looks"
    return (
        f"{names_of(left)} {looks} like {names_of(kept)} at the sampled angles, about {rate:.3g} in"
        f" a turn: the amplitudes stated for {names_of(kept)} are those of both together; sample"
        " more often, or at a rate that is not locked to the rotation",
    )


def _single_sentence(single: Sequence[Harmonic], rate: float) -> tuple[str, ...]:
    if not single:
        return ()
    several = len(single) > 1
    are, they = ("are", "they look") if several else ("is", "it looks")
    return (
        f"{names_of(single)} {are} left out: at the sampled angles, about {rate:.3g} in a turn,"
        f" {they} like a constant or {'show' if several else 'shows'} one phase only; sample more"
        " often, or at a rate that is not locked to the rotation",
    )

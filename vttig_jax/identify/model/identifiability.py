"""Identifiability: flanks and shafts that the logs cover, and reasons for parameters left out."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...base.errors import NoAnswerError
from ...base.units import REV
from ...logs.encoder_log import EncoderLog
from ...logs.motion.segments import Segment
from ...pair.gear_pair import Drive, Flank, GearPair
from ...pair.schema import HarmonicOrders
from .harmonics import TermPlan, plan_terms
from .sampled_orders import told_apart

_FLANKS: tuple[Flank, ...] = ("A", "B")
FULL_TURN = 0.99
"""Least turns that count as a full turn: a table of one turn lacks its last sample, and a log may
lack about a degree."""

FEW_TURNS = 6.0
"""Turns of the driving shaft below which noise may be correlated over the whole log (chosen)."""

SINGLE_TURN = 1.5
"""Turns of the driving shaft below which a log is a table of one turn (chosen). Noise with a long
correlation time cannot be distinguished from the orders of such a table."""

_LIKE_DRIFT = 0.25
"""Below this many turns of a shaft its first order is a parabola, to 2 % of its amplitude."""


@dataclass(frozen=True)
class Identifiability:
    """Flanks, segments and harmonics of a fit.

    **Arguments**
    - `flanks`, `segments`: flanks that the fit uses, and segments of each log.
    - `terms`: harmonics of the fit.
    - `reasons`: shaft → reason why its first order is not reported.
    - `short`: shafts of `reasons` that turned too little.
    - `turns`: shaft → turns in the log that covers most; of both flanks the smaller value.
    - `few_turns`: whether the turns are too few to separate noise, drift and orders clearly.
    - `notes`: sentences on flanks that are left out; the sentences on orders are in `terms`.
    """

    flanks: tuple[Flank, ...]
    segments: tuple[tuple[Segment, ...], ...]
    terms: TermPlan
    reasons: dict[str, str]
    short: tuple[str, ...]
    turns: dict[str, float]
    few_turns: bool = False
    notes: tuple[str, ...] = field(default=())

    @property
    def gap_of_delay(self) -> float:
        """Gap, rad, that resembles a delay of 1 s; 0 for one flank.

        It is |i| times the sum of the mean |ω₁| of both flanks.
        """
        if len(self.flanks) < 2:
            return 0.0
        used = [s for own in self.segments for s in own]
        means = []
        for flank in self.flanks:
            own = [s for s in used if s.flank == flank]
            length = [s.stop - s.start for s in own]
            means.append(np.average([abs(s.speed) for s in own], weights=length))
        return abs(float(self.terms.ratio)) * float(sum(means))


def find_identifiability(
    logs: Sequence[EncoderLog],
    segments: Sequence[tuple[Segment, ...]],
    pair: GearPair | Drive,
    options: HarmonicOrders,
    only: Flank | None,
    *,
    remembers: bool = False,
    given: bool = False,
    arcs: bool = False,
    unclear: str = "",
) -> Identifiability:
    """Return the flanks, segments and harmonics that can be fitted.

    `only` restricts the fit to one flank. With a `given` flank model, which replaces the first
    orders, all harmonics are free, and the rank of the rows decides what the logs determine.

    The result has `few_turns` for a drive with fewer than `FEW_TURNS` turns. For a gear pair, whose
    ratio is exact, this also requires `remembers`: noise correlated over a good part of the log.

    With `arcs`, two flanks of less than a revolution are fitted too, also if one of them covers
    slightly more than a revolution: they determine the gap over the covered angles. `unclear` says
    why the flank of many samples is unknown, and is empty otherwise.

    **Raises** `NoAnswerError` if no flank covers a revolution of either shaft, except with `arcs`.
    """
    covered: dict[Flank, tuple[float, float]] = {
        flank: _coverage(logs, segments, flank) for flank in _FLANKS if only in (None, flank)
    }
    flanks = _fitted_flanks(covered, arcs=arcs)
    if not flanks:
        raise _no_full_turn(covered, only, logs, unclear)
    turns = {
        shaft: min(covered[flank][k] for flank in flanks)
        for k, shaft in enumerate(("driving", "driven"))
    }
    orders = {"driving": options.driving_orders, "driven": options.driven_orders}
    reasons = {
        shaft: f"order 1 is not among {shaft}_orders of [fit]"
        for shaft, wanted in orders.items()
        if 1 not in wanted and not given
    }
    short = {} if given else _short(pair, turns, both=not reasons)
    reasons |= short
    for shaft, wanted in orders.items():
        if shaft in short:
            orders[shaft] = _nuisance(turns[shaft], wanted) if len(short) == 1 else ()
    few_turns = turns["driving"] < FEW_TURNS and (remembers or isinstance(pair, Drive))
    terms = plan_terms(
        pair.ratio,
        driving_orders=orders["driving"],
        driven_orders=orders["driven"],
        mesh_orders=options.mesh_orders,
        driving_teeth=pair.driving.teeth if isinstance(pair, GearPair) else None,
        # The ratio of a drive may be slightly wrong, and its orders then leak into each other.
        turns=turns["driving"] if few_turns or isinstance(pair, Drive) else math.inf,
        all_free=given,
    )
    used = tuple(tuple(s for s in own if s.flank in flanks) for own in segments)
    terms = told_apart(terms, logs, used)
    tied = {h.shaft for h in terms.tied}
    for shaft in () if given else ("driving", "driven"):
        if shaft not in tied and shaft not in reasons:
            reasons[shaft] = "driving order 1 and driven order 1 are the same frequency"
    return Identifiability(
        flanks=flanks,
        segments=used,
        terms=terms,
        reasons=reasons,
        short=tuple(short),
        turns=turns,
        few_turns=few_turns,
        notes=_left_out(covered, flanks),
    )


def _fitted_flanks(covered: dict[Flank, tuple[float, float]], *, arcs: bool) -> tuple[Flank, ...]:
    """Return the flanks on which a shaft makes a full turn, or both if they are `arcs`."""
    flanks: tuple[Flank, ...] = tuple(f for f, turns in covered.items() if max(turns) >= FULL_TURN)
    if arcs and (not flanks or _are_strokes_of_one_turn(covered)):
        return _of_an_arc(covered)
    return flanks


def _are_strokes_of_one_turn(covered: dict[Flank, tuple[float, float]]) -> bool:
    """Return whether strokes to and fro of about a turn are a full turn on one flank only.

    The gap over the angles of both flanks then says more than the orders of one flank.
    """
    turns = [max(own) for own in covered.values()]
    less, more = min(turns), max(turns)
    return len(turns) == len(_FLANKS) and less < FULL_TURN <= more < SINGLE_TURN * less


def _of_an_arc(covered: dict[Flank, tuple[float, float]]) -> tuple[Flank, ...]:
    """Return both flanks if both moved in contact; otherwise none."""
    both = len(covered) == len(_FLANKS) and all(max(turns) > 0 for turns in covered.values())
    return tuple(covered) if both else ()


def _left_out(
    covered: dict[Flank, tuple[float, float]], flanks: tuple[Flank, ...]
) -> tuple[str, ...]:
    """Return sentences on the flanks that moved, but are not fitted."""
    return tuple(
        f"flank {flank} is left out, so that no gap is determined: it covers"
        f" {max(turns):.2f} of a revolution only; record at least one turn both ways"
        for flank, turns in covered.items()
        if flank not in flanks and max(turns) > 0
    )


def _no_full_turn(
    covered: dict[Flank, tuple[float, float]],
    only: Flank | None,
    logs: Sequence[EncoderLog],
    unclear: str,
) -> NoAnswerError:
    most = max((max(turns) for turns in covered.values()), default=0.0)
    which = "" if only is None else f" on flank {only}"
    advice = unclear or (
        "record at least one turn at constant speed, better a whole hunting period (the gap alone"
        " needs only an arc that both directions cover), or correct the unit or counts_per_rev"
    )
    return NoAnswerError(
        f"no shaft turned a full revolution in steady contact{which} ({most:.2f} at most);"
        f" {advice}.",
        where=", ".join(log.source for log in logs),
    )


def _coverage(
    logs: Sequence[EncoderLog], segments: Sequence[tuple[Segment, ...]], flank: Flank
) -> tuple[float, float]:
    """Return the turns of the driving and the driven shaft on a flank, the largest of all logs."""
    most = (0.0, 0.0)
    for log, every in zip(logs, segments, strict=True):
        ends = np.array([k for s in every if s.flank == flank for k in (s.start, s.stop - 1)])
        if len(ends):
            angles = (log.driving_angle[ends], log.driven_angle[ends])
            turns = [float(np.ptp(angle)) / REV for angle in angles]
            most = (max(most[0], turns[0]), max(most[1], turns[1]))
    return most


def _short(pair: GearPair | Drive, turns: dict[str, float], *, both: bool) -> dict[str, str]:
    """Return shaft → reason for each shaft that turned too little for its first order.

    If `both` first orders are fitted, a log shorter than one beat of them, 1/|1 − i| driving turns,
    resolves neither.
    """
    short = {
        shaft: f"the {shaft} shaft turned {seen:.2f} of a revolution"
        for shaft, seen in turns.items()
        if seen < FULL_TURN
    }
    if not both or pair.ratio == 1:
        return short
    needed = 1 / abs(1 - pair.ratio)
    if turns["driving"] >= needed:
        return short
    sentence = (
        f"the driving shaft turned {turns['driving']:.2f} revolutions; below {float(needed):.2f}"
        " neither shaft's first order is resolved"
    )
    return {"driving": sentence, "driven": sentence}


def _nuisance(turns: float, orders: tuple[int | float, ...]) -> tuple[int | float, ...]:
    """Return the orders that are fitted for a shaft that turned less than once: (1,) or none.

    The first order is a nuisance parameter: it is fitted but not reported, because without it the
    first order of the other shaft would be biased. Below a quarter turn it cannot be distinguished
    from drift and is left out.
    """
    return (1,) if 1 in orders and turns >= _LIKE_DRIFT else ()

"""What a log can fix: which flanks and which shafts it covers, and why the rest is left out."""

from dataclasses import dataclass, field

import numpy as np

from ..base.errors import NoAnswerError
from ..base.units import REV
from ..logs.encoder_log import EncoderLog
from ..logs.segments import Segment
from ..pair.gears import Drive, Flank, GearPair
from ..pair.spec import FitOptions
from .terms import TermPlan, plan_terms


@dataclass(frozen=True)
class Scope:
    """Flanks, segments and harmonics of a fit.

    **Arguments**
    - `flanks`, `segments`: what is used.
    - `terms`: the harmonics.
    - `reasons`: shaft → why its first order is not fitted.
    - `turns`: shaft → turns covered on the flank that covers least.
    - `notes`: sentences for the reader.
    """

    flanks: tuple[Flank, ...]
    segments: tuple[Segment, ...]
    terms: TermPlan
    reasons: dict[str, str]
    turns: dict[str, float]
    notes: tuple[str, ...] = field(default=())


def find_scope(
    log: EncoderLog,
    segments: tuple[Segment, ...],
    pair: GearPair | Drive,
    options: FitOptions,
    only: Flank | None,
) -> Scope:
    """Decide what can be fitted; `only` restricts it to one flank.

    **Raises** `NoAnswerError` where no flank covers a revolution of either shaft.
    """
    notes = []
    covered = {
        flank: _coverage(log, [s for s in segments if s.flank == flank])
        for flank in ("A", "B")
        if only in (None, flank)
    }
    flanks = tuple(flank for flank, turns in covered.items() if max(turns) >= 1.0)
    if not flanks:
        most = max((max(turns) for turns in covered.values()), default=0.0)
        which = "" if only is None else f" on flank {only}"
        raise NoAnswerError(
            f"no shaft turned a full revolution in steady contact{which} ({most:.2f} at most);"
            " record at least one turn at constant speed, better a whole hunting period.",
            where=log.source,
        )
    for flank, turns in covered.items():
        if flank not in flanks and max(turns) > 0:
            notes.append(
                f"flank {flank} is left out: it covers {max(turns):.2f} of a revolution only."
            )
    turns = {
        shaft: min(covered[flank][k] for flank in flanks)
        for k, shaft in enumerate(("driving", "driven"))
    }
    orders = {"driving": options.driving_orders, "driven": options.driven_orders}
    reasons = {}
    for shaft, seen in turns.items():
        if seen < 1.0:
            reasons[shaft] = f"the {shaft} shaft turned {seen:.2f} of a revolution"
            orders[shaft] = ()
        elif 1 not in orders[shaft]:
            reasons[shaft] = f"order 1 is not among {shaft}_orders of [fit]"
    reasons |= _unresolved(pair, turns, reasons)
    teeth = pair.driving.teeth if isinstance(pair, GearPair) else None
    fitted = {s: () if "neither" in reasons.get(s, "") else orders[s] for s in orders}
    terms = plan_terms(pair.ratio, fitted["driving"], fitted["driven"], options.mesh_orders, teeth)
    tied = {h.shaft for h in terms.tied}
    for shaft in ("driving", "driven"):
        if shaft not in tied and shaft not in reasons:
            reasons[shaft] = "driving order 1 and driven order 1 are the same frequency"
    used = tuple(s for s in segments if s.flank in flanks)
    return Scope(flanks, used, terms, reasons, turns, (*notes, *terms.dropped))


def _coverage(log: EncoderLog, segments: list[Segment]) -> tuple[float, float]:
    """Turns of the driving and the driven shaft between the outermost angles of the segments."""
    if not segments:
        return 0.0, 0.0
    ends = np.array([index for s in segments for index in (s.start, s.stop - 1)])
    return (
        float(np.ptp(log.driving_angle[ends])) / REV,
        float(np.ptp(log.driven_angle[ends])) / REV,
    )


def _unresolved(
    pair: GearPair | Drive, turns: dict[str, float], reasons: dict[str, str]
) -> dict[str, str]:
    """Both first orders drop out where the log is too short to hold them apart."""
    if reasons or pair.ratio == 1:
        return {}
    needed = float(1 / abs(1 / pair.ratio - 1))
    if turns["driving"] >= needed:
        return {}
    sentence = (
        f"the driving shaft turned {turns['driving']:.2f} revolutions; below {needed:.2f} neither"
        " shaft's first order is resolved"
    )
    return {"driving": sentence, "driven": sentence}

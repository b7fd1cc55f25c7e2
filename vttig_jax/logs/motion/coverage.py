"""Whether a log can support a fit: what turned how far, and in which directions."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...base.units import REV
from ..encoder_log import EncoderLog
from .segments import Segment


@dataclass(frozen=True)
class Support:
    """Turns of each shaft over the samples on a certain flank, and what follows in words."""

    driving_turns: float
    driven_turns: float
    driving_resolved: bool
    driven_resolved: bool
    flanks: tuple[str, ...]
    sentences: tuple[str, ...]


def support_of(log: EncoderLog, segments: Sequence[Segment]) -> Support:
    """Judge the certain segments of a log.

    A shaft is resolved when it turned once. Both orders are told apart only after
    1/|1 − i| driving turns, one beat of the two; with i = 1 they never are.
    """
    driving, driven = (_turns(angle, segments) for angle in (log.driving_angle, log.driven_angle))
    apart = 1 / abs(1 - log.ratio) if log.ratio != 1 else None
    told = apart is not None and driving >= apart
    flanks = tuple(sorted({segment.flank for segment in segments}))
    sentences = []
    if not segments:
        sentences.append("no sample lies on a certain flank, so nothing can be fitted")
    elif apart is None:
        sentences.append(
            "with ratio 1 both shafts share order 1: their eccentricities cannot be told apart"
        )
    elif not told:
        sentences.append(
            f"the driving shaft turns {driving:.3g} times; under {float(apart):.3g} turns neither"
            " shaft's eccentricity can be told from the other's"
        )
    for name, turns in (("driving", driving), ("driven", driven)):
        if segments and turns < 1:
            sentences.append(
                f"the {name} shaft turns only {turns:.3g} times, so its first order cannot be"
                " determined"
            )
    if len(flanks) == 1:
        sentences.append(
            f"one direction only (flank {flanks[0]}): no backlash, and eccentricities only if the"
            " encoders are perfect"
        )
    return Support(
        driving, driven, told and driving >= 1, told and driven >= 1, flanks, tuple(sentences)
    )


def _turns(angle: Float[np.ndarray, " n"], segments: Sequence[Segment]) -> float:
    ends = [angle[k] for s in segments for k in (s.start, s.stop - 1)]
    return float(max(ends) - min(ends)) / REV if ends else 0.0

"""Coverage of a log: turns of each shaft and directions, which decide what a fit can determine."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...base.units import REV
from ..encoder_log import EncoderLog
from .segments import Segment


@dataclass(frozen=True)
class Support:
    """Turns of each shaft over the samples whose flank is certain, and conclusions as sentences.

    `driving_resolved` and `driven_resolved` say whether the first order of the shaft can be
    determined and separated from that of the other shaft. `flanks` holds the flanks that have
    samples, "A" and "B".
    """

    driving_turns: float
    driven_turns: float
    driving_resolved: bool
    driven_resolved: bool
    flanks: tuple[str, ...]
    sentences: tuple[str, ...]


def support_of(log: EncoderLog, segments: Sequence[Segment]) -> Support:
    """Return the turns of both shafts over the segments, and what a fit can determine from them.

    The first order of a shaft needs one turn of this shaft. Both first orders are separable
    only after 1/|1 − i| driving turns (one beat period, i = ratio); with i = 1 they never are.
    """
    driving, driven = (_turns(angle, segments) for angle in (log.driving_angle, log.driven_angle))
    beat = 1 / abs(1 - log.ratio) if log.ratio != 1 else None
    separable = beat is not None and driving >= beat
    flanks = tuple(sorted({segment.flank for segment in segments}))
    sentences = []
    if not segments:
        sentences.append("no sample lies on a certain flank, so nothing can be fitted")
    elif beat is None:
        sentences.append(
            "with ratio 1 both shafts share order 1: their eccentricities cannot be told apart"
        )
    elif not separable:
        sentences.append(
            f"the driving shaft turns {driving:.3g} times; under {float(beat):.3g} turns neither"
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
    resolved = separable and driving >= 1, separable and driven >= 1
    return Support(driving, driven, *resolved, flanks, tuple(sentences))


def _turns(angle: Float[np.ndarray, " n"], segments: Sequence[Segment]) -> float:
    ends = [angle[k] for s in segments for k in (s.start, s.stop - 1)]
    return float(max(ends) - min(ends)) / REV if ends else 0.0

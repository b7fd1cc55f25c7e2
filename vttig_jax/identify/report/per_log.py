"""Delay and gap of each of several logs alone, although all logs of a fit share them."""

import numpy as np

from ...base.units import DEG
from ..compress.harmonic_summary import summarise
from ..noise.noise_model import autoregression
from ..preliminary.delay import TOLD
from ..preliminary.linear_fit import LinearFit
from ..preliminary.nuisance import own_terms

_DIFFERENT = 5.0
"""Standard errors above which a difference between logs is reported; chosen value."""


def fit_log_alone(linear: LinearFit, log: int) -> dict:
    """Return delay (s) and gap (degrees, mean over the covered angles) of one log with their std.

    The gap is estimated with the common delay. A value that the log does not determine is None.
    """
    found: dict[str, float | None] = dict.fromkeys(
        ("delay_s", "delay_std_s", "gap_deg", "gap_std_deg")
    )
    if len(linear.rows) == 1:
        summary, filter_, own = linear.summary, linear.filter, linear.own
    else:
        summary = summarise([linear.rows[log]], linear.model.terms)
        filter_ = autoregression(summary)
        own = own_terms(summary, filter_)
    if "delay" in own.names and own.left("delay") > TOLD:
        step, std = own.estimate("delay", own.names)
        found |= {"delay_s": linear.channels[log].delay_s + step, "delay_std_s": std}
    if len(summary.flanks) == 2:
        known = summary.without(["delay"])
        offsets, variances = [], []
        for flank in known.flanks:
            factor = flank.factor(filter_)
            inverse = np.linalg.inv(factor[:-1, :-1])
            place = known.columns.index("offset")
            rows = max(flank.rows - len(inverse), 1)
            offsets.append(float(inverse[place] @ factor[:-1, -1]))
            variances.append(float(inverse[place] @ inverse[place]) * factor[-1, -1] ** 2 / rows)
        found |= {
            "gap_deg": (offsets[1] - offsets[0]) / DEG,
            "gap_std_deg": float(np.sqrt(sum(variances))) / DEG,
        }
    return found


def differences(alone: list[dict]) -> list[str]:
    """Return sentences on logs whose delay or gap differs significantly from the first log."""
    sentences = []
    first = alone[0]
    for name, unit, std, what in (
        ("delay_s", "s", "delay_std_s", "a delay"),
        ("gap_deg", "°", "gap_std_deg", "a gap between the flanks"),
    ):
        for number, one in enumerate(alone[1:], 2):
            if one[name] is None or first[name] is None:
                continue
            spread = float(np.hypot(one[std], first[std]))
            if abs(one[name] - first[name]) > _DIFFERENT * spread:
                sentences.append(
                    f"log 1 alone shows {what} of {first[name]:.4g} ± {first[std]:.1g} {unit}, log"
                    f" {number} {one[name]:.4g} ± {one[std]:.1g} {unit}: what they share is between"
                    " them, and neither may be right"
                )
    return sentences

"""Record of each log of a fit, with the delay and the gap that this log alone shows.

All logs of a fit share one delay and one gap. If a log alone shows a delay or gap that differs from
the first log, the report has a note.
"""

import numpy as np

from ...base.units import DEG
from ...logs.channel.channel import Channel
from ..compress.harmonic_summary import summarise
from ..noise.noise_model import autoregression
from ..preliminary.alignment import SHAFTS, START, Start
from ..preliminary.delay import TOLD
from ..preliminary.linear_fit import LinearFit
from ..preliminary.nuisance import own_terms
from ..solve.least_squares import Solution
from .comparisons.same_rig import phasors
from .record import Record

_DIFFERENT = 5.0
"""Standard errors above which a difference between logs is reported; chosen value."""


_CLEAR = 5.0  # an order above these standard errors determines a start angle; chosen value


class LogStart(Record, frozen=True):
    """Angles of both shafts, relative to the first log, at which the angles of a log are zero.

    Each angle has a standard error, which is 0 for an angle that is not fitted. Both are None if
    no order is significant in both logs, so that the start angle is not known.
    """

    driving_deg: float | None
    driving_std_deg: float | None
    driven_deg: float | None
    driven_std_deg: float | None


class LogAlone(Record, frozen=True):
    """Delay and gap that one log alone shows, with their standard errors.

    The gap is the difference of the offsets of flank B and flank A, after removal of the delay that
    all logs share. A value that the log does not determine is None.
    """

    delay_s: float | None = None
    delay_std_s: float | None = None
    gap_deg: float | None = None
    gap_std_deg: float | None = None


class LogRecord(Record, frozen=True):
    """One log of a fit.

    **Arguments**
    - `source`, `sha256`: file and digest. - `zero`: its angles are zero at the first sample
      ("start") or at the encoder reading zero ("reading").
    - `start`: start angles. - `zero_readings`: shaft → encoder reading, see `_zero_reading`.
    - `samples`: number of samples read, used, used on each flank, and not used (masked).
    - `alone`: what this log alone shows.
    """

    source: str
    sha256: str
    zero: str
    start: LogStart
    zero_readings: dict[str, int | float | None]
    samples: dict[str, int]
    alone: LogAlone


def log_record(linear: LinearFit, solution: Solution, log: int) -> LogRecord:
    """Return the record of one log; `log` counts from 0."""
    one, rows = linear.inputs[log].log, linear.rows[log]
    used = dict.fromkeys("AB", 0)
    for run in rows.runs:
        used[run.segment.flank] += rows.size * len(run.rows)
    total = sum(used.values())
    return LogRecord(
        source=one.source,
        sha256=one.sha256,
        zero=one.zero,
        start=start_of(linear, solution, log),
        zero_readings={
            shaft: None if channel is None else _zero_reading(channel, one.zero)
            for shaft, channel in (("driving", one.driving), ("driven", one.driven))
        },
        samples={
            "read": len(one),
            "used": total,
            "forward": used["A"],
            "backward": used["B"],
            "masked": len(one) - total,
        },
        alone=fit_log_alone(linear, log),
    )


def _zero_reading(channel: Channel, zero: str) -> int | float:
    """Return the reading at which the angle is zero: the first reading, unless it is a spike.

    If the angles are zero at the reading zero (`zero` is "reading"), the result is instead the
    first reading of the log, which shows where the log starts.
    """
    return channel.origin if zero == "start" else channel.reading[0].item()


def start_of(linear: LinearFit, solution: Solution, log: int) -> LogStart:
    """Return the start angles of a log relative to the first log; `log` counts from 0."""
    found: list[float | None] = []
    fitted = [shaft for shaft in SHAFTS if f"{START[shaft]}_of_{log + 1}" in solution.names]
    told = _told_shafts(linear, log) if fitted else set()
    for shaft in SHAFTS:
        if shaft in fitted and shaft not in told:
            found += [None, None]
            continue
        value, std = getattr(linear.starts[log], shaft), 0.0
        name = f"{START[shaft]}_of_{log + 1}"
        if name in solution.names:
            place = solution.names.index(name)
            value += float(solution.values[place])
            std = float(np.sqrt(solution.covariance[place, place]))
        found += [value / DEG % 360, std / DEG]
    return LogStart(*found)


def _told_shafts(linear: LinearFit, log: int) -> set[str]:
    """Return the shafts with an order that is significant in the first log and in this one."""
    first, other = (phasors(linear.rows[k], linear.model.terms, Start()) for k in (0, log))
    clear = [
        {key for key, (value, std) in each.items() if abs(value) > _CLEAR * std}
        for each in (first, other)
    ]
    return {harmonic.shaft for harmonic, _ in clear[0] & clear[1]}


def fit_log_alone(linear: LinearFit, log: int) -> LogAlone:
    """Return delay and gap from the rows of one log alone; `log` counts from 0."""
    if len(linear.rows) == 1:
        summary, filter_, own = linear.summary, linear.filter, linear.own
    else:
        summary = summarise([linear.rows[log]], linear.model.terms)
        filter_ = autoregression(summary)
        own = own_terms(summary, filter_)
    delay: tuple[float | None, float | None] = (None, None)
    if "delay" in own.names and own.left("delay") > TOLD:
        step, std = own.estimate("delay", own.names)
        delay = linear.channels[log].delay_s + step, std
    if len(summary.flanks) != 2 or linear.model.given is not None:
        return LogAlone(*delay)  # a given flank model shares its parameters between the flanks
    known = summary.without(["delay"])
    offsets, variances = [], []
    for flank in known.flanks:
        factor = flank.factor(filter_)
        inverse = np.linalg.inv(factor[:-1, :-1])
        place = known.columns.index("offset")
        rows = max(flank.rows - len(inverse), 1)
        offsets.append(float(inverse[place] @ factor[:-1, -1]))
        variances.append(float(inverse[place] @ inverse[place]) * factor[-1, -1] ** 2 / rows)
    gap = (offsets[1] - offsets[0]) / DEG
    return LogAlone(*delay, gap, float(np.sqrt(sum(variances))) / DEG)


def differences(logs: tuple[LogRecord, ...], *, of_gaps: bool) -> list[str]:
    """Return sentences on logs whose delay or gap differs significantly from the first log.

    Gaps are compared if `of_gaps` is true. If a shaft makes only a part of a turn, the gap of a log
    alone is that of its constant term, which the log does not determine.
    """
    alone = [log.alone for log in logs]
    delays = [(one.delay_s, one.delay_std_s) for one in alone]
    gaps = [(one.gap_deg, one.gap_std_deg) for one in alone]
    return [
        *_differing(delays, "s", "a delay"),
        *(_differing(gaps, "°", "a gap between the flanks") if of_gaps else []),
    ]


def _differing(alone: list[tuple[float | None, float | None]], unit: str, what: str) -> list[str]:
    first, first_std = alone[0]
    sentences = []
    for number, (value, std) in enumerate(alone[1:], 2):
        if value is None or std is None or first is None or first_std is None:
            continue
        if abs(value - first) > _DIFFERENT * float(np.hypot(std, first_std)):
            sentences.append(
                f"log 1 alone shows {what} of {first:.4g} ± {first_std:.1g} {unit}, log"
                f" {number} {value:.4g} ± {std:.1g} {unit}: what they share is between"
                " them, and neither may be right"
            )
    return sentences

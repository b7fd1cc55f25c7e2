"""What the logs of one fit must be (of one pair, distinct, long enough), and what was seen."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

from ..base.errors import LogError, NoAnswerError, UsageError
from ..logs.checks.ratio import SeenRatio
from ..logs.encoder_log import EncoderLog
from ..logs.lines.search import Line
from ..logs.motion.segments import Segments
from ..model.columns import row_duration
from ..model.density import LAGS
from ..model.mixed_fit import MixedFit
from ..model.rows import Shafts, Wave
from ..pair.gear_pair import Drive, GearPair, pair_from_spec
from ..pair.schema import Flank
from .given import GivenModel


@dataclass(frozen=True, eq=False)
class Identified:
    """The mixed model fitted to logs, and what was seen of them at the door.

    `short`: flanks without a stroke that is long enough. `given`: flank model of the user.
    """

    logs: Sequence[EncoderLog]
    core: MixedFit
    lines: list[Line]
    segments: list[Segments]
    ratios: list[SeenRatio]
    short: tuple[Flank, ...]
    given: GivenModel | None = None

    def name(self, log: int) -> str:
        """Return the name of a log and a colon, or nothing for a single log."""
        return f"{PurePath(self.logs[log].source).name}: " if len(self.logs) > 1 else ""


def stated_drive(log: EncoderLog) -> GearPair | Drive:
    """Return the gears or the drive that the options of the log state, such as its ratio.

    **Raises** `ValueError` for a log that was read with a pair, because the log does not keep it.
    """
    if log.spec is None:
        raise ValueError(
            "Argument `pair` must be given for a log that was read with a pair, but is None."
        )
    return pair_from_spec(log.spec)


def require_pair(log: EncoderLog, pair: GearPair | Drive) -> None:
    """Refuse a log that was read with another ratio than that of the pair."""
    if log.ratio != pair.ratio:
        raise LogError(
            f"this log was read with the ratio {log.ratio}, but the pair has {pair.ratio}; read it"
            " with the pair that it is fitted with.",
            where=log.source,
        )


def require_distinct(logs: Sequence[EncoderLog]) -> None:
    """Refuse a log that is given twice."""
    for number, log in enumerate(logs):
        for other in logs[:number]:
            if log is other or (log.sha256 and log.sha256 == other.sha256):
                same = log.source == other.source
                seen = "given twice" if same else f"the same data as {other.source}"
                raise UsageError(f"{seen}; give every log once.", where=log.source)


def usable(
    shafts: Sequence[Shafts], waves: Sequence[Wave], where: str
) -> tuple[tuple[Shafts, ...], tuple[Flank, ...]]:
    """Return the logs without the runs of a flank on which all runs are too short for rows.

    The second result names these flanks.

    **Raises** `NoAnswerError` if no run is left.
    """
    highest = max((wave.cycles(shafts[0].ratio) for wave in waves), default=1.0)
    found = [one for one in shafts if one.runs]
    row_s = row_duration(found, highest) if found else 0.0
    long = {
        run.flank
        for one in found
        for run in one.runs
        if (run.stop - run.start) // max(1, round(row_s / one.interval_s)) > LAGS + 1
    }
    if not long:
        raise NoAnswerError(
            f"no flank has {LAGS + 2} readings of this table; read more places, or every place"
            " several times."
            if any(one.still for one in found)
            else f"no stretch of certain contact on one flank holds {LAGS + 2} averaged samples;"
            " record longer strokes at a steady speed.",
            where=where,
        )
    seen: set[Flank] = {run.flank for one in found for run in one.runs}
    kept = [replace(one, runs=tuple(r for r in one.runs if r.flank in long)) for one in shafts]
    return tuple(kept), tuple(seen - long)

"""What the logs of one fit must be: of one pair, distinct, and long enough."""

from collections.abc import Sequence

from ..base.errors import LogError, NoAnswerError, UsageError
from ..logs.encoder_log import EncoderLog
from ..pair.gear_pair import Drive, GearPair
from ..pair.schema import HarmonicOrders
from .compress.harmonic_summary import HarmonicSummary
from .preliminary.model_selection import have_one_zero
from .settings import FitSettings


def require_pair(log: EncoderLog, pair: GearPair | Drive) -> None:
    """Refuse a log that was read with another ratio than that of the pair."""
    if log.ratio != pair.ratio:
        raise LogError(
            f"this log was read with the ratio {log.ratio}, but the pair has {pair.ratio}; read it"
            " with the pair that it is fitted with.",
            where=log.source,
        )


def require_one_phase(
    logs: Sequence[EncoderLog], orders: HarmonicOrders, settings: FitSettings
) -> None:
    """Refuse fractional orders of logs without a common zero; their phases differ in every log."""
    if len(logs) == 1 or have_one_zero(logs, settings):
        return
    for shaft in ("driving", "driven"):
        for order in getattr(orders, f"{shaft}_orders"):
            if not isinstance(order, int):
                raise UsageError(
                    f"{shaft} order {order} has another phase in every log, because no position of"
                    " the gears determines it; fit the logs one by one, or say --same-zero if both"
                    " encoders count whole turns from one zero in all of them.",
                    where=", ".join(log.source for log in logs),
                )


def require_distinct(logs: Sequence[EncoderLog]) -> None:
    """Refuse a log that is given twice."""
    for number, log in enumerate(logs):
        for other in logs[:number]:
            if log is other or (log.sha256 and log.sha256 == other.sha256):
                same = log.source == other.source
                seen = "given twice" if same else f"the same data as {other.source}"
                raise UsageError(f"{seen}; give every log once.", where=log.source)


def require_rows(summary: HarmonicSummary, where: str) -> None:
    """Refuse logs with fewer rows on a flank than coefficients; `where` names the logs."""
    columns = summary.columns.width - 1
    for flank in ("A", "B"):
        found = [f for f in summary.flanks if f.flank == flank]
        rows = sum(f.rows for f in found)
        usable = rows - sum(f.heads.shape[0] * f.heads.shape[1] for f in found)
        if (found and usable <= columns) or not summary.flanks:
            raise NoAnswerError(
                f"{rows} averaged samples on flank {flank} are too few for {columns} coefficients"
                " and their noise; record more turns, or list fewer orders in [fit].",
                where=where,
            )

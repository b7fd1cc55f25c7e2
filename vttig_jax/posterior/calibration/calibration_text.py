"""The table of coverages people read."""

from typing import TYPE_CHECKING

from ...base.tables import text_table
from .case import CaseResult, Ranks

if TYPE_CHECKING:
    from .calibrate import Calibration

_HEADERS = (
    "scenario",
    ("rate", "Hz"),
    "turns",
    "N",
    "rigs",
    ("68 %", "%"),
    ("95 %", "%"),
    ("95 % white", "%"),
    "AR order",
    "verdict",
)


def calibration_text(found: "Calibration") -> str:
    """Coverage of every case, from the worst to the best parameter, and the verdict in words."""
    rows = [_row(found, case) for case in found.cases]
    parts = [text_table(rows, _HEADERS, align="lrrrrrrrrl")]
    parts += [_sampled_row(case) for case in found.cases if case.sampled is not None]
    parts.append(
        "Coverage of nominal 68 % and 95 % intervals, lowest to highest of the parameters; N"
        " samples in all directions, turns of the driving shaft in each. White: the same logs,"
        " every sample counted as independent."
    )
    for cell in found.failed:
        parts.append(f"{cell.case}: {cell.name}, {cell.what}: p = {cell.probability:.1e}")
    parts += [f"{case}: its intervals hold although its model is wrong" for case in found.unseen]
    kinds = {case.scenario.holds for case in found.cases}
    words = {True: "right models hold", False: "wrong ones are seen to fail"}
    verdict = "yes; " + ", ".join(words[kind] for kind in (True, False) if kind in kinds)
    parts.append(f"calibrated: {verdict if found.is_calibrated else f'NO; {found.sentence}'}")
    return "\n\n".join(parts)


def _row(found: "Calibration", case: CaseResult) -> list[str]:
    s = case.scenario
    return [
        s.case,
        f"{s.rate_hz:g}",
        f"{s.turns:.2f}",
        str(case.samples),
        str(len(case.ranks)),
        _range(case, case.ranks, 0.68),
        _range(case, case.ranks, 0.95),
        _range(case, case.white_samples, 0.95),
        f"{case.orders.min()}–{case.orders.max()}",
        found.verdict(case),
    ]


def _range(case: CaseResult, ranks: Ranks, level: float) -> str:
    low, high = (100 * share for share in case.range_of(ranks, level))
    return f"{low:.1f}–{high:.1f}"


def _sampled_row(case: CaseResult) -> str:
    assert case.sampled is not None  # held by the caller
    ranks = case.sampled.ranks
    return (
        f"{case.scenario.case}: {len(ranks)} rigs sampled, 68 % {_range(case, ranks, 0.68)} %,"
        f" 95 % {_range(case, ranks, 0.95)} %, longest autocorrelation"
        f" {case.sampled.tau.max():.0f} of {case.sampled.steps} steps"
    )

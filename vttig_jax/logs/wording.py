"""The report of an inspection, laid out to be read from top to bottom."""

from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING

from ..base.tables import key_values, text_table
from ..base.units import REV
from .sampling import Sampling

if TYPE_CHECKING:
    from .inspection import ColumnReport, Inspection

WIDTH = 100

MOST_LINES = 12
"""Rows of a table before it is cut short."""


def inspection_text(report: "Inspection") -> str:
    """All sections of a report; empty ones are left out."""
    segments = report.segments
    parts = [
        f"{report.source}\n",
        column_table(report.columns),
        key_values(
            [
                *sampling_rows(report.sampling, segments.read),
                ("angle zero", "first sample" if report.zero == "start" else "reading zero"),
                ("ratio", report.ratio.short),
            ]
        ),
        key_values(
            [
                ("flank A (forward)", f"{segments.forward} samples"),
                ("flank B (backward)", f"{segments.backward} samples"),
                ("masked", f"{segments.masked} samples (ramps, dwell, gap crossing)"),
            ],
            title="what a fit can use",
        ),
        _motion_table(report),
        _plateau_table(report),
        _spectrum_table(report),
        _lines(report),
        bullets("note", _remarks(report)),
    ]
    return "\n\n".join(part.rstrip() for part in parts if part)


def column_table(columns: "Sequence[ColumnReport]") -> str:
    """One row a column of the log."""
    rows = [
        (
            c.role or "",
            c.name,
            c.unit,
            f"{c.low:.9g}",
            f"{c.high:.9g}",
            None if c.turns is None else f"{c.turns:.4g}",
            None if c.resolution_arcsec is None else f"{c.resolution_arcsec:.3g}",
            f"{c.wraps} at {c.modulus:.6g}" if c.modulus is not None else "no",
        )
        for c in columns
    ]
    heads = ["used as", "column", "unit", "lowest", "highest", "turns", ("step", "″"), "wraps"]
    return text_table(rows, heads, align="lllrrrrr")


def sampling_rows(sampling: Sampling, rows: int) -> list[tuple[str, str]]:
    """Name and value of everything about the time stamps."""
    share = sampling.jitter_s * sampling.rate_hz
    found = [
        ("samples", f"{rows} in {sampling.duration_s:.6g} s"),
        ("rate", f"{sampling.rate_hz:.6g} Hz (every {1 / sampling.rate_hz:.4g} s)"),
        ("jitter", f"{sampling.jitter_s:.2g} s rms, {share:.1%} of it" if share > 1e-6 else "none"),
        (
            "gaps",
            f"{sampling.gaps}, the longest {sampling.longest_s:.4g} s" if sampling.gaps else "none",
        ),
    ]
    if sampling.duplicates:
        found.append(("repeated stamps", str(sampling.duplicates)))
    return found


def bullets(title: str, sentences: Sequence[str]) -> str:
    """Sentences as a list, one "title:" each, wrapped."""
    indent = " " * (len(title) + 2)
    return "\n".join(
        fill(f"{title}: {s}", WIDTH, subsequent_indent=indent, break_long_words=False)
        for s in sentences
    )


def _motion_table(report: "Inspection") -> str:
    motion = report.segments.motion
    rows = [
        (m.kind, str(m.start), str(m.stop), f"{60 * m.speed / REV:.4g}")
        for m in motion[:MOST_LINES]
    ]
    if len(motion) > MOST_LINES:
        rows.append((f"and {len(motion) - MOST_LINES} more", "", "", ""))
    return text_table(rows, ["motion", "from sample", "to", ("mean speed", "rpm")])


def _plateau_table(report: "Inspection") -> str:
    rows = [
        (p.flank, f"{p.speed_rpm:.5g}", str(p.segments), str(p.samples))
        for p in report.plateaus[:MOST_LINES]
    ]
    if not rows:
        return ""
    if len(report.plateaus) > MOST_LINES:
        rows.append((f"and {len(report.plateaus) - MOST_LINES} more", "", "", ""))
    return text_table(rows, ["flank", ("mean driving speed", "rpm"), "segments", "samples"])


def _spectrum_table(report: "Inspection") -> str:
    cells: dict[tuple[str, int], dict[str, str]] = {}
    for line in report.spectrum:
        row = cells.setdefault((line.shaft, line.order), {})
        row[line.flank] = f"{line.amplitude_arcsec:.3g}"
    if not cells:
        return ""
    rows = [(f"{s} {k}", row.get("A"), row.get("B")) for (s, k), row in cells.items()]
    return text_table(rows, ["order", ("flank A", "″"), ("flank B", "″")])


def _lines(report: "Inspection") -> str:
    """Lines of the blind search; with their period where there is one steady speed."""
    if not report.lines:
        return ""
    speeds = [abs(plateau.speed_rpm) for plateau in report.plateaus]
    steady = max(speeds) <= 1.05 * min(speeds)
    rows = [
        (
            f"{line.cycles_per_rev:.5g}",
            f"{line.cycles_std:.1g}",
            f"{60 / (max(speeds) * line.cycles_per_rev):.4g}" if steady else None,
            f"{line.amplitude_arcsec:.3g}",
            f"{line.amplitude_std_arcsec:.1g}",
            f"{line.false_alarm:.1g}",
        )
        for line in report.lines
    ]
    head = [
        ("line found blind", "cycles/rev"),
        ("std", "cycles/rev"),
        ("period", "s"),
        ("amplitude", "″"),
        ("std", "″"),
        "false alarm",
    ]
    return text_table(rows, head)


def _remarks(report: "Inspection") -> list[str]:
    remarks = list(report.notes)
    if report.ratio.verdict not in ("agrees", "none"):
        remarks.insert(0, report.ratio.sentence)
    for one in report.commensurate:
        remarks.append(
            f"at {one.speed_rpm:.5g} rpm the {one.shaft} encoder passes"
            f" {one.counts_per_sample:.4f} counts a sample, a whole number: its quantisation does"
            " not average out and biases the first order; change the speed or the rate slightly"
        )
    for one in report.aliased:
        name = "tooth-mesh" if one.shaft == "mesh" else one.shaft
        orders = (
            f"order {one.order}"
            if one.order == one.highest
            else (f"orders {one.order} to {one.highest}")
        )
        remarks.append(
            f"{name} {orders} of the fit lie above half the sampling rate at"
            f" {one.speed_rpm:.4g} rpm and alias; sample faster or take them out of [fit]"
        )
    return [*remarks, *report.support.sentences]
